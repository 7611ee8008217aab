"""Six raw streams in; predictions, measurements, residual and exposure out."""
