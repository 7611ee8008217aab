"""Prediction: what lives on the seat's grid, the model, its doses, and the comparison with the other sensors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from biodyn_core.comparison import Comparison
from biodyn_core.conditioning import Block
from biodyn_core.exposure import Dose, DoseMeter
from biodyn_core.metering import Batch
from biodyn_core.model import Chain, Stepper
from biodyn_core.segments import MEASURED_SEGMENTS, N_SEGMENTS, SEGMENTS, SENSORS

Floats = NDArray[np.float64]


class SeatSide:
    """What lives on the seat's grid: the model, the doses of its predictions, and the comparison with the sensors."""

    def __init__(self, chain: Chain, rate_hz: float, wait_s: float, window_s: float) -> None:
        self.stepper = Stepper(chain, rate_hz)
        self.divergences = 0
        self.comparison = Comparison(rate_hz, wait_s, window_s)
        self.doses = DoseMeter("Wk", rate_hz, N_SEGMENTS, window_s)
        self._batch = Batch()

    def push(self, block: Block) -> Floats:
        """Predict the segments' accelerations (n, 6); each run starts from rest."""
        if block.begins_run:
            self.stepper.reset()
            self._digest(self._batch.take())
            self.doses.skip(block.gap_s)
        accel = self.stepper.push(block.low_passed_mps2)
        if not math.isfinite(accel[-1, 0] + accel[-1, -1]):
            self._restart_behind_divergence(block.low_passed_mps2, accel)
        self._digest(self._batch.add(accel))
        self.comparison.seat(block, accel)
        return accel

    def _digest(self, rows: Floats | None) -> None:
        if rows is not None:
            self.doses.push(rows)

    def _restart_behind_divergence(self, seat_mps2: Floats, accel: Floats) -> None:
        """Never a wrong number as a good one: predict nothing where the chain left the finite numbers, and start anew.

        Sample by sample the same as in blocks: once it has diverged, every later row of a block is not finite either.
        """
        lost: list[int] = []
        start = 0
        while not (finite := np.isfinite(accel[start:]).all(axis=1)).all():
            lost.append(start + int(np.argmin(finite)))
            start = lost[-1] + 1
            self.stepper.reset()
            accel[start:] = self.stepper.push(seat_mps2[start:])
        accel[lost] = np.nan
        self.divergences += len(lost)

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._digest(self._batch.take())
        self.doses.reset()
        self.comparison.reset()

    def predicted(self, rolling: bool) -> dict[str, Dose]:
        """Doses of the predictions by segment."""
        self._digest(self._batch.take())
        return dict(zip(SEGMENTS, self.doses.rolling() if rolling else self.doses.since_reset(), strict=True))

    def measured(self, rolling: bool, sensors: tuple[str, ...]) -> dict[str, Dose]:
        """Doses of what was measured, low-passed, on the same grid, for the sensors named."""
        doses = self.comparison.doses.rolling() if rolling else self.comparison.doses.since_reset()
        return {name: dose for name, dose in zip(SENSORS, doses, strict=True) if name in sensors}

    def residual(self, rolling: bool) -> dict[str, tuple[float, float]]:
        """(rms m/s^2, rms over measured rms in percent) by segment, for those that were compared."""
        meter = self.comparison.residual
        rms, percent = meter.rolling() if rolling else meter.since_reset()
        pairs = zip(MEASURED_SEGMENTS, rms.tolist(), percent.tolist(), strict=True)
        return {name: (value, share) for name, value, share in pairs if not math.isnan(value)}
