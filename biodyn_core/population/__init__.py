"""People who were never recorded: published measurements, and a distribution of parameters that agrees with them."""
