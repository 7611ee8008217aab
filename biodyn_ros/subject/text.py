"""A made subject as text for the terminal, and as JSON."""

from __future__ import annotations

from typing import Any

from biodyn_ros.subject.making import RESULT, MadeSubject
from biodyn_ros.subject.wording import result_line, sentence_of


def text_of(made: MadeSubject) -> str:
    """One line for each step, and the result."""
    lines = [f"{step.name:<9} {step.state:<8} {sentence_of(step, made.used)}" for step in made.steps.values()]
    return "\n".join([f"{made.name}: {made.directory}", *lines, result_line(made)])


def document_of(made: MadeSubject) -> dict[str, Any]:
    """The mapping of `biodyn subject --json`."""
    path = made.directory / RESULT
    return {
        "name": made.name,
        "directory": str(made.directory),
        "subject": str(path) if path.exists() else None,
        "steps": [
            {"name": step.name, "state": step.state, "result": sentence_of(step, made.used), "seconds": step.seconds}
            | dict(step.facts)
            for step in made.steps.values()
        ],
        "uses": dict(made.used.uses) if made.used else {},
    }
