"""Experiments of language questions."""
