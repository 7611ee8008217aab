"""Gravity search: the rest of one sensor anywhere in a whole record, searched for before conditioning.

A live sensor waits for rest, and its samples until then are not counted. Offline, rest may be anywhere in the record,
and conditioning begins at the first sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import (
    MAX_TILT_DEG,
    SAME_MOUNTING_MPS2,
    SAME_REST_MPS2,
    STUCK_MPS2,
    Gravity,
    angle_deg,
)
from biodyn_core.conditioning.rest import RestWindow
from biodyn_core.conditioning.tilt import Vector, gravity_and_vertical, is_gravity
from biodyn_core.kernels import sensor as kernel

LONE_STAMPS: Final = 10
"""A part of a record with fewer samples, before all others, has stray stamps."""

PARTS: Final = 4
"""A window at rest may begin at any of so many parts of its length, so that a rest of less than two is found."""

MIN_PART_SHARE: Final = 0.75
"""The parts of a window hold about equally many samples: a part below this share of the largest has a gap."""


class GravitySearch:
    """`push` the samples of one sensor in order of arrival until it is `decided`, then read the `result`.

    Rest at the start is found as live. Else the result is the first window at rest with the mounting of the motion.
    Memory grows by a row for each quarter of rest_s. settings: of the sensor. vertical (3,): the direction of up in the
    sensor's axes, if it is given.
    """

    def __init__(self, settings: ConditioningSettings | None = None, vertical: Vector | None = None) -> None:
        s = settings or ConditioningSettings()
        self._rest_rms_mps2, self._implausible_mps2 = s.rest_rms_mps2, kernel.IMPLAUSIBLE * s.saturation_mps2
        self._vertical = vertical
        self._first_window: RestWindow | None = RestWindow(
            s.rest_s, 0.0, s.rest_rms_mps2, s.max_gap_s, self._implausible_mps2
        )
        self._part_ns = round(1e9 * s.rest_s / PARTS)
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

        A sensor that repeats one reading is stuck, or too coarse to show its noise. It is at rest if it returns to this
        reading after changes, unless a rest with noise is nearer to the mean over motion. Without any other rest, the
        reading is taken at the start of the record, or near the mean over motion.
        """
        windows = self._windows()
        quiet = [at for at, window in windows.items() if window.rms_mps2 <= self._rest_rms_mps2]
        resting = {at + k for at in quiet for k in range(PARTS)}
        moving = [part for at, part in enumerate(self._parts) if at not in resting]
        if not self._parts:
            return self._constant_at_begin
        motion = _joined(moving or self._parts)
        rests = [windows[at] for at in quiet if self._has_gravity(windows[at].mean_mps2)]
        alike = [one for one in rests if angle_deg(one.mean_mps2, motion.mean_mps2) <= MAX_TILT_DEG]
        if (found := self._rest_among(alike, motion)) is not None:
            return found
        if not self._has_gravity(motion.mean_mps2):
            return None
        quietest_mps2 = None if rests else min((window.rms_mps2 for window in windows.values()), default=None)
        stuck_at_s = self._seconds_of(alike[0]) if alike else None
        return Gravity(
            motion.mean_mps2, "motion", samples=(motion.first, motion.end), quietest_mps2=quietest_mps2,
            tilted=bool(rests) and not alike, stuck_at_s=stuck_at_s,
        )  # fmt: skip

    def _rest_among(self, alike: Sequence[_Part], motion: _Part) -> Gravity | None:
        """The rest by windows with the mounting of the motion; None without any that is plausible."""
        with_noise = next((self._at(one) for one in alike if not one.is_constant), None)
        repeated = self._repeated(alike)
        if with_noise is not None and repeated is not None:
            if math.dist(repeated.mean_mps2, with_noise.mean_mps2) <= SAME_REST_MPS2:
                first = repeated if repeated.origin == "begin" else with_noise
                return replace(first, is_constant=False, stuck_at_s=repeated.stuck_at_s)
            if repeated.is_constant or not _is_nearer(repeated, with_noise, motion):
                return replace(with_noise, stuck_at_s=repeated.at_s)
            return repeated
        near = (one for one in alike if math.dist(one.mean_mps2, motion.mean_mps2) <= SAME_MOUNTING_MPS2)
        likely = next((replace(self._at(one), is_constant=True) for one in near), None)
        return with_noise or repeated or likely

    def _repeated(self, rests: Sequence[_Part]) -> Gravity | None:
        """A rest whose reading the sensor repeats and returns to, the first one; else that at the begin."""
        begin = self._constant_at_begin
        returns = _Returns([part for part in self._parts if not part.is_constant], rests)
        if begin is not None and returns.to(begin.mean_mps2, 0):
            return replace(begin, is_constant=False)
        tested: Vector | None = None
        for window in (one for one in rests if one.rms_mps2 <= STUCK_MPS2):
            # Of the windows with one reading the first is enough.
            if tested is not None and math.dist(window.mean_mps2, tested) <= STUCK_MPS2:
                continue
            tested = window.mean_mps2
            # A steady acceleration upwards returns too, but is no gravity.
            if is_gravity(math.hypot(*tested)) and returns.to(tested, window.end):
                return self._at(window) if begin is None else replace(self._at(window), stuck_at_s=0.0)
        return begin

    def _at(self, window: _Part) -> Gravity:
        return Gravity(window.mean_mps2, "rest", self._seconds_of(window), (window.first, window.end))

    def _seconds_of(self, window: _Part) -> float:
        """The time of a window since the first part whose stamps are not stray."""
        assert self._epoch_ns is not None  # known once there are parts
        first = next((part for part in self._parts if part.size >= LONE_STAMPS), self._parts[0])
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


def _is_nearer(one: Gravity, other: Gravity, motion: _Part) -> bool:
    """Whether a rest is nearer than another one to the mean over motion."""
    return math.dist(one.mean_mps2, motion.mean_mps2) < math.dist(other.mean_mps2, motion.mean_mps2)


class _Returns:
    """Whether a sensor returns `to` a reading: a stuck one does not."""

    def __init__(self, changing: Sequence[_Part], rests: Sequence[_Part]) -> None:
        self._changing_firsts = np.array([part.first for part in changing], dtype=np.int64)
        self._changing_ends = np.array([part.end for part in changing], dtype=np.int64)
        self._firsts = np.array([rest.first for rest in rests], dtype=np.int64)
        self._means = np.array([rest.mean_mps2 for rest in rests]).reshape(-1, 3)

    def to(self, mean_mps2: Vector, end: int) -> bool:
        """Whether it rests with the same mean again, after so many samples and then as much change as a rest is long.

        A single glitch of a stuck sensor is shorter.
        """
        changed = int(np.searchsorted(self._changing_firsts, end)) + PARTS - 1
        if changed >= len(self._changing_ends):
            return False
        later = self._means[self._firsts >= self._changing_ends[changed]]
        return bool((np.linalg.norm(later - mean_mps2, axis=1) <= SAME_REST_MPS2).any())
