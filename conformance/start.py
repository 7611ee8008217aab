"""The start of a record: gravity is present from the first sample, and must not count as a step of 1 g."""

from __future__ import annotations

from typing import Final

import numpy as np

from biodyn_core.base.segments import HEAD, SENSORS
from conformance import record, twins
from conformance.record import GRAVITY_MPS2
from conformance.table import Row, RowTable

RATE_HZ: Final = 1129.3
SECONDS: Final = 8.0
NOTHING: Final = 10.0 * record.NOISE_MPS2
GRAVITIES_MPS2: Final = (9.78, 9.80665, 9.832, 9.6, 10.0, 9.9)
"""Equator, standard, pole, and sensors with a gain or bias."""

TOLERANCE: Final = 0.001


def rest_rows() -> list[Row]:
    """Six sensors at rest."""
    time = record.instants(RATE_HZ, SECONDS)
    found = record.replayed({sensor: record.stream(sensor, time, np.zeros(time.size)) for sensor in SENSORS}).document
    rows = [_nothing(f"VDV, {sensor}", found["sensors"][sensor]["vdv_mps175"], "m/s¹·⁷⁵") for sensor in SENSORS]
    rows += [_nothing(f"VDV, seat, {a}", found["seat"]["vdv_weighted_mps175"][a], "m/s¹·⁷⁵") for a in "xyz"]
    rows += [_nothing(f"predicted VDV, {HEAD}", found["predicted"][HEAD]["vdv_mps175"], "m/s¹·⁷⁵")]
    rows += [_nothing("DRI, compression", found["dri"]["compression"])]
    rows += [_nothing("HIC15, vertical", found["hic15"]["vertical"])]
    return [*rows, Row("HIC15 as printed, 1 g for 15 ms", found["hic15"]["as_printed"], 0.015, NOTHING)]


def _nothing(what: str, value: float, unit: str = "") -> Row:
    return Row(what, value, 0.0, NOTHING, unit, absolute=True)


def gravity_rows() -> list[Row]:
    """One motion, six different magnitudes of gravity."""
    time = record.instants(RATE_HZ, SECONDS)
    modes = twins.decay(6.0, 5.0, 0.4, 1.5)
    streams = {}
    for sensor, gravity in zip(SENSORS, GRAVITIES_MPS2, strict=True):
        streams[sensor] = record.stream(sensor, time, twins.motion(modes, time) + (gravity - GRAVITY_MPS2))
    found = record.replayed(streams).document["sensors"]
    begin_s = float(time[record.first_counted(time)])
    analog = twins.figures("Wk", modes, begin_s, float(time[-1])).vdv_mps175
    return [
        Row(f"VDV, gravity reads {gravity:g} m/s²", found[sensor]["vdv_mps175"], analog, TOLERANCE, "m/s¹·⁷⁵")
        for sensor, gravity in zip(SENSORS, GRAVITIES_MPS2, strict=True)
    ]


def sections() -> list[RowTable]:
    """All sections; a second."""
    counted = twins.figures("Wk", twins.step(GRAVITY_MPS2, 0.0), 0.0, SECONDS).vdv_mps175
    rest = f"""\
Six sensors at rest, gravity along six different axes from the first sample on. As a step to 1 g it would give a VDV of
{counted:.2f} m/s¹·⁷⁵. Tolerance: ten times the noise of every sensor, {record.NOISE_MPS2:g} m/s²."""
    same = """\
One motion (5 Hz from 6 m/s², decaying with 0.4 s), measured by sensors that read gravity differently, by place, gain or
bias. Reference: the analog curve in closed form. Tolerance: that of Wk."""
    return [RowTable("Rest", rest, tuple(rest_rows())), RowTable("Gravity", same, tuple(gravity_rows()))]
