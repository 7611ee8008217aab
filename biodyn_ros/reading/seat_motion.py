"""A measured seat motion from a CSV file or a bag, for `biodyn simulate`: any rate, any mounting.

The vertical is found from gravity in the record, and gravity is removed; without gravity the third axis must point up.
`seat_checks` refuses what is no motion.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, STANDARD_GRAVITY_MPS2
from biodyn_core.base.suggestions import did_you_mean, did_you_mean_file
from biodyn_core.base.wording import counted
from biodyn_core.body.synthesis import MOTION_S, SeatMotion
from biodyn_core.conditioning.channels import LARGEST_RATE_RADPS
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.tilt import rotation_to_vertical
from biodyn_ros.bag import imu_blocks, open_bag
from biodyn_ros.reading.mapping import sensors_of
from biodyn_ros.reading.saturation import limits_of
from biodyn_ros.reading.seat_checks import (
    MIN_RATE_HZ,
    OnWarning,
    check_mean,
    check_size,
    gaps_of,
    ignore_warning,
    order_of,
)
from biodyn_ros.reading.stamps import choose_times

TIME_UNITS_S: Final = {
    **dict.fromkeys(("t", "t_s", "time", "time_s", "timestamp_s", "seconds"), 1.0),
    **{
        f"{name}_{unit}": seconds
        for name in ("t", "time", "timestamp")
        for unit, seconds in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
    },
}
"""The unit of a time column in seconds, by its name."""

_TIME_UNIT: Final = re.compile(r"[_ ]?[\[(](s|ms|us|ns)[\])]$")
"""A unit in brackets, such as in `t [ms]`."""

ACCEL_NAMES: Final = tuple(
    f"{of}{axis}"
    for of in ("a_", "acc_", "accel_", "acceleration_", "linear_acceleration_")
    for axis in ("x", "y", "z", "forward", "left", "up")
)
"""Some of the names that `_COLUMN` matches, for suggestions."""

_COLUMN: Final = re.compile(
    r"(?:(?P<of>(?:linear_)?acceleration|linear_accel|accel|acc|a)[_. ]?)?(?P<axis>x|y|z|forward|left|right|up|down)?"
    r"(?:[_ ]?[\[(](?P<unit>[^\])]*)[\])]|_(?P<suffix>m?g|mps2|ms2|m/s\^?2))?"
)
"""Name of an acceleration column, in lower case: quantity, axis, unit."""

_UNITS: Final = (None, "m/s2", "m/s^2", "m/s²", "m/s/s", "mps2", "ms2", "ms-2", "m s-2")
_AXES: Final = (("x", "forward"), ("y", "left", "right"), ("z", "up", "down"))
_NEGATIVE: Final = ("right", "down")
_VERTICAL: Final = ("", "z", "up", "down")
"""Axes that a single column may have; a name without an axis counts as vertical."""

GRAVITY_FROM_MPS2: Final = 0.5 * STANDARD_GRAVITY_MPS2
"""A mean acceleration from here on is gravity, which gives the vertical and is removed."""


def read_seat_motion(
    path: str | Path,
    rate_hz: float | None,
    mapping: dict[str, str],
    time: str = "header",
    warn: OnWarning = ignore_warning,
) -> SeatMotion:
    """Read a seat motion; a CSV without a time column needs `rate_hz`. Raises InputError with file and position.

    mapping and time ("header" or "log") are for bags. `warn` is called with each warning, a line.
    """
    path = Path(path)
    if is_table(path):
        time_s, accel, pitch = _from_csv(path, rate_hz, warn)
    else:
        time_s, accel, pitch = _from_bag(path, mapping, time, warn)
    return _even(path, time_s, accel, pitch)


def is_table(path: str | Path) -> bool:
    """Whether a file is a table, by its name; all others are bags."""
    return Path(path).suffix.lower() in (".csv", ".txt")


def _from_bag(path: Path, mapping: dict[str, str], time: str, warn: OnWarning) -> tuple[Floats, Floats, Floats]:
    with open_bag(path) as reader:
        sensors = sensors_of(reader, mapping)
        topic = next(name for name, sensor in sensors.items() if sensor == SEAT)
        # If a driver leaves its stamps zero, the recorder's times are used.
        choice = choose_times(reader, [topic], time)[topic]
        blocks = [block for _, block in imu_blocks(reader, [topic], choice.time, gyro=True)]
        saturation_mps2 = limits_of(reader, {topic: SEAT}, None)[0][SEAT].saturation_mps2
    where = f"{path}: {topic}"
    if choice.defect:
        warn(f"{where}: {choice.defect}: log time is used instead")
    stamps_ns = np.concatenate([block.stamps_ns for block in blocks])
    accel = np.concatenate([block.accel_mps2 for block in blocks])
    bad = int((~np.isfinite(accel).all(axis=1)).sum())
    if bad:
        raise InputError(f"{where}: {counted(bad, 'sample is', 'samples are')} not finite")
    time_s = (stamps_ns - stamps_ns[0]) * 1e-9
    check_size(where, time_s, accel, saturation_mps2)
    check_mean(where, accel, warn)
    remedy = "correct the recorder's clock" if choice.time == "log" else "try --time log"
    order = order_of(where, time_s, remedy, warn)
    rotation, levelled = _level(accel[order])
    gyro = _rates(where, np.concatenate([block.gyro_radps for block in blocks])[order], warn)
    return time_s[order] - time_s[order[0]], levelled, (gyro @ rotation.T)[:, 1]


def _rates(where: str, gyro_radps: Floats, warn: OnWarning) -> Floats:
    """Angular rates (n, 3) rad/s, zero where there is no measurement: without a gyro the seat does not pitch."""
    usable = np.abs(gyro_radps) < LARGEST_RATE_RADPS
    unusable = int((~usable.all(axis=1)).sum())
    if 0 < unusable < len(usable):
        warn(f"{where}: {counted(unusable, 'angular rate is', 'angular rates are')} no measurement and taken as zero")
    return np.where(usable, gyro_radps, 0.0)


def _from_csv(path: Path, rate_hz: float | None, warn: OnWarning) -> tuple[Floats, Floats, Floats]:
    if rate_hz is not None and not 0.0 < rate_hz < np.inf:
        raise InputError(f"--seat-rate {rate_hz:g}: expected a positive number of Hz")
    names, table = _read_table(path)
    units_s = [TIME_UNITS_S.get(_TIME_UNIT.sub(r"_\1", name)) for name in names]
    time_column = next((i for i, unit_s in enumerate(units_s) if unit_s), None)
    if time_column is None and rate_hz is None:
        near = _near(names, tuple(TIME_UNITS_S))
        raise InputError(f"{path}: no time column among {', '.join(names)}: give --seat-rate{near}")
    if time_column is not None and rate_hz is not None:
        raise InputError(f"{path}: has the time column {names[time_column]}: omit --seat-rate")
    time_s = np.arange(len(table)) / (rate_hz or 1.0)
    if time_column is not None:
        time_s = (table[:, time_column] - table[0, time_column]) * (units_s[time_column] or 1.0)
    columns, signs = _accel_columns(path, names)
    accel = table[:, columns] * signs
    check_size(str(path), time_s, accel, ConditioningSettings.saturation_mps2)
    check_mean(str(path), accel, warn)
    order = order_of(str(path), time_s, "correct the time column", warn)
    time_s, accel = time_s[order] - time_s[order[0]], accel[order]
    if accel.shape[1] == 1:
        up = _upward(f"{path}: {names[columns[0]]}", accel[:, 0], warn)
        return time_s, np.column_stack([np.zeros_like(up), np.zeros_like(up), up]), np.zeros_like(up)
    return time_s, _level(accel)[1], np.zeros(len(accel))


def _read_table(path: Path) -> tuple[list[str], Floats]:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}){did_you_mean_file(path)}") from None
    if len(lines) < 2:
        raise InputError(f"{path}: a header line and rows of numbers are needed")
    delimiter = next((mark for mark in ",;\t" if mark in lines[0]), None)
    split = (lambda line: next(csv.reader([line], delimiter=delimiter))) if delimiter else str.split
    names = [name.strip().lower() or f"column {number}" for number, name in enumerate(split(lines[0]), start=1)]
    try:
        cells = {n: split(line) for n, line in enumerate(lines[1:], start=2) if line.strip()}
    except csv.Error as error:
        raise InputError(f"{path}: not a table ({error})") from None
    rows = [_row(f"{path}: line {n}", row, names) for n, row in cells.items()]
    if not rows:
        raise InputError(f"{path}: rows of {len(names)} numbers are needed, there is none")
    return names, np.array(rows)


def _row(where: str, cells: list[str], names: list[str]) -> list[float]:
    """The numbers of one row; raises InputError with the line and the column."""
    if len(cells) != len(names):
        raise InputError(f"{where}: has {counted(len(cells), 'value')}, the header has {counted(len(names), 'name')}")
    row = []
    for name, cell in zip(names, cells, strict=True):
        try:
            row.append(float(cell))
        except ValueError:
            raise InputError(f"{where}: {name} is {cell.strip()[:40]!r}, a number is needed") from None
        if not math.isfinite(row[-1]):
            raise InputError(f"{where}: {name} is {cell.strip()}, a finite number is needed")
    return row


def _accel_columns(path: Path, names: list[str]) -> tuple[list[int], Floats]:
    """Indices and signs of three acceleration columns, forward, left and up, or of one.

    By names such as x y z, ax ay az, a_forward, acc_z or linear_acceleration_x, in any order. Raises InputError if
    there are none, for two of one axis, and for another unit.
    """
    found: dict[str, int] = {}
    for place, name in enumerate(names):
        column = _COLUMN.fullmatch(name)
        if column is None or not (column["of"] or column["axis"]):
            continue
        if (unit := column["unit"] or column["suffix"]) not in _UNITS:
            raise InputError(f"{path}: {name} is in {unit}, m/s^2 is needed")
        axis = column["axis"] or ""
        if (other := next((known for known in found if _group(known) == _group(axis)), None)) is not None:
            raise InputError(f"{path}: {names[found[other]]} and {name} name one axis: remove or rename one of them")
        found[axis] = place
    chosen = [axis for axes in _AXES for axis in axes if axis in found]
    if len(found) == 1:
        chosen = list(found)
        if chosen[0] not in _VERTICAL:
            raise InputError(
                f"{path}: {names[found[chosen[0]]]}, the only acceleration column, is horizontal by its name: a"
                " vertical one (az, a_up or a_down) or three columns (ax, ay, az) are needed; add or rename columns"
            )
    elif len(found) != 3 or len(chosen) != 3 or any(not set(axes) & set(chosen) for axes in _AXES):
        listed, near = ", ".join(names), _near([name for name in names if not _COLUMN.fullmatch(name)], ACCEL_NAMES)
        raise InputError(f"{path}: no acceleration columns among {listed}: name them ax, ay, az or x, y, z{near}")
    return [found[axis] for axis in chosen], np.array([-1.0 if axis in _NEGATIVE else 1.0 for axis in chosen])


def _group(axis: str) -> tuple[str, ...]:
    """The names of an axis and of its opposite; empty for a column without an axis."""
    return next((axes for axes in _AXES if axis in axes), ())


def _near(names: list[str], known: Sequence[str]) -> str:
    """A suggestion of the known name that is closest to one of a table's names."""
    return next((near for name in names if (near := did_you_mean(name, known))), "")


def _upward(where: str, accel: Floats, warn: OnWarning) -> Floats:
    """Remove the mean of one vertical column (n,) m/s^2, and change its sign if that mean is gravity, but negative."""
    mean = float(accel.mean())
    if mean > -GRAVITY_FROM_MPS2:
        return accel - mean
    warn(f"{where}: gravity shows that the axis points the other way than its name states: the sign is changed")
    return mean - accel


def _level(accel: Floats) -> tuple[Floats, Floats]:
    mean = accel.mean(axis=0)
    norm = float(np.linalg.norm(mean))
    if norm < GRAVITY_FROM_MPS2:
        return np.eye(3), accel - mean
    rotation = rotation_to_vertical(mean / norm)
    return rotation, (accel - mean) @ rotation.T


def _even(path: Path, time_s: Floats, accel: Floats, pitch: Floats) -> SeatMotion:
    """Interpolate the motion, in order of time, to an even grid.

    The grid counts lost samples, so that it meets the others of an even record; it never is slower than the samples.
    """
    if time_s.size < 3 or time_s[-1] < MOTION_S[0]:
        raise InputError(f"{path}: at least {MOTION_S[0]:g} s of motion with increasing time are needed")
    rate = (time_s.size - 1) / float(time_s[-1])
    if rate < MIN_RATE_HZ:
        raise InputError(
            f"{path}: a rate of {rate:.3g} Hz is too low for a seat motion, at least {MIN_RATE_HZ:g} Hz is needed"
        )
    steps_s = np.diff(time_s)
    # From 1.75 periods on, a sample was lost; jitter of 30 % of a period makes steps of up to 1.6.
    periods = int(np.maximum(np.floor(steps_s / np.median(steps_s) + 0.25), 1.0).sum())
    even = _interpolated(time_s, np.column_stack([accel, pitch]), np.linspace(0.0, time_s[-1], periods + 1))
    return SeatMotion(periods / float(time_s[-1]), even[:, :3], even[:, 3])


def _interpolated(time_s: Floats, values: Floats, at_s: Floats) -> Floats:
    """Interpolate values (n, k) at time_s (n,) to at_s (m,): cubic splines between gaps, straight lines across gaps.

    Splines, because straight lines between samples take away what lies near half the sampling rate.
    """
    found: Floats = np.column_stack([np.interp(at_s, time_s, column) for column in values.T])
    ends = np.flatnonzero(gaps_of(time_s)) + 1
    for begin, end in zip([0, *ends], [*ends, time_s.size], strict=True):
        inside = slice(*np.searchsorted(at_s, [time_s[begin], time_s[end - 1]]))
        if end - begin > 1:  # a single sample between two gaps has no spline
            found[inside] = scipy.interpolate.CubicSpline(time_s[begin:end], values[begin:end], axis=0)(at_s[inside])
    return found
