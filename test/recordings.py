"""Real recordings of the shared data that are no bags, as stamps and accelerations: see each folder's SOURCE.txt."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2

Recording = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Stamps (n,) ns as they were written, and specific force (n, 3) m/s^2."""

START_NS = 1_600_000_000 * 10**9


def tram(data: Path, name: str) -> Recording:
    """A tram or bus floor at 500 Hz, m/s^2; no time column."""
    accel = np.loadtxt(data / "bratislava_tram_bus_500hz" / name, skiprows=1)
    return START_NS + np.arange(len(accel)) * 2_000_000, accel


def baja(data: Path) -> Recording:
    """A Baja car, stamps in whole milliseconds with steps of 6 to 120."""
    rows = np.loadtxt(data / "jittery_timestamps/baja_DATA_033.csv", delimiter=",", skiprows=1, usecols=(0, 2, 3, 4))
    return START_NS + rows[:, 0].astype(np.int64) * 1_000_000, rows[:, 1:]


def android(data: Path) -> Recording:
    """A telephone in a car, gravity taken off by the application; steps in whole milliseconds."""
    rows = np.loadtxt(data / "jittery_timestamps/android_car_ride_accel__3.txt")
    return START_NS + np.cumsum(rows[:, 3].astype(np.int64)) * 1_000_000, rows[:, :3]


def parachute(data: Path) -> Recording:
    """A WitMotion sensor at 200 Hz with steps of 5 and 10 ms, and peaks up to its 16 g."""
    text = (data / "jittery_timestamps/witmotion_parachute_data_2.txt").read_text(encoding="utf-8", errors="replace")
    rows = [line.split("\t") for line in text.splitlines()[2:] if line.strip()]
    times = [datetime.fromisoformat(f"{row[2]}+00:00") for row in rows]
    stamps = [round((time - times[0]).total_seconds() * 1000) * 1_000_000 for time in times]
    accel = np.array([[float(cell) for cell in row[3:6]] for row in rows]) * STANDARD_GRAVITY_MPS2
    return START_NS + np.array(stamps), accel


def comma(data: Path) -> Recording:
    """A car on a highway at 104.36 Hz, seconds since boot; forward, right, down."""
    rows = np.loadtxt(data / "comma2k19_car_imu_104hz/imu.csv", delimiter=",", skiprows=1)
    return np.rint(rows[:, 0] * 1e9).astype(np.int64), rows[:, 1:4]


def comma_turning(data: Path) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """The same car on an even grid: accelerations and angular rates (n, 6), rate (Hz), speed by the car's bus (n,)."""
    folder = data / "comma2k19_car_imu_104hz"
    rows = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1)
    even_s = np.linspace(rows[0, 0], rows[-1, 0], len(rows))
    values = np.column_stack([np.interp(even_s, rows[:, 0], column) for column in rows[:, 1:7].T])
    speed_t, speed = (np.load(folder / f"speed_{kind}.npy").ravel() for kind in ("t", "value"))
    return values, (len(rows) - 1) / (rows[-1, 0] - rows[0, 0]), np.interp(even_s, speed_t, speed)
