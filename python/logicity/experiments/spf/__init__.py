"""Experiments of Safe Path Following."""
