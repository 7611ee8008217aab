"""Sensor meters: the exposure of one sensor, counted before the low-pass at the sensor's own rate."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import HEAD, SEAT
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.hidden_motion import HiddenMotion
from biodyn_core.exposure.injury import HIC_LENGTHS_S, Dri, DriMeter, Hic, HicMeter
from biodyn_core.exposure.meters import Dose, DoseMeter, HorizontalMeter, Meter, motion_sickness_mps15
from biodyn_core.exposure.suspect import SuspectSamples, constant_parts
from biodyn_core.exposure.tally import BIN_S
from biodyn_core.signals.weighting import WeightingName

BATCH: Final = 128
"""Least samples that are counted at once, so that a prediction does not wait for exposure. No figure depends on it."""

FIRST_LEVEL_S: Final = 2.0
"""Length of the first readings whose mean is the level that weightings of a run without a rest start from.

It is the time constant of the level of Wk and Wd (`LEVEL_SHARE`). These readings are counted late, not lost.
"""

HIDDEN: Final = "hidden"
"""The name of the stored powers that losses may hide."""

SUSPECT: Final = " (suspect)"
"""Ends the names of stored totals of suspect samples."""


class Batch:
    """Collect the rows of one run until there are `least` of them."""

    def __init__(self, least: int = BATCH) -> None:
        self.least = least
        self._rows: list[Floats] = []
        self._size = 0

    def add(self, rows: Floats) -> Floats | None:
        """Add rows (n, c); return all collected rows once they are enough."""
        self._rows.append(rows)
        self._size += rows.shape[0]
        return self.take() if self._size >= self.least else None

    def take(self) -> Floats | None:
        """Return all collected rows, None where there are none."""
        if not self._rows:
            return None
        rows = np.concatenate(self._rows)
        self._rows, self._size = [], 0
        return rows


class SensorMeters:
    """Wk for every sensor; Wd, DRI and motion sickness for the seat; HIC for the head.

    weightings: further ones of the vertical. first_axis_rad: see `HorizontalMeter`. begins_in_motion: the run does not
    follow a rest, so weightings start from the mean of the readings of the first `FIRST_LEVEL_S`, which wait for it.
    Figures are without suspect samples, except where these are asked for.

    has_level: whether weightings have a level to start from. Before it nothing of this run is counted.
    """

    def __init__(
        self,
        sensor: str,
        rate_hz: float,
        window_s: float,
        weightings: tuple[WeightingName, ...] = (),
        first_axis_rad: float = 0.0,
        begins_in_motion: bool = False,
    ) -> None:
        self.rate_hz = rate_hz
        self.has_level = not begins_in_motion
        self._batch = Batch(BATCH if self.has_level else math.ceil(FIRST_LEVEL_S * rate_hz))
        self._losses: list[Integers] = []
        self._suspects, self._follows_loss = SuspectSamples(rate_hz), begins_in_motion
        self._hidden = HiddenMotion(rate_hz)
        self._vertical = DoseMeter("Wk", rate_hz, 1, window_s)
        self._further = {name: DoseMeter(name, rate_hz, 1, window_s) for name in weightings}
        self._plane = HorizontalMeter(rate_hz, window_s, first_axis_rad) if sensor == SEAT else None
        self._dri = DriMeter(rate_hz, window_s) if sensor == SEAT else None
        self._sickness = DoseMeter("Wf", rate_hz, 1, BIN_S) if sensor == SEAT else None
        lengths_s = HIC_LENGTHS_S if sensor == HEAD else {}
        self._hics = {name: HicMeter(rate_hz, length_s, window_s) for name, length_s in lengths_s.items()}
        named = {"vertical": self._vertical, "plane": self._plane, "dri": self._dri, "sickness": self._sickness}
        further = {f"also {name}": meter for name, meter in self._further.items()}
        self._named: dict[str, Meter[Any]] = {
            name: m for name, m in (named | self._hics | further).items() if m is not None
        }
        upward = (self._vertical, *self._further.values(), self._dri, self._sickness)
        self._upward = [meter for meter in upward if meter is not None]

    def push(self, block: Block) -> None:
        """Count a block; nothing integrates across a break."""
        if block.begins_run:
            self.finish()
            for meter in self._named.values():
                meter.skip(block.gap_s)
            self._suspects.begin_run(self._follows_loss)
            self._hidden.begin_run(block.gap_s)
            self._follows_loss = True  # every later run does
        self._losses.append(block.losses)
        self._count(self._batch.add(block.levelled_mps2))

    def _count(self, rows: Floats | None) -> None:
        if rows is None:
            return
        if not self.has_level:
            self._begin(rows)
        lost = np.concatenate(self._losses)
        suspect = self._suspects.flags(rows, lost)
        self._hidden.push(np.ascontiguousarray(rows[:, 2]), lost)
        self._losses = []
        for begin, end in constant_parts(suspect):
            self._push(rows[begin:end], bool(suspect[begin]))

    def _push(self, rows: Floats, suspect: bool) -> None:
        up = np.ascontiguousarray(rows[:, 2:])
        for meter in self._upward:
            meter.push(up, suspect)
        if self._plane:
            self._plane.push(np.ascontiguousarray(rows[:, :2]), suspect)
        for hic in self._hics.values():
            hic.push(rows, suspect)

    def _begin(self, rows: Floats) -> None:
        """Start the weightings from the level of the first rows."""
        first = rows[: self._batch.least]
        self.has_level, self._batch.least = True, BATCH
        self._suspects.begin_level(first)
        for meter in self._upward:
            if isinstance(meter, DoseMeter):
                meter.begin(first[:, 2:])
        if self._plane:
            self._plane.begin(first[:, :2])

    def finish(self) -> None:
        """Count the rows that wait, at the end of the run."""
        self._count(self._batch.take())

    def _count_batch(self) -> None:
        """Count the rows that wait, before a figure is read; the first ones wait until they show the level."""
        if self.has_level:
            self.finish()

    def vertical(self, rolling: bool = False) -> Dose:
        """The vertical, Wk."""
        self._count_batch()
        return (self._vertical.rolling() if rolling else self._vertical.since_reset())[0]

    def vertical_with_suspect(self, with_hidden: bool = False) -> Dose:
        """The vertical since reset, Wk, with suspect samples, and with what losses may hide (`hidden_motion`)."""
        self._count_batch()
        dose = self._vertical.with_suspect()[0]
        if not with_hidden:
            return dose
        second, fourth = self._hidden.powers
        return dataclasses.replace(
            dose,
            aw_mps2=math.sqrt(dose.aw_mps2**2 + second / max(dose.seconds, 1.0 / self.rate_hz)),
            vdv_mps175=(dose.vdv_mps175**4 + fourth) ** 0.25,
        )

    def suspect_s(self, rolling: bool = False) -> float:
        """Seconds of suspect samples, which count in no figure except their time."""
        self._count_batch()
        return float(self._vertical.suspect_samples(rolling)[0]) / self.rate_hz

    def has_sure_samples(self, rolling: bool = False) -> bool:
        """Whether there are counted samples that are not suspect."""
        return self.vertical(rolling).seconds > self.suspect_s(rolling)

    def further(self, rolling: bool = False) -> dict[str, Dose]:
        """The vertical, by further weighting."""
        self._count_batch()
        return {name: (m.rolling() if rolling else m.since_reset())[0] for name, m in self._further.items()}

    def plane(self) -> HorizontalMeter:
        """The seat's horizontal plane, Wd."""
        self._count_batch()
        assert self._plane is not None
        return self._plane

    def dri(self, rolling: bool) -> Dri:
        """The seat's dynamic response."""
        self._count_batch()
        assert self._dri is not None
        return self._dri.rolling() if rolling else self._dri.since_reset()

    def msdv_mps15(self) -> float | None:
        """The seat's motion sickness dose since reset, None while the record is too short for one."""
        self._count_batch()
        assert self._sickness is not None
        return motion_sickness_mps15(self._sickness.since_reset()[0])

    def hic(self, name: str, rolling: bool) -> Hic:
        """The head's injury criterion of a name in `HIC_LENGTHS_S`."""
        self._count_batch()
        return self._hics[name].rolling() if rolling else self._hics[name].since_reset()

    def end_window(self, absent_s: float) -> None:
        """Let rolling figures end so long after the last sample: it is absent, and the window moves on."""
        for meter in self._named.values():
            meter.end_window(absent_s)

    def reset(self) -> None:
        """Set everything "since reset" to zero; first readings that still wait are dropped."""
        if not self.has_level:
            self._batch.take()
            self._losses = []
        self._count_batch()
        self._hidden.reset()
        for meter in self._named.values():
            meter.reset()

    def totals(self) -> dict[str, Floats]:
        """The totals since reset, by meter, without first readings that still wait."""
        self._count_batch()
        hidden = self._hidden.totals()
        return stored_totals(self._named) | ({HIDDEN: hidden} if hidden.any() else {})

    def resume(self, totals: Mapping[str, Floats], break_s: float) -> None:
        """Continue from totals of an earlier run, after a break; raises InputError for totals that do not fit."""
        self._count_batch()
        for name, meter in self._named.items():
            resume_meter(meter, totals, name)
            meter.skip(break_s)
        if (hidden := totals.get(HIDDEN)) is not None:
            if hidden.shape != (1, 2) or hidden.min() < 0.0:
                raise InputError(f"{HIDDEN}: the stored totals are not two sums of powers")
            self._hidden.resume(hidden)
        self._follows_loss = True


def stored_totals(meters: Mapping[str, Meter[Any]]) -> dict[str, Floats]:
    """The totals since reset by the names of the meters; those of suspect samples, where there are any, beside them."""
    totals = {name: meter.totals() for name, meter in meters.items()}
    suspect = {f"{name}{SUSPECT}": meter.suspect_totals() for name, meter in meters.items()}
    return totals | {name: rows for name, rows in suspect.items() if rows.any()}


def resume_meter(meter: Meter[Any], stored: Mapping[str, Floats], name: str) -> None:
    """Continue a meter from `stored_totals`; raises InputError where shape or values are not a meter's of this name."""
    for key, resume, own in (
        (name, meter.resume, meter.totals()),
        (f"{name}{SUSPECT}", meter.resume_suspect, meter.suspect_totals()),
    ):
        if (totals := stored.get(key)) is None:
            continue
        if totals.shape != own.shape:
            raise InputError(f"{key}: the stored totals have shape {totals.shape}, {own.shape} is needed")
        try:
            resume(totals)
        except InputError as error:
            raise InputError(f"{key}: {error}") from None
