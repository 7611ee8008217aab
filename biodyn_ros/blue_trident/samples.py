"""The common form of both kinds of export: samples in SI units, and a description of the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_ros.blue_trident.rows import Damage

Channel = Literal["low", "high"]
Kind = Literal["Capture.U", "Nexus"]

ACCEL_UNITS: Final = {
    "m/s/s": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "m/s2": 1.0, "g": STANDARD_GRAVITY_MPS2,
    "mm/s/s": 1e-3, "mm/s^2": 1e-3, "mm/s²": 1e-3, "mm/s2": 1e-3,
}  # fmt: skip
"""Units of acceleration in m/s^2."""

GYRO_UNITS: Final = {"deg/s": np.pi / 180.0, "°/s": np.pi / 180.0, "rad/s": 1.0}
"""Units of angular velocity in rad/s."""

LATEST_S: Final = 2.0**31
"""ROS stamps have 31 bits for seconds."""


class Samples(NamedTuple):
    """Samples of one channel: stamps_ns (n,), accel_mps2 (n, 3), gyro_radps and mag (n, 3) or None."""

    stamps_ns: Integers
    accel_mps2: Floats
    gyro_radps: Floats | None = None
    mag: Floats | None = None

    def rows(self, which: slice | Flags) -> Samples:
        """The selected rows."""
        return Samples(*(None if part is None else part[which] for part in self))


class Part(NamedTuple):
    """Samples of one channel of one sensor."""

    serial: str
    channel: Channel
    samples: Samples


@dataclass(frozen=True)
class ChannelInfo:
    """One channel of one sensor in a file, with the units of acceleration and angular velocity as in the file."""

    serial: str
    channel: Channel
    accel_unit: str
    gyro_unit: str | None


class Export(Protocol):
    """One export file: kind, take and channels."""

    path: Path
    kind: Kind
    take: str
    channels: tuple[ChannelInfo, ...]

    def parts(self, damage: Damage, start_ns: int, max_bytes: int) -> Iterator[tuple[int, list[Part]]]:
        """Yield (bytes read, samples read); start_ns is for files without a time of day."""


def joined(first: Samples, second: Samples) -> Samples:
    """Concatenate samples of one channel."""
    pairs = zip(first, second, strict=True)
    return Samples(*(None if a is None or b is None else np.concatenate([a, b]) for a, b in pairs))


def scale_of(unit: str, known: dict[str, float], where: str) -> float:
    """The factor from a unit to SI; raises InputError for an unknown unit."""
    scale = known.get(unit.strip())
    if scale is None:
        raise InputError(f"{where}: unit {unit.strip()!r} is unknown; known units: {', '.join(known)}")
    return scale
