"""Removes rows without a measurement from a low-g channel: rows of zeros, rows faded into zeros, unreadable rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_ros.blue_trident.samples import Samples, joined

MAX_PLAUSIBLE_MPS2: Final = 1e5
"""Larger values, ten thousand g, are not measurements."""

FADED: Final = 0.97
ALIKE: Final = 0.05
"""A row is faded if field and acceleration are reduced by the same factor, within this, below `FADED` of their
neighbours: Nexus resamples, and mixes the first or last sample of a sensor with zeros."""


@dataclass
class OmittedRows:
    """Omitted rows by cause: zeros before the start, during the recording, after the end; faded; unreadable."""

    late_start: int = 0
    dropouts: int = 0
    early_end: int = 0
    faded: int = 0
    unreadable: int = 0


class Cleaner:
    """`push` samples of the file and get the measured ones; `finish` gives the last one."""

    def __init__(self) -> None:
        self.omitted = OmittedRows()
        self._before: Samples | None = None
        self._waiting: Samples | None = None
        self._begun = False
        self._zeros = 0

    def push(self, samples: Samples) -> Samples:
        """Add a block; the last row is kept, because the next row decides whether it is faded."""
        usable = (np.abs(samples.accel_mps2) < MAX_PLAUSIBLE_MPS2).all(axis=1)
        self.omitted.unreadable += int((~usable).sum())
        samples = samples if usable.all() else samples.rows(usable)
        if not len(samples.stamps_ns):
            return samples
        if self._waiting is not None:
            samples = joined(self._waiting, samples)
        self._waiting = samples.rows(slice(len(samples.stamps_ns) - 1, None))
        return self._decide(samples, 1)

    def finish(self) -> Samples | None:
        """Return the last row, if it is measured, and count the zeros at the end."""
        last = None if self._waiting is None else self._decide(self._waiting, 0)
        self.omitted.early_end, self._zeros = (self._zeros, 0) if self._begun else (0, self._zeros)
        self.omitted.late_start += self._zeros
        return last

    def _decide(self, samples: Samples, ahead: int) -> Samples:
        """The measured samples without the last `ahead`, which are only compared."""
        known = 0 if self._before is None else 1
        seen = samples if self._before is None else joined(self._before, samples)
        zero = _zeros(seen)
        faded = _faded(seen, zero, at_start=not known, at_end=not ahead)
        upto = len(zero) - ahead
        if upto > 0:
            self._before = seen.rows(slice(upto - 1, upto))
        decided = slice(known, upto)
        self._count(zero[decided])
        good = ~zero[decided] & ~faded[decided]
        self.omitted.faded += int(faded[decided].sum())
        part = seen.rows(decided)
        return part if good.all() else part.rows(good)

    def _count(self, zero: Flags) -> None:
        measured = np.flatnonzero(~zero)
        if not measured.size:
            self._zeros += int(zero.sum())
            return
        before = self._zeros + int(measured[0])
        amid = int(zero[measured[0] : measured[-1]].sum())
        if self._begun:
            self.omitted.dropouts += before + amid
        else:
            self.omitted.late_start += before
            self.omitted.dropouts += amid
        self._begun, self._zeros = True, zero.size - 1 - int(measured[-1])


def _zeros(samples: Samples) -> Flags:
    """Rows that are exactly zero; a sensor that measures has noise."""
    zero: Flags = (samples.accel_mps2 == 0.0).all(axis=1)
    if samples.gyro_radps is not None:
        zero &= (samples.gyro_radps == 0.0).all(axis=1)
    return zero


def _faded(samples: Samples, zero: Flags, at_start: bool, at_end: bool) -> Flags:
    """Rows beside zeros, or at an end of the file, that are a fraction of their other neighbour."""
    if samples.mag is None:
        return np.zeros(zero.shape, dtype=bool)
    field, accel = (np.linalg.norm(part, axis=1) for part in (samples.mag, samples.accel_mps2))
    zero_before = np.concatenate([[at_start], zero[:-1]])
    zero_after = np.concatenate([zero[1:], [at_end]])
    faded = zero_after & ~zero_before & _share(field, accel, np.roll(field, 1), np.roll(accel, 1))
    faded |= zero_before & ~zero_after & _share(field, accel, np.roll(field, -1), np.roll(accel, -1))
    return faded & ~zero


def _share(field: Floats, accel: Floats, fields: Floats, accels: Floats) -> Flags:
    with np.errstate(all="ignore"):
        of_field, of_accel = field / fields, accel / accels
        return (of_field < FADED) & (of_accel < FADED) & (np.abs(of_field - of_accel) < ALIKE)
