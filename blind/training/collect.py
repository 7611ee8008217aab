"""Collect training data: the evidence of simulated bodies and their truth, one line of JSON for each body."""

from __future__ import annotations

import dataclasses
import json
import lzma
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from world.effects.moving import runs_away

from biodyn_core.tracing.evidence import Evidence
from blind.tracing.outcome import Cause
from blind.tracing.records import causes
from blind.training.draw import OUTSIDE, TOGETHER, TrainingBody, TrainingSettings, drawn, sittings
from blind.training.traced import TracedBody, traced

T = TypeVar("T")

EVIDENCES = ("evidence", "with_true_law")
"""Fields of an example that hold evidence."""


@dataclass(frozen=True)
class Example:
    """The evidence of one body, None if it cannot be traced, and its truth.

    causes: the hidden effects of the catalogue; outside: whether one of no class is hidden. ratio: that of the hidden
    effects as in the blind study (`blind.tracing.score.ratio`), None without. forms: their names in the simulation.
    background: the scales by kind. with_true_law: the evidence as if the catalogue had the law of the hidden effect,
    None unless it is one effect of the catalogue.
    """

    number: int
    causes: tuple[Cause, ...]
    outside: bool
    ratio: float | None
    forms: tuple[str, ...]
    background: Mapping[str, float]
    evidence: Evidence | None
    with_true_law: Evidence | None = None

    def line(self) -> str:
        """As one line of JSON."""
        facts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        facts["causes"] = [dataclasses.astuple(one) for one in self.causes]
        stored = {name: None if facts[name] is None else facts[name].to_dict() for name in EVIDENCES}
        return json.dumps(facts | stored, separators=(",", ":"))

    @classmethod
    def of_line(cls, line: str) -> Example:
        """From one line of JSON."""
        facts: dict[str, Any] = json.loads(line)
        facts["causes"] = tuple(Cause(*one) for one in facts["causes"])
        facts["forms"] = tuple(facts["forms"])
        read = {name: None if facts[name] is None else Evidence.from_dict(facts[name]) for name in EVIDENCES}
        return cls(**facts | read)


def collect(numbers: Sequence[int], seed: int, path: Path, processes: int, report: Callable[[str], None]) -> None:
    """Append the examples of these bodies to a file; those that are known are left out."""
    known = {example.number for example in examples(path)}
    missing = [number for number in numbers if number not in known]
    done = 0
    for lines in in_chunks(_lines, missing, TOGETHER, seed, processes):
        with path.open("a", encoding="utf-8") as file:
            file.writelines(line + "\n" for line in lines)
        done += len(lines)
        report(f"{done} of {len(missing)} bodies")


def in_chunks(
    make: Callable[[Sequence[int], int], list[T]], numbers: Sequence[int], together: int, seed: int, processes: int
) -> Iterator[list[T]]:
    """Make the results of bodies in several processes, `together` at once; each group is yielded when it is ready."""
    chunks = [numbers[begin : begin + together] for begin in range(0, len(numbers), together)]
    with ProcessPoolExecutor(processes) as executor:
        for future in as_completed([executor.submit(make, chunk, seed) for chunk in chunks]):
            yield future.result()


def archive_of(path: Path) -> Path:
    """The compressed file that keeps the examples of a file."""
    return path.with_name(path.name + ".xz")


def examples(path: Path) -> list[Example]:
    """The examples of a file and of its archive by number; none if there is neither."""
    return sorted(map(Example.of_line, _stored(path)), key=lambda one: one.number)


def pack(path: Path) -> None:
    """Move the examples of a file into its archive."""
    text = "".join(one.line() + "\n" for one in examples(path))
    archive_of(path).write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))
    path.unlink(missing_ok=True)


def _stored(path: Path) -> list[str]:
    plain = path.read_text(encoding="utf-8") if path.exists() else ""
    archive = archive_of(path)
    packed = lzma.decompress(archive.read_bytes()).decode() if archive.exists() else ""
    return [*packed.splitlines(), *plain.splitlines()]


def _lines(numbers: Sequence[int], seed: int) -> list[str]:
    return [one.line() for one in made(numbers, seed)]


def made(numbers: Sequence[int], seed: int, settings: TrainingSettings | None = None) -> Iterator[Example]:
    """The examples of bodies by their numbers, without evidence of those whose simulation stays unstable."""
    for number, one in zip(numbers, sittings(numbers, seed, settings), strict=True):
        body = drawn(number, seed, settings)
        own = causes([effect for effect in body.effects if effect.kind != OUTSIDE])
        found = None if runs_away(one.hidden) else traced(one, own[0] if len(body.effects) == len(own) == 1 else None)
        yield example(body, own, found)


def example(body: TrainingBody, own: tuple[Cause, ...], traced_body: TracedBody | None) -> Example:
    """The truth of a body beside its evidence, None if it cannot be traced."""
    found = traced_body or TracedBody(None, None)
    return Example(
        body.number, own, len(own) < len(body.effects), found.ratio, tuple(type(one).__name__ for one in body.effects),
        {kind: scale for kind, scale in body.scales.items() if scale}, found.evidence, found.with_true_law,
    )  # fmt: skip
