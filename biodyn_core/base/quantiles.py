"""Quantiles of the normal distribution."""

from __future__ import annotations

from typing import Final

NORMAL_95: Final = 1.959964
"""Half width of a 95 % interval in standard deviations."""
