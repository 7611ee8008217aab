"""Transfers: the response of one sensor of a structure to another, estimated from a stretch of both.

A short FIR filter with a ridge. Its length and ridge give the best prediction of each half of the stretch by the other.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats

RIDGES: Final = (1e-4, 1e-3, 1e-2, 1e-1)
"""Ridges, in shares of each input's power."""


def filled(values: Floats, bad: Flags) -> Floats:
    """Samples (n,) with straight lines where they are bad."""
    if not bad.any() or bad.all():
        return values
    at = np.arange(values.size)
    return np.interp(at, at[~bad], values[~bad])


def in_band(values: Floats, rate_hz: float, lowest_hz: float, highest_hz: float) -> Floats:
    """Samples (n, ...) between two frequencies, no phase."""
    sos = scipy.signal.butter(2, (lowest_hz, highest_hz), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(scipy.signal.sosfiltfilt(sos, values, axis=0))


def lagged(inputs: Floats, span: int) -> Floats:
    """Inputs (n, k) up to `span` samples late and early, (n, k (2 span + 1)); the ends wrap."""
    return np.column_stack([np.roll(inputs, late, axis=0) for late in range(-span, span + 1)])


def transfer(rows: Floats, output: Floats, keep: Flags, ridge: float) -> Floats:
    """Coefficients (m,) of rows (n, m) for an output (n,), with a ridge relative to each row's power."""
    kept = rows[keep]
    power = kept.T @ kept
    # Relative, because a gyro in rad/s has smaller values than accelerations.
    size = np.sqrt(np.maximum(np.diag(power), 1e-12 * np.diag(power).max() + 1e-300))
    alike = power / np.outer(size, size)
    return np.asarray(np.linalg.solve(alike + ridge * np.eye(len(size)), kept.T @ output[keep] / size) / size)


def window_sums(squares: Floats, keep: Flags, length: int) -> Floats:
    """Sums over whole windows (w,) of kept samples."""
    whole = squares.size // length * length
    return np.asarray(np.where(keep, squares, 0.0)[:whole].reshape(-1, length).sum(axis=1))


def percent(residual: Floats, output: Floats, keep: Flags) -> float:
    """Rms of the residual in percent of the rms of the output."""
    return float(100.0 * np.sqrt(np.sum(residual[keep] ** 2) / max(np.sum(output[keep] ** 2), 1e-300)))


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch in band: reference (n, k), output (n,), own axes (n, 2), mask (n,), length of a window in samples."""

    rate_hz: float
    reference: Floats
    output: Floats
    own: Floats | None
    keep: Flags
    length: int

    def only(self, these: Flags) -> Stretch:
        """The same with a smaller mask."""
        return dataclasses.replace(self, keep=self.keep & these)


@dataclass(frozen=True)
class Shape:
    """A background filter: samples before and after, and the ridge."""

    span: int
    ridge: float

    def predict(self, learnt: Stretch, other: Stretch) -> Floats:
        """The prediction (n,) for another stretch by the transfer of the learnt one."""
        found = transfer(lagged(learnt.reference, self.span), learnt.output, learnt.keep, self.ridge)
        return np.asarray(lagged(other.reference, self.span) @ found)


def best_shape(good: Stretch, longest_s: float) -> tuple[Shape, float]:
    """The best shape up to a length, by the prediction of each half from the other, and its error in percent."""
    most = round(longest_s * good.rate_hz)
    shapes = [Shape(span, ridge) for span in sorted({0, most // 4, most // 2, most}) for ridge in RIDGES]
    errors = [percent(good.output - across(good, shape), good.output, good.keep) for shape in shapes]
    best = int(np.argmin(errors))
    return shapes[best], errors[best]


def across(good: Stretch, shape: Shape) -> Floats:
    """The prediction (n,) of each half of a stretch by the transfer of the other."""
    late = np.arange(good.output.size) >= good.output.size // 2
    return np.where(late, shape.predict(good.only(~late), good), shape.predict(good.only(late), good))
