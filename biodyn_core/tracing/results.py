"""What a trace found, gathered from its rounds: verdict, intervals, events before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import signal

from biodyn_core.body.parameters import is_fitted
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, EffectParameter, logistic
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.diagnose import diagnose
from biodyn_core.tracing.experiments import separating, to_record
from biodyn_core.tracing.findings import (
    NAMING,
    ComparedEvent,
    Departure,
    Interval,
    Need,
    SensorFinding,
    Surface,
    Trace,
    Use,
)
from biodyn_core.tracing.local_fit import LEVELS
from biodyn_core.tracing.nuisance_model import N_THETA
from biodyn_core.tracing.rounds import Outcome
from biodyn_core.tracing.screen import candidates
from biodyn_core.tracing.sensor_limits import LIMITS, within_limits
from biodyn_core.tracing.sensor_tilt import lean_deg, leaning
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.surface import surface
from biodyn_core.tracing.verdict import explained, judged, named

NOISE_BAND_HZ: Final = (60.0, 85.0)
"""Here bodies hardly move: what a model misses of a channel, its sensor made."""


def decided(
    given: Subject, before: Subject, after: Subject, outcomes: Sequence[Outcome], sides: Sequence[Sequence[Case]],
    s: TraceSettings, left_out: Sequence[str], seed: int,
) -> Trace:  # fmt: skip
    """Everything a trace that could decide says."""
    train, choose, report = sides
    first, believed = outcomes[0], explained(outcomes, s)
    law = None if believed else _surface(first)
    leaning_sensors = _leaning(first, [*train, *choose], s)  # what is reported has no say in any verdict
    far = [one for one in leaning_sensors if not within_limits(one)]
    verdict, reasons = judged(outcomes, law, far, s)
    passing = _passing(outcomes) if believed else ()
    added = after.effects[len(before.effects) :]
    leans = tuple(far) if verdict in NAMING else ()
    beside = [one for one in leaning_sensors if one not in leans]
    rivals = tuple(one.applied for one in first.round.ambiguous_with) if believed else ()
    best = first.round.taken or next((one for one in first.round.ladder if one.steady), None)
    return Trace(
        verdict=verdict,
        reasons=(*reasons, *map(_passes, passing), *map(_leans, leans), *_on_bounds(added)),
        given=given,
        before=before,
        after=after,
        effects=(*leans, *added, *passing),
        intervals=(*(() for _ in leans), *_intervals(outcomes, added), *(() for _ in passing)),
        ambiguous_with=rivals,
        family=_family([*(added or passing or leans)[:1], *rivals]),
        experiment=separating([one.effect for one in (*(added or passing)[:1], *rivals)]),
        events=_events(given, before, after, train, choose, report),
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
        sensors=_sensors(outcomes, beside, believed),
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


def _sensors(outcomes: Sequence[Outcome], leans: Sequence[AppliedEffect], believed: bool) -> tuple[SensorFinding, ...]:
    """Leans that gyros tell, and faults that gained more than was asked of a candidate but were not believed."""
    first = outcomes[0].round
    tried = {(one.applied.effect.name, one.applied.site): one for one in reversed(first.ladder)}
    causes = {(one.effect.name, one.site) for one in _causes(outcomes)} if believed else set()
    found = {}
    for (name, site), one in tried.items():
        refused = one.usual and one.steady  # of what is set anew, a small gain says nothing
        strong = one.refitted and one.gain > first.threshold and (refused or one is first.taken)
        if name in LIMITS and strong and (name, site) not in causes:
            found[name, site] = SensorFinding(one.applied, "fit", one.gain, False)
    for tilt in leans:
        key = (tilt.effect.name, tilt.site)
        found[key] = SensorFinding(tilt, "gyro", tried[key].gain if key in tried else None, key in causes)
    return tuple(found.values())


def _causes(outcomes: Sequence[Outcome]) -> list[AppliedEffect]:
    """What the rounds took."""
    return [outcome.round.taken.applied for outcome in outcomes if outcome.round.taken is not None]


def _surface(outcome: Outcome) -> Surface | None:
    """The surface of the joint that gains most of one, among those the residual points to."""
    sites = [one.applied.site for one in outcome.round.ladder[:3] if one.applied.effect.place == "joint"]
    found = [surface(outcome.background, outcome.without, site) for site in dict.fromkeys(sites)]
    return max(found, key=lambda one: one.gain, default=None)


def undecided(
    given: Subject, before: Subject, sides: Sequence[Sequence[Case]], lacking: Sequence[str], needs: Sequence[Need],
    s: TraceSettings, left_out: Sequence[str], seed: int,
) -> Trace:  # fmt: skip
    """What can be said of events that carry no verdict, and what they lack."""
    everything = [case for side in sides for case in side]
    return Trace(
        verdict="not_decidable",
        reasons=("the events cannot carry a verdict", *lacking),
        given=given,
        before=before,
        after=before,
        effects=(),
        intervals=(),
        ambiguous_with=(),
        family="",
        experiment=to_record(needs, s.floor),
        events=_events(given, before, before, *sides),
        rounds=(),
        departures=(),
        diagnostics=None,
        surface=None,
        floor_percent=_floor_percent(sides[-1], before),
        p_value=None,
        threshold=None,
        untestable=tuple(candidates(everything)[1]) if everything else (),
        left_out=tuple(left_out),
        lacking=tuple(lacking),
        seed=seed,
        calibrated="not",
        needs=tuple(needs),
    )


def _events(given: Subject, before: Subject, after: Subject, *sides: Sequence[Case]) -> tuple[ComparedEvent, ...]:
    uses: tuple[Use, ...] = ("train", "choose", "held_out")
    return tuple(
        _event(case, use, given, before, after) for use, cases in zip(uses, sides, strict=True) for case in cases
    )


def _event(case: Case, use: Use, given: Subject, before: Subject, after: Subject) -> ComparedEvent:
    answers = [answer(subject, case) for subject in (before, after)]
    shown = [np.where(case.compared, one, np.nan) for one in (case.measured_mps2, *answers)]
    told = [errors(case, one) for one in answers]
    as_given = errors(case, answer(given, case)) if is_fitted(given.parameters) else None
    return ComparedEvent(
        case.name, case.case, use, case.rate_hz, shown[0], shown[1], shown[2], told[0], told[1], as_given
    )


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
