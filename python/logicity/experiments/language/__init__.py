"""Language questions as a task of experiments, and the solvers that need no language model."""
