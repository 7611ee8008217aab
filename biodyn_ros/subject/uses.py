"""Uses of a session's events: some of each loading condition are chosen, and dealt to fit, to choose and to report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.tracing import findings
from biodyn_ros.reading.dealing import TO_TRACE, Dealable, Use, deal, turns
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.trace.report import Report

_OF_TRACE: Final[Mapping[findings.Use, Use]] = {"train": "fit", "choose": "choose", "held_out": "report"}


@dataclass(frozen=True)
class UsedEvents:
    """The events of each use, and the number of those that are not used.

    fit: for parameters; choose: for the choice of an effect; report: only predicted. Held-out events come choose and
    report by turns within a condition, as a trace divides them.
    """

    uses: Mapping[str, Use]
    fit: tuple[BagPart, ...]
    held_out: tuple[BagPart, ...]
    unused: int

    @property
    def report(self) -> tuple[BagPart, ...]:
        """The events that are only predicted."""
        return tuple(part for part in self.held_out if self.uses[str(part)] == "report")

    def changed(self, in_trace: Mapping[str, str] | None) -> dict[str, str]:
        """The use of each event whose use in a trace, by `traced_uses`, is not the dealt one; none if unknown."""
        if in_trace is None:
            return {}
        found = {event: in_trace.get(event, "not used") for event in self.uses}
        return {event: use for event, use in found.items() if use != self.uses[event]}


def used_events(parts: Sequence[BagPart], per_case: int, seed: int) -> UsedEvents:
    """Choose at most per_case events of each condition, over all levels, and deal them."""
    chosen = [part for case in _cases(parts) for part in _over_levels(parts, case, per_case)]
    bags = list(dict.fromkeys(str(part.path) for part in parts))
    items = [
        Dealable(str(part), part.case or "", part.level_mps2, 1e6 * bags.index(str(part.path)) + part.begin_s)
        for part in chosen
    ]
    drawn = deal(items, TO_TRACE, seed)
    ranks = turns(drawn)
    ordered = sorted(chosen, key=lambda part: ranks[str(part)])
    return UsedEvents(
        {bag: use for bag, (_, use) in drawn.items()},
        tuple(part for part in ordered if drawn[str(part)][1] == "fit"),
        tuple(part for part in ordered if drawn[str(part)][1] != "fit"),
        len(parts) - len(chosen),
    )


def traced_uses(traced: Report) -> dict[str, str]:
    """The use of each event that a trace has used, several if a gap divides it.

    A trace divides the held-out events that it can use, so a use may differ from the dealt one.
    """
    by_name = {each.name: _OF_TRACE[each.use] for each in traced.trace.events}
    found: dict[str, list[Use]] = {}
    for event, case in traced.events:
        if case.name in by_name:
            found.setdefault(event.bag, []).append(by_name[case.name])
    return {bag: ", ".join(dict.fromkeys(uses)) for bag, uses in found.items()}


def _cases(parts: Sequence[BagPart]) -> list[str | None]:
    return list(dict.fromkeys(part.case for part in parts))


def _over_levels(parts: Sequence[BagPart], case: str | None, most: int) -> list[BagPart]:
    """At most so many events of a condition, from the weakest to the strongest."""
    of_case = sorted((part for part in parts if part.case == case), key=lambda part: part.level_mps2)
    at = np.unique(np.linspace(0, len(of_case) - 1, min(most, len(of_case))).round().astype(int))
    return [of_case[k] for k in at.tolist()]
