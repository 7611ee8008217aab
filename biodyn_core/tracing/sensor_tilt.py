"""Leans: sensors that lean while they move, told by their own gyros.

Recordings set such a sensor upright, so no model is asked to explain it; what is usual goes unsaid, more is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Case

USUAL_TIMES: Final = 3.0
"""A lean of so many times its usual spread is no longer usual."""

PLAIN_SHARE: Final = 0.3
"""... and less of it, where nothing else departs: 1.3 deg."""


def leaning(cases: Sequence[Case], usual_lean: float, plain: bool) -> tuple[AppliedEffect, ...]:
    """The sensors whose mean lean over all events is beyond the usual, as tilts; those not set upright are left out.

    plain: nothing else of this body or its sensors departs as far as usual.
    """
    limit = USUAL_TIMES * usual_lean * (PLAIN_SHARE if plain else 1.0)
    found = []
    for sensor in MEASURED_SEGMENTS:
        if not cases or not all(sensor in case.leans for case in cases):
            continue
        lean = np.mean([case.leans[sensor] for case in cases], axis=0)
        if float(np.linalg.norm(lean)) > limit:
            x, y = np.clip(lean, -0.4, 0.4).tolist()
            found.append(AppliedEffect(CATALOGUE["tilt"], sensor, {"lean_x": x, "lean_y": y}))
    return tuple(found)


def lean_deg(tilt: AppliedEffect) -> float:
    """How far a tilt leans."""
    return float(np.degrees(np.arcsin(np.hypot(tilt.values["lean_x"], tilt.values["lean_y"]))))
