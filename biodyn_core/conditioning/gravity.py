"""Gravity: the mean reading of one sensor at rest, from its record, its session, or another record."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.conditioning.attitude import MAX_RATE_SCATTER_RADPS
from biodyn_core.conditioning.tilt import Vector

Origin = Literal["begin", "rest", "session", "other_record", "motion"]
"""Rest at the start of the record, later in it, elsewhere in its session, or in another record; or no rest, and the
mean over all motion."""

SAME_MOUNTING_MPS2: Final = 0.86
"""Means of one sensor in two records differ by less than this, 5 deg of tilt, where it was mounted alike."""

IDLING_MPS2: Final = 1.0
"""An idling engine shakes a seat by less, rms: rest_rms_mps2 must not be set higher."""

SAME_REST_MPS2: Final = 0.2
"""Readings at rest are the same if they differ by less: 1.2 deg of tilt."""

STUCK_MPS2: Final = 1e-5
"""A sensor with less rms about its mean repeats one reading. Rounding gives 1e-6."""

LEAST_OTHERS: Final = 0.25
"""The least share of a rest in which a sensor must read others before a reading that it repeats counts as stuck."""

STUCK_READINGS: Final = 100
"""A sensor that shows its noise never repeats a reading so often: 25 ms at 4 kHz, 0.25 s at 400 Hz."""

MAX_TILT_DEG: Final = 30.0
"""A larger tilt between rest and the mean in motion means another mounting, such as on a table or in a hand. The mean
tilt of a seated person is smaller."""


@dataclass(frozen=True)
class Gravity:
    """Mean reading of one sensor, (3,) m/s^2: gravity and bias together.

    at_s: start of the averaged stretch in the record. samples: its first sample and the one after it, in order of
    arrival; None at the start, where conditioning finds them, and for another record (source). quietest_mps2: least rms
    of any window of a record without rest. tilted: there is a rest in the record, but mounted otherwise than in motion.
    rates_radps: the mean angular rate at rest, the gyro's bias, where the samples of the rest are not in the record.
    is_constant: the sensor repeats one reading in this rest. stuck_at_s: start of a stretch that is no rest, because
    the sensor repeats another reading there.
    """

    mean_mps2: Vector
    origin: Origin
    at_s: float = 0.0
    samples: tuple[int, int] | None = None
    quietest_mps2: float | None = None
    source: str = ""
    tilted: bool = False
    rates_radps: Vector | None = None
    is_constant: bool = False
    stuck_at_s: float | None = None

    @property
    def is_rest(self) -> bool:
        """Whether the mean is over a rest in the sensor's own record."""
        return self.origin in ("begin", "rest")

    def warning(self, vertical_given: bool) -> str | None:
        """The origin in one line; None for rest at the start."""
        origin = self._origin(vertical_given)
        if origin is None or self.stuck_at_s is None:
            return origin
        return f"{origin}; from {self.stuck_at_s:.1f} s on it repeats another reading: was it stuck?"

    def _origin(self, vertical_given: bool) -> str | None:
        if self.is_constant:
            record = f" in {self.source}" if self.source else ""
            return f"gravity is from {self.at_s:.1f} s on{record}, where it repeats one reading: is it stuck?"
        if self.origin in ("begin", "session"):
            return None
        if self.origin == "rest":
            no_rest = "no rest at the start: " if self.stuck_at_s is None else ""
            return f"{no_rest}gravity is from the rest at {self.at_s:.1f} s"
        if self.origin == "other_record":
            return f"no rest in the record: gravity is from the rest in {self.source}"
        averaged = "the length of gravity" if vertical_given else "gravity"
        if self.tilted:
            return (
                f"rests only where it is tilted by more than {MAX_TILT_DEG:g} deg: {averaged} is the mean over motion"
            )
        line = f"no rest in the record: {averaged} is the mean over motion"
        if self.quietest_mps2 is not None and self.quietest_mps2 <= IDLING_MPS2:
            line += (
                f"; with an engine that idles set rest_rms_mps2 above {self.quietest_mps2:.3f}, its quietest stretch"
            )
        return line if vertical_given else f"{line}; the parameter vertical gives the direction"


def angle_deg(one: Vector, other: Vector) -> float:
    """The angle between two directions."""
    cosine = float(np.dot(one, other)) / (math.hypot(*one) * math.hypot(*other))
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def gravity_in_rest(samples_mps2: Floats, rates_radps: Floats) -> Gravity | None:
    """The gravity of a sensor from its samples (n, 3) in a rest of its session; None where it moves or is stuck there.

    Where it repeats a reading that differs from its others it is stuck: these samples are left out. rates_radps (n, 3),
    NaN where none were read: their mean is the bias of the gyro, if they scatter little.
    """
    finite = samples_mps2[np.isfinite(samples_mps2).all(axis=1)]
    repeated = _repeated(finite)
    if repeated.all():
        return None
    stuck = repeated & (np.linalg.norm(finite - finite[~repeated].mean(axis=0), axis=1) > SAME_REST_MPS2)
    if stuck.any() and repeated.mean() > 1.0 - LEAST_OTHERS:
        return None
    finite = finite[~stuck]
    if not STUCK_MPS2 < float(np.sqrt(((finite - finite.mean(axis=0)) ** 2).sum(axis=1).mean())) <= IDLING_MPS2:
        return None
    read = rates_radps[np.isfinite(rates_radps).all(axis=1)]
    is_still = len(read) > 0 and bool((read.std(axis=0) < MAX_RATE_SCATTER_RADPS).all())
    x, y, z = finite.mean(axis=0).tolist()
    bias = tuple(read.mean(axis=0).tolist()) if is_still else None
    return Gravity((x, y, z), "session", rates_radps=bias)


def _repeated(samples_mps2: Floats) -> Flags:
    """Flags (n,) of samples (n, 3) in stretches of at least `STUCK_READINGS` equal ones."""
    count = len(samples_mps2)
    begins = np.flatnonzero(np.r_[True, (samples_mps2[1:] != samples_mps2[:-1]).any(axis=1)][:count])
    sizes = np.diff(np.append(begins, count))
    return np.asarray(np.repeat(sizes >= STUCK_READINGS, sizes))


def of_session(whole: Gravity) -> Gravity:
    """The gravity of a sensor in a part of a session, from the search in the whole."""
    return replace(whole, origin="motion" if whole.origin == "motion" else "session", samples=None)


def from_other_record(own: Gravity, others: Iterable[tuple[str, Gravity]]) -> Gravity:
    """The gravity of a sensor without rest, from its rest in another record with the same mounting.

    others: (name of the record, gravity there). The nearest mean is the result; of rests in which the sensor repeats
    one reading only without any other. Without both it is the own mean over motion.
    """
    if own.origin != "motion":
        return own
    near = [
        (other.is_constant, apart_mps2, name, other)
        for name, other in others
        if other.is_rest and (apart_mps2 := math.dist(own.mean_mps2, other.mean_mps2)) <= SAME_MOUNTING_MPS2
    ]
    if not near:
        return own
    is_constant, _, name, nearest = min(near, key=lambda each: each[:2])
    return replace(
        own, mean_mps2=nearest.mean_mps2, origin="other_record", at_s=nearest.at_s, samples=None, source=name,
        tilted=False, is_constant=is_constant,
    )  # fmt: skip
