"""Check of a sensor by another one that was recorded beside it."""
