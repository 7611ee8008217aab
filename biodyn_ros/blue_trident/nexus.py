"""Exports of Nexus: one file with all sensors, resampled to one rate, without a time of day."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_ros.blue_trident.rows import Damage, number_rows
from biodyn_ros.blue_trident.samples import (
    ACCEL_UNITS,
    GYRO_UNITS,
    LATEST_S,
    Channel,
    ChannelInfo,
    Kind,
    Part,
    Samples,
    scale_of,
)

SECTION, FRAME, SUB_FRAME = "Devices", "Frame", "Sub Frame"
ACCEL, GYRO, MAG, HIGH = "accel", "gyro", "mag", "HighG"
RATE_HZ: Final = (10.0, 20_000.0)
MAX_FRAMES, MAX_SUB_FRAMES = 1e9, 1e5


class _Triplet(NamedTuple):
    """Three adjacent columns: index of the first, and the factor to SI units."""

    first: int
    scale: float


@dataclass(frozen=True, eq=False)
class Nexus:
    """The devices of one trial: triplets by serial and channel name, and the stated rate."""

    path: Path
    take: str
    channels: tuple[ChannelInfo, ...]
    rate_hz: float
    triplets: dict[str, dict[str, _Triplet]]
    skip_lines: int
    width: int
    kind: Kind = "Nexus"

    def parts(self, damage: Damage, start_ns: int, max_bytes: int) -> Iterator[tuple[int, list[Part]]]:
        """Yield (bytes read, samples read); start_ns: time of the first row, or 0 for stamps from frame numbers."""
        firsts = [triplet.first for found in self.triplets.values() for triplet in found.values()]
        columns = [0, 1, *(first + axis for first in firsts for axis in range(3))]
        at = {first: 2 + 3 * number for number, first in enumerate(firsts)}
        per_frame = 0
        first_index: int | None = None
        every = number_rows(self.path, self.skip_lines, columns, self.width, damage, max_bytes, sections=True)
        for read, rows in every:
            good = _numbered(rows)
            per_frame = per_frame or _per_frame(good)
            good = good[good[:, 1] < per_frame]
            damage.untimed += len(rows) - len(good)
            index = (good[:, 0] * per_frame + good[:, 1]).astype(np.int64)
            if first_index is None and index.size:
                first_index = int(index[0]) if start_ns else 0
            index -= first_index or 0
            since_s = index / self.rate_hz
            kept = np.abs(since_s) < 0.5 * LATEST_S
            damage.untimed += int((~kept).sum())
            stamps_ns = start_ns + np.rint(1e9 * since_s[kept]).astype(np.int64)
            yield read, self._parts_of(good[kept], stamps_ns, at)

    def _parts_of(self, rows: Floats, stamps_ns: Integers, at: dict[int, int]) -> list[Part]:
        parts = []
        for serial, found in self.triplets.items():
            values = {
                name: rows[:, at[triplet.first] : at[triplet.first] + 3] * triplet.scale
                for name, triplet in found.items()
            }
            low = Samples(stamps_ns, values[ACCEL], values.get(GYRO), values.get(MAG))
            parts.append(Part(serial, "low", low))
            if HIGH in values:
                parts.append(Part(serial, "high", Samples(stamps_ns, values[HIGH])))
        return parts


def is_nexus(lines: Sequence[str]) -> bool:
    """Whether a file holds frames of devices, as an export of Nexus."""
    return any(_cells(line)[0] == SECTION for line in lines) or any(_is_header(line) for line in lines)


def nexus(path: Path, lines: Sequence[str]) -> Nexus:
    """Read the header of an export; raises InputError for a missing part.

    The line that starts with "Frame," is between names and units; the number above the names is the rate. Blank lines,
    and the empty cells that Excel adds, are allowed anywhere.
    """
    header = next((at for at, line in enumerate(lines) if _is_header(line)), None)
    if header is None or header == 0 or header + 1 >= len(lines):
        raise InputError(f"{path}: no line that starts with {FRAME},{SUB_FRAME} between names and units")
    names, axes, units = (_cells(lines[at]) for at in (header - 1, header, header + 1))
    rate_hz = _rate(path, lines[: header - 1])
    triplets: dict[str, dict[str, _Triplet]] = {}
    written: dict[tuple[str, str], str] = {}
    for first, name in enumerate(names):
        serial, dash, channel = name.rpartition(" - ")
        if not dash or channel not in (ACCEL, GYRO, MAG, HIGH):
            continue
        if axes[first : first + 3] != ["x", "y", "z"] or len(units) < first + 3:
            raise InputError(f"{path}: {name}: needs three columns x, y, z, each with a unit")
        if channel in triplets.setdefault(serial, {}):
            raise InputError(f"{path}: {name} is given twice")
        unit = written[serial, channel] = units[first]
        if set(units[first : first + 3]) != {unit}:
            raise InputError(f"{path}: {name} has the units {', '.join(units[first : first + 3])}: give one unit")
        known = {ACCEL: ACCEL_UNITS, HIGH: ACCEL_UNITS, GYRO: GYRO_UNITS}.get(channel)
        triplets[serial][channel] = _Triplet(first, scale_of(unit, known, f"{path}: {name}") if known else 1.0)
    triplets = {serial: found for serial, found in triplets.items() if ACCEL in found}
    if not triplets:
        raise InputError(f"{path}: no sensor with a channel '<serial> - {ACCEL}': export the Blue Trident devices")
    channels = [_channel(written, serial, "low") for serial in triplets]
    channels += [_channel(written, serial, "high") for serial, found in triplets.items() if HIGH in found]
    return Nexus(path, path.stem, tuple(channels), rate_hz, triplets, header + 2, len(axes))


def _channel(written: dict[tuple[str, str], str], serial: str, channel: Channel) -> ChannelInfo:
    if channel == "high":
        return ChannelInfo(serial, channel, written[serial, HIGH], None)
    return ChannelInfo(serial, channel, written[serial, ACCEL], written.get((serial, GYRO)))


def _is_header(line: str) -> bool:
    return line.replace(" ", "").startswith(f"{FRAME},{SUB_FRAME}".replace(" ", ""))


def _cells(line: str) -> list[str]:
    """The cells of a line without empty ones at its end; at least one."""
    return [cell.strip() for cell in line.rstrip(", \r").split(",")]


def _rate(path: Path, lines: Sequence[str]) -> float:
    for line in reversed(lines):
        text = _cells(line)[0]
        try:
            rate_hz = float(text)
        except ValueError:
            continue
        if not RATE_HZ[0] <= rate_hz <= RATE_HZ[1]:
            raise InputError(f"{path}: the rate is {text} Hz, allowed: {RATE_HZ[0]:g} to {RATE_HZ[1]:g} Hz")
        return rate_hz
    raise InputError(f"{path}: no rate above the names of the devices")


def _numbered(rows: Floats) -> Floats:
    """The rows with valid whole numbers as frame and sub frame."""
    frame, sub = rows[:, 0], rows[:, 1]
    with np.errstate(invalid="ignore"):
        good = (frame >= 0) & (frame < MAX_FRAMES) & (sub >= 0) & (sub < MAX_SUB_FRAMES)
        return rows[good & (frame % 1.0 == 0.0) & (sub % 1.0 == 0.0)]


def _per_frame(rows: Floats) -> int:
    """The number of sub frames of a frame, 0 without rows.

    A damaged number must not change the time of all rows, so the sub frame that most often precedes a change of frame
    is the last one.
    """
    if not len(rows):
        return 0
    ends = rows[:-1, 1][np.diff(rows[:, 0]) != 0.0]
    if not ends.size:
        return int(rows[:, 1].max()) + 1
    values, counts = np.unique(ends, return_counts=True)
    return int(values[counts.argmax()]) + 1


def parse_start(text: str) -> int:
    """Nanoseconds since 1970 of an ISO 8601 time with its zone, or of Unix seconds; raises InputError for others."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = _iso(text)
    if not 0.0 < seconds < LATEST_S:
        raise InputError(f"--start {text}: must be between 1970 and 2038, the range of ROS stamps")
    return round(seconds * 1e6) * 1000


def _iso(text: str) -> float:
    try:
        time = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        raise InputError(
            f"--start {text}: expected a time such as 2026-05-12T10:32:00+02:00, or Unix seconds"
        ) from None
    if time.tzinfo is None:
        raise InputError(f"--start {text}: has no time zone: add one, such as {text}+02:00, or Z")
    return time.timestamp()
