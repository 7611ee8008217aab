"""The seated body: parameters, subject, matrices, effects in their assembly, model and synthetic recordings."""
