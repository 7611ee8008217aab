"""Predicted run: a recording beside the model's forward prediction of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.model import Response, predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import apply_to_sensors
from biodyn_core.recording.recording import Recording


@dataclass(frozen=True, eq=False)
class PredictedRun:
    """A recording and its prediction; predicted_mps2 (n, 6) is NaN wherever measured_mps2 (n, 6) is masked.

    Both by segment. predicted_mps2 is what sensors with the subject's effects would read, to compare with
    measured_mps2; moved_mps2 is the motion of the segments itself. The central torso, which has no sensor, is masked in
    measured_mps2 alone.
    """

    recording: Recording
    response: Response
    measured_mps2: Floats
    predicted_mps2: Floats

    @classmethod
    def of(cls, recording: Recording, subject: Subject) -> PredictedRun:
        """Predict a recording from its seat alone; raises InputError where the model diverges."""
        channels = recording.named_channels()
        response = predict(subject, recording.seat_mps2, recording.rate_hz, channels)
        if not np.isfinite(response.accel_mps2).all():
            raise InputError(f"{recording.name}: the model of {subject.name} diverges: fit it again")
        measured = np.full(response.accel_mps2.shape, np.nan)
        measured[:, MEASURED_SEGMENT_INDEX] = recording.measured_mps2
        predicted = apply_to_sensors(subject.effects, response.accel_mps2, recording.rate_hz, channels).copy()
        masked = np.isnan(recording.measured_mps2)
        predicted[:, MEASURED_SEGMENT_INDEX] = np.where(masked, np.nan, predicted[:, MEASURED_SEGMENT_INDEX])
        return cls(recording, response, measured, predicted)

    @property
    def moved_mps2(self) -> Floats:
        """The predicted motion of the segments, (n, 6), NaN as predicted_mps2."""
        return np.where(np.isnan(self.predicted_mps2), np.nan, self.response.accel_mps2)

    @property
    def begin(self) -> int:
        """The first sample after the warm-up."""
        return self.recording.begin

    @property
    def seat_mps2(self) -> Floats:
        """The model's input, (n,)."""
        return self.recording.seat_mps2
