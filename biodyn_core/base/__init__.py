"""Shared basics: array types, segments, errors, settings, YAML files and wording."""
