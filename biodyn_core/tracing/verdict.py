"""Verdict of a trace from its rounds, and the reasons."""

from __future__ import annotations

from collections.abc import Sequence

from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.findings import RankedCandidate, Surface, Verdict
from biodyn_core.tracing.rounds import Outcome
from biodyn_core.tracing.sensor_limits import within_limits
from biodyn_core.tracing.settings import TraceSettings


def removed_share(outcomes: Sequence[Outcome], s: TraceSettings) -> float:
    """The share of the squared residual beyond the typical one that the effects remove; 1 if nothing is beyond it."""
    before, after = outcomes[0].before, outcomes[-1].after
    beyond = before**2 - s.usual_left**2
    return (before**2 - after**2) / beyond if beyond > 0.0 else 1.0


def is_explained(outcomes: Sequence[Outcome], s: TraceSettings) -> bool:
    """Whether the chosen effects are accepted: they remove enough of the residual beyond the typical one.

    Sensor faults within their data sheets are accepted only if there is a residual beyond the typical one.
    """
    enough = outcomes[0].chosen is not None and removed_share(outcomes, s) >= s.least_closed
    return enough and not only_allowed_faults(outcomes, s)


def only_allowed_faults(outcomes: Sequence[Outcome], s: TraceSettings) -> bool:
    """Whether all chosen effects are sensor faults within their data sheets, and the residual is typical."""
    effects = [one.round.chosen for one in outcomes if one.round.chosen is not None]
    return bool(effects) and outcomes[0].before <= s.usual_left and all(within_limits(one.applied) for one in effects)


def verdict_of(
    outcomes: Sequence[Outcome], law: Surface | None, tilts: Sequence[AppliedEffect], s: TraceSettings
) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict, and its reasons, a line each.

    law: the surface of a joint, if one was fitted. tilts: sensors tilted by more than a data sheet allows, by their
    gyros; they are a cause by themselves if the rounds found none.
    """
    verdict, reasons = _with_effect(outcomes[0], s) if is_explained(outcomes, s) else _without_effect(outcomes, law, s)
    return "effect" if tilts and verdict == "none" else verdict, reasons


def _without_effect(
    outcomes: Sequence[Outcome], law: Surface | None, s: TraceSettings
) -> tuple[Verdict, tuple[str, ...]]:
    """Without an accepted effect: whether the residual is typical, and which candidates have objections."""
    first, before = outcomes[0].round, outcomes[0].before
    best = first.chosen or first.ranking[0]
    gain = f"the largest gain is {best.gain:.2f} ({named(best.applied)}); {first.threshold:.2f} is required"
    strong = [one for one in first.ranking if one.refitted and one.objections and one.gain > first.threshold]
    refused = [_refusal(one) for one in strong if not one.typical]
    typical = [_refusal(one) for one in strong if one.typical]
    if outcomes[0].chosen is not None and not only_allowed_faults(outcomes, s):
        refused.append(
            f"{named(best.applied)} removes only {100.0 * removed_share(outcomes, s):.0f} % of the residual beyond the"
            f" typical one; {100.0 * s.least_closed:g} % is required"
        )
    last, square = outcomes[-1].before, outcomes[0].without.nuisance_square
    residual = f"the residual is {last:.2f} times that of a good model; up to {s.unusual:g} is typical"
    nuisance = f"the sum of squared nuisance parameters is {square:.0f}; up to {s.most_stretched:g} is typical"
    atypical = before > s.unusual or square > s.most_stretched
    if refused or atypical or (law is not None and law.gain > first.threshold):
        return "unexplained", (gain, residual, nuisance, *refused, *typical)
    return "none", (gain, residual, nuisance, *typical)


def _refusal(one: RankedCandidate) -> str:
    return f"{named(one.applied)} gains {one.gain:.2f}, but {'; '.join(one.objections)}"


def _with_effect(outcome: Outcome, s: TraceSettings) -> tuple[Verdict, tuple[str, ...]]:
    best = outcome.round.chosen
    assert best is not None
    where = "in events that its size was not fitted to"
    if not best.steady and not best.applied.effect.sized_by_training:
        where = f"in events that it was fitted to, where up to {s.evidence.unsteady_gain:g} is typical"
    gain = f"{named(best.applied)} gains {best.gain:.2f} {where}; {outcome.round.threshold:.2f} is required"
    others = [one.applied for one in outcome.round.ambiguous_with]
    if any(one.effect is not best.applied.effect for one in others):
        return "ambiguous", (gain, f"about as good: {', '.join(map(named, others))}")
    sites = ", ".join(one.site for one in others)
    site = f"its site is less certain; about as good: {sites}" if sites else "no other site is about as good"
    return "effect", (gain, f"no other effect is about as good; {site}")


def named(applied: AppliedEffect) -> str:
    """An effect and its site in words."""
    return f"{applied.effect.name} at {applied.site}"
