"""The machine of a measurement."""

from __future__ import annotations

import os
from pathlib import Path


def machine() -> str:
    """The number of cores and the model of the CPU; unlike ratios, absolute times depend on them."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown CPU")
    return f"{os.cpu_count()} cores, {model}"
