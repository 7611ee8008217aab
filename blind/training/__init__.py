"""Simulated bodies for training and checking the evidence of tracing; none has a form of the blind study."""
