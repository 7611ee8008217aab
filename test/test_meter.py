"""The readings of a vibration meter on the pages: the figures of the seat, a dash with its reason, and why >=."""

from __future__ import annotations

from typing import Any

import numpy as np
import test_report
from pages import lines

from biodyn_core.base.segments import SEGMENTS, SENSORS
from biodyn_core.exposure.losses import NO_LOSSES, Losses
from biodyn_core.exposure.meters import Dose
from biodyn_ros.reports.drawing import DASHED, MEASURED_COLOUR, PREDICTED_COLOUR
from biodyn_ros.reports.exposure_report import ChannelExposure
from biodyn_ros.reports.meter import MeterReadings, meter_readings
from biodyn_ros.reports.motion import Envelope, StrongestEvent, envelopes, overlay


def readings(lost: Losses = NO_LOSSES, **changed: Any) -> MeterReadings:
    """The readings of a seat with changed fields and these losses."""
    given = {
        "seconds": 61.25, "horizontal": "yaw_given",
        "aw_weighted_mps2": {"x": 0.11, "y": 0.12, "z": 0.13},
        "vdv_weighted_mps175": {"x": 1.1, "y": 1.2, "z": 1.3},
    } | changed  # fmt: skip
    dose = Dose(0.13, 0.5, 0.4, 1.3, 2.5, 61.25)
    read = meter_readings(test_report.seat(**given), ChannelExposure(dose, lost))
    assert read is not None
    return read


def test_the_readings_are_the_figures_of_the_seat() -> None:
    read = readings()
    assert [(each.axis, each.aw_mps2, each.vdv_mps175) for each in read.axes] == [
        ("x", 0.11, 1.1), ("y", 0.12, 1.2), ("z", 0.13, 1.3),
    ]  # fmt: skip
    assert (read.counted_s, read.mtvv_mps2, read.peak_mps2, read.bounds) == (61.25, 0.5, 2.5, "")
    assert read.note == "Horizontal axes from the yaw given."
    assert not any(each.aw_lower_bound or each.vdv_lower_bound for each in read.axes)


def test_the_largest_direction_stands_for_both_axes_and_missing_axes_are_a_dash_with_the_reason() -> None:
    worst = readings(
        horizontal="worst_direction", aw_weighted_mps2={"worst_direction": 0.2, "z": 0.13},
        vdv_weighted_mps175={"worst_direction": 2.0, "z": 1.3},
    )  # fmt: skip
    assert [each.aw_mps2 for each in worst.axes] == [0.2, 0.2, 0.13]
    assert "largest value over all horizontal directions" in worst.note
    alone = readings(
        horizontal="missing", lower_bound=True, aw_weighted_mps2={"z": 0.13}, vdv_weighted_mps175={"z": 1.3}
    )
    assert [(each.aw_mps2, each.vdv_mps175) for each in alone.axes] == [(None, None), (None, None), (0.13, 1.3)]
    assert alone.note == "Vertical only: horizontal data are missing."
    assert not alone.axes[2].vdv_lower_bound


def test_lower_bounds_say_why() -> None:
    read = readings(Losses(3, 0.25, 0.0, 0.0), lower_bound=True)
    assert read.bounds == "≥ means at least: 0.250 s missing, 3 samples clipped."
    assert all(each.vdv_lower_bound and each.aw_lower_bound for each in read.axes)
    absent = readings(NO_LOSSES._replace(absent_s=0.25), lower_bound=True)
    assert all(each.vdv_lower_bound and not each.aw_lower_bound for each in absent.axes)
    assert "a horizontal axis has no data" in readings(lower_bound=True).bounds


def test_before_the_seat_counts_there_are_no_readings() -> None:
    assert meter_readings(None, test_report.channel(0.1)) is None
    assert meter_readings(test_report.seat(), None) is None


def test_a_prediction_that_equals_the_measurement_is_dashed_over_a_solid_line() -> None:
    stamps_ns = 1_000_000 * np.arange(200)
    wave = np.repeat(np.sin(0.1 * np.arange(200.0))[:, None], 6, axis=1)
    event = StrongestEvent("seat", 0, 1.0, stamps_ns, wave, stamps_ns, wave)
    bins = Envelope(1_000_000, stamps_ns, wave - 0.5, wave + 0.5)
    over_all = envelopes(bins, bins, None, 0)
    for svg, measured_pt, predicted_pt, each in (
        (overlay(event, 0, {}), 1.7, 1.3, 1),
        (over_all, 1.1, 0.9, 2),
    ):
        solid, dashed = lines(svg, MEASURED_COLOUR, measured_pt), lines(svg, PREDICTED_COLOUR, predicted_pt)
        assert (len(solid), len(dashed)) == (each * len(SENSORS), each * len(SEGMENTS))
        assert not any(line.dashed for line in solid) and all(line.dashed for line in dashed)
    gap = DASHED[1][1]
    assert gap >= 2.0, "widths of the line: so much of the measurement is seen between two dashes"
