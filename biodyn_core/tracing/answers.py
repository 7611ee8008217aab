"""Answers of a subject, with more effects, to the seat of a case."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, N_SEGMENTS
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, apply_to_seat, apply_to_sensors
from biodyn_core.identification.problem import Case

RUNAWAY_MPS2: Final = 1e5
"""No body is accelerated so: a joint that a candidate makes softer than nothing has run away."""


def answer(subject: Subject, case: Case, effects: Sequence[AppliedEffect] = (), plain: Floats | None = None) -> Floats:
    """Accelerations (n, 5) that sensors show of a subject with effects added; with plain, that where it runs away.

    plain (n, 5), the answer without, also saves the integration where all that is added is on sensors.
    """
    if plain is not None and effects and all(one.effect.place == "sensor" for one in effects):
        whole = np.zeros((len(plain), N_SEGMENTS))
        whole[:, MEASURED_SEGMENT_INDEX] = plain
        return apply_to_sensors(effects, whole, case.rate_hz, case.channels)[:, MEASURED_SEGMENT_INDEX]
    (found,) = answers(dataclasses.replace(subject, effects=(*subject.effects, *effects)), [case])
    runs_away = not np.abs(found).max() < RUNAWAY_MPS2  # NaN runs away too
    return plain if runs_away and plain is not None else found


def answers(subject: Subject, cases: Sequence[Case]) -> list[Floats]:
    """Accelerations (n, 5) that sensors show of a subject in each case; NaN throughout where it runs away."""
    return sensed(subject, cases, moved(subject, cases))


def moved(subject: Subject, cases: Sequence[Case]) -> list[Floats]:
    """Accelerations (n, 6) of a subject's segments in each case, whatever its sensors show of them."""
    chain = Chain.of(subject)
    with np.errstate(all="ignore"):  # what is not finite is told by its number
        return [_moved(subject, chain, case) for case in cases]


def sensed(subject: Subject, cases: Sequence[Case], moved: Sequence[Floats]) -> list[Floats]:
    """What the subject's sensors show (n, 5) of segments that move so (n, 6) in each case; NaN of what has run away."""
    return [_sensed(subject, case, accel) for case, accel in zip(cases, moved, strict=True)]


def _moved(subject: Subject, chain: Chain, case: Case) -> Floats:
    seat = apply_to_seat(subject.effects, case.seat_mps2, case.rate_hz, case.channels)
    return Stepper(chain, case.rate_hz, chain.substeps(case.rate_hz)).push(seat, channels=case.channels)


def _sensed(subject: Subject, case: Case, accel: Floats) -> Floats:
    if not np.isfinite(accel).all():  # no sensor shows what has run away
        return np.full((len(accel), len(MEASURED_SEGMENT_INDEX)), np.nan)
    return apply_to_sensors(subject.effects, accel, case.rate_hz, case.channels)[:, MEASURED_SEGMENT_INDEX]
