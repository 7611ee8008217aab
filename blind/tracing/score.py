"""Scores: the truth of a record beside its answer, with refits for ratio and errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from world.effects import sitting
from world.effects.sitting import Sitting

from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.fit import Fit, fit_joint, mean_percent, prediction_errors, predictions
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.probability import Probabilities
from biodyn_core.tracing.settings import TraceSettings
from blind.tracing.answer import TRACE_SEED
from blind.tracing.ceiling import ceiling
from blind.tracing.outcome import Answer, Outcome, Score
from blind.tracing.own_laws import without_law
from blind.tracing.records import Record, causes, record
from blind.tracing.refits import FARTHEST_MPS2, oracle, placebo
from blind.tracing.rows import STRONG, WEAK, Drawing

Floats = NDArray[np.float64]

LEAST_TAKEN: Final = 0.01
"""An oracle that removes less than this share of the energy is no reference."""

PLACEBOS: Final = 20
"""Records of a row with a placebo. Only its median is shown, and it took 50 of 138 s of one score."""

FIR_S: Final = 0.25
FIR_EVERY_S: Final = 1.0 / 280.0
RIDGE: Final = 1e-3
"""The generic model: length and spacing of its taps (channels are low-passed at 100 Hz), and their ridge."""


def scored(drawing: Drawing, answer: Answer, one: Sitting) -> Score:
    """The score of one record's answer; without errors, but with the reason, if nothing can be fitted."""
    found = Score(drawing.name, answer.number, causes(one.effects))
    try:
        if drawing.effects == 0:
            return dataclasses.replace(found, own_ratio=own_ratio(drawing, answer, one))
        if drawing.needs == "ceilings":
            return dataclasses.replace(found, ceilings_alone=_ceilings_alone(drawing, one))
        return found if drawing.needs == "causes" else _refitted(found, drawing, answer, one)
    except InputError as error:
        return dataclasses.replace(found, why=str(error))


def own_ratio(drawing: Drawing, answer: Answer, one: Sitting) -> float | None:
    """The ratio of the background's own law that an answer names as the cause, None without one; see `own_laws`."""
    named = answer.effects[0] if answer.verdict == "effect" else None
    less = without_law(one, named) if named else None
    if less is None:
        return None
    known = [record(each, drawing.coloured, with_effects=False) for each in (one, less)]
    fits = [_base_fit(each) for each in known]
    return ratio(fits[0].subject, known[0].cases, fits[1].subject, known[1].cases)


def _base_fit(known: Record) -> Fit:
    return fit_joint(known.train, known.subject, TRACE_SEED, TraceSettings().base)


def _refitted(found: Score, drawing: Drawing, answer: Answer, one: Sitting) -> Score:
    hidden, plain = (record(one, drawing.coloured, with_effects) for with_effects in (True, False))
    fits = [_base_fit(known) for known in (hidden, plain)]
    subjects = _subjects(answer, hidden.subject)
    found = dataclasses.replace(
        found,
        ratio=ratio(fits[0].subject, hidden.cases, fits[1].subject, plain.cases),
        floor_percent=_percent(fits[1].subject, unseen(answer, plain).held_out),
        generic_percent=generic_percent(fits[0], unseen(answer, hidden)),
        after_percent=_percent(subjects[1], unseen(answer, hidden).held_out) if subjects else None,
        before_percent=_percent(fits[0].subject, unseen(answer, hidden).held_out),
    )
    shown = np.inf if one.level == 0.0 else found.ratio or 0.0
    if drawing.needs != "all" or shown <= WEAK or found.causes[0].name not in CATALOGUE:
        return found
    # What fails from here on must not take the known ratio, which decides the rows of the record.
    if subjects:  # the ceiling starts from the fit of the answer; a failed trace has none
        try:
            found = _with_ceiling(found, ceiling(hidden, subjects[0], found.causes[0], plain, fits[1].subject))
        except InputError as error:
            found = dataclasses.replace(found, why=f"ceiling: {error}")
    try:
        return _beside(found, answer, unseen(answer, hidden), fits[0]) if shown > STRONG else found
    except InputError as error:
        return dataclasses.replace(found, why=f"oracle: {error}")


def _with_ceiling(found: Score, ideal: Probabilities | None) -> Score:
    if ideal is None:
        return found
    return dataclasses.replace(found, ceiling=_rounded(ideal), ceiling_likely=ideal.likely)


def _ceilings_alone(drawing: Drawing, one: Sitting) -> tuple[dict[str, float], ...]:
    """The ceiling of each effect of a sitting in the same sitting without the others; empty if it is no candidate."""
    plain = record(one, drawing.coloured, with_effects=False)
    without = _base_fit(plain).subject
    found = []
    for alone in sitting.together([dataclasses.replace(one, effects=(effect,)) for effect in one.effects]):
        hidden, (cause,) = record(alone, drawing.coloured), causes(alone.effects)
        ideal = ceiling(hidden, _base_fit(hidden).subject, cause, plain, without)
        found.append({} if ideal is None else _rounded(ideal))
    return tuple(found)


def _rounded(ideal: Probabilities) -> dict[str, float]:
    return {name: float(f"{p:.4g}") for name, p in ideal.of_answers.items()}


def unseen(answer: Answer, known: Record) -> Record:
    """A record with only the held-out events that the answer names as unseen; all if it names none."""
    mine = tuple(case for case in known.held_out if case.name in answer.unseen)
    return dataclasses.replace(known, held_out=mine or known.held_out)


def _beside(found: Score, answer: Answer, hidden: Record, fit: Fit) -> Score:
    """With the errors of the oracle and, in the first records, the placebo, and the energy recovered."""
    cause = found.causes[0]
    best = oracle(fit, hidden.train, cause)
    wrong = placebo(fit, hidden.train, cause) if found.number < PLACEBOS else None
    before, after = _subjects(answer, hidden.subject) or (fit.subject, fit.subject)
    left, left_after, left_best = (sum_of_squares(subject, hidden.held_out) for subject in (before, after, best))
    return dataclasses.replace(
        found,
        oracle_percent=_percent(best, hidden.held_out),
        placebo_percent=None if wrong is None else _percent(wrong, hidden.held_out),
        recovered=recovered(left, left_after, left_best, Outcome(answer, found).class_right),
    )


def recovered(before: float, after: float, best: float, right: bool) -> float | None:
    """The energy that the answer removes, as a share of that of the oracle; 0 for a wrong or rejected class.

    None for the right class if the oracle removes next to nothing.
    """
    if not right:
        return 0.0
    return (before - after) / (before - best) if before - best > LEAST_TAKEN * before else None


def ratio(hidden: Subject, with_effect: Sequence[Case], plain: Subject, without: Sequence[Case]) -> float:
    """Rms of the residual with the effect minus that without, over the rms without, each by its own refitted subject.

    Samples are relative to the energy of the events without the effect, and compared in both.
    """
    own, rest = 0.0, 0.0
    beside = {case.name: case for case in without}
    for case in with_effect:
        if case.name not in beside:
            continue
        other = beside[case.name]
        rows = min(len(case.measured_mps2), len(other.measured_mps2))
        one, two = (residuals(of, c)[:rows] for of, c in ((hidden, case), (plain, other)))
        there = np.isfinite(one) & np.isfinite(two)
        scale = np.where(other.energy > 0.0, other.energy, np.inf)
        own += float((np.where(there, one - two, 0.0) ** 2 / scale).sum())
        rest += float((np.where(there, two, 0.0) ** 2 / scale).sum())
    return float(np.sqrt(own / rest))


def generic_percent(fit: Fit, known: Record) -> float:
    """Held-out error, percent, of the base refit and a ridge FIR from the seat to each segment's residual."""
    count = _taps(known.train[0]).shape[1]
    normal, match = np.zeros((count, count)), np.zeros((count, known.train[0].measured_mps2.shape[1]))
    for case in known.train:
        taps, left = _taps(case), np.nan_to_num(residuals(fit.subject, case))
        energy = float(case.seat_mps2 @ case.seat_mps2)  # so that no shock dominates
        normal += taps.T @ taps / energy
        match += taps.T @ left / energy
    weights = np.linalg.solve(normal + RIDGE * np.trace(normal) / count * np.eye(count), match)
    shares = []
    for case in known.held_out:
        left = residuals(fit.subject, case)
        squares = np.nansum((left - _taps(case) @ weights) ** 2, axis=0)
        shares.append(np.sqrt(squares[case.energy > 0.0] / case.energy[case.energy > 0.0]).mean())
    return float(100.0 * np.mean(shares))


def sum_of_squares(subject: Subject, cases: Sequence[Case]) -> float:
    """Squared residuals of cases, each segment of each event relative to its energy; infinite if unstable."""
    if is_unstable(subject, cases):
        return np.inf
    total = 0.0
    for case in cases:
        scale = np.where(case.energy > 0.0, case.energy, np.inf)
        total += float(np.nansum(residuals(subject, case) ** 2 / scale))
    return total


def is_unstable(subject: Subject, cases: Sequence[Case]) -> bool:
    """Whether the simulation of any case is unstable."""
    with np.errstate(all="ignore"):  # checked by the values
        return not all((np.abs(answer) < FARTHEST_MPS2).all() for answer in predictions(subject, cases))


def residuals(subject: Subject, case: Case) -> Floats:
    """Model less measurement (n, 5), clocks estimated, NaN where not compared."""
    theta = subject.parameters.vector()
    return TimeDomain([case], subject, RegularizationTerm(theta, 0.0), "estimated").residuals(0, theta)


def _subjects(answer: Answer, subject: Subject) -> tuple[Subject, Subject] | None:
    """The answer's subjects before and after; None without an answer."""
    if not answer.before or not answer.after:
        return None
    plain = dataclasses.replace(subject, parameters=Parameters.from_vector(np.array(answer.before)))
    after = dataclasses.replace(subject, parameters=Parameters.from_vector(np.array(answer.after)))
    return plain, Subject.from_dict(after.to_dict() | {"effects": list(answer.applied)})


def _taps(case: Case) -> Floats:
    """The seat's acceleration at increasing lags, (n, taps)."""
    every = max(1, round(FIR_EVERY_S * case.rate_hz))
    lags = np.arange(0, round(FIR_S * case.rate_hz), every)
    seat, n = case.seat_mps2, case.seat_mps2.size
    return np.column_stack([np.concatenate([np.zeros(lag), seat[: n - lag]]) for lag in lags])


def _percent(subject: Subject, cases: Sequence[Case]) -> float:
    return np.inf if is_unstable(subject, cases) else mean_percent(prediction_errors(subject, cases))
