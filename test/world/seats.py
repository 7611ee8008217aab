"""How vehicles move a seat: roads, potholes and rail-like shocks through a quarter car, and drives that were recorded.

Recordings (see their SOURCE.txt): tram and bus floors at 500 Hz, a car at 104 Hz, potholes at 50 Hz. They are raised to
the rate of the truth without inventing anything: what they cannot hold is not there, so a pothole ends at 25 Hz.
"""

from __future__ import annotations

import io
import os
import tarfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft, interpolate, signal

Floats = NDArray[np.float64]
Case = Literal["road", "pothole", "rail"]
Origin = Literal["synthetic", "recorded"]

CASES: Final[tuple[Case, ...]] = ("road", "pothole", "rail")
ORIGINS: Final[tuple[Origin, ...]] = ("synthetic", "recorded")
RATE_HZ: Final = 4.0 * 1129.3
GRAVITY_MPS2: Final = 9.80665

ROAD_RMS_MPS2: Final = (0.9, 1.8)
PEAKS_G: Final = {"pothole": (1.0, 3.0), "rail": (3.0, 8.0)}
"""The levels of the paper's cases (5.3); recordings, which are milder, are raised to the lower half of them."""

EDGE_S: Final = 0.4
"""Motion sets in and ends over so long, without a step in any derivative that matters."""

SLOWEST_HZ: Final = 0.4
"""Below lie gravity and the drift of the sensors that recorded."""

DRIVES: Final = {"road": ("bus", "car"), "rail": ("tram",)}


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of a seat: accelerations (n, 3) forward, left, up at `RATE_HZ`, without gravity, from rest to rest."""

    case: Case
    origin: str
    accel_mps2: Floats


def motion(case: Case, origin: Origin, seconds: float, rng: np.random.Generator) -> Motion:
    """Draw a motion of a case; FileNotFoundError where recordings are asked for that are not there."""
    if origin == "synthetic":
        made = Motion(case, "synthetic", _synthetic(case, seconds, rng))
    else:
        made = _gonzalez(case, seconds, rng) if case == "pothole" else _drive(case, seconds, rng)
    accel = made.accel_mps2 * edges(len(made.accel_mps2), RATE_HZ)[:, None]
    if case == "road":
        factor = rng.uniform(*ROAD_RMS_MPS2) / accel[:, 2].std()
    else:
        least, most = PEAKS_G[case]
        most = 0.5 * (least + most) if origin == "recorded" else most
        factor = rng.uniform(least, most) * GRAVITY_MPS2 / np.abs(accel[:, 2]).max()
    return Motion(case, made.origin, accel * factor)


def edges(count: int, rate_hz: float) -> Floats:
    """A window (count,) that rises and falls over `EDGE_S`."""
    since = np.minimum(np.arange(count), np.arange(count)[::-1]) / (EDGE_S * rate_hz)
    return np.sin(0.5 * np.pi * np.clip(since, 0.0, 1.0)) ** 2


# --- made ------------------------------------------------------------------------------------------------------------


def quarter_car(frequency_hz: Floats, wheel_hop_hz: float) -> NDArray[np.complex128]:
    """Acceleration of the floor of a car per displacement of the road, 1/s^2: two masses, 1.3 Hz and wheel hop."""
    s = 2j * np.pi * frequency_hz
    sprung, spring, damper = 400.0, 25e3, 1.8e3
    tyre, unsprung = 200e3, (200e3 + spring) / (2.0 * np.pi * wheel_hop_hz) ** 2
    link = damper * s + spring
    return s**2 * tyre * link / ((sprung * s**2 + link) * (unsprung * s**2 + link + tyre) - link**2)


def _synthetic(case: Case, seconds: float, rng: np.random.Generator) -> Floats:
    count = round(seconds * RATE_HZ)
    time_s = np.arange(count) / RATE_HZ
    frequency_hz = np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    car = quarter_car(frequency_hz, rng.uniform(9.5, 12.5))
    up = road(frequency_hz, car, count, rng)
    if case == "pothole":
        holes = _in_time(car * np.fft.rfft(_holes(time_s, rng)), count)
        up = 0.08 * up + holes / np.abs(holes).max()
    if case == "rail":
        strikes = _strikes(time_s, rng)
        up = 0.04 * up + strikes / np.abs(strikes).max()
    return np.column_stack([*companions(up, rng), up])


def road(frequency_hz: Floats, car: NDArray[np.complex128], count: int, rng: np.random.Generator) -> Floats:
    """A road of rms 1 (n,) through a car, and rumble of 0.3 beside it.

    ISO 8608: displacement falls with the frequency, so velocity is white. Rumble reaches the floor on other ways.
    """
    white = _white(frequency_hz, rng)
    height = _in_time(car * white / np.maximum(frequency_hz, SLOWEST_HZ), count)
    rumble = _in_time(_white(frequency_hz, rng) / (1.0 + (frequency_hz / 45.0) ** 4), count)
    return height / height.std() + 0.3 * rumble / rumble.std()


def _white(frequency_hz: Floats, rng: np.random.Generator) -> NDArray[np.complex128]:
    """A random spectrum (f,) that ends smoothly between 120 and 160 Hz."""
    phases = rng.standard_normal(frequency_hz.size) + 1j * rng.standard_normal(frequency_hz.size)
    return phases * _passed(frequency_hz, 120.0, 160.0)


def _passed(frequency_hz: Floats, begin_hz: float, end_hz: float) -> Floats:
    """1 up to begin_hz, 0 from end_hz on, a cosine between."""
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((frequency_hz - begin_hz) / (end_hz - begin_hz), 0.0, 1.0))


def _in_time(spectrum: NDArray[np.complex128], count: int) -> Floats:
    return np.fft.irfft(np.append(0.0, spectrum[1:]), count)


def _holes(time_s: Floats, rng: np.random.Generator) -> Floats:
    """The road's height (n,): every two or three seconds a hole of 0.6 to 1.2 m under one axle and the next."""
    height, at = np.zeros(time_s.size), rng.uniform(0.6, 1.2)
    while at < time_s[-1] - 1.2:
        speed_mps, length_m, depth_m = rng.uniform(6.0, 14.0), rng.uniform(0.6, 1.2), rng.uniform(0.5, 1.0)
        for late_s, share in ((0.0, 1.0), (2.7 / speed_mps, 0.5)):
            along = np.clip((time_s - at - late_s) * speed_mps / length_m, 0.0, 1.0)
            height -= share * depth_m * np.sin(np.pi * along) ** 2
        at += rng.uniform(1.6, 3.0)
    return height


def _strikes(time_s: Floats, rng: np.random.Generator) -> Floats:
    """Four wheelsets over a joint every two to three seconds: Ricker's wavelets, which leave no velocity behind."""
    up, at = np.zeros(time_s.size), rng.uniform(0.6, 1.2)
    while at < time_s[-1] - 1.3:
        strongest, frequency_hz = rng.uniform(0.4, 1.0), rng.uniform(12.0, 24.0)
        for late_s in np.array([0.0, 0.14, 0.42, 0.56]) * rng.uniform(0.8, 1.2):
            phase = (np.pi * frequency_hz * (time_s - at - late_s)) ** 2
            up += strongest * rng.uniform(0.6, 1.0) * (1.0 - 2.0 * phase) * np.exp(-phase)
        at += rng.uniform(2.0, 3.2)
    return up


def companions(up: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Forward and left (n,): a share of the vertical, some time later, and sway.

    In the recordings 0.13 to 0.38 of the vertical of the last 0.1 s goes to either axis (0.25 to 0.42 to both).
    """
    sos = signal.butter(2, [0.3, 4.0], "bandpass", fs=RATE_HZ, output="sos")

    def sideways() -> Floats:
        late, share = round(rng.uniform(0.0, 0.1) * RATE_HZ), rng.uniform(0.1, 0.4) * rng.choice((-1.0, 1.0))
        sway = signal.sosfilt(sos, rng.standard_normal(up.size))
        behind = np.concatenate([np.zeros(late), up[: up.size - late]])
        return share * behind + 0.25 * up.std() / sway.std() * sway

    return sideways(), sideways()


# --- recorded --------------------------------------------------------------------------------------------------------


def data() -> Path:
    """Where the recordings are, if they are there: `$BIODYN_DATA` or ../shared/data."""
    return Path(os.environ.get("BIODYN_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")


@cache
def _recorded(drive: str) -> tuple[Floats, float]:
    """A drive (n, 3) forward, left, up and its rate, the slow part taken off."""
    if drive == "car":
        rows = np.loadtxt(data() / "comma2k19_car_imu_104hz" / "imu.csv", delimiter=",", skiprows=1)
        rate_hz = (len(rows) - 1) / (rows[-1, 0] - rows[0, 0])
        even_s = rows[0, 0] + np.arange(len(rows)) / rate_hz
        forward, right, down = interpolate.CubicSpline(rows[:, 0], rows[:, 1:4])(even_s).T
        return _steady(np.column_stack([forward, -right, -down]), rate_hz), rate_hz
    name = {"bus": "L20_3014_Zaluhy_Drobneho.csv", "tram": "L3_StnVinohrady_Riazanska.csv"}[drive]
    back, left, up = np.loadtxt(data() / "bratislava_tram_bus_500hz" / name, skiprows=1).T
    return _steady(np.column_stack([-back, left, up]), 500.0), 500.0


@cache
def _potholes() -> tuple[Floats, ...]:
    """All recorded potholes, vertical (n,), 50 Hz."""
    with tarfile.open(data() / "gonzalez_road_events_50hz" / "gonzalez_2017.tar.gz") as archive:
        names = sorted(n for n in archive.getnames() if "/potholes/" in n and n.endswith(".csv"))
        texts = [archive.extractfile(name).read().decode() for name in names]
    return tuple(np.loadtxt(io.StringIO(text), skiprows=1) for text in texts)


def _steady(accel: Floats, rate_hz: float) -> Floats:
    sos = signal.butter(2, SLOWEST_HZ, "highpass", fs=rate_hz, output="sos")
    return signal.sosfiltfilt(sos, accel, axis=0)


def raised(values: Floats, rate_hz: float, count: int) -> Floats:
    """Samples (n, ...) at rate_hz as `count` samples at `RATE_HZ`, band-limited: nothing above half the old rate.

    The topmost fifth of the band, which every recorder folds into, goes off smoothly.
    """
    beyond = round(1.0 * rate_hz)
    padded = np.concatenate([values[beyond:0:-1], values, values[-2 : -beyond - 2 : -1]])
    spectrum = fft.rfft(padded, axis=0)
    frequency_hz = np.arange(len(spectrum)) * rate_hz / len(padded)
    spectrum *= _passed(frequency_hz, 0.4 * rate_hz, 0.5 * rate_hz).reshape(-1, *[1] * (values.ndim - 1))
    # The new samples lie where the old ones' band-limited curve is read, on a grid fine enough for a spline.
    finer = int(np.ceil(RATE_HZ / rate_hz))
    fine = fft.irfft(spectrum, len(padded) * finer, axis=0) * finer
    at_s = np.arange(count) / RATE_HZ + beyond / rate_hz
    return interpolate.CubicSpline(np.arange(len(fine)) / (rate_hz * finer), fine)(at_s)


def _drive(case: Case, seconds: float, rng: np.random.Generator) -> Motion:
    """A window of a drive: lively for a road, around one of the strongest shocks for rails."""
    name = str(rng.choice(DRIVES[case]))
    accel, rate_hz = _recorded(name)
    length = round(seconds * rate_hz) + 2
    begins = np.arange(0, len(accel) - length, round(0.5 * rate_hz))
    lively = np.array(
        [np.abs(accel[b : b + length, 2]).max() if case == "rail" else accel[b : b + length, 2].std() for b in begins]
    )
    begin = int(rng.choice(begins[lively >= np.quantile(lively, 0.6)]))
    return Motion(case, name, raised(accel[begin : begin + length], rate_hz, round(seconds * RATE_HZ)))


def _gonzalez(case: Case, seconds: float, rng: np.random.Generator) -> Motion:
    """Recorded potholes of 50 Hz one after the other, each from rest to rest; sideways nothing was recorded."""
    parts: list[Floats] = []
    while sum(map(len, parts)) < seconds * 50.0 + 2:
        events = _potholes()
        event = events[rng.integers(len(events))]
        parts.append((event - event.mean()) * edges(len(event), 50.0) / np.abs(event - event.mean()).max())
    up = raised(_steady(np.concatenate(parts), 50.0), 50.0, round(seconds * RATE_HZ))
    return Motion(case, "car (50 Hz)", np.column_stack([*companions(up, rng), up]))
