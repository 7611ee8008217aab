"""Exports of Capture.U: a file per sensor and channel, `<subject>_TS-02374_<date>_lowg.csv`, stamps of Unix time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

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

STAMP: Final = "unix_timestamp_microsec"
NAME: Final = re.compile(r"(?:.*_)?(?P<serial>TS-\w+?)_(?P<take>.+)_(?P<channel>lowg|highg|mag)", re.IGNORECASE)
COLUMN: Final = re.compile(r"(?P<name>[agm][xyz])_(?P<unit>.+)")


@dataclass(frozen=True, eq=False)
class CaptureU:
    """A file of one channel of one sensor; columns: the stamp, three accelerations, and angular velocities if any."""

    path: Path
    take: str
    channels: tuple[ChannelInfo, ...]
    columns: tuple[int, ...]
    width: int
    kind: Kind = "Capture.U"

    def parts(self, damage: Damage, start_ns: int, max_bytes: int) -> Iterator[tuple[int, list[Part]]]:
        """Yield (bytes read, samples read); start_ns is not used: the stamps are Unix time."""
        (info,) = self.channels
        accel = scale_of(info.accel_unit, ACCEL_UNITS, str(self.path))
        gyro = scale_of(info.gyro_unit, GYRO_UNITS, str(self.path)) if info.gyro_unit else 1.0
        for read, rows in number_rows(self.path, 1, self.columns, self.width, damage, max_bytes):
            there = np.abs(rows[:, 0] - 0.5e6 * LATEST_S) < 0.5e6 * LATEST_S
            damage.untimed += int((~there).sum())
            good = rows[there]
            stamps_ns = np.rint(good[:, 0]).astype(np.int64) * 1000
            rates = good[:, 4:7] * gyro if info.gyro_unit else None
            yield read, [Part(info.serial, info.channel, Samples(stamps_ns, good[:, 1:4] * accel, rates))]


def is_capture_u(lines: Sequence[str]) -> bool:
    """Whether a file starts as an export of Capture.U."""
    return STAMP in lines[0]


def is_magnetometer(path: Path) -> bool:
    """Whether a file holds a magnetic field, by its name; an Imu message has no field for it."""
    named = NAME.fullmatch(path.stem)
    return named is not None and named["channel"].lower() == "mag"


def capture_u(path: Path, lines: Sequence[str]) -> CaptureU:
    """Read the header of a low-g or high-g file; raises InputError for a missing part of its name or header."""
    named = NAME.fullmatch(path.stem)
    if named is None:
        raise InputError(
            f"{path}: sensor and channel are read from the file name: <subject>_TS-<number>_<date>_lowg.csv"
        )
    names = [name.strip() for name in lines[0].rstrip(",\r ").split(",")]
    found = {match["name"]: (at, match["unit"]) for at, name in enumerate(names) if (match := COLUMN.fullmatch(name))}
    missing = [f"a{axis}" for axis in "xyz" if f"a{axis}" not in found]
    if missing or STAMP not in names:
        raise InputError(f"{path}: no column {', '.join(missing) or STAMP} among {', '.join(names)}")
    with_gyro = all(f"g{axis}" in found for axis in "xyz")
    units = {letter: {found[f"{letter}{axis}"][1] for axis in "xyz"} for letter in ("ag" if with_gyro else "a")}
    for letter, of_axes in units.items():
        if len(of_axes) > 1:
            raise InputError(f"{path}: columns {letter}x, {letter}y, {letter}z have several units: {sorted(of_axes)}")
    accel_unit, gyro_unit = units["a"].pop(), units["g"].pop() if with_gyro else None
    scale_of(accel_unit, ACCEL_UNITS, str(path))
    if gyro_unit:
        scale_of(gyro_unit, GYRO_UNITS, str(path))
    columns = [names.index(STAMP), *(found[f"{letter}{axis}"][0] for letter in units for axis in "xyz")]
    channel: Channel = "low" if named["channel"].lower() == "lowg" else "high"
    info = ChannelInfo(named["serial"], channel, accel_unit, gyro_unit)
    return CaptureU(path, named["take"], (info,), tuple(columns), len(names))
