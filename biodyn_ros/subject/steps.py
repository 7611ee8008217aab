"""Steps: each is run once, stored with a key of all that it depends on, and used again while its key and files fit."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

from biodyn_core.base.errors import InputError, one_line
from biodyn_ros import __version__
from biodyn_ros.base.json_files import keys_of, read_json, write_json
from biodyn_ros.reading.provenance import sha256_of

SCHEMA: Final = 4

State = Literal["done", "failed", "skipped"]
"""skipped: not possible because an earlier step has failed."""


@dataclass(frozen=True)
class Step:
    """One step and its result; reason: why it failed or was skipped; facts: its main numbers; again: used again.

    sha256: of its files as they were written.
    """

    name: str
    state: State
    key: str = ""
    reason: str = ""
    seconds: float = 0.0
    facts: Mapping[str, Any] = field(default_factory=dict)
    again: bool = False
    sha256: str = ""


def key_of(*parts: object) -> str:
    """A key of everything that a step depends on, with the version of this program."""
    return hashlib.sha256(repr((parts, __version__)).encode()).hexdigest()


class StepLog:
    """The steps of a directory, written to `subject.json` after each one.

    A finished step of an earlier run is kept until this run finishes the same step, or writes files in its place.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._done = _read(path) if path.exists() else {}
        self.steps: dict[str, Step] = {}

    def run(
        self,
        name: str,
        key: str,
        outputs: Sequence[Path],
        work: Callable[[], Mapping[str, Any]],
        editable: bool = False,
    ) -> Step:
        """Run a step, or use its stored result again; an InputError is its failure, and does not end the others.

        A work calls `forget` before it writes. editable: whether files that were changed since are used too.
        """
        before = self._done.get(name)
        there = all(path.exists() for path in outputs) and (editable or self.is_as_written(name, outputs))
        if before and before.key == key and there:
            return self._add(replace(before, again=True))
        begin = time.monotonic()
        try:
            facts = work()
        except InputError as error:
            return self._add(Step(name, "failed", key, one_line(error), time.monotonic() - begin))
        return self._add(Step(name, "done", key, "", time.monotonic() - begin, facts, sha256=_content(outputs)))

    def skip(self, name: str, reason: str) -> Step:
        """A step that is not possible."""
        return self._add(Step(name, "skipped", reason=reason))

    def forget(self, name: str) -> None:
        """Forget a finished step before its files are written: a run that is stopped may leave old and new ones."""
        if self._done.pop(name, None):
            write_json(self.path, self.document())

    def is_as_written(self, name: str, outputs: Sequence[Path]) -> bool:
        """Whether the files of a finished step are as it wrote them; False for a step that is not known."""
        return name in self._done and self._done[name].sha256 == _content(outputs)

    def document(self) -> dict[str, Any]:
        """The mapping of subject.json: the steps of this run, and those of earlier runs that are kept."""
        kept = [step for name, step in self._done.items() if self.steps.get(name) is not step]
        of_run = [asdict(step) for step in self.steps.values()]
        return {"schema": SCHEMA, "version": __version__, "steps": of_run, "kept": [asdict(step) for step in kept]}

    def _add(self, step: Step) -> Step:
        self.steps[step.name] = step
        if step.state == "done":
            self._done[step.name] = step
        write_json(self.path, self.document())
        return step


def _content(outputs: Sequence[Path]) -> str:
    return sha256_of(path for path in outputs if path.is_file())


def _read(path: Path) -> dict[str, Step]:
    """The finished steps; none of a file of another version."""
    try:
        document = keys_of(read_json(path), "the file")
        if (document.get("schema"), document.get("version")) != (SCHEMA, __version__):
            return {}
        lists = keys_of(document, "the file", ("schema", "version", "steps", "kept"))
        fields = tuple(Step.__dataclass_fields__)
        steps = [Step(**keys_of(each, "steps", fields)) for each in (*lists["kept"], *lists["steps"])]
    except (InputError, TypeError) as error:
        raise InputError(f"{path}: {one_line(error)}; remove it to start anew") from None
    return {step.name: step for step in steps if step.state == "done"}
