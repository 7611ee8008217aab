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
    Held,
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
    """A file of one channel of one sensor; its columns are the stamp, then three accelerations, then any gyro."""

    path: Path
    take: str
    held: tuple[Held, ...]
    columns: tuple[int, ...]
    width: int
    kind: Kind = "Capture.U"

    def parts(self, damage: Damage, start_ns: int, most_bytes: int) -> Iterator[tuple[int, list[Part]]]:
        """(bytes read, samples read) over and over; start_ns is not used: the stamps are Unix time."""
        (held,) = self.held
        accel = scale_of(held.accel_unit, ACCEL_UNITS, str(self.path))
        gyro = scale_of(held.gyro_unit, GYRO_UNITS, str(self.path)) if held.gyro_unit else 1.0
        for read, rows in number_rows(self.path, 1, self.columns, self.width, damage, most_bytes):
            there = np.abs(rows[:, 0] - 0.5e6 * LATEST_S) < 0.5e6 * LATEST_S
            damage.untimed += int((~there).sum())
            good = rows[there]
            stamps_ns = np.rint(good[:, 0]).astype(np.int64) * 1000
            rates = good[:, 4:7] * gyro if held.gyro_unit else None
            yield read, [Part(held.serial, held.channel, Samples(stamps_ns, good[:, 1:4] * accel, rates))]


def is_capture_u(lines: Sequence[str]) -> bool:
    """Whether a file begins as Capture.U's do."""
    return STAMP in lines[0]


def is_magnetometer(path: Path) -> bool:
    """Whether a file's name says that it holds a magnetic field, which no Imu message has room for."""
    named = NAME.fullmatch(path.stem)
    return named is not None and named["channel"].lower() == "mag"


def capture_u(path: Path, lines: Sequence[str]) -> CaptureU:
    """What a file of low-g or high-g holds; raises InputError naming what is missing in its name or its header."""
    named = NAME.fullmatch(path.stem)
    if named is None:
        raise InputError(
            f"{path}: the name of a file of Capture.U tells sensor and channel: <subject>_TS-<number>_<date>_lowg.csv"
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
    held = Held(named["serial"], channel, accel_unit, gyro_unit)
    return CaptureU(path, named["take"], (held,), tuple(columns), len(names))
