"""Answers: accelerations that sensors show of a subject on the seat of a case."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, N_SEGMENTS
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, apply_to_seat, apply_to_sensors
from biodyn_core.identification.problem import Case

RUNAWAY_MPS2: Final = 1e5
"""A larger acceleration, of 10,000 g, means that the simulation is unstable."""


class UnstableSimulation(InputError):
    """The simulation of a fitted subject is unstable in an event."""


def answer(subject: Subject, case: Case, effects: Sequence[AppliedEffect] = (), plain: Floats | None = None) -> Floats:
    """Accelerations (n, 5) that sensors show of a subject with effects added.

    plain (n, 5): the answer without them. It is returned if the simulation is unstable, and it saves the simulation if
    all effects are on sensors.
    """
    if plain is not None and effects and all(one.effect.place == "sensor" for one in effects):
        whole = np.zeros((len(plain), N_SEGMENTS))
        whole[:, MEASURED_SEGMENT_INDEX] = plain
        return apply_to_sensors(effects, whole, case.rate_hz, case.channels)[:, MEASURED_SEGMENT_INDEX]
    (found,) = answers(dataclasses.replace(subject, effects=(*subject.effects, *effects)), [case])
    return plain if plain is not None and not is_stable(found) else found


def is_stable(answered: Floats) -> bool:
    """Whether an answer (n, 5) comes from a stable simulation."""
    return bool(np.abs(answered).max() < RUNAWAY_MPS2)  # False for NaN


def first_unstable(subject: Subject, cases: Sequence[Case]) -> Case | None:
    """The first case in which the simulation of a subject is unstable; None without any."""
    return next((case for case, one in zip(cases, answers(subject, cases), strict=True) if not is_stable(one)), None)


def check_stable(subject: Subject, cases: Sequence[Case]) -> None:
    """Raise UnstableSimulation, an InputError, for the first case in which the simulation of a subject is unstable."""
    if (case := first_unstable(subject, cases)) is not None:
        raise UnstableSimulation(
            f"{case.name}: the simulation with the fitted parameters is unstable; the seat reads up to"
            f" {np.abs(case.seat_mps2).max():.0f} m/s^2: look for outliers or a wrong unit, or leave the recording out"
        )


def answers(subject: Subject, cases: Sequence[Case]) -> list[Floats]:
    """Accelerations (n, 5) that sensors show of a subject in each case; all NaN if the simulation is unstable."""
    return sensed(subject, cases, accelerations(subject, cases))


def accelerations(subject: Subject, cases: Sequence[Case]) -> list[Floats]:
    """Accelerations (n, 6) of a subject's segments in each case, without the effects on sensors."""
    chain = Chain.of(subject)
    with np.errstate(all="ignore"):  # callers check for values that are not finite
        return [_simulated(subject, chain, case) for case in cases]


def sensed(subject: Subject, cases: Sequence[Case], accel: Sequence[Floats]) -> list[Floats]:
    """Accelerations (n, 5) that sensors show of segments (n, 6) in each case; all NaN if these are not finite."""
    return [_sensed(subject, case, one) for case, one in zip(cases, accel, strict=True)]


def _simulated(subject: Subject, chain: Chain, case: Case) -> Floats:
    seat = apply_to_seat(subject.effects, case.seat_mps2, case.rate_hz, case.channels)
    return Stepper(chain, case.rate_hz, chain.substeps(case.rate_hz)).push(seat, channels=case.channels)


def _sensed(subject: Subject, case: Case, accel: Floats) -> Floats:
    if not np.isfinite(accel).all():
        return np.full((len(accel), len(MEASURED_SEGMENT_INDEX)), np.nan)
    return apply_to_sensors(subject.effects, accel, case.rate_hz, case.channels)[:, MEASURED_SEGMENT_INDEX]
