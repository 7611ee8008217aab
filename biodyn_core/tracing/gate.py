"""Gate: what is known before any candidate is tried (tracing, 0 and "seconds of data").

Whether the seat would have to hold the person down, and whether the data can carry a verdict at all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.arrays import Floats
from biodyn_core.identification.problem import Case
from biodyn_core.model import Chain, predict
from biodyn_core.segments import MEASURED_SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.subject import Subject
from biodyn_core.tracing.settings import FloorSettings
from biodyn_core.wording import counted

_APART_S: Final = 1.0
"""Peaks closer together are of one shock: two axles, two rails."""

SPOILED: Final = 0.02
"""A sensor of which so much more than of the others is masked is left out of that event."""


@dataclass(frozen=True)
class Contents:
    """What events hold: seconds without shocks, how many shocks, and how many hard ones among them."""

    road_s: float
    shocks: int
    hard_shocks: int


def pulled_down(subject: Subject, case: Case) -> float:
    """The largest force with which the seat's joint holds the pelvis down in a prediction, over the weight it carries.

    Above 1 no seat can: lift-off is then a known omission, to be added before any other law is believed.
    """
    if any(applied.effect.name == "lift_off" for applied in subject.effects):
        return 0.0
    chain = Chain.of(subject)
    response = predict(subject, case.seat_mps2, case.rate_hz, case.channels)
    stretch, rate = response.displacement_m[:, 0], response.velocity_mps[:, 0]
    stiffness = chain.stiffness_n_per_m[0] * (1.0 + chain.stiffening_per_m[0] * np.abs(stretch))
    tension_n = stiffness * stretch + chain.damping_n_s_per_m[0] * rate
    return float(tension_n.max() / (STANDARD_GRAVITY_MPS2 * chain.mass_kg.sum()))


def contents(cases: Sequence[Case], settings: FloorSettings | None = None) -> Contents:
    """Count what events hold, behind their warm-up."""
    s = settings or FloorSettings()
    road_s, shocks, hard = 0.0, 0, 0
    for case in cases:
        peaks = _peaks_g(case, s.shock_g)
        shocks, hard = shocks + peaks.size, hard + int(np.count_nonzero(peaks >= s.hard_shock_g))
        seconds = (case.seat_mps2.size - case.begin) / case.rate_hz
        road_s += max(0.0, seconds - _APART_S * peaks.size)
    return Contents(road_s, shocks, hard)


def missing(cases: Sequence[Case], role: str, settings: FloorSettings | None = None) -> list[str]:
    """What events lack for a verdict, one line each; role says what they are for, such as `to fit`."""
    s = settings or FloorSettings()
    found = contents(cases, s)
    wanted = (
        (found.road_s, s.road_s, f"{found.road_s:.3g} s without shocks"),
        (found.shocks, s.shocks, f"{counted(found.shocks, 'shock')} of {s.shock_g:g} g and more"),
        (found.hard_shocks, s.hard_shocks, f"{counted(found.hard_shocks, 'shock')} of {s.hard_shock_g:g} g and more"),
    )
    return [
        f"{role}: {said}, {least:g} {'is' if least == 1 else 'are'} needed"
        for there, least, said in wanted
        if there < least
    ]


def _peaks_g(case: Case, least_g: float) -> Floats:
    """The largest reading of every shock of a case, in g, behind the warm-up."""
    size = np.abs(case.seat_mps2[case.begin :]) / STANDARD_GRAVITY_MPS2
    above = np.flatnonzero(size >= least_g)
    if above.size == 0:
        return np.empty(0)
    parts = np.split(above, np.flatnonzero(np.diff(above) > _APART_S * case.rate_hz) + 1)
    return np.array([size[part].max() for part in parts])


def cleaned(case: Case) -> tuple[Case, list[str]]:
    """A case without the sensors of which much is masked, and a line for each: what clips also loses its level."""
    share = case.compared[case.begin :].mean(axis=0)
    bad = (case.energy > 0.0) & (share < share.max() - SPOILED)
    said = [
        f"{case.name}: {name}, {100.0 * (share.max() - share[i]):.0f} % clipped, stuck or missing"
        for i, name in enumerate(MEASURED_SEGMENTS)
        if bad[i]
    ]
    if not said:
        return case, said
    compared = case.compared & ~bad
    energy = np.where(bad, 0.0, case.energy)
    return dataclasses.replace(case, compared=compared, energy=energy), said


def same(one: Case, other: Case) -> bool:
    """Whether two cases are of the same motion: the same seat, sample by sample."""
    a, b = one.seat_mps2, other.seat_mps2
    return a.size == b.size and bool(np.array_equal(a, b))
