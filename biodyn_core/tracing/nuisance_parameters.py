"""Nuisance parameters: typical deviations of every body and every sensor, which are no finding.

Joints are slightly nonlinear, masses differ from the table, sensors have gains, clocks and mountings. Each parameter
changes the answer along one direction and has a typical spread. Together they are the error that follows the input.
A candidate has to explain a part of the residual that remains beside them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, N_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect, JointForce
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.reach import Reach
from biodyn_core.tracing.settings import TypicalSettings


@dataclass(frozen=True)
class NuisanceParameter:
    """One typical deviation: of an effect's strength, of a mass, or of the seat's vertical towards a horizontal axis.

    spread: its standard deviation, for an effect in multiples of the applied strength. least_scale: the least prior
    scale of this parameter. reach_m: how far the joint of this law moves. other_spreads: spreads of further strengths
    of the effect, which this parameter does not change.
    """

    name: str
    spread: float
    applied: AppliedEffect | None = None
    segment: int = -1
    seat_axis: str = ""
    least_scale: float = 0.0
    reach_m: float = 0.0
    other_spreads: Mapping[str, float] = field(default_factory=dict)

    @property
    def site(self) -> str:
        """Its joint, segment or sensor."""
        if self.applied is not None:
            return self.applied.site
        return SEAT if self.seat_axis else SEGMENTS[self.segment]

    @property
    def strengths(self) -> dict[str, float]:
        """The strengths of its effect that are not zero, by name."""
        assert self.applied is not None
        given = self.applied.values
        return {name: given[name] for name in self.applied.effect.strengths if given[name]}


def nuisance_parameters(
    subject: Subject, cases: Sequence[Case], settings: TypicalSettings | None = None
) -> list[NuisanceParameter]:
    """All nuisance parameters that change these cases."""
    s = settings or TypicalSettings()
    found = [one for sensor in MEASURED_SEGMENTS for one in _of_sensor(sensor, cases, s)]
    reach = Reach.of(subject, cases)
    damping = Chain.of(subject).damping_n_s_per_m
    for joint, segment in enumerate(SEGMENTS):
        sizes = {
            "asymmetry": s.usual_bend / reach.stretch_m[joint],
            "cubic": s.usual_bend / reach.stretch_m[joint] ** 2,
            "quadratic_damping": s.usual_bend / reach.rate_mps[joint],
            "friction": s.usual_bend * damping[joint] * reach.rms_rate_mps[joint],
        }
        laws = [_strength(name, segment, size, size) for name, size in sizes.items()]
        found += [dataclasses.replace(one, reach_m=float(reach.stretch_m[joint])) for one in laws]
    found += [NuisanceParameter(f"mass of {name}", s.usual_mass, segment=i) for i, name in enumerate(SEGMENTS)]
    if _has_horizontal(SEAT, cases):
        # It moves the whole body, so sensor noise hardly limits its estimate.
        found += [
            NuisanceParameter(f"tilt of {SEAT} ({axis})", s.rest_lean, seat_axis=f"{SEAT}.{axis}", least_scale=1.0)
            for axis in "xy"
        ]
    return found


def nonlinear_force_n(chain: Chain, applied: AppliedEffect, reach_m: float) -> float:
    """The largest force, N, that a static law adds at the reach of its joint; 0 for any other law."""
    effect, elements = applied.effect, chain.with_effects((applied,)).elements
    if not (isinstance(effect, JointForce) and effect.static and elements):
        return 0.0
    constants = elements[-1].constants
    return max(abs(float(effect.law(stretch, 0.0, 0.0, *constants))) for stretch in (-reach_m, reach_m))


def changes_by(
    subject: Subject, case: Case, plain: Floats, parameters: Sequence[NuisanceParameter],
    decimated: Callable[[Floats], Floats],
) -> list[Floats]:  # fmt: skip
    """Change (m, 5) of the answer by each parameter, per typical spread, decimated from (n, 5).

    plain (n, 5) is the answer without.
    """
    before, found = decimated(plain), []
    for one in parameters:
        if one.applied is not None:
            found.append(one.spread * (decimated(answer(subject, case, (one.applied,), plain)) - before))
        elif one.seat_axis:
            seat_mps2 = case.seat_mps2 + one.spread * case.channels[one.seat_axis]
            found.append(decimated(answer(subject, dataclasses.replace(case, seat_mps2=seat_mps2))) - before)
        else:
            found.append(decimated(_with_heavier(subject, case, one.segment, one.spread)) - before)
    return found


def _of_sensor(sensor: str, cases: Sequence[Case], s: TypicalSettings) -> list[NuisanceParameter]:
    clock = _strength("clock", sensor, s.usual_clock_s, 0.001, "delay_s")
    found = [
        _strength("gain", sensor, s.usual_gain, 0.05),
        dataclasses.replace(clock, other_spreads={"drift": s.usual_clock_s / s.drift_s}),
        _strength("skin", sensor, s.usual_softness_s, 0.0025, "softness_s"),
    ]
    if _has_horizontal(sensor, cases):
        least_scale = min(s.rest_lean / s.usual_lean, 1.0)
        tilts = [_strength("tilt", sensor, s.usual_lean, 0.1, name) for name in ("lean_x", "lean_y")]
        found += [dataclasses.replace(one, least_scale=least_scale) for one in tilts]
    return found


def _has_horizontal(sensor: str, cases: Sequence[Case]) -> bool:
    return all(f"{sensor}.{axis}" in case.channels for case in cases for axis in "xy")


def _strength(name: str, site: str, spread: float, size: float, strength: str = "") -> NuisanceParameter:
    """A nuisance parameter for one strength of an effect, applied at a size within the strength's range."""
    effect = CATALOGUE[name]
    strength = strength or effect.strengths[0]
    values = {p.name: (0.0 if p.kind == "strength" else p.size) for p in effect.parameters}
    upper = next(p.upper for p in effect.parameters if p.name == strength)
    values[strength] = min(size, upper)
    label = f"{name} of {site}" + (f" ({strength})" if len(effect.strengths) > 1 else "")
    return NuisanceParameter(label, spread / values[strength], AppliedEffect(effect, site, values))


def _with_heavier(subject: Subject, case: Case, segment: int, share: float) -> Floats:
    """The answer (n, 5) with one segment heavier by a share of its mass; stiffness and damping do not change."""
    chain = Chain.of(subject)
    on = np.arange(N_SEGMENTS) == segment
    carried = on if chain.mass_matrix_form == "segment" else np.arange(N_SEGMENTS) <= segment
    inertia = chain.inertia_kg + share * chain.mass_kg[segment] * carried
    heavier = dataclasses.replace(chain, inertia_kg=inertia)
    stepper = Stepper(heavier, case.rate_hz, heavier.substeps(case.rate_hz))
    return stepper.push(case.seat_mps2, channels=case.channels)[:, MEASURED_SEGMENT_INDEX]
