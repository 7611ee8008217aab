"""Verdict: what the rounds of a trace amount to, and why that and nothing else."""

from __future__ import annotations

from collections.abc import Sequence

from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.findings import Candidate, Surface, Verdict
from biodyn_core.tracing.fitted_candidates import ANEW
from biodyn_core.tracing.rounds import Outcome
from biodyn_core.tracing.sensor_limits import within_limits
from biodyn_core.tracing.settings import TraceSettings


def closed(outcomes: Sequence[Outcome], s: TraceSettings) -> float:
    """How much of what was left beyond the usual is gone, as a share of squares; 1 where nothing was beyond it."""
    before, after = outcomes[0].before, outcomes[-1].after
    beyond = before**2 - s.usual_left**2
    return (before**2 - after**2) / beyond if beyond > 0.0 else 1.0


def explained(outcomes: Sequence[Outcome], s: TraceSettings) -> bool:
    """Whether what was taken is believed: where most of the gap stays open, the cause is likelier none of the list.

    Faults that data sheets allow are believed only where something beyond the usual was left for them to explain.
    """
    taken = outcomes[0].taken is not None and closed(outcomes, s) >= s.least_closed
    return taken and not findings_alone(outcomes, s)


def findings_alone(outcomes: Sequence[Outcome], s: TraceSettings) -> bool:
    """Whether all that was taken are faults within data sheets, and nothing beyond the usual was left to explain."""
    taken = [one.round.taken for one in outcomes if one.round.taken is not None]
    return bool(taken) and outcomes[0].before <= s.usual_left and all(within_limits(one.applied) for one in taken)


def judged(
    outcomes: Sequence[Outcome], law: Surface | None, leaning: Sequence[AppliedEffect], s: TraceSettings
) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict, and the reasons for it, a line each.

    law: a joint's surface, where one was looked at; leaning: sensors that lean farther than a data sheet allows, by
    their own gyros, which are a cause by themselves where the rounds found none.
    """
    verdict, reasons = _of_effect(outcomes[0]) if explained(outcomes, s) else _of_none(outcomes, law, s)
    return "effect" if leaning and verdict == "none" else verdict, reasons


def _of_none(outcomes: Sequence[Outcome], law: Surface | None, s: TraceSettings) -> tuple[Verdict, tuple[str, ...]]:
    """Where no effect is believed: whether more is left than is usual, or what would explain it was refused."""
    first, last = outcomes[0].round, outcomes[-1]
    best = first.taken or first.ladder[0]
    said = f"the best of all, {named(best.applied)}, gains {best.gain:.2f}; {first.threshold:.2f} was asked"
    strong = [one for one in first.ladder if one.refitted and one.against and one.gain > first.threshold]
    refused = [_refusal(one) for one in strong if not one.usual]
    usual = [_refusal(one) for one in strong if one.usual]
    if outcomes[0].taken is not None and not findings_alone(outcomes, s):
        refused.append(
            f"{named(best.applied)} closes only {100.0 * closed(outcomes, s):.0f} % of the gap between what is left"
            f" and what is usual, {100.0 * s.least_closed:g} % was asked"
        )
    much = f"what is left is {last.before:.2f} times what a good model misses, up to {s.unusual:g} is usual"
    stretched = outcomes[0].without.stretched
    far = f"usual departures are stretched to {stretched:.0f} in squares of theirs, up to {s.most_stretched:g} is usual"
    beyond = outcomes[0].before > s.unusual or stretched > s.most_stretched
    if refused or beyond or (law is not None and law.gain > first.threshold):
        return "unexplained", (said, much, far, *refused, *usual)
    return "none", (said, much, far, *usual)


def _refusal(one: Candidate) -> str:
    return f"{named(one.applied)} gains {one.gain:.2f}, but {'; '.join(one.against)}"


def _of_effect(outcome: Outcome) -> tuple[Verdict, tuple[str, ...]]:
    first = outcome.round
    assert first.taken is not None
    taken = first.taken
    where = "in events that its size was not fitted to"
    if not taken.steady and taken.applied.effect.name != "posture":  # its two stiffnesses are fitted to others
        where = f"set anew in the very events that choose, where {ANEW:g} says nothing"
    said = f"{named(taken.applied)} gains {taken.gain:.2f} {where}; {first.threshold:.2f} was asked"
    others = [one.applied for one in first.ambiguous_with]
    if any(one.effect is not taken.applied.effect for one in others):
        return "ambiguous", (said, f"as good or nearly: {', '.join(map(named, others))}")
    sites = ", ".join(one.site for one in others)
    where = f"where it sits is less sure, nearly as well: {sites}" if sites else "at no other site nearly as well"
    return "effect", (said, f"no other effect explains them nearly as well; {where}")


def named(applied: AppliedEffect) -> str:
    """An effect and its site in words."""
    return f"{applied.effect.name} at {applied.site}"
