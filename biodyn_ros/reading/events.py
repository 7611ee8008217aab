"""Events for fitting and tracing: the recordings of bags, each fitted or held out; a bag may be given once only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from biodyn_core.base.errors import InputError, UnusableRecording
from biodyn_core.base.suggestions import did_you_mean
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import CaseSettings
from biodyn_core.recording.recording import Recording
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_ros.base.progress import OnProgress
from biodyn_ros.reading.gravity import gravity_by_bag
from biodyn_ros.reading.parts import Bag, part_of
from biodyn_ros.reading.provenance import Source, source_of
from biodyn_ros.reading.recordings import RecordingOptions, case_of, read_recordings


@dataclass(frozen=True, eq=False)
class BagEvent:
    """One recording, its bag or part, and whether it is held out."""

    bag: str
    source: Source
    recording: Recording
    held_out: bool


Prepared = tuple[BagEvent, Case]
"""An event, and its recording prepared for fitting."""


@dataclass(frozen=True)
class EventOptions:
    """Options for reading and preparing events; cases: the loading condition of a bag, if not that of its name."""

    cases: Mapping[str, str]
    reading: RecordingOptions
    spectra: SpectrumSettings
    preparing: CaseSettings


@dataclass(frozen=True, eq=False)
class Events:
    """The events that can be compared, held-out ones last, and the reason why each other is excluded, a line each."""

    prepared: tuple[Prepared, ...]
    left_out: tuple[str, ...]


def check_bags(bags: Sequence[Bag], held_out: Sequence[Bag], cases: Iterable[str]) -> None:
    """Raise InputError for no bag, a bag or part given twice, or a case (by bag) of a bag that is not given."""
    if not bags:
        raise InputError("no bag is given: give at least one")
    parts = [part_of(bag) for bag in (*bags, *held_out)]
    for number, part in enumerate(parts):
        for other in parts[:number]:
            if part.shares(other):
                if part.is_whole and other.is_whole:
                    path = part.path.resolve()
                    raise InputError(f"{path}: given twice: give each bag once, either to fit or to hold out")
                raise InputError(f"{part}: overlaps {other}: give each part once, either to fit or to hold out")
    given = {str(bag) for bag in (*bags, *held_out)}
    for bag in cases:
        if bag not in given:
            raise InputError(f"case of {bag}: no such bag is given{did_you_mean(bag, given)}")


def read_events(bags: Sequence[Bag], held_out: Sequence[Bag], options: EventOptions, progress: OnProgress) -> Events:
    """The prepared recordings of all bags; a recording that cannot be compared with a model is excluded.

    Raises InputError for a bag that cannot be read, the same recording under two names, or if none to fit remains.
    """
    given = [(bag, False) for bag in bags] + [(bag, True) for bag in held_out]
    gravity = gravity_by_bag([bag for bag, _ in given], options.reading, options.reading.verticals())
    sources: list[tuple[Source, Bag]] = []
    prepared: list[Prepared] = []
    reasons: list[str] = []
    for number, (bag, is_held_out) in enumerate(given):
        progress(number, len(given))
        source = source_of(bag)
        if same := next((other for known, other in sources if known.overlaps(source)), None):
            raise InputError(f"{bag}: the same recording as {same}; give it once")
        sources.append((source, bag))
        case = options.cases.get(str(bag), case_of(bag))
        try:
            recordings = read_recordings(bag, case, options.reading, gravity=gravity[number])
        except UnusableRecording as error:
            reasons.append(str(error))
            continue
        for recording in recordings:
            try:
                ready = Case.of(recording, options.spectra, options.preparing)
            except UnusableRecording as error:
                reasons.append(str(error))
            else:
                prepared.append((BagEvent(str(bag), source, recording, is_held_out), ready))
    progress(len(given), len(given))
    names = [event.recording.name for event, _ in prepared]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"two recordings have the name {twice}: rename one of the events or bags")
    if all(event.held_out for event, _ in prepared):
        several = f"none of the {len(bags)} bags can be fitted; the first: " if len(bags) > 1 else ""
        raise InputError(f"{several}{reasons[0]}")
    return Events(tuple(prepared), tuple(f"left out: {reason}" for reason in reasons))
