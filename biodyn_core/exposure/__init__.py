"""What a person is exposed to: doses, injury criteria, limits, and what outlives a process."""
