"""The blind study of tracing: simulated records with hidden effects are traced before their truths are read."""
