"""Collect training data: the evidence of simulated bodies and their truth, one line of JSON for each body."""

from __future__ import annotations

import dataclasses
import json
import lzma
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from world.effects.moving import runs_away

from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import serial_map
from biodyn_core.tracing import data_checks
from biodyn_core.tracing.evidence import Evidence
from biodyn_core.tracing.rounds import search
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.trace import refitted
from blind.tracing.outcome import Cause
from blind.tracing.records import Record, causes, record
from blind.training.draw import OUTSIDE, TOGETHER, TrainingBody, TrainingSettings, drawn, sittings

SEED = 0
"""Of a trace."""


@dataclass(frozen=True)
class Example:
    """The evidence of one body, None if it cannot be traced, and its truth.

    causes: the hidden effects of the catalogue; outside: whether one of no class is hidden. ratio: about that of the
    hidden effects, None without. forms: their names in the simulation. background: the scales by kind.
    """

    number: int
    causes: tuple[Cause, ...]
    outside: bool
    ratio: float | None
    forms: tuple[str, ...]
    background: Mapping[str, float]
    evidence: Evidence | None

    def line(self) -> str:
        """As one line of JSON."""
        facts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        facts["causes"] = [dataclasses.astuple(one) for one in self.causes]
        evidence = None if self.evidence is None else self.evidence.to_dict()
        return json.dumps(facts | {"evidence": evidence}, separators=(",", ":"))

    @classmethod
    def of_line(cls, line: str) -> Example:
        """From one line of JSON."""
        facts: dict[str, Any] = json.loads(line)
        facts["causes"] = tuple(Cause(*one) for one in facts["causes"])
        facts["forms"] = tuple(facts["forms"])
        evidence = None if facts["evidence"] is None else Evidence.from_dict(facts["evidence"])
        return cls(**facts | {"evidence": evidence})


def collect(numbers: Sequence[int], seed: int, path: Path, processes: int, report: Callable[[str], None]) -> None:
    """Append the examples of these bodies to a file; those that are known are left out."""
    known = {example.number for example in examples(path)}
    missing = [number for number in numbers if number not in known]
    chunks = [missing[begin : begin + TOGETHER] for begin in range(0, len(missing), TOGETHER)]
    with ProcessPoolExecutor(processes) as executor, path.open("a", encoding="utf-8") as file:
        done = 0
        for future in as_completed([executor.submit(_lines, chunk, seed) for chunk in chunks]):
            lines = future.result()
            file.writelines(line + "\n" for line in lines)
            file.flush()
            done += len(lines)
            report(f"{done} of {len(missing)} bodies")


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
        evidence = None if runs_away(one.hidden) else evidence_of_record(record(one))
        yield _example(body, one.ratio if one.effects else None, evidence)


def _example(body: TrainingBody, ratio: float | None, evidence: Evidence | None) -> Example:
    """The truth of a body beside its evidence."""
    effects = body.effects
    return Example(
        body.number, causes([one for one in effects if one.kind != OUTSIDE]),
        any(one.kind == OUTSIDE for one in effects), ratio, tuple(type(one).__name__ for one in effects),
        {kind: scale for kind, scale in body.scales.items() if scale}, evidence,
    )  # fmt: skip


def evidence_of_record(one: Record, settings: TraceSettings | None = None) -> Evidence | None:
    """The evidence of the first round of a trace; None if the record cannot be fitted."""
    s = settings or TraceSettings()
    train, choose, _ = data_checks.usable(one.train, one.held_out, s.floor)
    if not train or not choose:
        return None
    try:
        before = refitted(train, one.subject, s, SEED, None, serial_map)
        found = search(before, train, choose, s, SEED, lambda stage, share: None)
        return found.evidence(s, found.diagnostics(s))
    except InputError:
        return None
