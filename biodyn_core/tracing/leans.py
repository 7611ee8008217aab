"""Leans: sensors that lean while they move, told by their own gyros.

Recordings set such a sensor upright, so no model is asked to explain it; what is usual goes unsaid, more is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Case
from biodyn_core.kernels.lean import follow_up
from biodyn_core.segments import MEASURED_SEGMENTS

Floats = NDArray[np.float64]

USUAL_TIMES: Final = 3.0
"""A lean of so many times its usual spread is no longer usual."""

PLAIN_SHARE: Final = 0.3
"""... and less of it, where nothing else departs: 1.3 deg."""


def leaning(cases: Sequence[Case], usual_lean: float, plain: bool) -> tuple[AppliedEffect, ...]:
    """The sensors whose mean lean over all events is beyond the usual, as tilts; those without gyro are left out.

    plain: nothing else of this body or its sensors departs as far as usual.
    """
    found = []
    for place, sensor in enumerate(MEASURED_SEGMENTS):
        names = [f"{sensor}.rate_{axis}" for axis in "xyz"]
        if not cases or not all(name in case.channels for case in cases for name in names):
            continue
        each = [_mean_up(case, names, case.compared[:, place]) for case in cases if case.compared[:, place].any()]
        if not each:
            continue
        lean = -np.mean(each, axis=0)
        if float(np.linalg.norm(lean)) > USUAL_TIMES * usual_lean * (PLAIN_SHARE if plain else 1.0):
            x, y = np.clip(lean, -0.4, 0.4).tolist()
            found.append(AppliedEffect(CATALOGUE["tilt"], sensor, {"lean_x": x, "lean_y": y}))
    return tuple(found)


def lean_deg(tilt: AppliedEffect) -> float:
    """How far a tilt leans."""
    return float(np.degrees(np.arcsin(np.hypot(tilt.values["lean_x"], tilt.values["lean_y"]))))


def _mean_up(case: Case, rates: Sequence[str], compared: NDArray[np.bool_]) -> Floats:
    """Where up lies on the mean along the sensor's two axes that were level at rest, (2,), where it is compared."""
    turning = np.ascontiguousarray(np.nan_to_num(np.column_stack([case.channels[name] for name in rates])))
    up = np.empty_like(turning)
    follow_up(turning, np.zeros_like(turning), 1.0 / case.rate_hz, 0.0, up)
    return np.asarray(up[compared, :2].mean(axis=0))
