"""Trace: the effect that a subject's model lacks, from the residual of a fitted subject."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import fit_joint, mean_percent
from biodyn_core.identification.identify import fingerprint
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing import data_checks
from biodyn_core.tracing.answers import UnstableSimulation, answer, check_stable, first_unstable
from biodyn_core.tracing.findings import Trace
from biodyn_core.tracing.joint_refit import generalised, jointly_refitted
from biodyn_core.tracing.preliminary_fit import OnStage
from biodyn_core.tracing.probability import packaged
from biodyn_core.tracing.results import build_result, build_undecided
from biodyn_core.tracing.rounds import PRELIMINARY, Checkpoint, Outcome, one_round
from biodyn_core.tracing.settings import TraceSettings

NO_BETTER: Final = (
    "without nuisance parameters the error of the events for choosing is {:.1f} % before and {:.1f} % with it"
)
UNSTABLE: Final = "with it the simulation of {} is unstable"
NO_FURTHER: Final = "no further effect was searched for: {}"


def trace(
    train: Sequence[Case],
    held_out: Sequence[Case],
    subject: Subject,
    settings: TraceSettings | None = None,
    seed: int = 0,
    on_stage: OnStage = lambda stage, share: None,
    checkpoint: Checkpoint | None = None,
    parallel: ParallelMap = serial_map,
) -> Trace:
    """Find the effect that a subject's model lacks.

    Theta and sizes are fitted to `train`; half of `held_out` chooses the effect, the other half gives the errors.
    checkpoint: stored results of the long stages, read if they are of the same problem, and extended. parallel: runs
    independent fits; the numbers do not depend on it. Raises InputError if nothing can be fitted. Too little data is no
    error, but the verdict `not_decidable`.
    """
    s = settings or TraceSettings()
    packaged()  # a damaged model is refused before the long work
    train, held_out, left_out = data_checks.usable(train, held_out, s.floor)
    choose, report = data_checks.split_held_out(held_out)
    uses, lacking = (train, choose, report), data_checks.lacking(train, held_out, s.floor)
    needs = data_checks.needs(train, held_out, s.floor) if lacking else []
    if not train:
        return build_undecided(subject, subject, uses, lacking, needs, s, left_out, seed)
    on_stage("fitting parameters", 0.0)
    checkpoint = {} if checkpoint is None else checkpoint
    known = set(checkpoint)
    before = refitted(train, subject, s, seed, checkpoint, parallel)
    if lacking:
        return build_undecided(subject, before, uses, lacking, needs, s, left_out, seed)
    check_stable(before, [*train, *choose, *report])
    rounds, ended = _rounds(before, uses, s, seed, on_stage, checkpoint, parallel)
    outcomes = [outcome for _, outcome in rounds]
    after = rounds[-1][0]
    found = build_result(subject, before, after, outcomes, uses, s, left_out, seed, ended)
    return dataclasses.replace(found, calibrated=_calibrated(set(checkpoint) - known))


def _calibrated(computed: Iterable[str]) -> Literal["anew", "found"]:
    """`anew` if this trace has computed the draws of the screening, `found` if it has read them.

    computed: the keys of the results that it has computed.
    """
    return "anew" if any(key.startswith(PRELIMINARY) for key in computed) else "found"


def refitted(
    train: Sequence[Case], subject: Subject, s: TraceSettings, seed: int, checkpoint: Checkpoint, parallel: ParallelMap
) -> Subject:  # fmt: skip
    """The subject with one theta fitted to all events, and its effects too, which are refitted beside an added one.

    Otherwise the added effect would be credited with the change of the others.
    """

    def fit() -> Subject:
        found = fit_joint(train, subject, seed, s.base, parallel).subject
        return jointly_refitted(found, train, s.joint_refit, parallel) if found.effects else found

    return _stored(checkpoint, f"refit {fingerprint(train, subject, seed, (s.base, s.joint_refit))}", subject, fit)


def _stored(checkpoint: Checkpoint, key: str, subject: Subject, fit: Callable[[], Subject]) -> Subject:
    """The subject with the stored values of a fit of its theta and its effects, or the new fit, which is stored."""
    if key in checkpoint:
        return _with_values(subject, **checkpoint[key])
    found = fit()
    values = [dict(one.values) for one in found.effects]
    checkpoint[key] = {"theta": found.parameters.vector().tolist(), "effects": values}
    return found


def _with_values(subject: Subject, theta: Sequence[float], effects: Sequence[Mapping[str, float]]) -> Subject:
    """The subject with stored values, without its provenance."""
    changed = (dataclasses.replace(one, values=values) for one, values in zip(subject.effects, effects, strict=True))
    parameters = Parameters.from_vector(np.array(theta))
    return dataclasses.replace(subject, parameters=parameters, effects=tuple(changed), provenance={})


def _rounds(
    subject: Subject, uses: Sequence[Sequence[Case]], s: TraceSettings, seed: int, on_stage: OnStage,
    checkpoint: Checkpoint, parallel: ParallelMap,
) -> tuple[list[tuple[Subject, Outcome]], str]:  # fmt: skip
    """Greedy rounds until one adds nothing, each with the subject after it; and why no further one was possible.

    uses: events for fitting, for choosing and for reporting.
    """
    found: list[tuple[Subject, Outcome]] = []
    for number in range(s.most_effects):
        least = s.named_from if found else 0.0  # a further effect has to be named, the first one may be ambiguous
        try:
            outcome = one_round(subject, uses[0], uses[1], s, seed + number, on_stage, checkpoint, parallel, least)
        except UnstableSimulation as error:
            if not found:
                raise
            return found, NO_FURTHER.format(error)
        if outcome.adds_effect:
            on_stage("refitting", 0.0)
        subject, outcome = _with_joint_refit(subject, outcome, uses, s, checkpoint, parallel, first=not found)
        found.append((subject, outcome))
        fit = outcome.chosen
        if fit is None or not outcome.adds_effect:  # another round would find the same cause again
            break
        if outcome.after < s.enough and fit.prior_scale == min(s.local_fit.prior_scales):
            break
    return found, ""


def _with_joint_refit(
    subject: Subject, outcome: Outcome, uses: Sequence[Sequence[Case]], s: TraceSettings,
    checkpoint: Checkpoint, parallel: ParallelMap, first: bool,
) -> tuple[Subject, Outcome]:  # fmt: skip
    """The subject with the chosen effect, refitted to all events; unchanged if its own prediction is no better.

    The general form of the effect's law stays if it predicts the events for choosing better than the textbook form. The
    result is compared with the subject refitted in the same way without the effect, because theta alone may gain by
    that; after the first round the subject is the end of such a refit. A subject whose simulation is unstable in any
    event is of no use, however well it predicts the others.
    """
    if outcome.chosen is None or not outcome.adds_effect:
        return subject, outcome
    train, choose, _ = uses

    def percent(one: Subject) -> float:
        return mean_percent([errors(case, answer(one, case)) for case in choose])

    def with_textbook_laws(one: Subject) -> Subject:
        key = f"joint refit {fingerprint(train, one, 0, s.joint_refit)}"
        return _stored(checkpoint, key, one, lambda: jointly_refitted(one, train, s.joint_refit, parallel))

    def with_general_law(one: Subject) -> Subject:
        key = f"general refit {fingerprint(train, one, 0, (s.joint_refit, chosen.to_dict()))}"
        return _stored(checkpoint, key, one, lambda: generalised(one, train, s.joint_refit, [chosen], parallel))

    chosen = outcome.chosen.subject
    *others, last = chosen.effects
    plain = dataclasses.replace(chosen, effects=(*others, last.textbook))
    textbook = with_textbook_laws(plain)
    fitted = min((textbook, with_general_law(textbook)), key=percent)
    without = with_textbook_laws(subject) if first else subject
    before = min(percent(subject), percent(without))
    after = percent(fitted)
    if not after < (1.0 - s.evidence.least_improvement) * before:
        return subject, outcome.refused(NO_BETTER.format(before, after))
    if (unstable := first_unstable(fitted, [case for cases in uses for case in cases])) is not None:
        return subject, outcome.refused(UNSTABLE.format(unstable.name))
    return fitted, outcome
