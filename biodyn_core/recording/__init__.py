"""One event of six sensors on the seat's grid, zero-phase: what subjects are fitted to."""
