"""Compilation of kernels and its cache; the only module that imports numba.

NUMBA_DISABLE_JIT=1 also skips the import of numba, which takes as long as the import of numpy.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

if os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0"):
    try:
        import numba
    except ImportError:  # apt-only installs: there is no numba package on Ubuntu noble
        numba = None
else:
    numba = None

F = TypeVar("F", bound=Callable[..., Any])

COMPILED: Final = numba is not None


def views(*arrays: Any) -> tuple[Any, ...]:
    """The arrays in the form that a kernel reads fastest: memory views where kernels are not compiled.

    Elements of memory views are Python numbers. A kernel called with them may only index and slice.
    """
    return arrays if COMPILED else tuple(memoryview(array) for array in arrays)


def cache_folder() -> str | None:
    """The user's folder for compiled code, or None where nothing is writable (read-only installs, no HOME)."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    user = os.getuid() if hasattr(os, "getuid") else "user"
    candidates = [Path(base) / "biodyn"] if base else []
    if os.environ.get("HOME"):
        candidates.append(Path(os.environ["HOME"]) / ".cache" / "biodyn")
    candidates.append(Path(tempfile.gettempdir()) / f"biodyn-cache-{user}")
    for folder in candidates:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # A folder of another user could contain foreign machine code.
            if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except OSError:
            continue
    return None


CACHE: Final = cache_folder() if COMPILED else None
"""The folder of compiled code, None without one."""


def compiled(function: F) -> F:
    """Compile with numba if present, cached if there is a cache folder; otherwise return the function."""
    return _compiled(function, forceinline=False)


def inlined(function: F) -> F:
    """Compile a part of a kernel and always inline it.

    The compiler itself stops inlining at some length, and a call with ten arrays costs more than the part.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: F, forceinline: bool) -> F:
    if numba is None:
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = CACHE or before
    try:
        # With numpy's error model a division by zero gives inf, as in uncompiled code.
        options = {"cache": CACHE is not None, "error_model": "numpy", "forceinline": forceinline}
        wrapped: F = numba.njit(**options)(function)
        return wrapped
    finally:
        numba.config.CACHE_DIR = before
