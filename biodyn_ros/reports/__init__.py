"""Shared by the reports: drawings, templates, the verdict on the seat, JSON mappings."""
