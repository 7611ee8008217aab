"""Result of a trace from its rounds: verdict, effects with intervals, and events before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import is_fitted
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, EffectParameter, logistic
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.experiments import separating, to_record
from biodyn_core.tracing.findings import (
    ComparedEvent,
    FurtherRecordings,
    Interval,
    LouderRecordings,
    NamedBodies,
    Need,
    NuisanceValue,
    RankedCandidate,
    RestoringForce,
    Round,
    SensorFinding,
    Surface,
    Trace,
    Use,
)
from biodyn_core.tracing.inverse_dynamics import Target
from biodyn_core.tracing.joint_refit import covariances
from biodyn_core.tracing.local_fit import LocalFit
from biodyn_core.tracing.louder import louder_recordings
from biodyn_core.tracing.nuisance_model import N_THETA
from biodyn_core.tracing.probability import packaged
from biodyn_core.tracing.restoring_force import FittedEffect, restoring_force
from biodyn_core.tracing.rounds import Outcome
from biodyn_core.tracing.screen import untestable
from biodyn_core.tracing.sensor_limits import LIMITS
from biodyn_core.tracing.sensor_tilt import sensor_tilts, tilt_deg
from biodyn_core.tracing.settings import ReportSettings, SurfaceSettings, TraceSettings
from biodyn_core.tracing.surface import surface
from biodyn_core.tracing.verdict import named, reasons_of, verdict_of

PASSED_SHARE: Final = 0.85
"""Up to this share of its cut-off frequency the low-pass leaves white noise as it is."""


def build_result(
    given: Subject, before: Subject, after: Subject, outcomes: Sequence[Outcome], uses: Sequence[Sequence[Case]],
    s: TraceSettings, left_out: Sequence[str], seed: int, ended: str = "",
) -> Trace:  # fmt: skip
    """The result of a trace with rounds; uses are the events for fitting, for choosing and for reporting.

    ended: why no further round was possible, empty if one was.
    """
    train, choose, report = uses
    first = outcomes[0]
    verdict = verdict_of(first.round, s.named_from)
    law = _surface(first, s.surface) if verdict == "unexplained" else None
    tilts = sensor_tilts([*train, *choose], s.nuisance.typical.usual_lean, s.tilt)  # nothing is decided by a report
    added = after.effects[len(before.effects) :]
    causes = tuple(one.round.chosen.applied for one in outcomes if one.round.chosen is not None)
    tilted = _not_stored(tilts, causes, added)
    not_added = _not_added(outcomes, tilted)
    rivals = tuple(one.applied for one in first.round.rivals)
    best = first.round.chosen or max(first.round.ranking, key=lambda one: (one.steady, one.gain))
    return Trace(
        verdict=verdict,
        reasons=(
            *reasons_of(first.round, s.named_from),
            *_why_not_added(outcomes, tilted),
            *map(_is_tilted, tilted),
            *_on_bounds(added),
            *([ended] if ended else []),
        ),
        given=given,
        before=before,
        after=after,
        effects=(*tilted, *added, *not_added),
        intervals=(*(() for _ in tilted), *_intervals(outcomes, added), *(() for _ in not_added)),
        ambiguous_with=rivals,
        named_bodies=_named_bodies(s) if verdict == "none" else (),
        further=_further(s) if verdict != "effect" else (),
        louder=_louder(first.round.likely, s) if verdict != "effect" else (),
        family=_family([*causes[:1], *rivals]),
        experiment=separating([one.effect for one in (*causes[:1], *rivals)]),
        events=_events(given, before, after, train, choose, report),
        rounds=tuple(outcome.round for outcome in outcomes),
        nuisance=_nuisance(outcomes[-1]),
        diagnostics=first.diagnostics,
        surface=law,
        restoring_forces=_restoring_forces(before, after, law, train, report, s, seed),
        floor_percent=_floor_percent(report, after, s.report),
        p_value=best.p_value if best.steady else None,
        named_from=s.named_from,
        untestable=untestable([*train, *choose]),
        left_out=tuple(left_out),
        seed=seed,
        calibrated="anew",
        sensors=_sensors(first.round, [one for one in tilts if one not in tilted], causes, s.report.likely_fault),
    )


def _named_bodies(s: TraceSettings) -> tuple[NamedBodies, ...]:
    """The bodies of the training with their effect named; empty for a probability that they were not counted for."""
    model = packaged()
    return model.named if model.named_from == s.named_from else ()


def _further(s: TraceSettings) -> tuple[FurtherRecordings, ...]:
    """The causes that further recordings name in simulation; empty for a probability that it was not counted for."""
    model = packaged()
    return model.further if model.named_from == s.named_from else ()


def _louder(mechanisms: Sequence[str], s: TraceSettings) -> tuple[LouderRecordings, ...]:
    """What louder motion lifts of these mechanisms; empty for a probability that it was not counted for."""
    return louder_recordings(mechanisms) if packaged().named_from == s.named_from else ()


def _is_among(one: AppliedEffect, others: Sequence[AppliedEffect]) -> bool:
    """Whether others have the same effect at the same site."""
    return any(one.effect is other.effect and one.site == other.site for other in others)


def _not_stored(
    tilts: Sequence[AppliedEffect], causes: Sequence[AppliedEffect], added: Sequence[AppliedEffect]
) -> tuple[AppliedEffect, ...]:
    """The tilts by gyros that are causes, without those that the subject stores because a part of them remained."""
    return tuple(one for one in tilts if _is_among(one, causes) and not _is_among(one, added))


def _is_tilted(one: AppliedEffect) -> str:
    return (
        f"the sensor of {one.site} has a mean tilt of {tilt_deg(one):.1f} deg in motion, by its gyro; recordings"
        " correct the tilt, so it cannot be stored in a subject"
    )


def _not_added(outcomes: Sequence[Outcome], tilted: Sequence[AppliedEffect]) -> tuple[AppliedEffect, ...]:
    """The chosen effects that the subject does not get, without the tilts by gyros."""
    fits = [one.chosen.applied for one in outcomes if one.chosen is not None and not one.adds_effect]
    return tuple(one for one in fits if one is not None and not _is_among(one, tilted))


def _why_not_added(outcomes: Sequence[Outcome], tilted: Sequence[AppliedEffect]) -> list[str]:
    """A line for each of `_not_added`."""
    others = [one for one in outcomes if one.chosen is not None and not one.adds_effect]
    return [
        f"{named(one.chosen.applied)}: {one.why or 'it varies with time, so it cannot be stored in a subject'}"
        for one in others
        if one.chosen is not None and one.chosen.applied in _not_added([one], tilted) and one.chosen.applied is not None
    ]


def _sensors(
    first: Round, tilts: Sequence[AppliedEffect], causes: Sequence[AppliedEffect], likely: float
) -> tuple[SensorFinding, ...]:
    """Tilts by gyros, and sensor faults of a likely probability that are not among the causes."""
    tried: dict[tuple[str, str], RankedCandidate] = {}
    for one in first.ranking:
        tried.setdefault(one.key, one)
    named_causes = {(one.effect.name, one.site) for one in causes}
    found = {
        key: SensorFinding(one.applied, "fit", one.gain, False)
        for key, one in tried.items()
        if key[0] in LIMITS and one.refitted and one.probability >= likely and key not in named_causes
    }
    for tilt in tilts:
        key = (tilt.effect.name, tilt.site)
        found[key] = SensorFinding(tilt, "gyro", tried[key].gain if key in tried else None, key in named_causes)
    return tuple(found.values())


def _surface(outcome: Outcome, s: SurfaceSettings) -> Surface | None:
    """The surface with the largest gain, of the joints among the first candidates."""
    first = outcome.round.ranking[: s.candidates]
    sites = [one.applied.site for one in first if one.applied.effect.place == "joint"]
    found = [surface(outcome.nuisance, outcome.without, site, s) for site in dict.fromkeys(sites)]
    return max(found, key=lambda one: one.gain, default=None)


def _restoring_forces(
    before: Subject, after: Subject, law: Surface | None, train: Sequence[Case], report: Sequence[Case],
    s: TraceSettings, seed: int,
) -> tuple[RestoringForce, ...]:  # fmt: skip
    """The missing force at each joint and segment with an added effect; without any, at the joint of a surface."""
    chain, added = Chain.of(after), after.effects[len(before.effects) :]
    every = covariances(after, train, s.nuisance.weights.independent, s.joint_refit) if added else []
    known = every[len(before.effects) :]
    fitted = [
        FittedEffect(one, covariance)
        for one, covariance in zip(added, known, strict=True)
        if one.effect.place in ("joint", "segment")
    ]
    by_target: dict[tuple[str, str], list[FittedEffect]] = {}
    for one in fitted:
        by_target.setdefault((one.applied.effect.place, one.applied.site), []).append(one)
    targets = [(Target.of(each[0].applied, chain, s.missing_force), each) for each in by_target.values()]
    if not added and law is not None:
        targets = [(Target.of_joint(SEGMENTS.index(law.site), chain, s.missing_force), [])]
    found = [restoring_force(target, before, after, each, report, seed, s.missing_force) for target, each in targets]
    return tuple(one for one in found if one is not None)


def _fits(outcomes: Sequence[Outcome]) -> list[LocalFit]:
    """The local fits of the chosen effects that a subject can store."""
    return [outcome.chosen for outcome in outcomes if outcome.adds_effect and outcome.chosen is not None]


def build_undecided(
    given: Subject, before: Subject, uses: Sequence[Sequence[Case]], lacking: Sequence[str], needs: Sequence[Need],
    s: TraceSettings, left_out: Sequence[str], seed: int,
) -> Trace:  # fmt: skip
    """The result of events with too little data for a verdict."""
    everything = [case for cases in uses for case in cases]
    return Trace(
        verdict="not_decidable",
        reasons=("the recordings have too little data for a verdict", *lacking),
        given=given,
        before=before,
        after=before,
        experiment=to_record(needs, s.floor),
        events=_events(given, before, before, *uses),
        floor_percent=_floor_percent(uses[-1], before, s.report),
        untestable=untestable(everything),
        left_out=tuple(left_out),
        lacking=tuple(lacking),
        seed=seed,
        calibrated="not",
        needs=tuple(needs),
    )


def _events(given: Subject, before: Subject, after: Subject, *by_use: Sequence[Case]) -> tuple[ComparedEvent, ...]:
    uses: tuple[Use, ...] = ("train", "choose", "held_out")
    return tuple(
        _event(case, use, given, before, after) for use, cases in zip(uses, by_use, strict=True) for case in cases
    )


def _event(case: Case, use: Use, given: Subject, before: Subject, after: Subject) -> ComparedEvent:
    answers = [answer(subject, case) for subject in (before, after)]
    shown = [np.where(case.compared, one, np.nan) for one in (case.measured_mps2, *answers)]
    of_both = [errors(case, one) for one in answers]
    as_given = errors(case, answer(given, case)) if is_fitted(given.parameters) else None
    return ComparedEvent(
        case.name, case.case, use, case.rate_hz, shown[0], shown[1], shown[2], of_both[0], of_both[1], as_given
    )


def _intervals(outcomes: Sequence[Outcome], added: Sequence[AppliedEffect]) -> list[tuple[Interval, ...]]:
    """The values of each added effect in the subject, with intervals as wide as those of its local fit.

    None where the general form was fitted: its values are correlated, and none is known alone.
    """
    return [
        tuple(
            _interval(p, one.values[p.name], *limits)
            for p, limits in zip(one.effect.textbook_parameters, fit.intervals, strict=False)
            if one == one.textbook
        )
        for fit, one in zip(_fits(outcomes)[: len(added)], added, strict=True)
    ]


def _interval(parameter: EffectParameter, value: float, low: float, high: float) -> Interval:
    """An interval of the same width around another value, on the real line that the range is mapped to."""
    share = np.clip([parameter.share(one) for one in (low, value, high)], 1e-9, 1.0 - 1e-9)
    psi = np.log(share / (1.0 - share))
    if parameter.on_bound(value) or share[1] < 1e-6:  # no symmetric interval at a bound
        return Interval(parameter.name, parameter.unit, value, min(low, value), max(high, value))
    half = 0.5 * (psi[2] - psi[0])
    ends = [parameter.at_share(one) for one in logistic(psi[1] + np.array([-half, half]))]
    return Interval(parameter.name, parameter.unit, value, *map(float, ends))


def _nuisance(outcome: Outcome) -> tuple[NuisanceValue, ...]:
    """The nuisance parameters, the largest multiple first."""
    coefficients = (outcome.chosen or outcome.without).coefficients[N_THETA:]
    found = [NuisanceValue(*each) for each in zip(outcome.nuisance.names, coefficients.tolist(), strict=True)]
    return tuple(sorted(found, key=lambda one: -abs(one.typical_multiple)))


def _on_bounds(added: Sequence[AppliedEffect]) -> list[str]:
    """A line for each strength on a bound after the joint refit, which has no nuisance parameters."""
    return [
        f"{p.name} of {named(applied)} is on its bound in the new subject: the functional form fits only approximately"
        for applied in added
        for p in applied.effect.parameters
        if p.kind == "strength" and p.on_bound(applied.values[p.name])
    ]


def _family(effects: Sequence[AppliedEffect]) -> str:
    """The common family of effects, empty if there is none."""
    families = {one.effect.family for one in effects}
    return families.pop() if len(families) == 1 else ""


def _floor_percent(cases: Sequence[Case], subject: Subject, s: ReportSettings) -> float | None:
    """Error by sensor noise alone, mean normalised rms in percent, from the band where bodies hardly move.

    An upper limit, because the error of the model in this band counts as noise. None where the low-pass takes the band.
    """
    found = []
    for case in cases:
        residual = np.where(case.compared, case.measured_mps2 - answer(subject, case), 0.0)
        after = residual[case.begin :]
        if len(after) < s.noise_samples or s.noise_band_hz[1] > PASSED_SHARE * case.cutoff_hz:
            continue
        frequency_hz, density = scipy.signal.welch(after, case.rate_hz, nperseg=s.noise_samples, axis=0)
        still = (frequency_hz >= s.noise_band_hz[0]) & (frequency_hz <= s.noise_band_hz[1])
        there = np.maximum(case.compared[case.begin :].mean(axis=0), 1e-9)  # masked samples are zeros
        # White noise has its density times the cut-off frequency as its mean square.
        noise = np.sqrt(np.median(density[still], axis=0) / there * case.cutoff_hz)
        rms = np.sqrt(case.energy / np.maximum(case.compared.sum(axis=0), 1))
        found.append(100.0 * np.mean(noise[case.energy > 0.0] / rms[case.energy > 0.0]))
    return float(np.mean(found)) if found else None
