"""How kernels are compiled: the only module that imports numba, and where its cache goes.

With numba's own switch, NUMBA_DISABLE_JIT=1, numba is not imported at all: its import takes as long as that of numpy.
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
    """The arrays as a kernel reads them fastest: uncompiled, by memory views, whose elements are Python's own numbers.

    A kernel that is called with them may index and slice, no more.
    """
    return arrays if COMPILED else tuple(memoryview(array) for array in arrays)


def cache_folder() -> str | None:
    """A folder of the user's own for compiled code, or None where nothing is writable (read-only installs, no HOME)."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    user = os.getuid() if hasattr(os, "getuid") else "user"
    candidates = [Path(base) / "biodyn"] if base else []
    if os.environ.get("HOME"):
        candidates.append(Path(os.environ["HOME"]) / ".cache" / "biodyn")
    candidates.append(Path(tempfile.gettempdir()) / f"biodyn-cache-{user}")
    for folder in candidates:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # A folder somebody else owns could feed us their machine code.
            if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except OSError:
            continue
    return None


CACHE: Final = cache_folder() if COMPILED else None
"""Where compiled code is kept, None where it cannot be."""


def compiled(function: F) -> F:
    """Compile with numba where it is present, cached where a cache can be kept; otherwise return the function."""
    return _compiled(function, forceinline=False)


def inlined(function: F) -> F:
    """The same for a part of a kernel, which becomes lines of its caller however long both are.

    Where that is left to the compiler it ends at some length, and a call with ten arrays costs more than the part.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: F, forceinline: bool) -> F:
    if numba is None:
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = CACHE or before
    try:
        # numpy's error model: a division by zero gives inf, as it does in the uncompiled twin.
        options = {"cache": CACHE is not None, "error_model": "numpy", "forceinline": forceinline}
        wrapped: F = numba.njit(**options)(function)
        return wrapped
    finally:
        numba.config.CACHE_DIR = before
