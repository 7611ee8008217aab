"""Channels: a sensor's horizontal accelerations and angular rates, in its own levelled frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.attitude import MAX_RATE_SCATTER_RADPS
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.kernels.sensor import IMPLAUSIBLE

LARGEST_RATE_RADPS: Final = IMPLAUSIBLE * 34.9
"""Ten times 2000 deg/s is no reading of a gyro; it counts as missing, like one that is not finite."""


@dataclass(frozen=True, eq=False)
class Channels:
    """Horizontal accelerations and rates of one sensor on the seat's grid, low-passed and masked (NaN) as its vertical.

    x is the horizontal projection of the sensor's first axis, z is up, and y completes a right-handed frame; where the
    first axis is nearly vertical, y is the projection of the second. So the axes of two sensors differ by an unknown
    rotation about the vertical, and those of one sensor stay the same as long as its mounting does.
    """

    horizontal_mps2: Floats
    """(n, 2) along x and y, without the reading at rest and the slow level; a tilt during motion adds gravity."""
    rates_radps: Floats | None
    """(n, 3) about x, y and z, without the bias at rest; NaN also in a gap of the gyro alone; None without a gyro."""

    def columns(self) -> dict[str, Floats]:
        """All channels by name, such as `x` or `rate_y`, (n,) each."""
        found = {"x": self.horizontal_mps2[:, 0], "y": self.horizontal_mps2[:, 1]}
        if self.rates_radps is not None:
            found |= {f"rate_{axis}": self.rates_radps[:, i] for i, axis in enumerate("xyz")}
        return found


class Gyro:
    """One sensor's angular rates: `push` them with its samples, and read them `on` the conditioned runs.

    is_still: whether rates scattered little at rest, so that their bias is known; set by `on`.
    """

    def __init__(self) -> None:
        self._stamps: list[Integers] = []
        self._rates: list[Floats] = []
        self._usable: list[Flags] = []
        self.is_still = False

    def push(self, stamps_ns: Integers, usable: Flags, rates_radps: Floats | None) -> None:
        """Add stamps (n,) in order of arrival, flags of usable accelerations (n,), and rates (n, 3), if any."""
        rates = np.full((len(stamps_ns), 3), np.nan) if rates_radps is None else np.array(rates_radps, dtype=np.float64)
        rates[~(np.abs(rates) < LARGEST_RATE_RADPS).all(axis=1)] = np.nan
        self._stamps.append(np.array(stamps_ns, dtype=np.int64))
        self._rates.append(rates)
        self._usable.append(usable)

    def on(self, blocks: Sequence[Block], conditioner: Conditioner) -> list[Floats]:
        """Rates (n, 3) in the sensor's axes on each of its runs, without bias, NaN where none was read.

        Raises InputError without a gyro, also for a constant reading (drivers that ignore REP-145 send zeros), and
        without rates at rest.
        """
        stamps, usable = np.concatenate(self._stamps), np.concatenate(self._usable)
        rates = np.concatenate(self._rates)
        known = rates[~np.isnan(rates[:, 0])]
        if (known == known[:1]).all():
            raise InputError(f"{conditioner.sensor}: no angular rates in the record")
        bias = self._bias(rates, stamps, conditioner)
        usable[: conditioner.skipped] = False
        read = _paired(np.concatenate([block.stamps_ns for block in blocks]), stamps[usable])
        found = np.where((read >= 0)[:, None], rates[usable][read], np.nan) - bias
        return np.split(found, np.cumsum([block.time_s.size for block in blocks])[:-1])

    def _bias(self, rates: Floats, stamps: Integers, conditioner: Conditioner) -> Floats:
        """The mean rate (3,) at rest."""
        known = conditioner.gravity
        if known is not None and known.rates_radps is not None:
            self.is_still = True
            return np.array(known.rates_radps)
        at_rest = rates[_rest(stamps, conditioner)]
        at_rest = at_rest[~np.isnan(at_rest[:, 0])]
        if at_rest.size == 0:
            raise InputError(f"{conditioner.sensor}: no angular rates at rest, so their bias is unknown: left out")
        self.is_still = bool((at_rest.std(axis=0) < MAX_RATE_SCATTER_RADPS).all())
        return np.asarray(at_rest.mean(axis=0))


def interpolated(time_s: Floats, values: Floats) -> Floats:
    """Values (n, k) with linear interpolation across NaN, as for acceleration."""
    known = ~np.isnan(values).any(axis=1)
    if not known.any():
        return np.zeros_like(values)
    return np.column_stack([np.interp(time_s, time_s[known], column) for column in values[known].T])


def _rest(stamps_ns: Integers, conditioner: Conditioner) -> slice:
    """The samples of a sensor's rest by order of arrival, because time may have leapt back; they are contiguous.

    Of samples that share the first stamp, the last alone is included.
    """
    if conditioner.gravity is not None:
        begin, end = (conditioner.gravity.samples or (0, 0)) if conditioner.gravity.is_rest else (0, 0)
        return slice(begin, end)
    assert conditioner.rest is not None
    before = stamps_ns[: conditioner.skipped]
    return slice(int(np.flatnonzero(before == conditioner.rest.epoch_ns)[-1]), conditioner.skipped)


def _paired(stamps_ns: Integers, pushed_ns: Integers) -> Integers:
    """For each stamp (n,) the index of the pushed one (m,), -1 for none; equal stamps pair in order.

    Conditioning drops samples but keeps their order, and measured samples keep their stamp.
    """
    order, pushed_order = np.argsort(stamps_ns, kind="stable"), np.argsort(pushed_ns, kind="stable")
    ascending, pushed = stamps_ns[order], pushed_ns[pushed_order]
    nth = np.arange(ascending.size) - np.searchsorted(ascending, ascending)
    at = np.searchsorted(pushed, ascending) + nth
    there = np.minimum(at, pushed.size - 1)
    paired = np.empty(stamps_ns.size, dtype=np.int64)
    paired[order] = np.where((at < pushed.size) & (pushed[there] == ascending), pushed_order[there], -1)
    return paired
