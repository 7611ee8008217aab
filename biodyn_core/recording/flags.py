"""Flags of samples: stretches of set flags, widened flags, and membership."""

from __future__ import annotations

import numpy as np

from biodyn_core.base.arrays import Flags, Integers


def stretches(flags: Flags) -> list[tuple[int, int]]:
    """(first, end) of every stretch of set flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def around(flags: Flags, before: int, after: int, least: int = 1) -> Flags:
    """Flags (n,) widened by so many samples before and after each stretch, without stretches shorter than `least`."""
    wide = np.zeros(flags.shape, dtype=np.bool_)
    for begin, end in stretches(flags):
        if end - begin >= least:
            wide[max(0, begin - before) : end + after] = True
    return wide


def among(values: Integers, ascending: Integers) -> Flags:
    """Flags (n,) of values that are among ascending ones (m,)."""
    if ascending.size == 0:
        return np.zeros(values.shape, dtype=np.bool_)
    at = np.minimum(np.searchsorted(ascending, values), ascending.size - 1)
    return ascending[at] == values
