"""From a fitted subject's residual to the effect that its model lacks."""
