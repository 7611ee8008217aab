"""Fits with a prior: how many data they need beside fits without one."""
