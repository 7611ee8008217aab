"""Frames: results of a push of the pipeline, predictions and aligned measurements."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.segments import N_SEGMENTS, N_SENSORS
from biodyn_core.body.model import MOTION_COLUMNS


class PredictedFrames(NamedTuple):
    """Predictions: stamps_ns (n,), accel_mps2 (n, 6) absolute, gravity-free, up, NaN where the model diverged.

    motion (n, 18): displacements and velocities relative to the seat, and forces of the joints (`parts_of_motion`).
    """

    stamps_ns: Integers
    accel_mps2: Floats
    motion: Floats


NO_PREDICTED: Final = PredictedFrames(
    np.empty(0, dtype=np.int64), np.empty((0, N_SEGMENTS)), np.empty((0, MOTION_COLUMNS))
)


class MeasuredFrames(NamedTuple):
    """Conditioned vertical acceleration at the seat's instants: stamps_ns (n,), accel_mps2 (n, 6) by sensor, or NaN.

    residual_mps2 (n, 5) is predicted minus measured for the five segments that carry a sensor.
    """

    stamps_ns: Integers
    accel_mps2: Floats
    residual_mps2: Floats


NO_MEASURED: Final = MeasuredFrames(np.empty(0, dtype=np.int64), np.empty((0, N_SENSORS)), np.empty((0, N_SENSORS - 1)))


class Frames(NamedTuple):
    """Results of one push; either part may be empty."""

    predicted: PredictedFrames
    measured: MeasuredFrames


NO_FRAMES: Final = Frames(NO_PREDICTED, NO_MEASURED)


def joined(frames: list[Frames]) -> Frames:
    """Concatenate the results of several pushes."""
    predicted = [f.predicted for f in frames if f.predicted.stamps_ns.size]
    measured = [f.measured for f in frames if f.measured.stamps_ns.size]
    return Frames(
        PredictedFrames(*map(np.concatenate, zip(*predicted, strict=True))) if predicted else NO_PREDICTED,
        MeasuredFrames(*map(np.concatenate, zip(*measured, strict=True))) if measured else NO_MEASURED,
    )
