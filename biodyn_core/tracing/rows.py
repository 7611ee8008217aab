"""Rows: what is compared in an event, thinned and weighted, and products of it window by window.

Everything a trace decides, it decides from these: residuals, what theta and the usual departures would change, what
candidates would. Sensors' clocks and levels, which differ from event to event, are taken off here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.settings import UsualSettings, WeightSettings

THINNED_HZ: Final = 280.0
"""All channels are low-passed at 100 Hz: closer samples say nothing new."""

LOCAL_S: Final = 0.5
"""Over which the size of the motion is taken that a sample's weight goes by."""


class Rows:
    """The rows of one case: of any values (n, 5, k) those compared, weighted, without this event's clocks and levels.

    answer (n, 5) is the model's, whose slope says what a clock that is off would change.
    """

    def __init__(self, case: Case, answer: Floats, weights: WeightSettings, usual: UsualSettings) -> None:
        self._begin, self._every = case.begin, max(1, round(case.rate_hz / THINNED_HZ))
        self.rate_hz = rate_hz = case.rate_hz / self._every
        measured, compared = self._thinned(case.measured_mps2), self._thinned(case.compared)
        self._weight = np.where(compared, 1.0 / _expected(measured, compared, rate_hz, weights), 0.0)
        self._length = max(1, round(weights.counted_s * rate_hz))
        self.windows = max(1, len(measured) // self._length)
        used = compared[: self.windows * self._length].reshape(self.windows, -1)
        self.samples = used.sum(axis=1).astype(np.float64)
        self._measured = measured
        self.usual_clock_s = usual.usual_clock_s
        slope = np.gradient(self._thinned(answer), 1.0 / rate_hz, axis=0)
        # A clock is one usual departure more, and weighed against the prior as those are; a level is nobody's news.
        spread = np.array(
            [usual.usual_clock_s * np.sqrt(weights.independent), usual.usual_level_mps2, usual.usual_level_mps2]
        )
        self._clock_s = float(spread[0])
        self._own = self._of_event(slope, spread)

    def __call__(self, values: Floats) -> Floats:
        """Rows (w, r, k) of values (n, 5, k), by window."""
        thinned = self._thinned(values) * self._weight[:, :, None]
        for s, (shapes, taken) in enumerate(self._own):
            thinned[:, s] -= shapes @ (taken @ thinned[:, s])
        whole = thinned[: self.windows * self._length]
        return np.ascontiguousarray(whole.reshape(self.windows, -1, values.shape[2]))

    def missed(self, answer: Floats) -> Floats:
        """Rows (w, r) of the measurement less an answer (n, 5)."""
        whole = np.zeros((len(answer), answer.shape[1], 1))
        whole[self._begin :: self._every, :, 0] = self._measured - self._thinned(answer)
        return self(whole)[:, :, 0]

    def moving_mps2(self, parts: int) -> Floats:
        """How much is measured in each of so many parts of each window, rms over segments, (w * parts,)."""
        whole = self._measured[: self.windows * self._length].reshape(self.windows, -1)
        each = whole.shape[1] // parts * parts
        return np.asarray(np.sqrt((whole[:, :each].reshape(self.windows * parts, -1) ** 2).mean(axis=1)))

    def _thinned(self, values: NDArray[Any]) -> NDArray[Any]:
        return values[self._begin :: self._every]

    def _of_event(self, slope: Floats, spread: Floats) -> list[tuple[Floats, Floats]]:
        """Per segment, shapes (n, 3) of a late clock, a level and a growing level, and what takes them off (3, n)."""
        there = np.ones(len(slope))
        growing = np.linspace(-1.0, 1.0, len(there))
        found = []
        for s in range(slope.shape[1]):
            shapes = np.column_stack([-slope[:, s], there, growing]) * self._weight[:, s, None]
            found.append((shapes, np.linalg.solve(shapes.T @ shapes + np.diag(1.0 / spread**2), shapes.T)))
        return found

    def on_time(self, left: Floats, segment: int) -> tuple[Floats, Floats]:
        """Rows (w, r) of what is left once one segment's clock is set in each window, and how late it was, (w,) s."""
        shape = self._own[segment][0][: self.windows * self._length, 0].reshape(self.windows, -1)
        changed = left.reshape(self.windows, -1, len(self._own)).copy()
        energy = (shape**2).sum(axis=1)
        more_s = (shape * changed[:, :, segment]).sum(axis=1) / np.where(energy > 0.0, energy, 1.0)
        changed[:, :, segment] -= more_s[:, None] * shape
        # What the usual spread allows of their mean has been taken off the whole event before.
        return changed.reshape(left.shape), more_s + self._clock_s**2 * float(energy @ more_s)


def _expected(measured: Floats, compared: Floats, rate_hz: float, s: WeightSettings) -> Floats:
    """What a good model still misses of each sample, rms, (n, 5)."""
    around = ndimage.uniform_filter1d(measured**2, max(1, round(LOCAL_S * rate_hz)), axis=0)
    whole = (measured**2).sum(axis=0) / np.maximum(compared.sum(axis=0), 1)
    return np.asarray(np.sqrt(s.noise_mps2**2 + s.local_share**2 * around + s.event_share**2 * whole))


@dataclass(frozen=True, eq=False)
class Products:
    """Sums of products over the rows of windows: of columns (w, k, k), with the miss (w, k), of the miss (w,).

    event (w,) numbers the event a window is of; samples (w,) are how many are compared in it.
    """

    columns: Floats
    miss: Floats
    square: Floats
    event: Integers
    samples: Floats

    @classmethod
    def of(cls, columns: Sequence[Floats], missed: Sequence[Floats], samples: Sequence[Floats]) -> Products:
        """From the rows (w, r, k) and (w, r) of each event."""
        return cls(
            columns=np.concatenate([np.einsum("wri,wrj->wij", c, c, optimize=True) for c in columns]),
            miss=np.concatenate(
                [np.einsum("wri,wr->wi", c, y, optimize=True) for c, y in zip(columns, missed, strict=True)]
            ),
            square=np.concatenate([np.einsum("wr,wr->w", y, y) for y in missed]),
            event=np.repeat(np.arange(len(samples)), [len(one) for one in samples]),
            samples=np.concatenate(list(samples)),
        )

    def left(self, b: Floats) -> Floats:
        """What columns times b (k,) leave of the miss, sums of squares (w,)."""
        along = np.einsum("wij,j->wi", self.columns, b)
        return np.maximum(self.square - 2.0 * self.miss @ b + along @ b, 0.0)
