"""Signals over frequency and time: ISO weightings, spectra and waterfalls."""
