"""Learners of Safe Path Following. Needs the extra `learn`."""
