"""Steps: each is run once, stored with a key of all that it depends on, and used again while its key and files fit."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from biodyn_core.base.errors import InputError, one_line
from biodyn_ros import __version__
from biodyn_ros.base.json_files import keys_of, read_json, write_json

SCHEMA: Final = 1

State = Literal["done", "failed", "skipped"]
"""skipped: not possible because an earlier step has failed."""


@dataclass(frozen=True)
class Step:
    """One step and its result; reason: why it failed or was skipped; facts: its main numbers; again: used again."""

    name: str
    state: State
    key: str = ""
    reason: str = ""
    seconds: float = 0.0
    facts: Mapping[str, Any] = field(default_factory=dict)
    again: bool = False


def key_of(*parts: object) -> str:
    """A key of everything that a step depends on, with the version of this program."""
    return hashlib.sha256(repr((parts, __version__)).encode()).hexdigest()


class StepLog:
    """The steps of a directory, written to `subject.json` after each one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._known = _read(path) if path.exists() else {}
        self.steps: dict[str, Step] = {}

    def run(self, name: str, key: str, outputs: Sequence[Path], work: Callable[[], Mapping[str, Any]]) -> Step:
        """Run a step, or use its stored result again; an InputError is its failure, and does not end the others."""
        before = self._known.get(name)
        if before and before.state == "done" and before.key == key and all(path.exists() for path in outputs):
            return self._add(Step(name, "done", key, "", before.seconds, before.facts, again=True))
        begin = time.monotonic()
        try:
            facts = work()
        except InputError as error:
            return self._add(Step(name, "failed", key, one_line(error), time.monotonic() - begin))
        return self._add(Step(name, "done", key, "", time.monotonic() - begin, facts))

    def skip(self, name: str, reason: str) -> Step:
        """A step that is not possible."""
        return self._add(Step(name, "skipped", reason=reason))

    def document(self) -> dict[str, Any]:
        """The mapping of subject.json."""
        return {"schema": SCHEMA, "version": __version__, "steps": [asdict(step) for step in self.steps.values()]}

    def _add(self, step: Step) -> Step:
        self.steps[step.name] = step
        write_json(self.path, self.document())
        return step


def _read(path: Path) -> dict[str, Step]:
    """The stored steps; none of a file of another version."""
    try:
        document = keys_of(read_json(path), "the file", ("schema", "version", "steps"))
        if (document["schema"], document["version"]) != (SCHEMA, __version__):
            return {}
        steps = [Step(**keys_of(each, "steps", tuple(Step.__dataclass_fields__))) for each in document["steps"]]
    except (InputError, TypeError) as error:
        raise InputError(f"{path}: {one_line(error)}; remove it to start anew") from None
    return {step.name: step for step in steps}
