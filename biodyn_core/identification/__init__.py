"""Identification of a subject from recordings: two-phase fits per case, their fusion, and the uncertainty."""
