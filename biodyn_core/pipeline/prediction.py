"""Prediction: the model on the seat's time grid, the doses of its predictions, and the comparison with the sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS, N_SEGMENTS, SEGMENTS, SENSORS
from biodyn_core.body.model import MOTION_COLUMNS, WARM_UP_S, Chain, Stepper, parts_of_motion
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.joint_forces import JointForce, JointForceMeter
from biodyn_core.exposure.meters import Dose, DoseMeter, Meter
from biodyn_core.exposure.sensor_meters import Batch, resume_meter, stored_totals
from biodyn_core.exposure.suspect import SuspectSamples, constant_parts
from biodyn_core.pipeline.comparison import Comparison
from biodyn_core.pipeline.intervals import IntervalEstimator, PredictionSpread, SegmentSpread

MAX_STRETCH_M: Final = 0.2
"""No joint of a seated body deforms so far; a chain beyond it has left the range of its laws."""

PEAK: Final = "seat_peak_mps2"
UNPREDICTED: Final = "unpredicted"
"""Names of the seat's peak, and of the samples without a counted prediction, among the totals of the meters."""

FEW: Final = 16
"""Up to so many samples a reduction by NumPy takes longer than one by Python."""

BLOCK_AFTER_DIVERGENCE: Final = 64
"""Samples that are predicted at once after a divergence."""


class SeatPredictor:
    """Predict the segments from the seat, count the predictions, and feed the comparison.

    The chain begins from rest after each gap and each divergence. Until it has settled (`WARM_UP_S`), its predictions
    are returned, but neither counted nor compared. Those of suspect samples are in no figure either (`suspect`),
    because the chain follows the straight line over a loss too. begins_at_rest: whether the first run does.
    divergences: samples at which the model left its range; unpredicted: samples since reset that are not counted.
    intervals: None without a spread of the predictions.
    """

    def __init__(
        self,
        chain: Chain,
        rate_hz: float,
        wait_s: float,
        window_s: float,
        spread: PredictionSpread | None = None,
        begins_at_rest: bool = True,
    ) -> None:
        self._rate_hz, self.stepper = rate_hz, Stepper(chain, rate_hz)
        self.divergences = 0
        self.unpredicted = 0
        self.seat_peak_mps2 = 0.0
        self.comparison = Comparison(rate_hz, wait_s, window_s)
        self.doses = DoseMeter("Wk", rate_hz, N_SEGMENTS, window_s, np.arange(N_SEGMENTS))
        # Forces under `cascade` would be those of a body three times as heavy.
        self.forces = JointForceMeter(rate_hz, N_SEGMENTS, window_s) if chain.mass_matrix_form == "segment" else None
        self.intervals = IntervalEstimator(spread, rate_hz, window_s) if spread else None
        self._accel_batch, self._force_batch = Batch(), Batch()
        self._warm_up = round(WARM_UP_S * rate_hz)
        self._unsettled = 0
        self._suspects, self._waits_suspect = SuspectSamples(rate_hz), False
        self._at_rest = begins_at_rest

    def push(self, block: Block) -> tuple[Floats, Floats]:
        """Predict the segments' accelerations (n, 6) and their motion (n, 18); each run starts from rest."""
        if block.begins_run:
            self._begin_run(block.gap_s)
        before = self.divergences
        accel, motion = self._predict(block.low_passed_mps2)
        self.seat_peak_mps2 = max(self.seat_peak_mps2, _peak(block.low_passed_mps2))
        settles = self._unsettled > 0 or self.divergences > before
        counted, counted_motion = self._settled(accel, motion) if settles else (accel, motion)
        suspect = self._suspects.flags(block.levelled_mps2, block.losses)
        self._count(counted, counted_motion, suspect)
        if self.intervals:
            self.intervals.push(block, counted)
        self.comparison.seat(block, counted, suspect)
        return accel, motion

    def _begin_run(self, gap_s: float) -> None:
        """Begin from rest after a gap, or at the first sample."""
        self.stepper.reset()
        self._unsettled = 0 if self._at_rest else self._warm_up
        self._suspects.begin_run(follows_loss=not self._at_rest)
        self._at_rest = False  # of the seat, where the next run begins
        self._count_all()
        for meter in self._of_predictions:
            meter.skip(gap_s)

    def _settled(self, accel: Floats, motion: Floats) -> tuple[Floats, Floats]:
        """The predictions with NaN until the chain has settled after its last begin from rest."""
        diverged = np.isnan(accel[:, 0])
        left = np.where(diverged, self._warm_up + 1, 0)
        left[0] = max(left[0], self._unsettled)
        # A sample later one sample less is left; the largest of all begins so far decides.
        at = np.arange(left.size)
        left = np.maximum.accumulate(left + at) - at
        self._unsettled = max(0, int(left[-1]) - 1)
        unsettled = left > 0
        self.unpredicted += int(unsettled.sum())
        accel, motion = accel.copy(), motion.copy()
        accel[unsettled], motion[unsettled] = np.nan, np.nan
        return accel, motion

    def _predict(self, seat_mps2: Floats) -> tuple[Floats, Floats]:
        """Predict NaN where the chain leaves its range, and restart it from rest; the same for any cut into blocks."""
        motion = np.empty((seat_mps2.size, MOTION_COLUMNS))
        accel = self.stepper.push(seat_mps2, motion)
        if self.forces is None:
            parts_of_motion(motion)[2][:] = np.nan
        diverged = kernels.first_invalid(accel, motion, MAX_STRETCH_M)
        if diverged == seat_mps2.size:
            return accel, motion
        accel[diverged], motion[diverged] = np.nan, np.nan
        self.stepper.reset()
        self.divergences += 1
        # The rest is integrated again after each divergence: short blocks limit the repeated work.
        for begin in range(diverged + 1, seat_mps2.size, BLOCK_AFTER_DIVERGENCE):
            part = slice(begin, begin + BLOCK_AFTER_DIVERGENCE)
            accel[part], motion[part] = self._predict(seat_mps2[part])
        return accel, motion

    def _count(self, accel: Floats, motion: Floats, suspect: Flags) -> None:
        """Count predictions once there are enough of them."""
        force = parts_of_motion(motion)[2]
        for begin, end in constant_parts(suspect):
            if suspect[begin] != self._waits_suspect:
                self._count_all()
                self._waits_suspect = bool(suspect[begin])
            self._push(self._accel_batch.add(accel[begin:end]), self._force_batch.add(force[begin:end]))

    def _count_all(self) -> None:
        """Count all predictions that still wait."""
        self._push(self._accel_batch.take(), self._force_batch.take())

    def _push(self, accel: Floats | None, force: Floats | None) -> None:
        if accel is not None:
            self.doses.push(accel, self._waits_suspect)
        if self.forces and force is not None:
            self.forces.push(force, self._waits_suspect)

    def reset(self) -> None:
        """Set everything "since reset" to zero."""
        self._count_all()
        for meter in self._of_predictions:
            meter.reset()
        if self.intervals:
            self.intervals.reset()
        self.comparison.reset()
        self.unpredicted = 0
        self.seat_peak_mps2 = 0.0

    def predicted(self, rolling: bool) -> dict[str, Dose]:
        """Doses of the predictions by segment, of those with counted samples."""
        self._count_all()
        doses = self.doses.rolling() if rolling else self.doses.since_reset()
        return {name: dose for name, dose in zip(SEGMENTS, doses, strict=True) if dose.has_figures}

    def suspect_s(self, rolling: bool = False) -> float:
        """Seconds of suspect samples, which count in no predicted figure except their time."""
        self._count_all()
        return float(self.doses.suspect_samples(rolling)[0]) / self._rate_hz

    def joint_forces(self, rolling: bool) -> dict[str, JointForce]:
        """Forces of the joints by the segment above; empty under `cascade`, and before the first prediction."""
        if self.forces is None:
            return {}
        self._count_all()
        found = self.forces.rolling() if rolling else self.forces.since_reset()
        return {name: force for name, force in zip(SEGMENTS, found, strict=True) if force.seconds > 0.0}

    def spreads(self, rolling: bool) -> dict[str, SegmentSpread]:
        """Spreads of the predicted figures by segment; empty without an interval, and before the first second."""
        return self.intervals.spreads(rolling) if self.intervals else {}

    def measured(self, rolling: bool, sensors: tuple[str, ...]) -> dict[str, Dose]:
        """Doses of the low-passed measurements on the seat's grid, of the sensors named that have counted samples."""
        doses = self.comparison.doses.rolling() if rolling else self.comparison.doses.since_reset()
        return {name: dose for name, dose in zip(SENSORS, doses, strict=True) if name in sensors and dose.has_figures}

    def residual(self, rolling: bool) -> dict[str, tuple[float, float]]:
        """(rms m/s^2, rms over measured rms in percent) by segment, for those that were compared."""
        meter = self.comparison.residual
        rms, percent = meter.rolling() if rolling else meter.since_reset()
        pairs = zip(MEASURED_SEGMENTS, rms.tolist(), percent.tolist(), strict=True)
        return {name: (value, share) for name, value, share in pairs if not math.isnan(value)}

    def end_window(self, absent_s: float) -> None:
        """Let rolling figures end so long after the seat's last sample."""
        for meter in self._meters.values():
            meter.end_window(absent_s)

    def totals(self) -> dict[str, Floats]:
        """Totals since reset: by meter, and the predictor's own."""
        self._count_all()
        own = {PEAK: self.seat_peak_mps2, UNPREDICTED: float(self.unpredicted)}
        return stored_totals(self._meters) | {name: np.array([[value]]) for name, value in own.items()}

    def resume(self, totals: Mapping[str, Floats], break_s: float) -> None:
        """Continue from totals of an earlier run, after a break; raises InputError for totals that do not fit."""
        self._count_all()
        for name, meter in self._meters.items():
            resume_meter(meter, totals, name)
            meter.skip(break_s)
        own = {name: float(totals[name].max(initial=0.0)) for name in (PEAK, UNPREDICTED) if name in totals}
        self.seat_peak_mps2 = max(self.seat_peak_mps2, own.get(PEAK, 0.0))
        self.unpredicted += round(own.get(UNPREDICTED, 0.0))

    @property
    def _meters(self) -> dict[str, Meter[Any]]:
        c = self.comparison
        forces: dict[str, Meter[Any]] = {} if self.forces is None else {"joint_forces": self.forces}
        spread = {} if self.intervals is None else self.intervals.meters
        return {
            "predicted": self.doses, "measured": c.doses, "residual": c.residual, "compared": c.compared, **forces,
            **spread,
        }  # fmt: skip

    @property
    def _of_predictions(self) -> tuple[Meter[Any], ...]:
        return (self.doses,) if self.forces is None else (self.doses, self.forces)


def _peak(values: Floats) -> float:
    """The largest magnitude; live blocks have few samples, for which two reductions take many times as long."""
    return max(map(abs, values.tolist())) if 0 < values.size <= FEW else float(np.abs(values).max(initial=0.0))
