"""What a trace found, gathered from its rounds: verdict, intervals, events before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import signal

from biodyn_core.effects import AppliedEffect, EffectParameter, logistic
from biodyn_core.identification.problem import Case, errors
from biodyn_core.subject import Subject
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.background import N_THETA
from biodyn_core.tracing.diagnose import diagnose
from biodyn_core.tracing.experiments import separating
from biodyn_core.tracing.findings import NAMING, ComparedEvent, Departure, Interval, Surface, Trace, Use
from biodyn_core.tracing.leans import lean_deg, leaning
from biodyn_core.tracing.rounds import Outcome
from biodyn_core.tracing.screen import candidates
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.settle import LEVELS
from biodyn_core.tracing.surface import surface
from biodyn_core.tracing.verdict import explained, judged, named

NOISE_BAND_HZ: Final = (60.0, 85.0)
"""Here bodies hardly move: what a model misses of a channel, its sensor made."""


def decided(
    before: Subject, after: Subject, outcomes: Sequence[Outcome], sides: Sequence[Sequence[Case]], s: TraceSettings,
    left_out: Sequence[str], seed: int,
) -> Trace:  # fmt: skip
    """Everything a trace that could decide says."""
    train, choose, report = sides
    first, believed = outcomes[0], explained(outcomes, s)
    law = None if believed else _surface(first)
    leaning_sensors = _leaning(first, [*train, *choose], s)  # what is reported has no say in any verdict
    verdict, reasons = judged(outcomes, law, leaning_sensors, s)
    passing = _passing(outcomes) if believed else ()
    added = after.effects[len(before.effects) :]
    leans = leaning_sensors if verdict in NAMING else ()
    rivals = tuple(one.applied for one in first.round.ambiguous_with) if believed else ()
    best = first.round.taken or next((one for one in first.round.ladder if one.steady), None)
    return Trace(
        verdict=verdict,
        reasons=(*reasons, *map(_passes, passing), *map(_leans, leaning_sensors), *_on_bounds(added)),
        before=before,
        after=after,
        effects=(*leans, *added, *passing),
        intervals=(*(() for _ in leans), *_intervals(outcomes, added), *(() for _ in passing)),
        ambiguous_with=rivals,
        family=_family([*(added or passing or leans)[:1], *rivals]),
        experiment=separating([one.effect for one in (*(added or passing)[:1], *rivals)]),
        events=_events(before, after, train, choose, report),
        rounds=tuple(outcome.round for outcome in outcomes),
        departures=_departures(outcomes[-1]),
        diagnostics=diagnose(before, first.background),
        surface=law,
        floor_percent=_floor_percent(report, after),
        p_value=best.p_value if best and best.steady else None,
        threshold=first.round.threshold,
        untestable=tuple(candidates([*train, *choose])[1]),
        left_out=tuple(left_out),
        lacking=(),
        seed=seed,
        calibrated="anew",
    )


def _passes(one: AppliedEffect) -> str:
    return f"{named(one)} is never twice the same, so no subject carries it"


def _leans(one: AppliedEffect) -> str:
    return (
        f"the sensor of {one.site} leans by {lean_deg(one):.1f} deg on the mean while it moves, as its gyro has it;"
        " recordings set it upright, so no subject carries it"
    )


def _passing(outcomes: Sequence[Outcome]) -> tuple[AppliedEffect, ...]:
    """What was taken and no subject carries."""
    taken = [outcome.taken for outcome in outcomes if not outcome.carried]
    return tuple(one.applied for one in taken if one is not None and one.applied is not None)


def _leaning(outcome: Outcome, cases: Sequence[Case], s: TraceSettings) -> tuple[AppliedEffect, ...]:
    """The sensors that lean farther than is usual for a body that departs as far as this one, or has an effect."""
    plain = outcome.background.level == LEVELS[-1] and outcome.taken is None
    return leaning(cases, s.background.usual.usual_lean, plain)


def _surface(outcome: Outcome) -> Surface | None:
    """The surface of the joint that gains most of one, among those the residual points to."""
    sites = [one.applied.site for one in outcome.round.ladder[:3] if one.applied.effect.place == "joint"]
    found = [surface(outcome.background, outcome.without, site) for site in dict.fromkeys(sites)]
    return max(found, key=lambda one: one.gain, default=None)


def undecided(
    train: Sequence[Case], choose: Sequence[Case], report: Sequence[Case], before: Subject, after: Subject,
    lacking: Sequence[str], left_out: Sequence[str], seed: int,
) -> Trace:  # fmt: skip
    """What can be said of events that carry no verdict, and what they lack."""
    everything = [*train, *choose, *report]
    return Trace(
        verdict="not_decidable",
        reasons=("the events cannot carry a verdict", *lacking),
        before=before,
        after=after,
        effects=(),
        intervals=(),
        ambiguous_with=(),
        family="",
        experiment="record what is lacking: " + "; ".join(lacking),
        events=_events(before, after, train, choose, report),
        rounds=(),
        departures=(),
        diagnostics=None,
        surface=None,
        floor_percent=_floor_percent(report, after),
        p_value=None,
        threshold=None,
        untestable=tuple(candidates(everything)[1]) if everything else (),
        left_out=tuple(left_out),
        lacking=tuple(lacking),
        seed=seed,
        calibrated="not",
    )


def _events(before: Subject, after: Subject, *sides: Sequence[Case]) -> tuple[ComparedEvent, ...]:
    uses: tuple[Use, ...] = ("train", "choose", "held_out")
    return tuple(_event(case, use, before, after) for use, cases in zip(uses, sides, strict=True) for case in cases)


def _event(case: Case, use: Use, before: Subject, after: Subject) -> ComparedEvent:
    answers = [answer(subject, case) for subject in (before, after)]
    shown = [np.where(case.compared, one, np.nan) for one in (case.measured_mps2, *answers)]
    told = [errors(case, one) for one in answers]
    return ComparedEvent(case.name, case.case, use, case.rate_hz, shown[0], shown[1], shown[2], told[0], told[1])


def _intervals(outcomes: Sequence[Outcome], added: Sequence[AppliedEffect]) -> list[tuple[Interval, ...]]:
    """For each effect that was added its values as they are in the subject, with intervals as wide as settling's."""
    taken = [outcome.taken for outcome in outcomes if outcome.carried and outcome.taken is not None][: len(added)]
    return [
        tuple(
            _interval(p, one.values[p.name], *limits)
            for p, limits in zip(one.effect.parameters, settled.intervals, strict=False)
        )
        for settled, one in zip(taken, added, strict=True)
    ]


def _interval(parameter: EffectParameter, value: float, low: float, high: float) -> Interval:
    """An interval around another value: as wide where the range is mapped to the whole line, so within it."""
    share = np.clip([parameter.share(one) for one in (low, value, high)], 1e-9, 1.0 - 1e-9)
    psi = np.log(share / (1.0 - share))
    if parameter.on_bound(value) or share[1] < 1e-6:  # nothing is symmetric about an end
        return Interval(parameter.name, parameter.unit, value, min(low, value), max(high, value))
    half = 0.5 * (psi[2] - psi[0])
    ends = [parameter.at_share(one) for one in logistic(psi[1] + np.array([-half, half]))]
    return Interval(parameter.name, parameter.unit, value, *map(float, ends))


def _departures(outcome: Outcome) -> tuple[Departure, ...]:
    """The usual departures, the farthest from the usual first."""
    settled = outcome.taken or outcome.without
    found = [
        Departure(name, float(times))
        for name, times in zip(outcome.background.names, settled.departures[N_THETA:], strict=True)
    ]
    return tuple(sorted(found, key=lambda one: -abs(one.times_usual)))


def _on_bounds(added: Sequence[AppliedEffect]) -> list[str]:
    """A line for each strength that ends on a bound once departures are left out: the law's form fits only roughly."""
    return [
        f"{p.name} of {named(applied)} ends on its bound in the new subject: its form fits only roughly"
        for applied in added
        for p in applied.effect.parameters
        if p.kind == "strength" and p.on_bound(applied.values[p.name])
    ]


def _family(effects: Sequence[AppliedEffect]) -> str:
    """The family they share, `` where they do not or there is none."""
    families = {one.effect.family for one in effects}
    return families.pop() if len(families) == 1 else ""


def _floor_percent(cases: Sequence[Case], subject: Subject) -> float | None:
    """What noise of the sensors alone leaves, mean normalised rms in percent, from the band where bodies hardly move.

    An upper limit: what the subject still misses there counts as noise.
    """
    found = []
    for case in cases:
        missed = np.where(case.compared, case.measured_mps2 - answer(subject, case), 0.0)
        moved = missed[case.begin :]
        if len(moved) < 1024:
            continue
        frequency_hz, density = signal.welch(moved, case.rate_hz, nperseg=1024, axis=0)
        still = (frequency_hz >= NOISE_BAND_HZ[0]) & (frequency_hz <= NOISE_BAND_HZ[1])
        noise = np.sqrt(np.median(density[still], axis=0) * 100.0)
        rms = np.sqrt(case.energy / np.maximum(case.compared.sum(axis=0), 1))
        found.append(100.0 * np.mean(noise[case.energy > 0.0] / rms[case.energy > 0.0]))
    return float(np.mean(found)) if found else None
