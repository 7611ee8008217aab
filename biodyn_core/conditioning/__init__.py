"""From raw stamps and samples of a sensor to evenly spaced, level, gravity-free, low-passed ones."""
