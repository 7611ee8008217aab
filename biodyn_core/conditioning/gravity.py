"""Gravity: the mean reading of one sensor at rest, searched for in a whole record before conditioning.

A live sensor waits for rest, and its samples until then are not counted. Offline, rest may be anywhere in the record,
and conditioning begins at the first sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.attitude import MAX_RATE_SCATTER_RADPS
from biodyn_core.conditioning.rest import RestWindow
from biodyn_core.conditioning.tilt import Vector, gravity_and_vertical

Origin = Literal["begin", "rest", "session", "other_record", "motion"]
"""Rest at the start of the record, later in it, elsewhere in its session, or in another record; or no rest, and the
mean over all motion."""

SAME_MOUNTING_MPS2: Final = 0.86
"""Means of one sensor in two records differ by less than this, 5 deg of tilt, where it was mounted alike."""

IDLING_MPS2: Final = 1.0
"""An idling engine shakes a seat by less, rms: rest_rms_mps2 must not be set higher."""

STUCK_MPS2: Final = 1e-5
"""A sensor with less rms about its mean reads a constant. Rounding gives 1e-6.

It is stuck, or too coarse to show its noise: such a rest counts only without another one.
"""

SAME_REST_MPS2: Final = 0.2
"""A reading that is repeated at the begin is right if a rest with noise differs by less: 1.2 deg of tilt."""

PARTS: Final = 4
"""A window at rest may begin at any of so many parts of its length, so that a rest of less than two is found."""

MAX_TILT_DEG: Final = 30.0
"""A larger tilt between rest and the mean in motion means another mounting, such as on a table or in a hand. The mean
tilt of a seated person is smaller."""

MIN_PART_SHARE: Final = 0.75
"""The parts of a window hold about equally many samples: a part below this share of the largest has a gap."""


@dataclass(frozen=True)
class Gravity:
    """Mean reading of one sensor, (3,) m/s^2: gravity and bias together.

    at_s: start of the averaged stretch in the record. samples: its first sample and the one after it, in order of
    arrival; None at the start, where conditioning finds them, and for another record (source). quietest_mps2: least rms
    of any window of a record without rest. tilted: there is a rest in the record, but mounted otherwise than in motion.
    rates_radps: the mean angular rate at rest, the gyro's bias, where the samples of the rest are not in the record.
    is_constant: the sensor repeats one reading in this rest.
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

    @property
    def is_rest(self) -> bool:
        """Whether the mean is over a rest in the sensor's own record."""
        return self.origin in ("begin", "rest")

    def warning(self, vertical_given: bool) -> str | None:
        """The origin in one line; None for rest at the start."""
        if self.is_constant:
            return f"gravity is from {self.at_s:.1f} s on, where it repeats one reading: is it stuck?"
        if self.origin in ("begin", "session"):
            return None
        if self.origin == "rest":
            return f"no rest at the start: gravity is from the rest at {self.at_s:.1f} s"
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


class GravitySearch:
    """`push` the samples of one sensor in order of arrival until it is `decided`, then read the `result`.

    Rest at the start is found as live. Else the result is the first window at rest with the mounting of the motion.
    Memory grows by a row for each quarter of rest_s. rest_s, rest_rms_mps2, max_gap_s, implausible_mps2: see
    `RestWindow`. vertical (3,): the direction of up in the sensor's axes, if it is given.
    """

    def __init__(
        self, rest_s: float, rest_rms_mps2: float, max_gap_s: float, implausible_mps2: float, vertical: Vector | None
    ) -> None:
        self._rest_rms_mps2, self._implausible_mps2, self._vertical = rest_rms_mps2, implausible_mps2, vertical
        self._first_window: RestWindow | None = RestWindow(rest_s, 0.0, rest_rms_mps2, max_gap_s, implausible_mps2)
        self._part_ns = round(1e9 * rest_s / PARTS)
        self._epoch_ns: int | None = None
        self._arrived = 0
        self._open: list[tuple[Integers, Floats]] = []
        self._slot = self._begin_ns = 0
        self._parts: list[_Part] = []
        self._at_begin: Gravity | None = None
        self._constant_at_begin: Gravity | None = None
        self._is_faulty = False

    @property
    def decided(self) -> bool:
        """Whether later samples change nothing: there is rest at the start, or conditioning will refuse the stamps."""
        return self._is_faulty or self._at_begin is not None

    def push(self, stamps_ns: Integers, samples_mps2: Floats) -> None:
        """Take raw specific force (n, 3) m/s^2 with stamps (n,) ns, in order of arrival."""
        if self.decided:
            return
        is_set = stamps_ns != 0
        if self._first_window is not None:
            self._check_begin(self._first_window, stamps_ns[is_set], samples_mps2[is_set])
        # NaN compares as False.
        usable = np.flatnonzero(is_set & (np.abs(samples_mps2) < self._implausible_mps2).all(axis=1))
        if usable.size:
            self._add(np.asarray(stamps_ns[usable], dtype=np.int64), samples_mps2[usable], self._arrived + usable)
        self._arrived += len(stamps_ns)

    def result(self) -> Gravity | None:
        """End the record: the rest found, else the mean over motion.

        None for a record that is shorter than rest_s, without gravity, or faulty.
        """
        if self._is_faulty or self._first_window is not None:
            return None
        self._close_part()
        return self._at_begin or self._of_parts()

    def _check_begin(self, window: RestWindow, stamps_ns: Integers, samples_mps2: Floats) -> None:
        """Search for rest at the start, as live."""
        window.add(stamps_ns, samples_mps2)
        try:
            rest = window.find()
        except InputError:
            self._is_faulty = True
            return
        if rest is None:
            return
        self._first_window = None
        if not rest.in_motion and self._has_gravity(rest.mean_mps2):
            if window.rms_mps2 > STUCK_MPS2:
                self._at_begin = Gravity(rest.mean_mps2, "begin")
            else:
                self._constant_at_begin = Gravity(rest.mean_mps2, "begin", is_constant=True)

    def _add(self, stamps_ns: Integers, samples_mps2: Floats, arrival: Integers) -> None:
        """Sort samples into parts of time, and close complete parts."""
        if self._epoch_ns is None:
            self._epoch_ns = int(stamps_ns[0])
        slots = (stamps_ns - self._epoch_ns) // self._part_ns
        cuts = [0, *(np.flatnonzero(np.diff(slots)) + 1).tolist(), slots.size]
        for begin, end in pairwise(cuts):
            if int(slots[begin]) != self._slot:
                self._close_part()
                self._slot = int(slots[begin])
            if not self._open:
                self._begin_ns = int(stamps_ns[begin])
            self._open.append((arrival[begin:end], samples_mps2[begin:end]))

    def _close_part(self) -> None:
        """Sum the open part at once, so that block cuts change no number."""
        if not self._open:
            return
        arrival, samples = (np.concatenate(pieces) for pieces in zip(*self._open, strict=True))
        self._open = []
        self._parts.append(
            _Part(
                self._begin_ns, self._slot, int(arrival[0]), int(arrival[-1]) + 1, len(samples), samples.sum(axis=0),
                float((samples**2).sum()), len(samples) > 1 and not np.ptp(samples, axis=0).any(),
            )
        )  # fmt: skip

    def _of_parts(self) -> Gravity | None:
        """The first window at rest with the mounting of the motion, else the mean over motion.

        A constant reading is taken without any other rest alone.
        """
        windows = self._windows()
        quiet = [at for at, window in windows.items() if window.rms_mps2 <= self._rest_rms_mps2]
        resting = {at + k for at in quiet for k in range(PARTS)}
        moving = [part for at, part in enumerate(self._parts) if at not in resting] or self._parts
        if not moving:
            return self._constant_at_begin
        motion = _joined(moving)
        rests = [windows[at] for at in quiet if self._has_gravity(windows[at].mean_mps2)]
        begin = self._constant_at_begin
        alike = [one for one in rests if angle_deg(one.mean_mps2, motion.mean_mps2) <= MAX_TILT_DEG]
        for window in (one for one in alike if not one.is_constant):
            if begin is not None and math.dist(begin.mean_mps2, window.mean_mps2) <= SAME_REST_MPS2:
                return replace(begin, is_constant=False)
            return Gravity(window.mean_mps2, "rest", self._seconds_of(window), (window.first, window.end))
        if begin is not None:
            return begin
        for window in alike:
            at_s = self._seconds_of(window)
            return Gravity(window.mean_mps2, "rest", at_s, (window.first, window.end), is_constant=True)
        if not self._has_gravity(motion.mean_mps2):
            return None
        quietest_mps2 = None if rests else min((window.rms_mps2 for window in windows.values()), default=None)
        return Gravity(
            motion.mean_mps2, "motion", samples=(motion.first, motion.end), quietest_mps2=quietest_mps2,
            tilted=bool(rests),
        )  # fmt: skip

    def _seconds_of(self, window: _Part) -> float:
        """The time of a window since the first sample that is not alone in its part, as one with a stray stamp is."""
        assert self._epoch_ns is not None  # known once there are parts
        first = next((part for part in self._parts if part.size > 1), self._parts[0])
        return 1e-9 * (self._epoch_ns + window.slot * self._part_ns - first.begin_ns)

    def _windows(self) -> dict[int, _Part]:
        """Windows without a gap, by the index of their first part."""
        found = {}
        for at in range(len(self._parts) - PARTS + 1):
            parts = self._parts[at : at + PARTS]
            sizes = [part.size for part in parts]
            follows = all(later.slot == part.slot + 1 for part, later in pairwise(parts))
            if follows and min(sizes) >= MIN_PART_SHARE * max(sizes):
                found[at] = _joined(parts)
        return found

    def _has_gravity(self, mean_mps2: Vector) -> bool:
        return gravity_and_vertical(mean_mps2, self._vertical)[1] is not None


class _Part(NamedTuple):
    """Sums of samples: first stamp, slot in time, first sample and the one after it, count, sum, sum of squares.

    is_constant: one reading is repeated in it, or in a part of it.
    """

    begin_ns: int
    slot: int
    first: int
    end: int
    size: int
    sum_mps2: Floats
    squares: float
    is_constant: bool

    @property
    def mean_mps2(self) -> Vector:
        x, y, z = (self.sum_mps2 / self.size).tolist()
        return x, y, z

    @property
    def rms_mps2(self) -> float:
        """About the mean, over all axes."""
        mean = self.sum_mps2 / self.size
        return math.sqrt(max(0.0, self.squares / self.size - float(mean @ mean)))


def _joined(parts: Sequence[_Part]) -> _Part:
    """Several stretches as one."""
    return _Part(
        parts[0].begin_ns, parts[0].slot, parts[0].first, parts[-1].end, sum(part.size for part in parts),
        np.sum([part.sum_mps2 for part in parts], axis=0), math.fsum(part.squares for part in parts),
        any(part.is_constant for part in parts),
    )  # fmt: skip


def angle_deg(one: Vector, other: Vector) -> float:
    """The angle between two directions."""
    cosine = float(np.dot(one, other)) / (math.hypot(*one) * math.hypot(*other))
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def gravity_in_rest(samples_mps2: Floats, rates_radps: Floats) -> Gravity | None:
    """The gravity of a sensor from its samples (n, 3) in a rest of its session; None where it moves or is stuck there.

    rates_radps (n, 3), NaN where none were read: their mean is the bias of the gyro, if they scatter little.
    """
    finite = samples_mps2[np.isfinite(samples_mps2).all(axis=1)]
    if len(finite) == 0:
        return None
    if not STUCK_MPS2 < float(np.sqrt(((finite - finite.mean(axis=0)) ** 2).sum(axis=1).mean())) <= IDLING_MPS2:
        return None
    read = rates_radps[np.isfinite(rates_radps).all(axis=1)]
    is_still = len(read) > 0 and bool((read.std(axis=0) < MAX_RATE_SCATTER_RADPS).all())
    x, y, z = finite.mean(axis=0).tolist()
    bias = tuple(read.mean(axis=0).tolist()) if is_still else None
    return Gravity((x, y, z), "session", rates_radps=bias)


def of_session(whole: Gravity) -> Gravity:
    """The gravity of a sensor in a part of a session, from the search in the whole."""
    return replace(whole, origin="motion" if whole.origin == "motion" else "session", samples=None)


def from_other_record(own: Gravity, others: Iterable[tuple[str, Gravity]]) -> Gravity:
    """The gravity of a sensor without rest, from its rest in another record with the same mounting.

    others: (name of the record, gravity there). The nearest mean is the result, without one the own mean over motion.
    """
    if own.origin != "motion":
        return own
    rested = [(math.dist(own.mean_mps2, other.mean_mps2), name, other) for name, other in others if other.is_rest]
    apart_mps2, name, nearest = min(rested, key=lambda each: each[0], default=(math.inf, "", own))
    if apart_mps2 > SAME_MOUNTING_MPS2:
        return own
    return replace(own, mean_mps2=nearest.mean_mps2, origin="other_record", samples=None, source=name, tilted=False)
