"""Trace: from a fitted subject's residual to the effect that its model lacks, and the error before and after."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.identify import fingerprint
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing import gate
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.findings import Trace
from biodyn_core.tracing.joint_refit import jointly_refitted
from biodyn_core.tracing.local_fit import LEVELS
from biodyn_core.tracing.preliminary_fit import Tell
from biodyn_core.tracing.results import decided, undecided
from biodyn_core.tracing.rounds import Kept, Outcome, one_round
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.verdict import explained

WORSE: Final = (
    "by itself, no departures weighed in, it misses the events that choose by {:.1f} % before, {:.1f} % with it"
)


def trace(
    train: Sequence[Case],
    held_out: Sequence[Case],
    subject: Subject,
    settings: TraceSettings | None = None,
    seed: int = 0,
    tell: Tell = lambda stage, share: None,
    kept: Kept | None = None,
) -> Trace:
    """Find what a subject's model lacks.

    Theta and sizes are fitted to `train`; half of `held_out` chooses the effect, the other half gives the errors.
    Raises InputError where nothing can be fitted to; where a verdict cannot be carried, the verdict says so. kept: the
    long parts of earlier traces, taken up where they are of the same problem, and added to.
    """
    s = settings or TraceSettings()
    train, held_out, left_out = gate.usable(train, held_out)
    choose, report = gate.dealt(held_out)
    sides, lacking = (train, choose, report), gate.lacking(train, held_out, s.floor)
    needs = gate.needs(train, held_out, s.floor) if lacking else []
    if not train:
        return undecided(subject, subject, sides, lacking, needs, s, left_out, seed)
    tell("fitting theta", 0.0)
    before = _refitted(train, subject, s, seed, kept)
    if lacking:
        return undecided(subject, before, sides, lacking, needs, s, left_out, seed)
    known = set(kept or ())
    outcomes = _rounds(before, train, choose, s, seed, tell, kept)
    after = outcomes[-1][0] if explained([outcome for _, outcome in outcomes], s) else before
    found = decided(subject, before, after, [outcome for _, outcome in outcomes], sides, s, left_out, seed)
    anew = kept is None or set(kept) != known
    return dataclasses.replace(found, calibrated="anew" if anew else "found")


def _refitted(train: Sequence[Case], subject: Subject, s: TraceSettings, seed: int, kept: Kept | None) -> Subject:
    """The subject with one theta fitted to all events."""
    key = f"theta {fingerprint(train, subject, seed, s.base)}"
    if kept is not None and key in kept:
        return dataclasses.replace(subject, parameters=Parameters.from_vector(np.array(kept[key])), provenance={})
    found = fit_joint(train, subject, seed, s.base).subject
    if kept is not None:
        kept[key] = found.parameters.vector().tolist()
    return found


def _rounds(
    subject: Subject, train: Sequence[Case], choose: Sequence[Case], s: TraceSettings, seed: int, tell: Tell,
    kept: Kept | None,
) -> list[tuple[Subject, Outcome]]:  # fmt: skip
    """Greedy rounds until one takes nothing; after each, the subject as it is then."""
    found: list[tuple[Subject, Outcome]] = []
    for number in range(s.most_effects):
        outcome = one_round(subject, train, choose, s, seed + number, tell, kept)
        subject, outcome = _carried(subject, outcome, train, choose)
        found.append((subject, outcome))
        taken = outcome.round.taken
        if taken is None or not taken.steady:  # the next would find the same again
            break
        if outcome.taken is not None and outcome.after < s.enough and outcome.taken.level == LEVELS[-1]:
            break
    return found


def _carried(
    subject: Subject, outcome: Outcome, train: Sequence[Case], choose: Sequence[Case]
) -> tuple[Subject, Outcome]:
    """The subject with what was taken, fitted to all events; as it was if by itself it then predicts no better."""
    if outcome.taken is None or not outcome.carried:
        return subject, outcome
    fitted = jointly_refitted(outcome.taken.subject, train)
    before, after = (_mean_percent(one, choose) for one in (subject, fitted))
    return (fitted, outcome) if after < before else (subject, outcome.uncarried(WORSE.format(before, after)))


def _mean_percent(subject: Subject, cases: Sequence[Case]) -> float:
    """What a subject misses of these events by itself, no departures weighed in, percent."""
    return float(np.mean([errors(case, answer(subject, case)).mean_percent for case in cases]))
