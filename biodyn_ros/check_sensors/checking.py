"""The work of `biodyn check-sensors`: pairs of sensors of a recording against good recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.sensor_pairs.checks import Finding, Recorded, SensorCheck, check_sensor
from biodyn_core.sensor_pairs.settings import PairSettings, StretchSettings
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.check_sensors.records import Record, RecordOptions, present_sensors, read_record
from biodyn_ros.reading.provenance import bag_sha256

SIGNED: Final = ("clock", "drift", "gain")
"""Faults whose opposite is a fault as well."""


class SensorPair(NamedTuple):
    """A sensor under test, and the one that checks it: sensors or Imu topics."""

    under_test: str
    reference: str


@dataclass(frozen=True)
class CheckOptions:
    """Options of a check; pairs: empty for all neighbours; good_until_s: end of the good part of the bag itself."""

    pairs: tuple[SensorPair, ...]
    reading: RecordOptions
    stretches: StretchSettings
    settings: PairSettings
    good_until_s: float | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Report:
    """The results of a bag by pair; good: the good recordings, empty where the bag's own first part is the good one."""

    bag: str
    good: tuple[str, ...]
    seconds: float
    results: tuple[tuple[SensorPair, SensorCheck], ...]
    notes: tuple[str, ...]
    options: CheckOptions

    @property
    def suspects(self) -> tuple[str, ...]:
        """The sensors with a fault by their own reference, and the opposite fault as a reference of another sensor."""
        as_tested = {pair.under_test: result.finding for pair, result in self.results}
        as_reference = {pair.reference: result.finding for pair, result in self.results}
        both = as_tested.keys() & as_reference.keys()
        return tuple(name for name in as_tested if name in both and _opposite(as_tested[name], as_reference[name]))


def _opposite(one: Finding, other: Finding) -> bool:
    """Whether both findings may be the same signed fault with opposite signs."""
    common = {one.name, *one.ambiguous_with} & {other.name, *other.ambiguous_with} & set(SIGNED)
    return bool(common) and one.size * other.size < 0.0


def parse_pairs(texts: Sequence[str]) -> tuple[SensorPair, ...]:
    """Read `sensor=reference` texts; raises InputError naming the text."""
    found: list[SensorPair] = []
    for text in texts:
        under_test, _, reference = text.partition("=")
        if not under_test or not reference or under_test == reference:
            raise InputError(f"--pair {text}: expected SENSOR=REFERENCE, two different sensors or Imu topics")
        if (pair := SensorPair(under_test, reference)) in found:
            raise InputError(f"--pair {text}: given twice; give each pair once")
        found.append(pair)
    return tuple(found)


def check_sensors(
    bag: str, good: Sequence[str], options: CheckOptions, progress: OnProgress = ignore_progress
) -> Report:
    """Check the pairs of a bag against good recordings, or against its own first part.

    Raises InputError for a bag or sensor that is missing, a bag given twice, and a part that is too short.
    """
    _check_different((bag, *good))
    pairs, notes = (options.pairs, []) if options.pairs else _neighbours((bag, *good), options.reading)
    names = tuple(dict.fromkeys(name for pair in pairs for name in pair))
    records = [read_record(one, names, options.reading, progress) for one in (bag, *good)]
    checked, baselines = records[0], records[1:]
    if options.good_until_s is not None:
        checked, baselines = _halves(checked, options.good_until_s, options.settings.least_s)
    results = []
    for number, pair in enumerate(pairs):
        progress(number, len(pairs))
        results.append((pair, _result(pair, checked, baselines, options)))
    progress(len(pairs), len(pairs))
    notes += [note for record in records for note in record.notes]
    notes += [f"{name}: no gyro: rotation is not an input" for name in _without_gyro(results)]
    return Report(bag, tuple(good), checked.seconds, tuple(results), tuple(dict.fromkeys(notes)), options)


def _check_different(bags: Sequence[str]) -> None:
    """Raise InputError for a bag that is given twice, by path or by content."""
    seen: dict[object, str] = {}
    for bag in bags:
        for key in (Path(bag).resolve(), bag_sha256(bag)):
            if key in seen:
                raise InputError(
                    f"{bag}: the same recording as {seen[key]}: a good recording is another one; if its first part is"
                    " good, use --good-until"
                )
            seen[key] = bag


def _neighbours(bags: Sequence[str], options: RecordOptions) -> tuple[tuple[SensorPair, ...], list[str]]:
    """Every sensor that all bags have, by the next lower one, and a line for each other sensor."""
    present = {bag: present_sensors(bag, options) for bag in bags}
    common = [sensor for sensor in SENSORS if all(sensor in there for there in present.values())]
    if len(common) < 2:
        each = "; ".join(f"{bag}: {', '.join(there) or 'none'}" for bag, there in present.items())
        raise InputError(
            f"a pair needs two sensors that all bags have ({each}): map topics with --map SENSOR=TOPIC, or give topics"
            " with --pair TOPIC=TOPIC"
        )
    lines = []
    for bag, there in present.items():
        lacking = [s for s in SENSORS if s not in there and any(s in other for other in present.values())]
        lines += [f"not checked: {', '.join(lacking)}: not in {bag}, or in several topics"] if lacking else []
    return tuple(SensorPair(upper, lower) for lower, upper in pairwise(common)), lines


def _halves(record: Record, until_s: float, least_s: float) -> tuple[Record, list[Record]]:
    """The rest of a recording, and its good first part."""
    if not least_s <= until_s <= record.seconds - least_s:
        raise InputError(
            f"{record.bag}: --good-until {until_s:g}: both parts need {least_s:g} s, and the recording is"
            f" {record.seconds:.1f} s long"
        )
    return record.between(until_s, record.seconds + 1.0), [record.between(0.0, until_s)]


def _result(pair: SensorPair, checked: Record, good: Sequence[Record], options: CheckOptions) -> SensorCheck:
    """The result of a pair; not decidable where a recording has no usable samples of a sensor."""
    for record in (checked, *good):
        for name in pair:
            if name in record.unusable:
                return SensorCheck(Finding("not_decidable", f"{record.bag}: {name}: {record.unusable[name]}"))
    ready = [Recorded(one.streams[pair.reference], one.streams[pair.under_test]) for one in (checked, *good)]
    return check_sensor(ready[0], ready[1:], options.seed, options.stretches, options.settings)


def _without_gyro(results: Sequence[tuple[SensorPair, SensorCheck]]) -> list[str]:
    """The references whose gyro was not an input."""
    return [pair.reference for pair, result in results if result.checks and not result.uses_gyro]
