"""Events: the recordings of bags with what each is for, as fitting and tracing read them; no bag counts twice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from biodyn_core.errors import InputError
from biodyn_core.recording import Recording
from biodyn_core.suggestions import did_you_mean
from biodyn_ros.progress import OnProgress
from biodyn_ros.provenance import bag_sha256
from biodyn_ros.reading.recordings import RecordingOptions, case_of, read_recordings


@dataclass(frozen=True, eq=False)
class BagEvent:
    """One recording, the bag it is of, and whether it was held out by name."""

    bag: str
    sha256: str
    recording: Recording
    held_out: bool


def check_bags(bags: Sequence[str | Path], held_out: Sequence[str], cases: Iterable[str]) -> None:
    """Raise InputError for no bag, one given twice, or a case (by bag) of none that is given."""
    if not bags:
        raise InputError("no bag is given: give at least one")
    paths = [Path(bag).resolve() for bag in (*bags, *held_out)]
    for path in paths:
        if paths.count(path) > 1:
            raise InputError(f"{path}: given twice; what is fitted to cannot be held out, nor count double")
    given = {str(bag) for bag in (*bags, *held_out)}
    for bag in cases:
        if bag not in given:
            raise InputError(f"case of {bag}: no such bag is given{did_you_mean(bag, given)}")


def read_events(
    bags: Sequence[str | Path],
    held_out: Sequence[str],
    cases: Mapping[str, str],
    reading: RecordingOptions,
    progress: OnProgress,
) -> list[BagEvent]:
    """The recordings of all bags, those held out last; raises InputError for the same recording by two names."""
    events: list[BagEvent] = []
    given = [(bag, False) for bag in bags] + [(bag, True) for bag in held_out]
    for number, (bag, is_held_out) in enumerate(given):
        progress(number, len(given))
        sha256 = bag_sha256(bag)
        _refuse_twin(bag, sha256, events)
        found = read_recordings(bag, cases.get(str(bag), case_of(bag)), reading)
        events += [BagEvent(str(bag), sha256, recording, is_held_out) for recording in found]
    progress(len(given), len(given))
    return events


def _refuse_twin(bag: str | Path, sha256: str, events: Sequence[BagEvent]) -> None:
    for event in events:
        if event.sha256 == sha256:
            raise InputError(f"{bag}: the same recording as {event.bag}; give it once")
