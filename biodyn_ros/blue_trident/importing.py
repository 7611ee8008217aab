"""Imports exports of Blue Trident sensors to one bag: survey, high-g where low-g is saturated, writing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.dual_range import HIGH_RAIL_MPS2, saturated
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings
from biodyn_ros import __version__
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.base.topics import INPUT
from biodyn_ros.blue_trident.cleaning import Cleaner
from biodyn_ros.blue_trident.exports import ChosenExports, FoundExports, choose, find_exports
from biodyn_ros.blue_trident.high_g import Comparison, Replacement
from biodyn_ros.blue_trident.outcome import Outcome, SampleCounts, document_of, ranges
from biodyn_ros.blue_trident.reader import ExportReader
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export, Samples, joined
from biodyn_ros.blue_trident.survey import SurveyResult, survey
from biodyn_ros.reading.provenance import sha256_of
from biodyn_ros.reading.saturation import stated

MADE_BY: Final = "biodyn import-blue-trident"
FROM_HIGH_G: Final = "biodyn_from_high_g"
"""The metadata record with the stamps of high-g samples by sensor."""

TURN_NS: Final = 500_000_000


@dataclass(frozen=True)
class ImportOptions:
    """{sensor: serial}; take; start of a recording without a time of day, ns; whether high-g replaces clipped low-g."""

    mapping: Mapping[str, str]
    take: str | None = None
    start_ns: int | None = None
    high_g: bool = True
    settings: DualRangeSettings = field(default_factory=DualRangeSettings)
    compression: str = "zstd"


def import_blue_trident(
    place: Path,
    bag: Path,
    options: ImportOptions,
    progress: OnProgress = ignore_progress,
) -> Outcome:
    """Write the bag and return the outcome.

    `progress` is called with (bytes read, all bytes). Raises InputError for invalid input, without leaving a bag.
    """
    found = find_exports(place)
    chosen = choose(found, options.mapping, options.take)
    if options.start_ns is not None and any(export.kind == "Capture.U" for export in chosen.exports):
        raise InputError("--start: exports of Capture.U have Unix time: omit it")
    reader = ExportReader(chosen, options.start_ns or 0, progress)
    with BagWriter(bag, compression=options.compression) as writer:
        outcome = _imported(bag, found, reader, writer, options)
        _add_provenance(writer, outcome)
    return outcome


def _imported(
    bag: Path, found: FoundExports, reader: ExportReader, writer: BagWriter, options: ImportOptions
) -> Outcome:
    chosen, sizes = reader.chosen, reader.sizes
    read = survey(reader, options.settings)
    _check(chosen, read)
    damage = dict(read.damage)
    replacements = _compared(reader, read, options.settings, damage) if options.high_g else {}
    for sensor in chosen.sensors.values():
        writer.add_topic(INPUT[sensor], IMU_TYPE)
    counts = _InterleavedWriter(chosen, read, replacements, writer, options.settings).write_all(reader)
    hashes = {export: sha256_of([export.path], sizes[export]) for export in chosen.exports}
    how = options.start_ns, options.settings, options.high_g
    return Outcome(bag, found, chosen, read, replacements, counts, damage, sizes, hashes, *how)


def _check(chosen: ChosenExports, read: SurveyResult) -> None:
    """Raise InputError for a sensor without samples, and for sensors that do not overlap in time."""
    seen = {serial: read.sensors[serial] for serial in chosen.sensors}
    for serial, one in seen.items():
        file = chosen.file_of(serial, "low")
        assert file is not None
        if not one.count:
            ragged = read.damage[file].ragged
            why = "its rows have a wrong number of cells: export with decimal points" if ragged else ""
            raise InputError(
                f"{file.path}: {serial} ({chosen.sensors[serial]}) has no sample: {why or 'remove it from the mapping'}"
            )
        if one.back > one.count // 2:
            raise InputError(
                f"{file.path}: {serial} ({chosen.sensors[serial]}): stamps do not increase: Excel rounds them when it "
                "saves, so export again"
            )
    last, first = max(seen, key=lambda one: seen[one].first_ns), min(seen, key=lambda one: seen[one].last_ns)
    if seen[first].last_ns < seen[last].first_ns:
        raise InputError(
            f"{chosen.sensors[first]} ({first}) ends {1e-9 * (seen[last].first_ns - seen[first].last_ns):.1f} s before "
            f"{chosen.sensors[last]} ({last}) starts: give files of one recording, see --take"
        )


def _compared(
    reader: ExportReader, read: SurveyResult, settings: DualRangeSettings, damage: dict[Export, Damage]
) -> dict[str, Replacement]:
    """The high-g replacement by serial, for the sensors that have high-g and are clipped."""
    comparisons: dict[str, Comparison] = {}
    exports: dict[Export, None] = {}
    for serial in reader.chosen.sensors:
        low, high = reader.chosen.file_of(serial, "low"), reader.chosen.file_of(serial, "high")
        if read.sensors[serial].clipped() and low is not None and high is not None:
            comparisons[serial] = Comparison(read.sensors[serial], settings, shared=low is high)
            exports |= {low: None, high: None}
    reader.expect(exports)
    again: dict[Export, Damage] = {}
    for parts in reader.in_time_order(exports, again):
        for part in parts:
            if part.serial in comparisons:
                comparisons[part.serial].push(part.channel, part.samples)
    damage |= {export: one for export, one in again.items() if export not in damage}
    return {serial: comparison.finish() for serial, comparison in comparisons.items()}


class _InterleavedWriter:
    """Buffers samples, so that the messages of all sensors are written roughly in order of time."""

    def __init__(
        self,
        chosen: ChosenExports,
        read: SurveyResult,
        replacements: dict[str, Replacement],
        writer: BagWriter,
        settings: DualRangeSettings,
    ) -> None:
        self._sensors, self._surveys, self._replacements = chosen.sensors, read.sensors, replacements
        self._writer, self._settings = writer, settings
        self._waiting: dict[str, Samples] = {}
        self._latest_ns = {serial: read.sensors[serial].first_ns for serial in chosen.sensors}
        self._counts = {serial: SampleCounts() for serial in chosen.sensors}

    def write_all(self, reader: ExportReader) -> dict[str, SampleCounts]:
        """Write the samples of all sensors, half a second of each in turn; return their counts by serial."""
        for block in reader.cleaned({serial: Cleaner() for serial in self._sensors}, {}):
            for serial, samples in block:
                self._add(serial, samples)
            self._write(final=False)
        self._write(final=True)
        return self._counts

    def _add(self, serial: str, samples: Samples) -> None:
        if not len(samples.stamps_ns):
            return
        samples = samples._replace(mag=None)
        old = self._waiting.get(serial)
        self._waiting[serial] = samples if old is None else joined(old, samples)
        # Stamps may decrease: the largest stamp so far counts.
        self._latest_ns[serial] = max(self._latest_ns[serial], int(samples.stamps_ns.max()))

    def _write(self, final: bool) -> None:
        """Write up to the time that all unfinished sensors have reached, or everything."""
        ends = [ns for serial, ns in self._latest_ns.items() if ns < self._surveys[serial].last_ns]
        end_ns = 2**63 - 1 if final or not ends else min(ends)
        while self._waiting:
            begin_ns = min(int(samples.stamps_ns[0]) for samples in self._waiting.values())
            if begin_ns >= end_ns:
                return
            for serial in list(self._waiting):
                self._turn(serial, min(begin_ns + TURN_NS, end_ns))

    def _turn(self, serial: str, upto_ns: int) -> None:
        samples = self._waiting[serial]
        count = int(np.searchsorted(np.maximum.accumulate(samples.stamps_ns), upto_ns))
        if not count:
            return
        if count == len(samples.stamps_ns):
            del self._waiting[serial]
        else:
            self._waiting[serial] = samples.rows(slice(count, None))
        self._put(serial, samples.rows(slice(0, count)))

    def _put(self, serial: str, samples: Samples) -> None:
        sensor, counts, variance = self._sensors[serial], self._counts[serial], None
        at_rail = saturated(samples.accel_mps2, self._settings) != 0
        if serial in self._replacements:
            samples, share, spread = self._replacements[serial].applied(samples)
            at_rail &= share == 0.0
            if share.any():
                # Imu has no flags. Its covariance, of which 0 is "unknown", marks each high-g axis of each sample
                # and gives its error.
                variance = spread
                counts.from_high_g += int(share.any(axis=1).sum())
        counts.clipped += int(at_rail.any(axis=1).sum())
        counts.written += len(samples.stamps_ns)
        payload = encode_imu(samples.stamps_ns, samples.accel_mps2, samples.gyro_radps, sensor, variance)
        self._writer.write(INPUT[sensor], samples.stamps_ns, payload)


def _add_provenance(writer: BagWriter, outcome: Outcome) -> None:
    """Add the source, the processing and the saturation limits to the metadata of the bag."""
    limits = {INPUT[name]: _limit_mps2(outcome, serial) for name, serial in outcome.serials.items()}
    default = ConditioningSettings.saturation_mps2
    limits = {topic: limit for topic, limit in limits.items() if limit != default}
    document = document_of(outcome)
    values = {key: document[key] for key in ("format", "take", "start")}
    values |= {key: json.dumps(document[key]) for key in ("files", "sensors", "warnings")}
    writer.add_metadata("biodyn", {"made_by": MADE_BY, "version": __version__, **values, **stated(limits)})
    sensors, replacements = outcome.chosen.sensors, outcome.replacements
    marks = {sensors[serial]: ranges(one) for serial, one in replacements.items() if one.replaced}
    if marks:
        writer.add_metadata(FROM_HIGH_G, marks)


def _limit_mps2(outcome: Outcome, serial: str) -> float:
    """The saturation limit of a sensor: that of high-g, or that of low-g if any sample is still clipped."""
    counts = outcome.counts[serial]
    return HIGH_RAIL_MPS2 if counts.from_high_g and not counts.clipped else outcome.settings.saturation_mps2
