"""A model's prediction beside an event that it was not fitted to."""
