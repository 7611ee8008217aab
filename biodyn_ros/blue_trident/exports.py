"""Finds exports in a directory or file, and selects them by serial number and take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.base.suggestions import did_you_mean, did_you_mean_file
from biodyn_core.base.wording import counted
from biodyn_core.base.yaml_files import read_yaml
from biodyn_ros.base.wording import listed
from biodyn_ros.blue_trident.capture_u import capture_u, is_capture_u, is_magnetometer
from biodyn_ros.blue_trident.nexus import is_nexus, nexus
from biodyn_ros.blue_trident.rows import head_of, lines_of
from biodyn_ros.blue_trident.samples import Channel, Export
from biodyn_ros.reading.mapping import parse_map

MAX_FILES: Final = 10_000


@dataclass(frozen=True)
class FoundExports:
    """Exports of a directory; ignored files, a line each; and exports that cannot be read."""

    place: Path
    exports: tuple[Export, ...]
    ignored: tuple[str, ...]
    refused: tuple[str, ...]

    def serials(self) -> list[str]:
        """The serial numbers of all sensors."""
        return sorted({info.serial for export in self.exports for info in export.channels})


@dataclass(frozen=True)
class ChosenExports:
    """The selected exports of one take, and {serial: sensor}."""

    exports: tuple[Export, ...]
    sensors: dict[str, str]

    def file_of(self, serial: str, channel: Channel) -> Export | None:
        """The export that contains this channel of a sensor."""
        return next((export for export in self.exports if (serial, channel) in _channels_of(export)), None)


def _channels_of(export: Export) -> list[tuple[str, Channel]]:
    return [(info.serial, info.channel) for info in export.channels]


def parse_serials(pairs: Iterable[str], file: str | Path | None = None) -> dict[str, str]:
    """{sensor: serial} from `sensor=serial` pairs and a YAML file of pairs; raises InputError with the pair."""
    given = [*pairs]
    if file is not None:
        document = read_yaml(file)
        if not isinstance(document, Mapping):
            raise InputError(f"{file}: expected lines such as 'seat: TS-02374'")
        for sensor, serial in document.items():
            if not isinstance(serial, str):
                raise InputError(f"{file}: {sensor}: {serial!r} is no serial number such as TS-02374")
            given.append(f"{sensor}={serial}")
    return parse_map(given, "serial")


def find_exports(place: Path) -> FoundExports:
    """Search the files of a directory, or one file; raises InputError if there is no export."""
    if not place.exists():
        raise InputError(f"{place}: no such file or directory{did_you_mean_file(place)}")
    if not place.is_dir():
        return FoundExports(place, (_export_of(place),), (), ())
    try:
        paths = sorted(path for path in place.iterdir() if path.is_file())
    except OSError as error:
        raise InputError(f"{place}: cannot be read ({error.strerror})") from None
    if len(paths) > MAX_FILES:
        count = counted(len(paths), "file")
        raise InputError(f"{place}: {count} are too many for one recording: give another directory")
    exports: list[Export] = []
    ignored, refused = [], []
    for path in paths:
        if is_magnetometer(path):
            ignored.append(f"{path.name}: magnetometer, not part of an Imu message")
            continue
        if path.suffix.lower() != ".csv":
            ignored.append(f"{path.name}: no CSV file")
            continue
        try:
            exports.append(_export_of(path))
        except InputError as error:
            refused.append(str(error))
    if not exports:
        why = f"; {refused[0]}" if refused else f"; its files: {listed([path.name for path in paths])}"
        raise InputError(f"{place}: no export of Capture.U or Nexus{why}")
    return FoundExports(place, tuple(exports), tuple(ignored), tuple(refused))


def choose(found: FoundExports, mapping: Mapping[str, str], take: str | None) -> ChosenExports:
    """Select the exports of the mapping {sensor: serial} and the take; raises InputError if they are not unique.

    A take is the date in a name of Capture.U or the name of a file of Nexus; its first characters suffice. The last
    characters of a serial suffice if they are unique.
    """
    there = found.serials()
    if not mapping:
        raise InputError(
            f"{found.place}: no sensor is mapped; serials: {listed(there)}: use --map {SENSORS[0]}={there[0]}"
        )
    mapping = {sensor: _serial(found, sensor, given) for sensor, given in mapping.items()}
    for sensor, serial in mapping.items():
        first = next(name for name, other in mapping.items() if other == serial)
        if first != sensor:
            raise InputError(f"{found.place}: --map {sensor}={serial}: the serial is also mapped to {first}")
    exports = [export for export in found.exports if any(info.serial in mapping.values() for info in export.channels)]
    if take is not None:
        takes = sorted({export.take for export in exports})
        exports = [export for export in exports if export.take == take] or [
            export for export in exports if export.take.startswith(take)
        ]
        if not exports:
            near = did_you_mean(take, takes)
            raise InputError(f"{found.place}: --take {take}: no such take; takes: {listed(takes)}{near}")
    for sensor, serial in mapping.items():
        _check_one(found.place, sensor, serial, exports)
    kinds = {export.kind for export in exports}
    if len(kinds) > 1:
        raise InputError(
            f"{found.place}: exports of {' and '.join(sorted(kinds))} have different clocks: give one of them"
        )
    if "Nexus" in kinds and len(exports) > 1:
        trials = listed(sorted(export.take for export in exports))
        raise InputError(
            f"{found.place}: the sensors are in several trials of Nexus: {trials}: each counts its frames from its own"
            " start: choose one with --take TAKE"
        )
    return ChosenExports(tuple(exports), {serial: sensor for sensor, serial in mapping.items()})


def _serial(found: FoundExports, sensor: str, given: str) -> str:
    """The serial that is given completely or by its end; raises InputError if none or several match."""
    there, where = found.serials(), f"{found.place}: --map {sensor}={given}"
    if given in there:
        return given
    ending = [serial for serial in there if serial.casefold().endswith(given.casefold())]
    if len(ending) > 1:
        raise InputError(f"{where}: {listed(ending)} end with it: give a complete serial")
    if not ending:
        ends = [serial[-len(given) :] for serial in there]
        hint = did_you_mean(given, [*there, *ends]) or (f"; {found.refused[0]}" if found.refused else "")
        raise InputError(f"{where}: no such serial; serials: {listed(there)}{hint}")
    return ending[0]


def _check_one(place: Path, sensor: str, serial: str, exports: list[Export]) -> None:
    """Raise InputError unless a sensor has exactly one low-g channel and at most one high-g among the exports."""
    for channel in ("low", "high"):
        with_it = [export for export in exports if (serial, channel) in _channels_of(export)]
        takes = sorted({export.take for export in with_it})
        if len(takes) > 1:
            raise InputError(
                f"{place}: {serial} ({sensor}) has several takes: {listed(takes)}: choose with --take TAKE"
            )
        if len(with_it) > 1:
            names = listed([export.path.name for export in with_it])
            raise InputError(f"{place}: {serial} ({sensor}) has a channel twice: {names}: remove one")
        if channel == "low" and not with_it:
            raise InputError(f"{place}: {serial} ({sensor}) has no low-g file in this take: export it")


def _export_of(path: Path) -> Export:
    lines = lines_of(head_of(path))
    if any(";" in line and line.count(";") > line.count(",") for line in lines[:10]):
        raise InputError(f"{path}: cells are separated by semicolons: export with commas, and decimal points")
    if lines and is_capture_u(lines):
        return capture_u(path, lines)
    if lines and is_nexus(lines):
        return nexus(path, lines)
    raise InputError(
        f"{path}: no export of Capture.U or Nexus: neither unix_timestamp_microsec nor Devices in its first lines"
    )
