"""What further recordings lift: the same bodies, traced from the least data and from more of several kinds.

Each body has one effect amid a background. All its recordings come from one sitting.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from world.effects.moving import runs_away
from world.effects.sitting import Planned, Sitting
from world.seats import Case

from biodyn_core.tracing.findings import FurtherRecordings
from biodyn_core.tracing.probability import LearnedModel
from blind.tracing.records import causes
from blind.training.calibrate import Prediction, answers
from blind.training.collect import Example, example, examples, in_chunks, pack
from blind.training.draw import TrainingSettings, drawn, sittings
from blind.training.ideal import IdealDecision
from blind.training.learn import WEAK, labelled, labelled_with_true_law
from blind.training.traced import traced

TOGETHER: Final = 6
"""Bodies that are simulated at once: each has twice as many events as one for training."""

_BASE, _AGAIN, _HALF = (1, 2, 3), (4, 5, 6), (7, 8, 9)

SETTINGS: Final = TrainingSettings(
    nothing=0.0, two=0.0, outside=0.0, bare=0.0, missing=0.0, ratio=(0.3, 3.0), counts=((9, 9),) * 3,
    seconds=((10.0, 10.0), (6.0, 6.0), (6.0, 6.0)), levels=(*[1.0] * 6, *[0.5] * 3),
)  # fmt: skip
"""Nine events of each case and use, each as long as one of the least data; the last three have half the motion."""


@dataclass(frozen=True)
class Amount:
    """What is recorded: its name, in words, and the numbers of the events of each case and use."""

    name: str
    words: str
    numbers: Mapping[Case, Sequence[int]]

    def has(self, planned: Planned) -> bool:
        """Whether it has this event."""
        number = int(planned.name.rsplit("_", 1)[1])
        return number in self.numbers[planned.event.case]


def _amount(name: str, words: str, road: Sequence[int], shocks: Sequence[int]) -> Amount:
    return Amount(name, words, {"road": road, "pothole": shocks, "rail": shocks})


AMOUNTS: Final = (
    _amount("least", "the least data: 30 s of road and six shocks", _BASE, _BASE),
    _amount("road", "as much road again", (*_BASE, *_AGAIN), _BASE),
    _amount("shocks", "as many shocks again", _BASE, (*_BASE, *_AGAIN)),
    _amount("levels", "all again at half the level", (*_BASE, *_HALF), (*_BASE, *_HALF)),
    _amount("all", "all of these", (*_BASE, *_AGAIN, *_HALF), (*_BASE, *_AGAIN, *_HALF)),
)
"""The first one is the least data for a verdict, for fitting and again held out."""


def recorded(one: Sitting, amount: Amount) -> Sitting:
    """The part of a sitting that is recorded."""
    kept = [i for i, planned in enumerate(one.events) if amount.has(planned)]
    events, plain, hidden = (tuple(of[i] for i in kept) for of in (one.events, one.plain, one.hidden))
    return dataclasses.replace(one, events=events, plain=plain, hidden=hidden)


def collect(numbers: Sequence[int], seed: int, directory: Path, processes: int, report: Callable[[str], None]) -> None:
    """Add the examples of these bodies to the files of all amounts in a directory, without those that are known."""
    known = {number for number, _ in stored(directory)}
    missing = [number for number in numbers if number not in known]
    done = 0
    for bodies in in_chunks(_found, missing, TOGETHER, seed, processes):
        for found in bodies:
            _append(directory, found)
        done += len(bodies)
        report(f"{done} of {len(missing)} bodies with further recordings")
    for amount in AMOUNTS:
        pack(_path(directory, amount))


def stored(directory: Path) -> list[tuple[int, Mapping[str, Example]]]:
    """The examples of each body that has all amounts, by its number and by the names of the amounts."""
    every = {amount.name: {one.number: one for one in examples(_path(directory, amount))} for amount in AMOUNTS}
    whole = sorted(set.intersection(*(set(found) for found in every.values())))
    return [(number, {name: found[number] for name, found in every.items()}) for number in whole]


def _found(numbers: Sequence[int], seed: int) -> list[Mapping[str, Example]]:
    return list(made(numbers, seed))


def made(numbers: Sequence[int], seed: int, settings: TrainingSettings = SETTINGS) -> Iterator[Mapping[str, Example]]:
    """The examples of bodies by the names of the amounts."""
    for number, one in zip(numbers, sittings(numbers, seed, settings), strict=True):
        body = drawn(number, seed, settings)
        own = causes(body.effects)
        yield {
            amount.name: example(body, own, None if runs_away(one.hidden) else traced(recorded(one, amount), own[0]))
            for amount in AMOUNTS
        }


def _path(directory: Path, amount: Amount) -> Path:
    return directory / f"{amount.name}.jsonl"


def _append(directory: Path, found: Mapping[str, Example]) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    for amount in AMOUNTS:
        with _path(directory, amount).open("a", encoding="utf-8") as file:
            file.write(found[amount.name].line() + "\n")


@dataclass(frozen=True, eq=False)
class Answers:
    """The answers to bodies from one amount: with the catalogue's laws, and with the true law of each.

    learned: with the true laws by the decision that was learned with true laws.
    """

    catalogue: Sequence[Prediction]
    true_law: Sequence[Prediction]
    learned: Sequence[Prediction]


def summary(found: Mapping[str, Answers], named_from: float) -> tuple[FurtherRecordings, ...]:
    """The right causes named from each amount, with the catalogue's laws; empty without bodies.

    Bodies whose effect is so weak in the least data that `none` is right too are left out.
    """
    kept = [i for i, one in enumerate(found[AMOUNTS[0].name].catalogue) if one.labelled.ratio >= WEAK]
    every = [(amount.words, [found[amount.name].catalogue[i] for i in kept]) for amount in AMOUNTS]
    return tuple(
        FurtherRecordings(
            words, len(of), sum(one.names_right(named_from) for one in of), sum(one.best in one.right for one in of)
        )
        for words, of in every
        if of
    )


def answered(
    found: Sequence[tuple[int, Mapping[str, Example]]], model: LearnedModel, ideal: IdealDecision
) -> dict[str, Answers]:
    """The answers by the names of the amounts, in the order of bodies that can be traced from every amount."""
    with_true_laws = [{name: labelled_with_true_law(one) for name, one in each.items()} for _, each in found]
    usable = [(each, true) for (_, each), true in zip(found, with_true_laws, strict=True) if all(true.values())]
    by_amount = {}
    for amount in AMOUNTS:
        own = [labelled(each[amount.name])[0] for each, _ in usable]
        true = [one[amount.name][0] for _, one in usable]
        by_model = [answers(one, model.weights, model.temperature) for one in (own, true)]
        by_amount[amount.name] = Answers(*by_model, ideal.answers(true))
    return by_amount
