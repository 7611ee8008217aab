"""Metering: one sensor's exposure, measured before the low-pass at the sensor's own rate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import HEAD, SEAT
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.injury import HIC_LENGTHS_S, Dri, DriMeter, Hic, HicMeter
from biodyn_core.exposure.meters import BIN_S, Dose, DoseMeter, HorizontalMeter, Meter, motion_sickness_mps15
from biodyn_core.signals.weighting import WeightingName

BATCH: Final = 128
"""Exposure is counted in batches of at least so many samples, predictions come first. No figure depends on it."""


class Batch:
    """Gathers rows of one run until there are enough of them to be counted."""

    def __init__(self) -> None:
        self._rows: list[Floats] = []
        self._size = 0

    def add(self, rows: Floats) -> Floats | None:
        """Add rows (n, c); returns what has gathered once it is enough."""
        self._rows.append(rows)
        self._size += rows.shape[0]
        return self.take() if self._size >= BATCH else None

    def take(self) -> Floats | None:
        """Hand out what has gathered, None where that is nothing."""
        if not self._rows:
            return None
        rows = np.concatenate(self._rows)
        self._rows, self._size = [], 0
        return rows


class SensorMeters:
    """Wk for every sensor, Wd, DRI and motion sickness for the seat, HIC for the head, and what else was asked for.

    first_axis_rad: see `HorizontalMeter`.
    """

    def __init__(
        self,
        sensor: str,
        rate_hz: float,
        window_s: float,
        also: tuple[WeightingName, ...] = (),
        first_axis_rad: float = 0.0,
    ) -> None:
        self.rate_hz = rate_hz
        self._batch = Batch()
        self._vertical = DoseMeter("Wk", rate_hz, 1, window_s)
        self._also = {name: DoseMeter(name, rate_hz, 1, window_s) for name in also}
        self._plane = HorizontalMeter(rate_hz, window_s, first_axis_rad) if sensor == SEAT else None
        self._dri = DriMeter(rate_hz, window_s) if sensor == SEAT else None
        self._sickness = DoseMeter("Wf", rate_hz, 1, BIN_S) if sensor == SEAT else None
        lengths_s = HIC_LENGTHS_S if sensor == HEAD else {}
        self._hics = {name: HicMeter(rate_hz, length_s, window_s) for name, length_s in lengths_s.items()}
        named = {"vertical": self._vertical, "plane": self._plane, "dri": self._dri, "sickness": self._sickness}
        further = {f"also {name}": meter for name, meter in self._also.items()}
        self._named: dict[str, Meter] = {name: m for name, m in (named | self._hics | further).items() if m is not None}
        upward = (self._vertical, *self._also.values(), self._dri, self._sickness)
        self._upward = [meter for meter in upward if meter is not None]

    def push(self, block: Block) -> None:
        """Count a block; nothing integrates across a break."""
        if block.begins_run:
            self._settle()
            for meter in self._named.values():
                meter.skip(block.gap_s)
        self._digest(self._batch.add(block.levelled_mps2))

    def _digest(self, rows: Floats | None) -> None:
        if rows is None:
            return
        up = np.ascontiguousarray(rows[:, 2:])
        for meter in self._upward:
            meter.push(up)
        if self._plane:
            self._plane.push(np.ascontiguousarray(rows[:, :2]))
        for hic in self._hics.values():
            hic.push(rows)

    def _settle(self) -> None:
        self._digest(self._batch.take())

    def vertical(self, rolling: bool = False) -> Dose:
        """The vertical, Wk."""
        self._settle()
        return (self._vertical.rolling() if rolling else self._vertical.since_reset())[0]

    def also(self, rolling: bool = False) -> dict[str, Dose]:
        """The vertical by the further weightings."""
        self._settle()
        return {name: (m.rolling() if rolling else m.since_reset())[0] for name, m in self._also.items()}

    def plane(self) -> HorizontalMeter:
        """The seat's horizontal plane, Wd."""
        self._settle()
        assert self._plane is not None
        return self._plane

    def dri(self, rolling: bool) -> Dri:
        """The seat's dynamic response."""
        self._settle()
        assert self._dri is not None
        return self._dri.rolling() if rolling else self._dri.since_reset()

    def msdv_mps15(self) -> float | None:
        """The seat's motion sickness dose since reset, None while the record is too short for one."""
        self._settle()
        assert self._sickness is not None
        return motion_sickness_mps15(self._sickness.since_reset()[0])

    def hic(self, name: str, rolling: bool) -> Hic:
        """The head's injury criterion of a name in `HIC_LENGTHS_S`."""
        self._settle()
        return self._hics[name].rolling() if rolling else self._hics[name].since_reset()

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._settle()
        for meter in self._named.values():
            meter.reset()

    def kept(self) -> dict[str, Floats]:
        """What was counted since reset, by meter."""
        self._settle()
        return {name: meter.kept() for name, meter in self._named.items()}

    def resume(self, kept: Mapping[str, Floats], gap_s: float) -> None:
        """Count on from what was kept, so long ago; raises InputError for rows that no meter of this name has."""
        self._settle()
        for name, meter in self._named.items():
            if name in kept:
                resume_meter(meter, kept[name], name)
            meter.skip(gap_s)


def resume_meter(meter: Meter, kept: Floats, name: str) -> None:
    """Let a meter go on from what was kept; raises InputError where its rows are another meter's, or nobody's."""
    if kept.shape != meter.kept().shape:
        raise InputError(f"{name}: kept as {kept.shape}, {meter.kept().shape} are needed")
    try:
        meter.resume(kept)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
