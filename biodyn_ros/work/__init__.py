"""Long work: where it is done, and what is kept of it when it ends early."""
