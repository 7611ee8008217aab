"""Rows: weighted samples of an event, and their products by window.

All decisions of a trace use them: for residuals and for changes by theta, nuisance parameters and candidates. Clock
offsets and levels of sensors, which differ between events, are removed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.settings import TypicalSettings, WeightSettings


class Rows:
    """The rows of one case: values (n, 5, k) where compared, weighted, without clock offsets and levels of this event.

    answer (n, 5) is the model's; its slope is the change by a clock offset.
    """

    def __init__(self, case: Case, answer: Floats, weights: WeightSettings, typical: TypicalSettings) -> None:
        self._begin, self._every = case.begin, max(1, round(case.rate_hz / weights.decimated_hz))
        self.rate_hz = rate_hz = case.rate_hz / self._every
        measured, compared = self.decimated(case.measured_mps2), self.decimated(case.compared)
        self._weight = np.where(compared, 1.0 / _expected(measured, compared, rate_hz, weights), 0.0)
        self._length = max(1, round(weights.counted_s * rate_hz))
        self.windows = max(1, len(measured) // self._length)
        used = compared[: self.windows * self._length].reshape(self.windows, -1)
        self.samples = used.sum(axis=1).astype(np.float64)
        self._measured = measured
        self.typical_clock_s = typical.usual_clock_s
        slope = np.gradient(self.decimated(answer), 1.0 / rate_hz, axis=0)
        # The clock has the prior of a nuisance parameter; the levels carry no information.
        spread = np.array(
            [typical.usual_clock_s * np.sqrt(weights.independent), typical.usual_level_mps2, typical.usual_level_mps2]
        )
        self._clock_s = float(spread[0])
        self._own = self._event_shapes(slope, spread)

    def __call__(self, values: Floats) -> Floats:
        """Rows (w, r, k) of values (n, 5, k), by window."""
        return self.of_decimated(self.decimated(values))

    def of_decimated(self, values: Floats) -> Floats:
        """Rows (w, r, k) of `decimated` values (m, 5, k); with many columns decimate each before they are stacked."""
        weighted = values * self._weight[:, :, None]
        for s, (shapes, solve) in enumerate(self._own):
            weighted[:, s] -= shapes @ (solve @ weighted[:, s])
        whole = weighted[: self.windows * self._length]
        return np.ascontiguousarray(whole.reshape(self.windows, -1, values.shape[2]))

    def residual(self, answer: Floats) -> Floats:
        """Rows (w, r) of the measurement less an answer (n, 5)."""
        return self.of_decimated((self._measured - self.decimated(answer))[:, :, None])[:, :, 0]

    def moving_mps2(self, parts: int) -> Floats:
        """Measured acceleration in each part of each window, rms over samples and segments, (w * parts,)."""
        whole = self._measured[: self.windows * self._length].reshape(self.windows, -1)
        each = whole.shape[1] // parts * parts
        return np.asarray(np.sqrt((whole[:, :each].reshape(self.windows * parts, -1) ** 2).mean(axis=1)))

    def decimated(self, values: NDArray[Any]) -> NDArray[Any]:
        """The samples (m, ...) of values (n, ...) that rows have."""
        return values[self._begin :: self._every]

    def _event_shapes(self, slope: Floats, spread: Floats) -> list[tuple[Floats, Floats]]:
        """Per segment, shapes (n, 3) of a clock offset, a level and a linear level, and their fit (3, n)."""
        level = np.ones(len(slope))
        growing = np.linspace(-1.0, 1.0, len(level))
        found = []
        for s in range(slope.shape[1]):
            shapes = np.column_stack([-slope[:, s], level, growing]) * self._weight[:, s, None]
            found.append((shapes, np.linalg.solve(shapes.T @ shapes + np.diag(1.0 / spread**2), shapes.T)))
        return found

    def clock_corrected(self, residual: Floats, segment: int) -> tuple[Floats, Floats]:
        """Residual rows (w, r) with the clock of one segment fitted in each window, and its delay (w,), s."""
        shape = self._own[segment][0][: self.windows * self._length, 0].reshape(self.windows, -1)
        changed = residual.reshape(self.windows, -1, len(self._own)).copy()
        energy = (shape**2).sum(axis=1)
        more_s = (shape * changed[:, :, segment]).sum(axis=1) / np.where(energy > 0.0, energy, 1.0)
        changed[:, :, segment] -= more_s[:, None] * shape
        # The event's own clock offset has been removed before.
        return changed.reshape(residual.shape), more_s + self._clock_s**2 * float(energy @ more_s)


def _expected(measured: Floats, compared: Floats, rate_hz: float, s: WeightSettings) -> Floats:
    """Expected error of a good model at each sample, rms, (n, 5)."""
    around = scipy.ndimage.uniform_filter1d(measured**2, max(1, round(s.around_s * rate_hz)), axis=0)
    whole = (measured**2).sum(axis=0) / np.maximum(compared.sum(axis=0), 1)
    return np.asarray(np.sqrt(s.noise_mps2**2 + s.local_share**2 * around + s.event_share**2 * whole))


@dataclass(frozen=True, eq=False)
class Products:
    """Sums of products by window: of columns (w, k, k), of columns and residual (w, k), of the residual (w,).

    event (w,): the number of the window's event; samples (w,): how many samples are compared in it; counted (w,):
    whether they are enough for a gain.
    """

    columns: Floats
    cross: Floats
    square: Floats
    event: Integers
    samples: Floats
    counted: Flags

    @classmethod
    def of(
        cls, columns: Sequence[Floats], residuals: Sequence[Floats], samples: Sequence[Floats], least_samples: int
    ) -> Products:
        """From the rows (w, r, k) and (w, r) of each event; a window with fewer than least_samples does not count."""
        of_windows = np.concatenate(list(samples))
        return cls(
            columns=np.concatenate([np.einsum("wri,wrj->wij", c, c, optimize=True) for c in columns]),
            cross=np.concatenate(
                [np.einsum("wri,wr->wi", c, y, optimize=True) for c, y in zip(columns, residuals, strict=True)]
            ),
            square=np.concatenate([np.einsum("wr,wr->w", y, y) for y in residuals]),
            event=np.repeat(np.arange(len(samples)), [len(one) for one in samples]),
            samples=of_windows,
            counted=of_windows >= least_samples,
        )

    def residual_square(self, b: Floats) -> Floats:
        """Sums of squares (w,) of the residual less columns times b (k,)."""
        along = np.einsum("wij,j->wi", self.columns, b)
        return np.maximum(self.square - 2.0 * self.cross @ b + along @ b, 0.0)
