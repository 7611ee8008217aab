"""Exposure of a person: doses, injury criteria, limits, and the checkpoint that outlives a process."""
