"""Usual departures: what every body and every sensor has of its own, and no verdict is to be built on.

Joints bend a little, masses differ from the table, sensors have gains, clocks and mountings. Each is a direction in
which the answer may go, with a spread that is usual; together they are the misfit that follows the input. Candidates
are weighed against what is left once these, too, have taken what they usually take.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, N_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain, Stepper, predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect, JointForce
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.settings import UsualSettings

DRIFTING_S: Final = 5.0
"""A clock that drifts is late by as much after so long, the middle of an event, as others usually are throughout."""


@dataclass(frozen=True)
class Direction:
    """One usual departure: an effect of the catalogue, a mass, or a horizontal axis in the seat's vertical.

    usual is the spread of it, for an effect in multiples of one that shows; least is the share of the usual that also
    those have who depart in nothing; reach_m is how far the joint goes whose law it bends; besides are the spreads of
    strengths that go with it and that it does not show itself.
    """

    name: str
    usual: float
    applied: AppliedEffect | None = None
    segment: int = -1
    leaking: str = ""
    least: float = 0.0
    reach_m: float = 0.0
    besides: Mapping[str, float] = field(default_factory=dict)

    @property
    def site(self) -> str:
        """The joint, segment or sensor that it is of."""
        if self.applied is not None:
            return self.applied.site
        return SEAT if self.leaking else SEGMENTS[self.segment]

    @property
    def strengths(self) -> dict[str, float]:
        """What of an effect shows, by name."""
        assert self.applied is not None
        given = self.applied.values
        return {name: given[name] for name in self.applied.effect.strengths if given[name]}


def directions(subject: Subject, cases: Sequence[Case], settings: UsualSettings | None = None) -> list[Direction]:
    """All directions that these cases can show."""
    s = settings or UsualSettings()
    found = [d for sensor in MEASURED_SEGMENTS for d in _of_sensor(sensor, cases, s)]
    reach_m, rate_mps, rms_mps = _travel(subject, cases)
    damping = Chain.of(subject).damping_n_s_per_m
    for joint, segment in enumerate(SEGMENTS):
        sizes = {
            "asymmetry": s.usual_bend / reach_m[joint],
            "cubic": s.usual_bend / reach_m[joint] ** 2,
            "quadratic_damping": s.usual_bend / rate_mps[joint],
            "friction": s.usual_bend * damping[joint] * rms_mps[joint],
        }
        laws = [_strength(name, segment, size, size) for name, size in sizes.items()]
        found += [dataclasses.replace(one, reach_m=float(reach_m[joint])) for one in laws]
    found += [Direction(f"mass of {segment}", s.usual_mass, segment=i) for i, segment in enumerate(SEGMENTS)]
    if _measured_aside(SEAT, cases):
        # The whole body answers to it, so next to no noise hides it.
        found += [Direction(f"lean of {SEAT} ({a})", s.rest_lean, leaking=f"{SEAT}.{a}", least=1.0) for a in "xy"]
    return found


def bend_n(chain: Chain, applied: AppliedEffect, reach_m: float) -> float:
    """The most force that a law of stretch alone adds where its joint goes farthest, N; 0 for any other law."""
    effect, elements = applied.effect, chain.with_effects((applied,)).elements
    if not (isinstance(effect, JointForce) and effect.static and elements):
        return 0.0
    constants = elements[-1].constants
    return max(abs(float(effect.law(stretch, 0.0, 0.0, *constants))) for stretch in (-reach_m, reach_m))


def columns(subject: Subject, case: Case, plain: Floats, found: Sequence[Direction]) -> Floats:
    """What each direction adds to the answer, per usual spread, (n, 5, d); plain (n, 5) is the answer without."""
    out = np.empty((*plain.shape, len(found)))
    for i, direction in enumerate(found):
        if direction.applied is not None:
            out[:, :, i] = direction.usual * (answer(subject, case, (direction.applied,), plain) - plain)
        elif direction.leaking:
            seat_mps2 = case.seat_mps2 + direction.usual * case.channels[direction.leaking]
            out[:, :, i] = answer(subject, dataclasses.replace(case, seat_mps2=seat_mps2)) - plain
        else:
            out[:, :, i] = _heavier(subject, case, direction.segment, direction.usual) - plain
    return out


def _of_sensor(sensor: str, cases: Sequence[Case], s: UsualSettings) -> list[Direction]:
    clock = _strength("clock", sensor, s.usual_clock_s, 0.001, "delay_s")
    found = [
        _strength("gain", sensor, s.usual_gain, 0.05),
        dataclasses.replace(clock, besides={"drift": s.usual_clock_s / DRIFTING_S}),
        _strength("skin", sensor, s.usual_softness_s, 0.0025, "softness_s"),
    ]
    if _measured_aside(sensor, cases):
        least = min(s.rest_lean / s.usual_lean, 1.0)
        leans = [_strength("tilt", sensor, s.usual_lean, 0.1, lean) for lean in ("lean_x", "lean_y")]
        found += [dataclasses.replace(one, least=least) for one in leans]
    return found


def _measured_aside(sensor: str, cases: Sequence[Case]) -> bool:
    return all(f"{sensor}.{axis}" in case.channels for case in cases for axis in "xy")


def _strength(name: str, site: str, usual: float, shows: float, strength: str = "") -> Direction:
    """A departure by the one strength of an effect, tried at a size that shows, within its range."""
    effect = CATALOGUE[name]
    strength = strength or effect.strengths[0]
    values = {p.name: (0.0 if p.kind == "strength" else p.size) for p in effect.parameters}
    upper = next(p.upper for p in effect.parameters if p.name == strength)
    values[strength] = min(shows, upper)
    label = f"{name} of {site}" + (f" ({strength})" if len(effect.strengths) > 1 else "")
    return Direction(label, usual / values[strength], AppliedEffect(effect, site, values))


def _travel(subject: Subject, cases: Sequence[Case]) -> tuple[Floats, Floats, Floats]:
    """How far and how fast each joint goes, (6,) each: the median over events of the largest, and of the rms rate."""
    reach, rate, rms = [], [], []
    for case in cases:
        response = predict(subject, case.seat_mps2, case.rate_hz, case.channels)
        stretch, speed = response.displacement_m[case.begin :], response.velocity_mps[case.begin :]
        reach.append(np.abs(stretch).max(axis=0))
        rate.append(np.abs(speed).max(axis=0))
        rms.append(np.sqrt((speed**2).mean(axis=0)))
    return np.median(reach, axis=0), np.median(rate, axis=0), np.median(rms, axis=0)


def _heavier(subject: Subject, case: Case, segment: int, share: float) -> Floats:
    """The answer (n, 5) with one segment heavier by a share of its mass; stiffness and damping stay as they are."""
    chain = Chain.of(subject)
    on = np.arange(N_SEGMENTS) == segment
    carried = on if chain.mass_matrix_form == "segment" else np.arange(N_SEGMENTS) <= segment
    inertia = chain.inertia_kg + share * chain.mass_kg[segment] * carried
    heavier = dataclasses.replace(chain, inertia_kg=inertia)
    stepper = Stepper(heavier, case.rate_hz, heavier.substeps(case.rate_hz))
    return stepper.push(case.seat_mps2, channels=case.channels)[:, MEASURED_SEGMENT_INDEX]
