"""Exports of Blue Trident sensors made from a motion that is known at every instant, for tests of their import."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biodyn_ros.bag import imu_blocks, open_bag
from biodyn_ros.base.topics import INPUT
from biodyn_ros.blue_trident import ImportOptions, document_of, import_blue_trident

Floats = NDArray[np.float64]
Motion = Callable[[Floats], Floats]

G = 9.80665
RAIL = 16.0 * G
TAKE = "2021-05-12-10-32-11"
UNIX_US = 1_620_808_331_000_000
LOW_HZ, HIGH_HZ = 1125.0, 1600.0


def shock(at_s: Sequence[float] = (3.0,), peak_g: float = 60.0, width_s: float = 0.011, axis: int = 2) -> Motion:
    """A seated person's specific force (n, 3): rest for 1.2 s, a ride of a few m/s^2, half-sine shocks of one axis."""

    def force(t: Floats) -> Floats:
        rise = np.clip((t - 1.2) / 0.3, 0.0, 1.0)
        x, y, z = (size * np.sin(2 * np.pi * hz * t) * rise for size, hz in ((1.5, 3.1), (1.2, 5.7), (2.5, 4.3)))
        out = np.column_stack([x, y, z + G])
        for begin in at_s:
            phase = (t - begin) / width_s
            out[:, axis] += peak_g * G * np.where((phase > 0.0) & (phase < 1.0), np.sin(np.pi * phase), 0.0)
        return out

    return force


@dataclass(frozen=True)
class Wide:
    """Error of the high-g channel with its step and noise: those of a 12-bit part of 200 g."""

    bias: tuple[float, float, float] = (4.0, -7.0, 9.0)
    gain: float = 1.0
    delay_s: float = 0.0
    step: float = 400.0 * G / 4096.0
    noise: float = 0.6


WIDE = Wide()


def low_g(motion: Motion, t: Floats, rng: np.random.Generator) -> Floats:
    """16 bits over 16 g either way, a little noise."""
    step = RAIL / 32768.0
    seen = motion(t) + 0.03 * rng.standard_normal((t.size, 3))
    return np.clip(np.rint(seen / step), -32768, 32767) * step


def high_g(motion: Motion, t: Floats, wide: Wide, rng: np.random.Generator) -> Floats:
    """Biased, coarse, noisy; delayed by `delay_s`."""
    seen = wide.gain * motion(t - wide.delay_s) + wide.bias + wide.noise * rng.standard_normal((t.size, 3))
    return np.clip(np.rint(seen / wide.step) * wide.step, -200.0 * G, 200.0 * G)


def capture_u_files(
    directory: Path, serial: str, motion: Motion, seconds: float = 6.0, wide: Wide | None = WIDE, starts_s: float = 0.0,
    take: str = TAKE, low_hz: float = LOW_HZ, seed: int = 1,
) -> Path:  # fmt: skip
    """A sensor's files as Capture.U names them, lowg, highg (unless None) and mag; the low-g file's path."""
    directory.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    t = starts_s + np.arange(round(seconds * low_hz)) / low_hz
    gyro = np.rad2deg(np.column_stack([np.sin(t), 0.5 * np.cos(t), 0.1 * t]))
    stem = directory / f"anna_{serial}_{take}"
    low = write_capture_u(Path(f"{stem}_lowg.csv"), t, np.hstack([low_g(motion, t, rng), gyro]))
    if wide is not None:
        th = starts_s + 0.0137 + np.arange(round((seconds - 0.02) * HIGH_HZ)) / HIGH_HZ
        write_capture_u(Path(f"{stem}_highg.csv"), th, high_g(motion, th, wide, rng))
    tm = starts_s + np.arange(round(seconds * 112.0)) / 112.0
    write_capture_u(Path(f"{stem}_mag.csv"), tm, np.tile([20.0, -5.0, 40.0], (tm.size, 1)), "mx_uT,my_uT,mz_uT")
    return low


def write_capture_u(path: Path, t: Floats, values: Floats, names: str = "") -> Path:
    """One file: stamps in microseconds since 1970, seconds, the columns."""
    names = names or "ax_m/s/s,ay_m/s/s,az_m/s/s" + (",gx_deg/s,gy_deg/s,gz_deg/s" if values.shape[1] == 6 else "")
    stamps = UNIX_US + np.rint(1e6 * t).astype(np.int64)
    rows = [
        f"{stamp},{since:.6f},{','.join(f'{value:.6f}' for value in row)}"
        for stamp, since, row in zip(stamps.tolist(), (t - t[0]).tolist(), values.tolist(), strict=True)
    ]
    path.write_text("\n".join([f"unix_timestamp_microsec,time_s,{names}", *rows, ""]))
    return path


def nexus_text(
    sensors: dict[str, Floats], rate: str = "250", per_frame: int = 5, top: str = "\n\n", trailing: str = "",
    units: tuple[str, str] = ("mm/s²", "deg/s"), end: str = "\r\n", first_frame: int = 1,
) -> str:  # fmt: skip
    """An export of Nexus: sensors {serial: (n, 15)} in SI but deg/s, laid out as the real ones are, in mm/s^2."""
    channels = ("accel", "gyro", "mag", "Global Angle", "HighG")
    unit_of = {"accel": units[0], "gyro": units[1], "mag": "T", "Global Angle": "deg", "HighG": units[0]}
    names = ",," + ",".join(f"{serial} - {channel},," for serial in sensors for channel in channels)
    axes = "Frame,Sub Frame" + ",x,y,z" * (5 * len(sensors))
    unit = ",," + ",".join(",".join([unit_of[channel]] * 3) for _ in sensors for channel in channels)
    scale = 1000.0 if units[0].startswith("mm") else 1.0
    factor = np.repeat([scale, 1.0, 1.0, 1.0, scale], 3)
    table = np.hstack([values * factor for values in sensors.values()])
    rows = [
        f"{first_frame + number // per_frame},{number % per_frame},{','.join(f'{value:.6g}' for value in row)}"
        for number, row in enumerate(table.tolist())
    ]
    lines = [f"Devices{trailing}", f"{rate}{trailing}", names, axes, unit, *rows]
    return (top + "\n".join(lines) + "\n").replace("\n", end)


def still(count: int, accel: tuple[float, float, float] = (0.0, 0.0, G), seed: int = 1) -> Floats:
    """Rows of one sensor of Nexus (n, 15), SI but deg/s: at rest with a little noise, high-g biased."""
    rng = np.random.default_rng(seed)
    out = np.zeros((count, 15))
    out[:, :3] = np.array(accel) + 0.02 * rng.standard_normal((count, 3))
    out[:, 3:6] = rng.standard_normal((count, 3))
    out[:, 6:9] = [2e-5, 1e-5, -3e-5]
    out[:, 9:12] = 10.0
    out[:, 12:] = out[:, :3] + [1.0, 2.0, 9.0] + 0.5 * rng.standard_normal((count, 3))
    return out


def imported(place: Path, bag: Path, mapping: dict[str, str], **how: Any) -> dict[str, Any]:
    return document_of(import_blue_trident(place, bag, ImportOptions(mapping, **how)))


def samples(bag: Path, sensor: str) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Stamps, accelerations and angular rates of one sensor, as every other reader of the project sees them."""
    with open_bag(bag) as reader:
        blocks = [block for _, block in imu_blocks(reader, [INPUT[sensor]], gyro=True)]
    parts = [(block.stamps_ns, block.accel_mps2, block.gyro_radps) for block in blocks]
    stamps, accel, gyro = (np.concatenate(part) for part in zip(*parts, strict=True))
    return stamps, accel, gyro
