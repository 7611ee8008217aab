"""Pairs of channels that were recorded side by side on one structure, with one fault hidden in the one under test.

The recordings (see their SOURCE.txt): both accelerometers of a Blue Trident on an arm and on running legs, one leg
beside the other, and the axes and gyro of one IMU in a car, a tram and buses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal
from scipy.spatial.transform import Rotation

from world.seats import data

Floats = NDArray[np.float64]
Fault = Literal["none", "clock", "drift", "gain", "tilt", "saturation", "skin"]

FAULTS: Final[tuple[Fault, ...]] = ("clock", "drift", "gain", "tilt", "saturation", "skin")
UNFAULTED: Final = 0.3
"""So many of the records hide nothing."""

OFFSET_S: Final = (0.001, 0.005)
DRIFT: Final = (50e-6, 300e-6)
GAIN: Final = (0.01, 0.10)
TILT_DEG: Final = (2.0, 10.0)
CLIPPED_QUANTILE: Final = (0.6, 0.95)
POLE_HZ: Final = (15.0, 60.0)
"""Sizes that are drawn; the sign of the first three either way."""

STRETCH_S: Final = (6.0, 12.0)
FINER: Final = 8
"""Faults act on a curve so many times finer than the samples, as they would on the motion itself."""

NEXUS: Final = {"arm": "BraccioLineareVelocita01.csv", "wrist": "Extra.csv", "legs": "MovimentoGambe01.csv"}
LATE_START_S: Final = 0.4
"""Some sensors send zeros so long."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Synchronous raw channels: reference (n, k), and under test (n, 3) m/s^2, whose last axis is the one predicted.

    turns says whether the two horizontal axes belong to the sensor under test alone: else they are in the reference,
    and a tilt would turn that as well.
    """

    name: str
    rate_hz: float
    reference: Floats
    under_test: Floats
    turns: bool


@dataclass(frozen=True, eq=False)
class Record:
    """The input of a method: an earlier stretch of a pair without a fault, and a later one to check."""

    name: str
    earlier: Pair
    later: Pair


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth of a record: the fault, its size (s, s/s, share, rad, m/s^2, Hz), and the later axis without it."""

    fault: Fault
    size: float
    clean_mps2: Floats


# --- recordings ------------------------------------------------------------------------------------------------------


@cache
def pairs() -> tuple[Pair, ...]:
    """Every recorded pair; FileNotFoundError where the recordings are not there."""
    return (*_two_accelerometers(), *_legs(), *_axes())


@cache
def _nexus(name: str) -> tuple[Floats, ...]:
    """The sensors of one export, (n, 15) each: acceleration, gyro, magnet, angle, high-g; m/s^2 where accelerations."""
    text = (data() / "bluetrident_nexus_export" / NEXUS[name]).read_text(encoding="utf-8-sig").splitlines()
    head = next(number for number, line in enumerate(text) if line.startswith("Frame,"))
    rows = [line.split(",") for line in text[head + 2 :] if line.count(",") >= 16]
    values = np.array([[float(cell or "nan") for cell in row] for row in rows])[round(LATE_START_S * 250.0) :, 2:]
    sensors = [values[:, begin : begin + 15] for begin in range(0, values.shape[1] // 15 * 15, 15)]
    return tuple(np.column_stack([s[:, :3] * 1e-3, s[:, 3:12], s[:, 12:] * 1e-3]) for s in sensors)


def _last(axis: int) -> list[int]:
    """The three axes, the one asked for last."""
    return [(axis + 1) % 3, (axis + 2) % 3, axis]


def _two_accelerometers() -> list[Pair]:
    """The low-g chip of a Blue Trident beside its high-g chip: one housing, every axis in turn."""
    found = []
    for name in NEXUS:
        for number, sensor in enumerate(_nexus(name)):
            for axis in range(3):
                label = f"{name} {number + 1} {'xyz'[axis]}"
                low, high = sensor[:, :3], sensor[:, 12:]
                found.append(Pair(f"{label}, low-g by high-g", 250.0, high, low[:, _last(axis)], turns=True))
    return found


def _legs() -> list[Pair]:
    """One leg by the other: one body, but no rigid one."""
    one, other = _nexus("legs")
    return [
        Pair(f"leg {'xyz'[axis]} by the other leg", 250.0, one[:, :3], other[:, _last(axis)], True) for axis in (0,)
    ]


def _axes() -> list[Pair]:
    """One axis by the others of the same sensor, and by its gyro where it has one."""
    rows = np.loadtxt(data() / "comma2k19_car_imu_104hz" / "imu.csv", delimiter=",", skiprows=1)
    rate_hz = (len(rows) - 1) / (rows[-1, 0] - rows[0, 0])
    even_s = rows[0, 0] + np.arange(len(rows)) / rate_hz
    car = interpolate.CubicSpline(rows[:, 0], rows[:, 1:7])(even_s)
    found = []
    for axis in range(3):
        accel = car[:, _last(axis)]
        found.append(
            Pair(f"car {'xyz'[axis]} by axes, gyro", rate_hz, np.column_stack([accel[:, :2], car[:, 3:]]), accel, False)
        )
    for name, file in (
        ("tram", "L3_StnVinohrady_Riazanska.csv"),
        ("bus", "L20_3014_Zaluhy_Drobneho.csv"),
        ("idling bus", "L35_1915_Most_Kutiky_neutral.csv"),
    ):
        accel = np.loadtxt(data() / "bratislava_tram_bus_500hz" / file, skiprows=1)
        found.append(Pair(f"{name} z by x, y", 500.0, accel[:, :2], accel, False))
    return found


def cut(pair: Pair, begin: int, end: int) -> Pair:
    """Samples begin to end of a pair."""
    return Pair(pair.name, pair.rate_hz, pair.reference[begin:end], pair.under_test[begin:end], pair.turns)


# --- faults ----------------------------------------------------------------------------------------------------------


def late(accel: Floats, rate_hz: float, late_s: Floats) -> Floats:
    """Samples (n, 3) that are read late_s (n,) after their time."""
    return _fine(accel, rate_hz)(np.arange(len(accel)) / rate_hz - late_s)


def _fine(accel: Floats, rate_hz: float) -> Callable[[Floats], Floats]:
    """The motion between samples, band-limited, and still beyond its ends."""
    finer = signal.resample_poly(accel, FINER, 1, axis=0, padtype="line")
    time_s = np.arange(len(finer)) / (FINER * rate_hz)
    curve = interpolate.CubicSpline(time_s, finer)
    return lambda at_s: curve(np.clip(at_s, 0.0, (len(accel) - 1) / rate_hz))


def soft(accel: Floats, rate_hz: float, pole_hz: float) -> Floats:
    """Samples (n, 3) of a sensor that follows its bone with a lag of first order."""
    finer = signal.resample_poly(accel, FINER, 1, axis=0, padtype="line")
    keeps = float(np.exp(-2.0 * np.pi * pole_hz / (FINER * rate_hz)))
    # The mean of two neighbours: else the lag would gain half a fine sample on the motion.
    b, a = [0.5 * (1.0 - keeps), 0.5 * (1.0 - keeps)], [1.0, -keeps]
    return signal.lfilter(b, a, finer, axis=0, zi=signal.lfilter_zi(b, a)[:, None] * finer[0])[0][::FINER]


def turned(accel: Floats, angle_rad: float, towards_rad: float) -> Floats:
    """Samples (n, 3) of a sensor whose last axis leans by an angle towards a direction in the plane of the others."""
    axis = np.array([np.cos(towards_rad), np.sin(towards_rad), 0.0])
    return accel @ Rotation.from_rotvec(angle_rad * axis).as_matrix().T


def peaks(values: Floats) -> Floats:
    """The sizes of all local extremes of a channel (n,), about its median."""
    size = np.abs(values - np.median(values))
    return size[signal.argrelmax(size)[0]]


def clipped(accel: Floats, limit_mps2: float) -> Floats:
    """Samples (n, 3) of a sensor with a smaller range."""
    return np.clip(accel, -limit_mps2, limit_mps2)


def faulty(pair: Pair, fault: Fault, begin: int, rng: np.random.Generator) -> tuple[Pair, float]:
    """A pair with a fault from sample `begin` on, and the size of the fault."""
    accel, rate_hz = pair.under_test, pair.rate_hz
    sign, size = rng.choice((-1.0, 1.0)), 0.0
    if fault == "clock":
        size = sign * rng.uniform(*OFFSET_S)
        accel = late(accel, rate_hz, np.full(len(accel), size))
    elif fault == "drift":
        size = sign * rng.uniform(*DRIFT)
        accel = late(accel, rate_hz, size * (np.arange(len(accel)) - begin) / rate_hz)
    elif fault == "gain":
        size = sign * rng.uniform(*GAIN)
        accel = (1.0 + size) * accel
    elif fault == "tilt":
        size = np.deg2rad(rng.uniform(*TILT_DEG))
        accel = turned(accel, size, rng.uniform(0.0, 2.0 * np.pi))
    elif fault == "skin":
        size = rng.uniform(*POLE_HZ)
        accel = soft(accel, rate_hz, size)
    elif fault == "saturation":
        # Strongest peaks of the whole sensor axis, gravity included: a range applies to the raw value.
        highest = np.abs(accel[begin:, 2])
        size = float(np.quantile(highest[signal.argrelmax(highest)[0]], 0.5 + 0.5 * rng.uniform(*CLIPPED_QUANTILE)))
        accel = clipped(accel, size)
    return Pair(pair.name, rate_hz, pair.reference, accel, pair.turns), size


# --- records ---------------------------------------------------------------------------------------------------------


def records(count: int, seed: int) -> tuple[list[Record], list[Truth]]:
    """Draw records, 30 % of them without a fault, and the truth of each."""
    rng = np.random.default_rng(seed)
    sound = round(UNFAULTED * count)
    faults = ["none"] * sound + [FAULTS[number % len(FAULTS)] for number in range(count - sound)]
    drawn = [_record(f"record {number + 1}", fault, rng) for number, fault in enumerate(rng.permutation(faults))]
    return [record for record, _ in drawn], [truth for _, truth in drawn]


def _seconds(pair: Pair) -> float:
    """The longest stretch of which a pair has two."""
    return 0.5 * len(pair.reference) / pair.rate_hz


def _record(name: str, fault: Fault, rng: np.random.Generator) -> tuple[Record, Truth]:
    """One record; a tilt is hidden only where the sensor's other axes are not the reference."""
    choice = [pair for pair in pairs() if _seconds(pair) >= STRETCH_S[0] and (pair.turns or fault != "tilt")]
    pair = choice[rng.integers(len(choice))]
    length = int(rng.uniform(STRETCH_S[0], min(STRETCH_S[1], _seconds(pair))) * pair.rate_hz)
    begin = int(rng.integers(len(pair.reference) - 2 * length + 1))
    middle, end = begin + length, begin + 2 * length
    after, size = faulty(pair, fault, middle, rng)
    truth = Truth(fault, size, pair.under_test[middle:end, 2].copy())
    return Record(f"{name}, {pair.name}", cut(pair, begin, middle), cut(after, middle, end)), truth
