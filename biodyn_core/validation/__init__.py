"""Comparison of a model's prediction with an event that it was not fitted to."""
