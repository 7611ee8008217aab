"""Plays a bag onto its topics."""
