"""Prediction: what lives on the seat's grid, the model, its doses, and the comparison with the other sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS, N_SEGMENTS, SEGMENTS, SENSORS
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.meters import Dose, DoseMeter, Meter
from biodyn_core.exposure.sensor_meters import Batch, resume_meter
from biodyn_core.pipeline.comparison import Compared, Comparison

MOST_STRETCH_M: Final = 0.2
"""No joint of a seated body gives way so far; a chain beyond it has left the range that its laws are for."""

PEAK: Final = "seat_peak_mps2"
UNPREDICTED: Final = "unpredicted"
"""What the seat's peak, and the samples without a prediction, are kept as beside the meters."""

BEHIND_LOSS: Final = 64
"""Samples that are predicted at once behind one that was lost."""


class SeatPredictor:
    """What lives on the seat's grid: the model, the doses of its predictions, and the comparison with the sensors."""

    def __init__(self, chain: Chain, rate_hz: float, wait_s: float, window_s: float) -> None:
        self.stepper = Stepper(chain, rate_hz)
        self.divergences = 0
        self.unpredicted = 0
        self.seat_peak_mps2 = 0.0
        self.comparison = Comparison(rate_hz, wait_s, window_s)
        self.doses = DoseMeter("Wk", rate_hz, N_SEGMENTS, window_s)
        self._batch = Batch()

    def push(self, block: Block) -> Floats:
        """Predict the segments' accelerations (n, 6); each run starts from rest."""
        if block.begins_run:
            self.stepper.reset()
            self._digest(self._batch.take())
            self.doses.skip(block.gap_s)
        accel = self._predict(block.low_passed_mps2)
        self.seat_peak_mps2 = max(self.seat_peak_mps2, _peak(block.low_passed_mps2))
        self._digest(self._batch.add(accel))
        self.comparison.seat(block, accel)
        return accel

    def _predict(self, seat_mps2: Floats) -> Floats:
        """Never a wrong number as a good one: predict nothing where the chain leaves its range, and start it anew.

        Sample by sample the same as in blocks.
        """
        motion = np.empty((seat_mps2.size, 2 * N_SEGMENTS))
        accel = self.stepper.push(seat_mps2, motion)
        held = kernels.first_invalid(accel, motion, MOST_STRETCH_M)
        if held == seat_mps2.size:
            return accel
        accel[held] = np.nan
        self.stepper.reset()
        self.divergences += 1
        self.unpredicted += 1
        # What follows is integrated anew for every loss, so not too much of it at once.
        for begin in range(held + 1, seat_mps2.size, BEHIND_LOSS):
            part = slice(begin, begin + BEHIND_LOSS)
            accel[part] = self._predict(seat_mps2[part])
        return accel

    def _digest(self, rows: Floats | None) -> None:
        if rows is not None:
            self.doses.push(rows)

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._digest(self._batch.take())
        self.doses.reset()
        self.comparison.reset()
        self.unpredicted = 0
        self.seat_peak_mps2 = 0.0

    def predicted(self, rolling: bool) -> dict[str, Dose]:
        """Doses of the predictions by segment."""
        self._digest(self._batch.take())
        return dict(zip(SEGMENTS, self.doses.rolling() if rolling else self.doses.since_reset(), strict=True))

    def measured(self, rolling: bool, sensors: tuple[str, ...]) -> dict[str, Dose]:
        """Doses of what was measured, low-passed, on the same grid, for the sensors named."""
        doses = self.comparison.doses.rolling() if rolling else self.comparison.doses.since_reset()
        return {name: dose for name, dose in zip(SENSORS, doses, strict=True) if name in sensors}

    def compared(self, rolling: bool) -> dict[str, Compared]:
        """Doses of measurement and prediction over the same samples, by segment."""
        return self.comparison.compared_doses(rolling)

    def residual(self, rolling: bool) -> dict[str, tuple[float, float]]:
        """(rms m/s^2, rms over measured rms in percent) by segment, for those that were compared."""
        meter = self.comparison.residual
        rms, percent = meter.rolling() if rolling else meter.since_reset()
        pairs = zip(MEASURED_SEGMENTS, rms.tolist(), percent.tolist(), strict=True)
        return {name: (value, share) for name, value, share in pairs if not math.isnan(value)}

    def kept(self) -> dict[str, Floats]:
        """What was counted since reset: by meter, and the figures of its own."""
        self._digest(self._batch.take())
        own = {PEAK: self.seat_peak_mps2, UNPREDICTED: float(self.unpredicted)}
        meters = {name: meter.kept() for name, meter in self._meters.items()}
        return meters | {name: np.array([[value]]) for name, value in own.items()}

    def resume(self, kept: Mapping[str, Floats], gap_s: float) -> None:
        """Count on from what was kept, so long ago."""
        self._digest(self._batch.take())
        for name, meter in self._meters.items():
            if name in kept:
                resume_meter(meter, kept[name], name)
            meter.skip(gap_s)
        own = {name: float(kept[name].max(initial=0.0)) for name in (PEAK, UNPREDICTED) if name in kept}
        self.seat_peak_mps2 = max(self.seat_peak_mps2, own.get(PEAK, 0.0))
        self.unpredicted += round(own.get(UNPREDICTED, 0.0))

    @property
    def _meters(self) -> dict[str, Meter]:
        beside = self.comparison
        return {
            "predicted": self.doses, "measured": beside.doses, "residual": beside.residual, "compared": beside.compared,
        }  # fmt: skip


def _peak(values: Floats) -> float:
    """The largest magnitude; live blocks are of one sample, for which two reductions take many times as long."""
    return abs(values.item()) if values.size == 1 else float(np.abs(values).max(initial=0.0))
