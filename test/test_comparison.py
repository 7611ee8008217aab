"""Compared figures: measurement and prediction of one segment count the same samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from naive import weighted
from streams import RATE_HZ, in_turn, noisy_streams, run
from test_snapshot_builder import Ride

from biodyn_core.base.segments import HEAD, MEASURED_SEGMENTS, SEAT, SEGMENTS, SENSORS

LARGEST_GAIN = 1.1
"""Wk amplifies no frequency by more (ISO 2631-1:1997, Table 3: 1.054 at 6.3 Hz)."""


def aw_mps2(signals: np.ndarray) -> float:
    return math.sqrt(float(np.mean(weighted("Wk", signals, RATE_HZ) ** 2)))


def test_a_failed_sensor_is_compared_at_its_own_samples() -> None:
    streams = noisy_streams()
    dead = run(streams, [cut for cut in in_turn(streams) if cut[0] != HEAD or cut[2] < 3000])
    measured = dead.measured[:, SENSORS.index(HEAD)]
    known = ~np.isnan(measured)
    assert 0.3 < known.mean() < 0.7, known.mean()
    compared = dead.exposure.compared[HEAD]
    for dose, signals in (
        (compared.measured, measured),
        (compared.predicted, dead.predicted[:, SEGMENTS.index(HEAD)]),
        (compared.seat, dead.measured[:, SENSORS.index(SEAT)]),
    ):
        assert dose is not None
        assert dose.seconds == pytest.approx(known.sum() / RATE_HZ, rel=1e-3)
        assert dose.aw_mps2 == pytest.approx(aw_mps2(signals[known]), rel=5e-3)
    whole = dead.exposure.compared["central_torso"]
    assert whole.measured is None
    assert whole.predicted == dead.exposure.predicted["central_torso"]
    assert whole.seat == dead.exposure.measured_low_passed[SEAT]


def test_rows_differ_by_no_more_than_their_residual_while_a_sensor_lags() -> None:
    """|aw of a minus aw of b| is at most aw of their difference, where both are of the same samples."""
    ride = Ride().drive(noisy_streams(6.0), behind={"neck": 840})
    rows = [row for shown in ride.snapshots for row in shown["rows"] if row["residual_mps2"] is not None]
    assert len(rows) > 10 * len(MEASURED_SEGMENTS)
    for row in rows:
        apart = abs(row["measured_mps2"] - row["predicted_mps2"])
        assert apart <= LARGEST_GAIN * row["residual_mps2"] + 1e-3, row
