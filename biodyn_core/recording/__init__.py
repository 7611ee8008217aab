"""One event of six sensors on the seat's grid, zero-phase, for fits of subjects."""
