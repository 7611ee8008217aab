"""Recorded pulses, which are not part of the repository: NHTSA's dummy heads, Yoganandan's seat pulses."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import HEAD, SEAT
from conformance import record, twins
from conformance.injury import WIDE_RANGE
from conformance.record import GRAVITY_MPS2
from conformance.table import Row, RowTable

Floats = NDArray[np.float64]

RATE_HZ: Final = 10_000.0
QUIET_S: Final = 1.2

HEADS: Final = {"toyota_corolla": (205.75, 345.55), "honda_cr_v": (177.63, 330.60)}
"""HIC15 and HIC36 of the resultant, as given with the recordings: trapezoids over all windows of whole samples."""

HIC_TOLERANCE: Final = 0.001
PULSES_MS: Final = (50, 75, 100, 150, 200)
DRI_TOLERANCE: Final = 1e-4


def data() -> Path:
    """The directory of the recordings: `$BIODYN_DATA` or ../shared/data; it need not exist."""
    return Path(os.environ.get("BIODYN_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")


def head_rows() -> list[Row]:
    """HIC of two frontal impacts, 10 kHz, three axes."""
    rows = []
    for name, wanted in HEADS.items():
        table = np.loadtxt(data() / "nhtsa_head_hic15" / f"{name}.csv", delimiter=",", skiprows=1)
        x, y, z = np.vstack([np.zeros((round(QUIET_S * RATE_HZ), 3)), table[:, 1:] * GRAVITY_MPS2]).T
        time = np.arange(x.size) / RATE_HZ
        streams = {SEAT: record.stream(SEAT, time, np.zeros(time.size)), HEAD: record.stream(HEAD, time, z, x, y)}
        found = record.replayed(streams, conditioning=WIDE_RANGE).document
        for key, hic in zip(("hic15", "hic36"), wanted, strict=True):
            rows.append(Row(f"{key}.resultant, {name}", found[key]["resultant"], hic, HIC_TOLERANCE))
    return rows


def seat_rows() -> list[Row]:
    """DRI of five upward pulses."""
    rows = []
    for length_ms in PULSES_MS:
        at, g = np.loadtxt(
            data() / "yoganandan_spine_pulses" / f"accel_{length_ms}ms.csv", delimiter=",", skiprows=1, unpack=True
        )
        time = record.instants(RATE_HZ, QUIET_S + 1.0)
        up = np.interp(time - QUIET_S, at, g * GRAVITY_MPS2, left=0.0, right=0.0)
        found = record.replayed({SEAT: record.stream(SEAT, time, up)}, conditioning=WIDE_RANGE).document["dri"]
        ahead, behind = [at[0] - 1e-4], [at[-1] + 1e-4, at[-1] + 0.5]
        compression, _ = twins.dynamic_response(
            np.concatenate([ahead, at, behind]), np.concatenate([[0.0], g * GRAVITY_MPS2, [0.0, 0.0]])
        )
        rows.append(Row(f"compression, {length_ms} ms", found["compression"], compression, DRI_TOLERANCE))
    return rows


HEAD_WORDS: Final = f"""\
NHTSA frontal impacts, dummy head, 10 kHz. Reference: the values given with the recordings, trapezoids over all windows
of whole samples. Tolerance: {100.0 * HIC_TOLERANCE:g} %, because the end of a window may lie between two samples."""
SEAT_WORDS: Final = f"""\
Seat pulses of Yoganandan et al. 2021, digitised, sampled at 10 kHz. Reference: the oscillator integrated by DOP853
over the digitised points. Tolerance: {100.0 * DRI_TOLERANCE:g} %, because of corners between two samples."""


def sections() -> list[RowTable]:
    """All sections, about three seconds; FileNotFoundError without the recordings."""
    return [
        RowTable("HIC of recorded head impacts", HEAD_WORDS, tuple(head_rows())),
        RowTable("DRI of seat pulses", SEAT_WORDS, tuple(seat_rows())),
    ]
