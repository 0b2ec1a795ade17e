"""Experiments: many cells, each a training or a set of answers, from one YAML file. Needs the extra `learn`.

`logicity experiment` runs them. A task says what a cell is, how it is run and measured, and what the paper reports:
`spf` for Safe Path Following, `vap` for Visual Action Prediction, and `language` for language questions.
"""
