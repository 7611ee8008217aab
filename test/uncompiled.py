"""Kernels as ordinary Python, in a process that has compiled ones."""

from __future__ import annotations

import sys

import pytest


class Uncompiled:
    """Kernels call each other by name: while it lasts those names are plain functions too."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        package = "biodyn_core.kernels"
        modules = [module for name, module in sys.modules.items() if f"{name}.".startswith(f"{package}.")]
        for module in modules:
            for name, value in list(vars(module).items()):
                if hasattr(value, "py_func"):
                    monkeypatch.setattr(module, name, value.py_func)
