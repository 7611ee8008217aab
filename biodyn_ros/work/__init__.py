"""Long computations: executors, tasks, and checkpoints of finished parts."""
