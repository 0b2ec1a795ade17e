"""Experiments of Visual Action Prediction."""
