"""Transfers: what one sensor of a structure shows of what another shows, learnt from a stretch of both.

Short, linear, and pulled to zero: how short and how much is what predicts either half from the other best.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import signal

from biodyn_core.base.arrays import Flags, Floats

RIDGES: Final = (1e-4, 1e-3, 1e-2, 1e-1)
"""Pulls on coefficients, in shares of each input's own power."""


def filled(values: Floats, bad: Flags) -> Floats:
    """Samples (n,) with straight lines where they are bad."""
    if not bad.any() or bad.all():
        return values
    at = np.arange(values.size)
    return np.interp(at, at[~bad], values[~bad])


def in_band(values: Floats, rate_hz: float, lowest_hz: float, highest_hz: float) -> Floats:
    """Samples (n, ...) between two frequencies, no phase."""
    sos = signal.butter(2, (lowest_hz, highest_hz), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(signal.sosfiltfilt(sos, values, axis=0))


def lagged(inputs: Floats, span: int) -> Floats:
    """Inputs (n, k) up to `span` samples late and early, (n, k (2 span + 1)); the ends wrap."""
    return np.column_stack([np.roll(inputs, late, axis=0) for late in range(-span, span + 1)])


def transfer(rows: Floats, output: Floats, keep: Flags, ridge: float) -> Floats:
    """Coefficients (m,) of rows (n, m) for an output (n,), pulled to zero by a share of each row's own power."""
    kept = rows[keep]
    power = kept.T @ kept
    # By each row's own: a gyro in rad/s is small beside accelerations, and no less worth.
    size = np.sqrt(np.maximum(np.diag(power), 1e-12 * np.diag(power).max() + 1e-300))
    alike = power / np.outer(size, size)
    return np.asarray(np.linalg.solve(alike + ridge * np.eye(len(size)), kept.T @ output[keep] / size) / size)


def window_sums(squares: Floats, keep: Flags, length: int) -> Floats:
    """Sums over whole windows (w,) of what is kept."""
    whole = squares.size // length * length
    return np.asarray(np.where(keep, squares, 0.0)[:whole].reshape(-1, length).sum(axis=1))


def percent(residual: Floats, output: Floats, keep: Flags) -> float:
    """Rms of what is left, of the rms of the output."""
    return float(100.0 * np.sqrt(np.sum(residual[keep] ** 2) / max(np.sum(output[keep] ** 2), 1e-300)))


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch in band: reference (n, k), output (n,), own axes (n, 2), what is compared (n,), a window's length."""

    rate_hz: float
    reference: Floats
    output: Floats
    own: Floats | None
    keep: Flags
    length: int

    def only(self, these: Flags) -> Stretch:
        """The same, comparing some of its samples alone."""
        return dataclasses.replace(self, keep=self.keep & these)


@dataclass(frozen=True)
class Shape:
    """How a background is learnt: samples it looks back and ahead, and the pull on its coefficients."""

    span: int
    ridge: float

    def predict(self, learnt: Stretch, other: Stretch) -> Floats:
        """What another stretch shows, (n,), by the transfer of the one it is learnt from."""
        found = transfer(lagged(learnt.reference, self.span), learnt.output, learnt.keep, self.ridge)
        return np.asarray(lagged(other.reference, self.span) @ found)


def best_shape(good: Stretch, longest_s: float) -> tuple[Shape, float]:
    """The shape, no longer than that, by which one half predicts the other best, and its error in percent."""
    most = round(longest_s * good.rate_hz)
    shapes = [Shape(span, ridge) for span in sorted({0, most // 4, most // 2, most}) for ridge in RIDGES]
    errors = [percent(good.output - across(good, shape), good.output, good.keep) for shape in shapes]
    best = int(np.argmin(errors))
    return shapes[best], errors[best]


def across(good: Stretch, shape: Shape) -> Floats:
    """What either half of a stretch shows by the transfer of the other, (n,)."""
    late = np.arange(good.output.size) >= good.output.size // 2
    return np.where(late, shape.predict(good.only(~late), good), shape.predict(good.only(late), good))
