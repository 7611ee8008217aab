"""Own laws: the same body without that law of its background which an answer names.

The paper's background consists of laws of all joints and errors of all sensors. One of them may be large in a body, and
then an answer that names it is wrong in the study and right of the body.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
from world.effects import sitting
from world.effects.background import NOTHING, Background
from world.effects.sitting import Sitting

from biodyn_core.base.segments import SEGMENTS
from blind.tracing.outcome import Cause

OF_JOINTS: Final[Mapping[str, tuple[str, ...]]] = {
    "nonlinear_stiffness": ("bent", "cubic"),
    "quadratic_damping": ("squared",),
    "dry_friction": ("friction_n",),
}
OF_SENSORS: Final[Mapping[str, tuple[str, ...]]] = {
    "gain": ("gain",),
    "clock": ("late_s",),
    "tilt": ("lean_rad",),
    "skin": ("skin_hz",),
}
"""Fields of the background by class; those of joints by segment, those of sensors by segment after the seat."""


def without_law(one: Sitting, named: Cause) -> Sitting | None:
    """The sitting, simulated without the background's law of the named class at the named site; None if it has none."""
    background = _without(one.background, named)
    if background is None:
        return None
    (found,) = sitting.together([dataclasses.replace(one, background=background)])
    return found


def _without(background: Background, named: Cause) -> Background | None:
    fields = {**OF_JOINTS, **OF_SENSORS}.get(named.mechanism, ())
    if not fields or named.site not in SEGMENTS:
        return None
    at = SEGMENTS.index(named.site) + (named.mechanism in OF_SENSORS)
    changed = {}
    for field in fields:
        values, absent = getattr(background, field).copy(), getattr(NOTHING, field)[at]
        if np.array_equal(values[at], absent):
            continue
        values[at] = absent
        changed[field] = values
    return dataclasses.replace(background, **changed) if changed else None
