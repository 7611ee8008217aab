"""A trace for the terminal, from the mapping of trace.json."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import wrap
from typing import Any, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_ros.base.wording import number, parameter_name, words
from biodyn_ros.trace.wording import (
    belief,
    effect_name,
    grouped,
    headline,
    parameters_of,
    sensors_said,
    short_name,
    subject_said,
)

Document = dict[str, Any]

USES: Final = {"train": "train", "choose": "choose", "held_out": "held out"}
_COLUMNS: Final = 120
_RUNGS: Final = 3
_MOVED: Final = 3
_LISTED: Final = 4
"""So many of each are shown; trace.json and the page have all."""


def text_of(document: Document) -> str:
    """The document for the terminal."""
    lines = [
        headline(document),
        belief(document),
        *(f"because: {reason}" for reason in document["reasons"][:_LISTED]),
        "",
        "error, % of measured rms " + "".join(f"{words(name):>12}" for name in MEASURED_SEGMENTS) + f"{'all':>9}",
        *_error_rows(document["error"]),
        *_floor_line(document["floor"]),
        "",
        *_effect_lines(document),
        *_rung_lines(document["candidates"]),
        *(f"sensor: {line}" for line in sensors_said(document)),
        *_refit_lines(document),
        *_moved_lines(document["parameters_moved"]),
        subject_said(document),
        *_named("could be as well", grouped(document["ambiguous_with"])),
        *_named("record next", [document["separating_experiment"]] if _worth_saying(document) else []),
        *_named("left out", document["left_out"]),
        *_named("untestable, a channel is missing", [words(each) for each in document["untestable"]]),
        *([f"bags: {document['dealt']}"] if document.get("dealt") else []),
        *(f"warning: {line}" for line in document.get("warnings", [])),
        document["proof"],
    ]
    return "\n".join(part for line in lines for part in _wrapped(line))


def _wrapped(line: str) -> list[str]:
    """The line in lines that a terminal shows; tables are narrow enough."""
    if len(line) <= _COLUMNS:
        return [line]
    return wrap(line, _COLUMNS, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)


def _error_rows(error: Document) -> Iterator[str]:
    for use, title in USES.items():
        for when in ("before", "after"):
            if known_use(error, use):
                shown = [error[when][use][name] for name in MEASURED_SEGMENTS]
                cells = "".join(f"{number(value):>12}" for value in shown)
                yield f"  {title + ', ' + when:<23}{cells}{number(error[when][use]['all']):>9}"


def known_use(error: Document, use: str) -> bool:
    """Whether there is an error of this use."""
    return any(value is not None for when in error.values() for value in when.get(use, {}).values())


def _floor_line(floor: float | None) -> Iterator[str]:
    if floor is not None:
        yield f"floor, what noise of the sensors alone leaves: {number(floor)} %"


def _effect_lines(document: Document) -> Iterator[str]:
    for effect in document["effects"]:
        shown = ", ".join(f"{name} {value}" for name, value in parameters_of(effect))
        what = effect_name(effect["name"], effect["site"])
        done = "added" if effect["added"] else "named, not added"
        yield f"{done}: {what} [{effect['family']}]" + (f": {shown}" if shown else "")


def _rung_lines(candidates: Sequence[Document]) -> Iterator[str]:
    if candidates:
        shown = (f"{short_name(each)} (gain {number(each['gain'])})" for each in candidates[:_RUNGS])
        yield f"best of {len(candidates)} tried: {'; '.join(shown)}"


def _refit_lines(document: Document) -> Iterator[str]:
    """Why the refit is where it is."""
    if document.get("refit"):
        yield f"refit: {document['refit']['text']}"


def _moved_lines(moved: Document) -> Iterator[str]:
    """The parameters that moved most by the refit, then by the effect: given, refitted, with the effect."""
    for key, before, after, title in (
        ("refit_percent", "given", "refitted", "moved most by the refit"),
        ("percent", "refitted", "with_effect", "moved most by the effect"),
    ):
        known = [name for name, of in moved.items() if of[key]]
        largest = sorted(known, key=lambda name: -abs(moved[name][key]))[:_MOVED]
        if largest:
            yield f"{title}: " + ", ".join(_change(name, moved[name], key, before, after) for name in largest)


def _change(name: str, of: Document, key: str, before: str, after: str) -> str:
    return f"{parameter_name(name)} {number(of[before])} to {number(of[after])} ({of[key]:+.1f} %)"


def _worth_saying(document: Document) -> bool:
    """Whether the next experiment is not in the headline already."""
    return bool(document["separating_experiment"]) and not document["to_record"]


def _named(title: str, lines: Sequence[str]) -> Iterator[str]:
    if lines:
        more = f"; {len(lines) - _LISTED} more in trace.json" if len(lines) > _LISTED else ""
        yield f"{title}: {'; '.join(lines[:_LISTED])}{more}"
