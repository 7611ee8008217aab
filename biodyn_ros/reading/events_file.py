"""The events file: events of sessions by bag and time, written by `biodyn events` and edited by people.

A bag is referenced by its path from the file's folder, and by its content; it is never copied.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import yaml

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.base.suggestions import known_are
from biodyn_core.base.yaml_files import mapping_of, read_yaml, text_of
from biodyn_core.sessions.findings import Event, Findings, Rest
from biodyn_ros import __version__
from biodyn_ros.base.files import check_file_name, exists, write_text
from biodyn_ros.reading.parts import BagPart, latest_end_s
from biodyn_ros.reading.provenance import bag_sha256

SCHEMA: Final = 1
MADE_BY: Final = "biodyn events"

TIME_DIGITS: Final = 2
"""Times are written to a hundredth of a second: events are cut between shocks, not within."""

_EVENT: Final = ("bag", "start_s", "end_s", "case")
_EVENT_MORE: Final = ("name", "peak_mps2", "level_mps2", "aw_mps2", "shocks", "rest_s", "rest_bag", "quality")
_SESSION: Final = ("bag", "sha256", "seconds")
_SESSION_MORE: Final = ("map", "time", "rests_s", "gravity_mps2", "clock_ppm", "faults", "warnings")

MAX_BYTES: Final = 2**24
"""Ten times a day with a shock each ten seconds; unlike other YAML files, a program writes it."""

LARGEST_PPM: Final = 1000.0
"""A larger drift is none of a clock."""


@dataclass(frozen=True, eq=False)
class FoundSession:
    """A session: its bag, the SHA-256 of it, and what was found; warnings: about the bag and its clocks.

    begin_ns: stamp of the seat's first sample. borrowed: the rest of another session, for events without one. mapping,
    time: the given topic by sensor and clock, with which events are read too.
    """

    bag: Path
    sha256: str
    findings: Findings
    warnings: tuple[str, ...]
    begin_ns: int = 0
    borrowed: tuple[Path, Rest] | None = None
    mapping: Mapping[str, str] = field(default_factory=dict)
    time: str = "header"

    def rest_of(self, event: Event) -> tuple[Path, Rest] | None:
        """The rest that gives gravity to an event, with its bag."""
        return self.borrowed if event.rest is None else (self.bag, self.findings.rests[event.rest])

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """The warnings about the bag and about its sensors."""
        return (*self.warnings, *self.findings.warnings)


def is_events_file(path: str | Path) -> bool:
    """Whether a path is that of an events file, by its ending; the metadata of a recording is none."""
    return Path(path).suffix in (".yaml", ".yml") and Path(path).name != "metadata.yaml"


def events_document(sessions: Sequence[FoundSession], folder: Path) -> dict[str, Any]:
    """The content of an events file in a folder."""
    return {
        "schema": SCHEMA,
        "made_by": MADE_BY,
        "version": __version__,
        "sessions": [_session(one, folder) for one in sessions],
        "events": [_event(event, one, folder) for one in sessions for event in one.findings.events],
    }


def write_events(sessions: Sequence[FoundSession], path: Path) -> None:
    """Write an events file."""
    write_text(path, events_text(sessions, path.parent))


def events_text(sessions: Sequence[FoundSession], folder: Path) -> str:
    """The text of an events file in a folder."""
    document = events_document(sessions, folder)
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)


def load_events(path: str | Path) -> list[BagPart]:
    """The events of a file as parts of bags; raises InputError for an invalid file, or a bag that is not as it was."""
    path = Path(path)
    whole = mapping_of(read_yaml(path, MAX_BYTES), str(path), ("schema", "sessions", "events"), ("made_by", "version"))
    if whole["schema"] != SCHEMA:
        raise InputError(f"{path}: schema is {whole['schema']!r}, this version reads {SCHEMA}: run biodyn events again")
    sessions = dict(_known_bag(each, path) for each in _list(whole["sessions"], f"{path}: sessions"))
    parts = [
        _part(each, f"{path}: event {number}", path, sessions)
        for number, each in enumerate(_list(whole["events"], f"{path}: events"), 1)
    ]
    if not parts:
        raise InputError(f"{path}: has no events")
    _check_apart(parts, path)
    return parts


def _session(one: FoundSession, folder: Path) -> dict[str, Any]:
    found = one.findings
    return {
        "bag": _relative(one.bag, folder),
        "sha256": one.sha256,
        "seconds": _time(found.seconds),
        "map": dict(one.mapping),
        "time": one.time,
        "rests_s": [[_time(rest.begin_s), _time(rest.end_s)] for rest in found.rests],
        "gravity_mps2": [
            {name: [round(axis, 3) for axis in mean] for name, mean in rest.gravity_mps2.items()}
            for rest in found.rests
        ],
        "clock_ppm": {name: round(drift.ppm, 2) for name, drift in found.drifts.items()},
        "faults": [
            f"{fault.sensor}: {fault.kind} from {fault.begin_s:.1f} to {fault.end_s:.1f} s" for fault in found.faults
        ],
        "warnings": list(one.all_warnings),
    }


def _event(event: Event, one: FoundSession, folder: Path) -> dict[str, Any]:
    bag, rest = one.rest_of(event) or (one.bag, None)
    elsewhere = {} if bag == one.bag else {"rest_bag": _relative(bag, folder)}
    return {
        "name": event.name,
        "bag": _relative(one.bag, folder),
        "start_s": _time(event.begin_s),
        "end_s": _time(event.end_s),
        "case": event.case,
        "peak_mps2": round(event.peak_mps2, 2),
        "level_mps2": round(event.level_mps2, 3),
        "aw_mps2": round(event.aw_mps2, 3),
        "shocks": [[_time(shock.time_s), round(shock.peak_mps2, 2)] for shock in event.shocks],
        "rest_s": None if rest is None else [_time(rest.begin_s), _time(rest.end_s)],
        **elsewhere,
        "quality": list(event.quality),
    }


def _time(seconds: float) -> float:
    return round(seconds, TIME_DIGITS)


def _relative(bag: Path, folder: Path) -> str:
    return os.path.relpath(bag.resolve(), folder.resolve())


@dataclass(frozen=True)
class _KnownBag:
    """The length of a bag, s, the drift of clocks in it, and how it was read; None where that is not stated."""

    seconds: float
    clock_ppm: Mapping[str, float]
    mapping: Mapping[str, str] | None
    time: str | None


def _known_bag(session: object, path: Path) -> tuple[str, _KnownBag]:
    """A session's bag by its name; raises InputError for a bag that was moved or has changed."""
    known = mapping_of(session, f"{path}: session", _SESSION, _SESSION_MORE)
    name = text_of(known["bag"], f"{path}: bag")
    bag = path.parent / name
    if not exists(bag):
        raise InputError(f"{path}: {name}: no such bag: if it was moved, correct its path in the file")
    if bag_sha256(bag) != known["sha256"]:
        raise InputError(f"{path}: {name} has changed since its events were found: run biodyn events again")
    where = f"{path}: clock_ppm of {name}"
    drifts = mapping_of(known.get("clock_ppm", {}), where, (), SENSORS, "sensor")
    clock_ppm = {sensor: _number(ppm, f"{where}: {sensor}") for sensor, ppm in drifts.items()}
    if wrong := next((sensor for sensor, ppm in clock_ppm.items() if abs(ppm) > LARGEST_PPM), None):
        raise InputError(f"{where}: {wrong} is {clock_ppm[wrong]:g}, allowed are {-LARGEST_PPM:g} to {LARGEST_PPM:g}")
    where = f"{path}: map of {name}"
    given = mapping_of(known["map"], where, (), SENSORS, "sensor") if "map" in known else None
    topics = (
        None if given is None else {sensor: text_of(topic, f"{where}: {sensor}") for sensor, topic in given.items()}
    )
    time = text_of(known["time"], f"{path}: time of {name}") if "time" in known else None
    if time not in (None, "header", "log"):
        raise InputError(f"{path}: time of {name} is {time!r}, {known_are(str(time), ('header', 'log'))}")
    return name, _KnownBag(_number(known["seconds"], f"{path}: seconds of {name}"), clock_ppm, topics, time)


def _part(event: object, where: str, path: Path, known: Mapping[str, _KnownBag]) -> BagPart:
    given = mapping_of(event, where, _EVENT, _EVENT_MORE)
    name = text_of(given["name"], f"{where}: name") if "name" in given else ""
    where = f"{path}: event {name}" if name else where
    bag = text_of(given["bag"], f"{where}: bag")
    if bag not in known:
        raise InputError(f"{where}: bag {bag!r} is not among the sessions, {known_are(bag, list(known))}")
    begin_s, end_s = _interval([given["start_s"], given["end_s"]], f"{where}: start_s and end_s", known[bag].seconds)
    rest_bag = text_of(given.get("rest_bag", bag), f"{where}: rest_bag")
    if rest_bag not in known:
        raise InputError(
            f"{where}: rest_bag {rest_bag!r} is not among the sessions, {known_are(rest_bag, list(known))}"
        )
    if (known[rest_bag].mapping, known[rest_bag].time) != (known[bag].mapping, known[bag].time):
        raise InputError(f"{where}: rest_bag {rest_bag!r} was read with another map or time: find both together")
    rest_s = (
        None if given.get("rest_s") is None else _interval(given["rest_s"], f"{where}: rest_s", known[rest_bag].seconds)
    )
    level = _number(given.get("level_mps2", 0.0), f"{where}: level_mps2")
    case, elsewhere = text_of(given["case"], f"{where}: case"), None if rest_bag == bag else _beside(path, rest_bag)
    of_bag = known[bag]
    return BagPart(
        _beside(path, bag), begin_s, end_s, case, rest_s, elsewhere, name, level, of_bag.clock_ppm, of_bag.mapping,
        of_bag.time,
    )  # fmt: skip


def _beside(path: Path, bag: str) -> Path:
    """The path of a bag that is named from the folder of a file, without `..` where that leads to the same."""
    whole = path.parent / bag
    short = Path(os.path.normpath(whole))
    return short if exists(short) and short.samefile(whole) else whole


def _interval(ends: object, where: str, seconds: float) -> tuple[float, float]:
    if not isinstance(ends, list) or len(ends) != 2:
        raise InputError(f"{where}: expected two times")
    begin_s, end_s = (_number(each, where) for each in ends)
    if not 0.0 <= begin_s < end_s <= latest_end_s(seconds):
        raise InputError(f"{where}: {begin_s:g} to {end_s:g} s is not within the bag, which has {seconds:g} s")
    return begin_s, end_s


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {value!r} is no number")
    return float(value)


def _list(value: object, where: str) -> list[object]:
    if not isinstance(value, list):
        raise InputError(f"{where}: expected a list")
    return value


def _check_apart(parts: Sequence[BagPart], path: Path) -> None:
    """Raise InputError for two events of one name or with time in common, and for a name that is no directory's."""
    names: set[str] = set()
    for part in parts:
        if part.name:
            check_file_name(part.name, f"{path}: name of an event")
        if part.name and part.name in names:
            raise InputError(f"{path}: two events have the name {part.name}: names are unique")
        names.add(part.name)
    ordered = sorted(parts, key=lambda part: (str(part.path), part.begin_s))
    for one, other in pairwise(ordered):
        if one.shares(other):
            raise InputError(
                f"{path}: events {_label(one)} and {_label(other)} overlap: end the first by {other.begin_s:g} s"
            )


def _label(part: BagPart) -> str:
    return part.name or str(part)
