"""Choice: the ranking of the candidates by probability, the chosen one, and its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from biodyn_core.base.wording import counted
from biodyn_core.tracing.candidate import Candidate, CandidateFit
from biodyn_core.tracing.evidence import theta_moved_to_bound
from biodyn_core.tracing.findings import RankedCandidate, Round
from biodyn_core.tracing.local_fit import LocalFit
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.probability import Probabilities
from biodyn_core.tracing.screen import Screening


@dataclass(frozen=True, eq=False)
class Choice:
    """The candidates that may be chosen, by probability, and the round with at most one of them; index: its place."""

    fitted: tuple[Candidate, ...]
    round: Round
    index: int | None


def choose(
    fitted: Sequence[Candidate], rest: Sequence[Candidate], p: Probabilities, least: float, nuisance: NuisanceModel,
    without: LocalFit, screening: Screening, near_bound: float,
) -> Choice:  # fmt: skip
    """Choose the most probable candidate of the most probable answer, if that is a mechanism of at least this chance.

    fitted: candidates fitted to all events, of which the one with the larger gain counts if an effect and site has two
    (a cause that varies with time is one of its own); rest: those that are only screened.
    """
    largest: dict[tuple[str, str], Candidate] = {}
    for one in sorted(fitted, key=lambda one: -one.best_fit.gain):
        largest.setdefault(one.key, one)
    by_probability = sorted(largest.values(), key=lambda one: -p.of(one.key))
    rows = [_fitted_row(one, p, nuisance, without, screening, near_bound) for one in by_probability]
    every = sorted([*rows, *(_screened_row(one, p) for one in rest)], key=lambda one: -one.probability)
    answers, likely = p.of_answers, p.likely
    best = next(iter(answers))
    able = [i for i, one in enumerate(rows) if one.applied.effect.mechanism == best and answers[best] >= least]
    index = able[0] if able else None
    chosen = None if index is None else rows[index]
    rivals = _rivals(chosen, every, p) if chosen is not None else ()
    return Choice(tuple(by_probability), Round(tuple(every), answers, likely, chosen, rivals), index)


def _rivals(
    chosen: RankedCandidate, ranking: Sequence[RankedCandidate], p: Probabilities
) -> tuple[RankedCandidate, ...]:
    """The best candidate of each other mechanism in the 90 % set, and the other likely sites of the chosen one."""
    found: dict[tuple[str, str], RankedCandidate] = {}
    seen = {chosen.applied.effect.mechanism}
    for one in ranking:
        mechanism = one.applied.effect.mechanism
        other_site = mechanism == chosen.applied.effect.mechanism and one.applied.site != chosen.applied.site
        if (mechanism in p.likely and mechanism not in seen) or (other_site and one.probability >= p.set_threshold):
            found.setdefault((mechanism, one.applied.site), one)
        seen.add(mechanism)
    return tuple(found.values())


def _screened_row(one: Candidate, p: Probabilities) -> RankedCandidate:
    of = one.screened
    return RankedCandidate(one.start, p.of(one.key), of.gain, False, of.p_value, of.absorbed, None)


def _fitted_row(
    one: Candidate, p: Probabilities, nuisance: NuisanceModel, without: LocalFit, screening: Screening,
    near_bound: float,
) -> RankedCandidate:  # fmt: skip
    fit = one.best_fit
    return RankedCandidate(
        fit.applied, p.of(one.key), fit.gain, True, screening.p_value(fit.gain), one.screened.absorbed,
        fit.improved_events, tuple(_remarks(fit, nuisance, without, near_bound)), fit.steady,
    )  # fmt: skip


def _remarks(fit: CandidateFit, nuisance: NuisanceModel, without: LocalFit, near_bound: float) -> list[str]:
    """What an engineer should know of a fit, a line each."""
    found = [f"{name} ends on a bound" for name in fit.local.at_bound]
    if fit.improved_events < fit.gains.size:
        found.append(f"improves {fit.improved_events} of {counted(fit.gains.size, 'event')}")
    found += [fit.objection] if fit.objection else []
    moved = theta_moved_to_bound(nuisance, without, fit.local, near_bound)
    return [*found, *(f"{name} moves to its bound" for name in moved)]
