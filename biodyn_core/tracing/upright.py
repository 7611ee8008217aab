"""Upright: verticals of sensors that lean while they move, set right by their own gyros before anything is modelled.

A reading along the axis that was vertical at rest takes the horizontal motion for vertical once the sensor leans: at
10 deg of lean and 5 m/s^2 fore and aft by 0.9 m/s^2. With rates it is known where up is; that is a fault of measurement
and no effect of the body.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.identification.problem import Case
from biodyn_core.kernels.lean import follow_up
from biodyn_core.segments import MEASURED_SEGMENTS, SEAT, STANDARD_GRAVITY_MPS2

Floats = NDArray[np.float64]

REST_S: Final = 1.0
"""At its begin an event rests for so long: what rates say there is their bias."""

STILL_RADPS: Final = 0.05
"""... unless it is more than this, rms: then up cannot be followed."""

LONGEST_S: Final = 120.0
"""In longer events a bias known to 0.0002 rad/s is more than a degree off at the end."""


def upright(case: Case) -> tuple[Case, list[str]]:
    """A case with the verticals of the seat and the segments along the true vertical, and a line for each that is not.

    A sensor without horizontal axes or rates stays as it is.
    """
    if case.seat_mps2.size > LONGEST_S * case.rate_hz:
        return case, [f"{case.name}: longer than {LONGEST_S:g} s, so lean is not followed"]
    said: list[str] = []
    seat = _vertical(case, SEAT, case.seat_mps2, said)
    columns = [_vertical(case, name, case.measured_mps2[:, i], said) for i, name in enumerate(MEASURED_SEGMENTS)]
    measured = np.where(case.compared, np.column_stack(columns), 0.0)
    return dataclasses.replace(case, seat_mps2=seat, measured_mps2=measured, energy=(measured**2).sum(axis=0)), said


def _vertical(case: Case, sensor: str, along_mps2: Floats, said: list[str]) -> Floats:
    """One sensor's true vertical (n,), from its reading along the axis that was vertical at rest (n,)."""
    names = [f"{sensor}.{name}" for name in ("x", "y", "rate_x", "rate_y", "rate_z")]
    if not all(name in case.channels for name in names):
        return along_mps2
    x, y, *rates = (np.nan_to_num(case.channels[name]) for name in names)
    rates_radps = np.column_stack(rates)
    rest = rates_radps[: max(2, round(REST_S * case.rate_hz))]
    bias = rest.mean(axis=0)
    if float(np.sqrt(((rest - bias) ** 2).mean())) > STILL_RADPS:
        said.append(f"{case.name}: {sensor} turns from the first second on, so its lean is not followed")
        return along_mps2
    up = np.empty_like(rates_radps)
    follow_up(np.ascontiguousarray(rates_radps - bias), 1.0 / case.rate_hz, up)
    force = np.column_stack([x, y, along_mps2 + STANDARD_GRAVITY_MPS2])
    return np.asarray((up * force).sum(axis=1) - STANDARD_GRAVITY_MPS2)
