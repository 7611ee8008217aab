"""Dealing: which events are fitted to and which are held out, drawn by loading condition, level and time.

Of the events of a condition, neighbours in level go to different uses. Of many such draws the one is taken whose uses
differ least in mean level and in mean time of the session.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_ros.reading.events import Prepared

Use = Literal["fit", "choose", "report"]

TO_FIT: Final[tuple[Use, ...]] = ("fit", "report")
TO_TRACE: Final[tuple[Use, ...]] = ("fit", "choose", "report", "fit")
"""The uses of neighbours in level; with fewer events of a condition the first ones."""

DRAWS: Final = 200


@dataclass(frozen=True)
class Dealable:
    """A bag or part: its loading condition, level (rms of the seat, m/s^2) and time, s."""

    bag: str
    case: str
    level_mps2: float
    time_s: float


def dealt(events: Sequence[Prepared], uses: Sequence[Use], seed: int) -> list[Prepared]:
    """The events with those of every use but `fit` held out; last, and of a condition alternately choose and report."""
    drawn = deal(dealables(events), uses, seed)
    ranks = turns(drawn)
    held = [(dataclasses.replace(event, held_out=drawn[event.bag][1] != "fit"), case) for event, case in events]
    return sorted(held, key=lambda each: (each[0].held_out, ranks[each[0].bag]))


def turns(drawn: Mapping[str, tuple[str, Use]]) -> dict[str, int]:
    """The place of each bag, so that choose and report alternate within a condition."""
    ranks: dict[str, int] = {}
    counts: dict[tuple[str, Use], int] = {}
    for bag, (case, use) in drawn.items():
        at = counts[case, use] = counts.get((case, use), -1) + 1
        ranks[bag] = 2 * at + (use == "report")
    return ranks


def dealt_line(events: Sequence[Prepared], seed: int) -> str:
    """How the events were dealt, in one line."""
    held = list(dict.fromkeys(event.bag for event, _ in events if event.held_out))
    every = len({event.bag for event, _ in events})
    return (
        f"dealt at random (seed {seed}), balanced by loading condition, level and time: {every - len(held)} to fit,"
        f" {len(held)} held out"
    )


def dealables(events: Sequence[Prepared]) -> list[Dealable]:
    """Each bag or part of the events once."""
    found: dict[str, Dealable] = {}
    for event, case in events:
        level = float(np.sqrt((case.seat_mps2[case.begin :] ** 2).mean()))
        time_s = 1e-9 * float(event.recording.stamps_ns[0])
        before = found.get(event.bag)
        found[event.bag] = before or Dealable(event.bag, case.case, level, time_s)
    return list(found.values())


def deal(items: Sequence[Dealable], uses: Sequence[Use], seed: int) -> dict[str, tuple[str, Use]]:
    """The condition and the use of each bag."""
    rng = np.random.default_rng(seed)
    draws = [_draw(items, uses, rng) for _ in range(DRAWS)]
    values = np.array([[item.level_mps2, item.time_s] for item in items])
    scaled = (values - values.mean(axis=0)) / np.where(values.std(axis=0) > 0.0, values.std(axis=0), 1.0)
    best = min(draws, key=lambda draw: _imbalance(draw, scaled, uses))
    return {item.bag: (item.case, use) for item, use in zip(items, best, strict=True)}


def _draw(items: Sequence[Dealable], uses: Sequence[Use], rng: np.random.Generator) -> list[Use]:
    """A use for each item: in blocks of neighbours in level within a condition, in random order."""
    found: dict[int, Use] = {}
    for case in dict.fromkeys(item.case for item in items):
        of_case = sorted((k for k, item in enumerate(items) if item.case == case), key=lambda k: items[k].level_mps2)
        for begin in range(0, len(of_case), len(uses)):
            block = of_case[begin : begin + len(uses)]
            order = rng.permutation(len(block)).tolist()
            found |= {k: uses[place] for k, place in zip(block, order, strict=True)}
    return [found[k] for k in range(len(items))]


def _imbalance(draw: Sequence[Use], scaled: Floats, uses: Sequence[Use]) -> float:
    """Sum over uses of the squared distance of its mean level and time from those of all."""
    given = np.array(draw)
    return float(sum((scaled[given == use].mean(axis=0) ** 2).sum() for use in set(uses) if (given == use).any()))
