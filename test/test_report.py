"""The replay's page: its contents, its escaping, and its traces, which are those of the whole record."""

from __future__ import annotations

import html
import math
import re
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pages import NASTY, Page, assert_self_contained, empty_drawings, lines, no_drawings
from provenances import with_spread
from streams import held_bytes, in_turn, noisy_streams, predicted_frames, run, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, N_SEGMENTS, SEGMENTS, SENSORS
from biodyn_core.exposure.figure_spread import FigureSpread
from biodyn_core.exposure.injury import Dri, Hic, Window
from biodyn_core.exposure.joint_forces import JointForce
from biodyn_core.exposure.limit_assessment import LimitAssessment, SeatExposure
from biodyn_core.exposure.limits import EU_LIMITS, Limits
from biodyn_core.exposure.losses import NO_LOSSES, Losses
from biodyn_core.exposure.meters import Dose
from biodyn_core.exposure.shock_ratios import ShockRatio
from biodyn_core.pipeline.frames import NO_MEASURED, NO_PREDICTED, Frames, MeasuredFrames, PredictedFrames
from biodyn_core.pipeline.intervals import ForceSpread, SegmentSpread
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.run_status import RunStatus
from biodyn_ros.base.wording import (
    INTERVAL_MEANS,
    INTERVAL_OF_BOUND,
    INTERVAL_OF_MISFIT,
    bound,
    duration,
    number,
    sentence,
    with_interval,
)
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.replay import traces as traces_of_replay
from biodyn_ros.replay.page import replay_page
from biodyn_ros.replay.text import summary
from biodyn_ros.replay.traces import ENVELOPE_BINS, RECENT_SAMPLES, Traces
from biodyn_ros.reports.doses import Pair, doses
from biodyn_ros.reports.downsampling import BIN_NS
from biodyn_ros.reports.drawing import MEASURED_COLOUR
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import (
    ChannelExposure,
    ExposureReport,
    JointExposure,
    MisfitTime,
    Residual,
    exposure_report,
)
from biodyn_ros.reports.motion import Envelope
from biodyn_ros.reports.pages import write_drawn
from biodyn_ros.reports.verdict import left, seat_verdict, shocks, time_left

START_NS = 1_767_225_600 * 10**9 + 37
RATE_HZ = 1000.0


# --- material --------------------------------------------------------------------------------------------------------


def channel(level: float, lost: Losses = NO_LOSSES) -> ChannelExposure:
    return ChannelExposure(Dose(level, 2 * level, level, 5 * level, 7.25 * level, 60.5), lost)


def ratios(crest: float | None = 7.25, mtvv: float | None = 1.31) -> tuple[ShockRatio, ...]:
    """The shock ratios of the governing axis."""
    return (
        ShockRatio("crest_factor", crest, 9.0, "6.2.2"),
        ShockRatio("mtvv_over_aw", mtvv, 1.5, "6.3.3"),
        ShockRatio("vdv_over_aw_t", 1.21, 1.75, "6.3.3"),
    )


def seat(**changed: Any) -> SeatExposure:
    """The seat of a quiet recording, with changed fields."""
    quiet = SeatExposure(
        source="2002/44/EC",
        zone="below_action_value",
        zone_reason="everything is below",
        may_be_reached=None,
        governing="vdv",
        axis="z",
        time_to_action_value_s=14_400.0,
        time_to_limit_value_s=400_000.0,
        seconds=60.5,
        suspect_s=0.0,
        horizontal="worst_direction",
        aw_weighted_mps2={"worst_direction": 0.0313, "z": 0.412},
        vdv_weighted_mps175={"worst_direction": 0.213, "z": 2.317},
        a8_so_far_mps2=0.0187,
        a8_axis="worst_direction",
        vdv_so_far_mps175=2.317,
        vdv_axis="z",
        lower_bound=False,
        withheld=None,
        a8_projected_8h_mps2=None,
        vdv_projected_8h_mps175=None,
        projected_from_s=None,
        projected_lower_bound=False,
        shock_ratios=ratios(),
        additional=(
            LimitAssessment(
                EU_LIMITS.additional[0].source, "below_action_value", "lower than 8.5", None, "vdv", "z", None, None
            ),
        ),
    )
    return replace(quiet, **changed)


def report(**changed: Any) -> ExposureReport:
    """The report of a quiet recording without fault, with changed fields."""
    windows_s = {"as_printed": Window(1.0, 1.015), "vertical": Window(1.0, 1.015), "resultant": Window(1.2, 1.2131)}
    quiet = ExposureReport(
        bag="rail.mcap",
        subject="subject_1",
        mass_matrix="segment",
        path="causal",
        window_s=10.0,
        limits=EU_LIMITS,
        run=RunStatus(61.25, 80.0, 1, 0, 0.0, is_extrapolating=False, latency={}),
        uncounted_s=0.75,
        sensors={name: channel(0.1 + 0.011 * i) for i, name in enumerate(SENSORS)},
        predicted={name: channel(0.2 + 0.013 * i) for i, name in enumerate(SEGMENTS)},
        measured_low_passed={name: channel(0.3 + 0.017 * i) for i, name in enumerate(SENSORS)},
        also_weighted={},
        seat=seat(),
        msdv_mps15=None,
        dri=Dri(6.78, 7.89, 23.456),
        hic15=Hic(1.234, 0.456, 0.567, 564.6, windows_s),
        hic36=Hic(2.345, 0.678, 0.789, 564.6, windows_s),
        residual={name: Residual(0.123, 11.0 + i) for i, name in enumerate(MEASURED_SEGMENTS)},
        joint_forces={
            name: JointExposure(JointForce(901.0 - i, 401.0 - i, 101.0 - i, 60.5), NO_LOSSES, 301.0 - i)
            for i, name in enumerate(SEGMENTS)
        },
        body_mass_kg=71.5,
    )
    return replace(quiet, **changed)


def factors(*given: float) -> list[float]:
    """Spreads of which the intervals reach to the figure over and times these factors."""
    return [math.log(factor) / NORMAL_95 for factor in given]


def sure(**changed: Any) -> ExposureReport:
    """The report of the quiet recording whose predictions have intervals, with changed fields."""
    accel, force = FigureSpread(*factors(2.0, 1.25, 5.0)), ForceSpread(*factors(2.5, 10.0, 10.0))
    spread = SegmentSpread(accel, force)
    return report(spreads=dict.fromkeys(SEGMENTS, spread), **changed)


def losing(name: str, lost: Losses) -> dict[str, ChannelExposure]:
    """The sensors of the quiet recording, one of them with losses."""
    sensors = report().sensors
    return {**sensors, name: sensors[name]._replace(losses=lost)}


def record(samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, predicted and measured of a record with gaps, jumps of level and NaN in both."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.arange(samples) * round(1e9 / RATE_HZ)
    stamps[samples // 2 :] += 730_000_000
    loud = 1.0 + 20.0 * np.exp(-0.5 * ((np.arange(samples) - 0.7 * samples) / 50.0) ** 2)
    predicted = loud[:, None] * rng.standard_normal((samples, 6))
    measured = predicted + 0.1 * rng.standard_normal((samples, 6))
    measured[:, 4] = np.nan
    measured[rng.random((samples, 6)) < 0.05] = np.nan
    predicted[100:105] = np.nan
    return stamps, predicted, measured


def frames_of(stamps, predicted, measured) -> tuple[PredictedFrames, MeasuredFrames]:
    residual = predicted[:, MEASURED_SEGMENT_INDEX] - measured[:, 1:]
    return predicted_frames(stamps, predicted), MeasuredFrames(stamps, measured, residual)


def feed(traces: Traces, stamps, predicted, measured, cuts, late: int = 0) -> None:
    """Push blocks as the pipeline does: predictions at once, measurements `late` blocks later."""
    edges = [0, *sorted(cuts), len(stamps)]
    parts = [frames_of(stamps[a:b], predicted[a:b], measured[a:b]) for a, b in pairwise(edges)]
    for i in range(len(parts) + late):
        first = parts[i][0] if i < len(parts) else NO_PREDICTED
        second = parts[i - late][1] if i >= late else NO_MEASURED
        traces.add(Frames(first, second))


def traces_of(samples: int = 4000) -> Traces:
    traces = Traces()
    feed(traces, *record(samples), range(280, samples, 280), late=3)
    return traces


def write_replay_report(path: Path, changed: ExposureReport, traces: Traces | None = None) -> None:
    write_drawn(path, lambda: replay_page(changed, traces_of() if traces is None else traces))


def page_of(
    tmp_path: Path, changed: ExposureReport, traces: Traces | None = None,
    drawings: Callable[[], AbstractContextManager[None]] = no_drawings,
) -> Page:  # fmt: skip
    path = tmp_path / "report.html"
    with drawings():
        write_replay_report(path, changed, traces)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    return Page(path.read_text(encoding="utf-8"))


# --- traces ----------------------------------------------------------------------------------------------------------


def assert_envelope(envelope: Envelope, stamps, values) -> None:
    bins = stamps // envelope.width_ns
    begins = np.unique(bins)
    np.testing.assert_array_equal(envelope.begins_ns, begins * envelope.width_ns)
    for row, begin in enumerate(begins):
        inside = values[bins == begin]
        for column in range(values.shape[1]):
            known = inside[:, column][~np.isnan(inside[:, column])]
            expected = (known.min(), known.max()) if known.size else (np.nan, np.nan)
            np.testing.assert_array_equal((envelope.low_mps2[row, column], envelope.high_mps2[row, column]), expected)


@settings(max_examples=25)
@given(st.lists(st.integers(1, 2999), max_size=30), st.integers(0, 4), st.integers(1, 3000), st.integers(3, 40))
def test_any_cut_gives_the_envelope_and_event_of_the_whole(cuts, late, digest, bins):
    stamps, predicted, measured = record(3000)
    traces = Traces()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(traces_of_replay, "BATCH_SAMPLES", digest)
        patch.setattr(traces_of_replay, "ENVELOPE_BINS", bins)
        patch.setattr(traces_of_replay, "EVENT_HALF_NS", 150_000_000)
        feed(traces, stamps, predicted, measured, cuts, late)
        envelopes, event = (traces.predicted(), traces.measured()), traces.event()
    for envelope, values in zip(envelopes, (predicted, measured), strict=True):
        assert envelope.begins_ns.size <= bins
        assert envelope.width_ns % BIN_NS == 0
        assert_envelope(envelope, stamps, values)
    absolute = np.nan_to_num(np.abs(measured[:, [0, 5]]))
    row, column = np.unravel_index(absolute.argmax(), absolute.shape)
    assert (event.peak_ns, event.peak_mps2, event.sensor) == (stamps[row], absolute.max(), ("seat", "head")[column])
    near = np.abs(stamps - stamps[row]) <= 150_000_000
    for found, expected in (
        (event.measured_ns, stamps[near]),
        (event.predicted_ns, stamps[near]),
        (event.measured_mps2, measured[near]),
        (event.predicted_mps2, predicted[near]),
    ):
        np.testing.assert_array_equal(found, expected)


def test_bins_are_tenths_of_a_second_while_they_fit():
    assert traces_of().measured().width_ns == 100_000_000


def test_times_count_from_the_first_instant_for_any_bin_width():
    traces = Traces()
    stamps = START_NS + 777_777_777 + np.arange(2400) * 100_000_000  # four minutes, one instant in each bin
    values = np.zeros((stamps.size, 6))
    values[1000, 0] = 5.0
    feed(traces, stamps, values, values, [])
    assert traces.measured().width_ns > 100_000_000
    assert traces.first_ns == stamps[0]
    assert traces.event().peak_ns - traces.first_ns == 100_000_000_000


@pytest.mark.slow
def test_memory_is_flat_in_the_length_of_the_record():
    traces, sizes = Traces(), []
    rng = np.random.default_rng(0)
    for block in range(2000):
        stamps = START_NS + (280 * block + np.arange(280)) * 1_000_000
        # Ever stronger, so that a new event begins in every block.
        feed(traces, stamps, *(block * rng.random((280, 6)) for _ in range(2)), [])
        if block % 20 == 0:
            sizes.append(held_bytes(traces))
    assert max(sizes) < 2_500_000  # one batch, two streams of recent instants and of bins, the event, and spectra
    assert max(sizes[50:]) < 1.05 * max(sizes[:50])


def test_predictions_without_measurement_are_dropped():
    traces = Traces()
    for block in range(200):
        stamps = START_NS + (1000 * block + np.arange(1000)) * 1_000_000
        traces.add(Frames(predicted_frames(stamps, np.ones((1000, N_SEGMENTS))), NO_MEASURED))
    assert traces.event() is None
    row_bytes = 8 * (1 + N_SEGMENTS)
    assert held_bytes(traces) < RECENT_SAMPLES * row_bytes + ENVELOPE_BINS * 2 * row_bytes + 20_000


def test_stamps_that_jump_back_go_to_their_bins():
    stamps, predicted, measured = record(2000)
    stamps[1000:] = stamps[:1000]
    traces = Traces()
    feed(traces, stamps, predicted, measured, range(100, 2000, 100))
    assert_envelope(traces.measured(), stamps, measured)


# --- page ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the report with its drawings."""
    path: Path = tmp_path_factory.mktemp("drawn") / "report.html"
    write_replay_report(path, report())
    return path


def test_the_page_has_every_figure_with_its_unit(drawn):
    text = Page(drawn.read_text(encoding="utf-8")).text
    for expected in (
        "Replay of rail.mcap", "subject_1", "segment", "61.2 s", "0.75 s", "0.1.0", "causal",
        "Below the action values so far", "A(8), m/s² 0.0187 0.5 1.15 worst direction",
        "VDV, m/s¹·⁷⁵ 2.32 9.1 21 z", "Everything is below.",
        "Also ISO 2631-1 caution zone: below the action values so far. Lower than 8.5.",
        "no additional evaluation required (ISO 2631-1:1997, axis z): crest factor 7.25, MTVV/aw 1.31",
        "Governed by VDV, axis z (2002/44/EC)", "4 h 0 min left", "more than 24 h left", "use the seat only",
        "No yaw given", "worst direction 0.0313 0.213 1.4 0.0438 0.298",
        "Largest residual 15.0 % of the measured rms (head)", "neck 0.123 14.0",
        "seat 0.100 0.500 0.200 7.25 0.725 0.000 0", "pelvis 0.200 0.317 1.00 1.58 0.400 7.25 1.45 not validated",
        "central torso 0.226 – 1.13 –", "DRI 6.78", "band 5.2-13.0", "7.89 as printed in the paper, with |z|",
        "23.456 s after the start of counting",
        "a single upward pulse", "not a dose of repeated shocks", "HIC15 1.23 0.456 0.567 1.200 to 1.213 565",
        "HIC36 2.35 0.678 0.789 1.200 to 1.213 565",
        "before the 80.0 Hz low-pass", "Predictions come from a model",
        "aw, m/s² VDV, m/s¹·⁷⁵ MTVV, m/s² crest factor peak, m/s²", "whole record: residual 0.123 m/s² rms, 15.0 %",
    ):  # fmt: skip
        assert expected in text, expected
    assert ">= " not in text
    assert "made by the model" not in text


def test_forces_are_shown_with_their_static_weight_and_what_they_rest_on(drawn):
    for text in (Page(drawn.read_text()).text, summary(report())):
        assert "pelvis to lower torso (lumbar)" in text and "71.5 kg" in text and "no force in people" in text
        for figure in ("900", "400", "100", "300"):
            assert figure in text
    assert "would lift off" in summary(report()) and report().lifts_off  # a tension of 401 N against 301 N
    bound = report(
        joint_forces={"pelvis": JointExposure(JointForce(9.5, 0.0, 3.5, 1.0), Losses(0, 1.0, 0.0, 0.0), 5.0)}
    )
    assert "would lift off" not in summary(bound)
    assert ">= 9.50" in summary(bound) and ">= 3.50" not in summary(bound)


def test_a_lower_bound_of_the_dri_is_in_its_band_or_in_a_higher_one(tmp_path):
    clipped = losing("seat", Losses(1, 0.0, 0.0, 0.0))
    for compression, lost, band, higher in (
        (5.1, True, "at least band < 5.2", True),
        (5.1, False, "band < 5.2", False),
        (18.0, True, "band > 17.7 (AIS 2+ threshold)", False),  # the highest band
    ):
        changed = report(dri=Dri(compression, 19.0, 23.456), sensors=clipped if lost else report().sensors)
        for text in (summary(changed), page_of(tmp_path, changed).text):
            assert f", {band};" in text and ("at least band" in text) == higher
        assert exposure_document(changed)["dri"]["class_lower_bound"] is higher
    assert "as printed >= 19.0" in summary(changed)


def test_the_terminal_marks_every_definition_of_the_hic_of_a_clipped_head():
    text = summary(report(sensors=losing("head", Losses(1, 0.0, 0.0, 0.0))))
    assert ">= 0.567 resultant" in text and ">= 0.456 vertical" in text and ">= 1.23 with 1 g as printed" in text


def test_the_terminal_has_the_status_of_the_predictions():
    harder = replace(report().run, is_extrapolating=True)
    for changed, status in ((report(), "not validated"), (report(run=harder), "extrapolated")):
        assert summary(changed).endswith(
            f"measured before, predicted after the low-pass. Predictions are a model's: {status}."
        )


def test_every_prediction_has_its_interval_in_the_document():
    document = exposure_document(sure())
    pelvis, joint = document["predicted"]["pelvis"], document["joint_forces"]["pelvis"]
    assert pelvis["aw_interval_mps2"] == pytest.approx([0.1, 0.4])
    assert pelvis["vdv_interval_mps175"] == pytest.approx([0.8, 1.25])
    assert pelvis["peak_interval_mps2"] == pytest.approx([0.29, 7.25])
    assert joint["compression_interval_n"] == pytest.approx([90.1, 9010.0])
    assert joint["tension_interval_n"] == pytest.approx([40.1, 4010.0])
    assert joint["rms_interval_n"] == pytest.approx([40.4, 252.5])
    assert document["no_interval"] is None


def test_a_report_has_the_spreads_of_its_pipeline_or_the_reason():
    streams = noisy_streams()
    fitted = run(streams, in_turn(streams), pipeline=Pipeline(with_spread(subject())))
    found = exposure_report(fitted.pipeline)
    assert (found.spreads, found.no_interval) == (fitted.exposure.spreads, "")
    assert set(found.spreads) == set(SEGMENTS)
    assert "covariance" in exposure_report(Pipeline(subject())).no_interval
    assert exposure_report(Pipeline(with_spread(subject()))).no_interval == "no whole second was predicted"


def test_without_enough_motion_it_is_unknown_whether_the_model_fits(tmp_path):
    streams, why = noisy_streams(20.0, "road"), "no whole second in motion was compared, 15 s are needed"
    of_seat = [cut for cut in in_turn(streams) if cut[0] == "seat"]
    seat = run(streams, of_seat, pipeline=Pipeline(with_spread(subject())))
    found = exposure_report(seat.pipeline)
    assert exposure_document(found)["not_monitored"] == why
    for shown in (summary(found), page_of(tmp_path, report(not_monitored=found.not_monitored)).text):
        assert f"Unknown: {why}." in shown
    fitted = exposure_report(run(streams, in_turn(streams), pipeline=Pipeline(with_spread(subject()))).pipeline)
    assert exposure_document(fitted)["not_monitored"] is None
    assert exposure_document(fitted)["monitored"] == list(MEASURED_SEGMENTS)
    assert "The model fits as it did in its held-out events." in summary(fitted)
    partly = replace(fitted, monitored=("head", "lower_torso"))
    for shown in (summary(partly), page_of(tmp_path, report(monitored=("head", "lower_torso"))).text):
        assert " (tested: lower torso, head)." in shown


def test_zero_and_a_segment_that_was_not_counted_have_no_interval(tmp_path):
    still = JointExposure(JointForce(9.5, 0.0, 3.5, 1.0), NO_LOSSES, 5.0)
    changed = sure(predicted={**report().predicted, "head": channel(0.0)}, joint_forces={"pelvis": still})
    changed = replace(changed, spreads={name: changed.spreads[name] for name in ("head", "pelvis")})
    document = exposure_document(changed)
    assert document["joint_forces"]["pelvis"]["tension_interval_n"] is None
    assert document["joint_forces"]["pelvis"]["rms_interval_n"] is not None
    for name in ("head", "neck"):
        for figure in ("aw_interval_mps2", "vdv_interval_mps175", "peak_interval_mps2"):
            assert document["predicted"][name][figure] is None
    assert "head 0 0.385 0 1.93 0 – 0 not validated" in page_of(tmp_path, changed, None, empty_drawings).text
    assert re.search(r"^head +0 +0 +–$", summary(changed), re.MULTILINE)


def test_terminal_and_page_show_the_intervals(tmp_path):
    text = summary(sure())
    assert re.search(
        r"^pelvis +0\.200 \(0\.100 to 0\.400\) +1\.00 \(0\.800 to 1\.25\) +901 \(90\.1 to 9010\)$", text, re.MULTILINE
    )
    table = text[text.index("predicted, with 95 % interval") :].splitlines()[1:7]
    assert [line.partition("  ")[0] for line in table] == [name.replace("_", " ") for name in reversed(SEGMENTS)]
    page = page_of(tmp_path, sure(), None, empty_drawings).text
    for expected in (
        "pelvis 0.200 0.100 to 0.400 0.317 1.00 0.800 to 1.25 1.58 0.400 7.25 1.45 0.290 to 7.25 not validated",
        "seat to pelvis 901 90.1 to 9010 401 40.1 to 4010 101 40.4 to 252 301",
        "predicted (hatched), with its 95 % interval",
    ):
        assert expected in page, expected
    for shown in (text, page):
        assert INTERVAL_MEANS in shown
        assert INTERVAL_OF_BOUND not in shown


def test_without_an_interval_the_reason_is_shown(tmp_path):
    changed = report(no_interval="its file has no covariance")
    page = page_of(tmp_path, changed).text
    for shown in (summary(changed), page):
        assert "Predictions for subject_1 have no 95 % interval: its file has no covariance." in shown
        assert INTERVAL_MEANS not in shown
    assert "with its 95 % interval" not in page
    assert exposure_document(changed)["no_interval"] == "its file has no covariance"
    assert "interval" not in summary(report(predicted={}, joint_forces={}, no_interval="nothing was predicted"))


@pytest.mark.parametrize(
    ("losses", "is_bound"),
    [(NO_LOSSES, False), (NO_LOSSES._replace(dead_s=2.0), True), (NO_LOSSES._replace(absent_s=0.5), True)],
    ids=["none", "dead axis", "missing"],
)
def test_hic_is_a_lower_bound_if_the_head_lacks_samples_or_an_axis(losses: Losses, is_bound: bool):
    found = report()
    sensors = found.sensors | {"head": found.sensors["head"]._replace(losses=losses)}
    document = exposure_document(replace(found, sensors=sensors))
    assert (document["hic15"]["lower_bound"], document["hic36"]["lower_bound"]) == (is_bound, is_bound)


def test_the_interval_of_a_lower_bound_is_named_as_such(tmp_path):
    missing = NO_LOSSES._replace(absent_s=1.234)
    changed = sure(predicted={name: each._replace(losses=missing) for name, each in report().predicted.items()})
    assert ">= 1.00 (0.800 to 1.25)" in summary(changed)
    for shown in (summary(changed), page_of(tmp_path, changed).text):
        assert INTERVAL_OF_BOUND in shown


def test_the_interval_does_not_hold_while_the_model_does_not_fit() -> None:
    assert INTERVAL_OF_MISFIT not in summary(sure())
    assert INTERVAL_OF_MISFIT in summary(sure(misfits=[MisfitTime("head", 3.0, None, 2.5)]))


def test_the_drawing_has_an_error_bar_for_each_interval_and_room_for_it():
    rows = [Pair("head", 1.0, 2.0, predicted_interval=(1.0, 8.0)), Pair("neck", 1.0, 2.0)]
    plain, drawn = doses([row._replace(predicted_interval=None) for row in rows], "VDV"), doses(rows, "VDV")
    assert [len(lines(svg, MEASURED_COLOUR, 1.1)) for svg in (plain, drawn)] == [0, 1]
    (bar,) = lines(drawn, MEASURED_COLOUR, 1.1)
    # The axis ends at 1.3 times the largest value or end.
    np.testing.assert_allclose(bar.points[:, 0], [1.0 / 10.4, 8.0 / 10.4], atol=1e-3)


def test_the_page_needs_no_network_and_repeats_no_id(drawn):
    source = drawn.read_text(encoding="utf-8")
    assert_self_contained(source)
    assert source.count("<svg") == 4


def test_the_same_replay_gives_the_same_page(drawn, tmp_path):
    write_replay_report(tmp_path / "again", report())
    assert (tmp_path / "again").read_bytes() == drawn.read_bytes()


def test_names_from_outside_are_escaped(tmp_path):
    page = page_of(
        tmp_path, report(bag=NASTY, subject="<b>x</b>", warnings=["seat: <img src=x> & more"]), None, empty_drawings
    )
    assert NASTY in page.text
    assert "<b>x</b>" in page.text
    assert "1 warning seat: <img src=x> & more" in page.text
    assert not {"script", "img"} & set(page.tags)
    assert html.escape(NASTY, quote=False) not in "".join(page.tags)


def test_a_bag_name_that_is_not_utf8_does_not_stop_the_page(tmp_path):
    assert r"rail\udcff.mcap" in page_of(tmp_path, report(bag="rail\udcff.mcap")).text


def test_lower_bounds_are_printed_as_such_and_never_green(tmp_path):
    doubtful = seat(
        lower_bound=True, time_to_action_value_s=None, time_to_limit_value_s=None, zone="undecided",
        zone_reason="too much is missing", withheld="1.23 s are missing at the seat, more than 1 %",
    )  # fmt: skip
    missing = NO_LOSSES._replace(absent_s=1.234)
    sensors = losing("head", NO_LOSSES._replace(clipped=17)) | {"seat": channel(0.1, missing)}
    predicted = {name: each._replace(losses=missing) for name, each in report().predicted.items()}
    page = page_of(tmp_path, report(seat=doubtful, sensors=sensors, predicted=predicted), None, empty_drawings)
    for expected in (
        "Undecided: no assessment of the seat", "Too much is missing.", "A(8), m/s² >= 0.0187", "VDV, m/s¹·⁷⁵ >= 2.32",
        "at the seat 1.234 s missing.",
        "Action value: time left withheld, because 1.23 s are missing at the seat, more than 1 %.",
        "seat 0.100 >= 0.500 >= 0.200 7.25 >= 0.725 1.234 0.000 0",
        "head >= 0.155 >= 0.775 >= 0.310 7.25 >= 1.12 0.000 0.000 17",
        "pelvis 0.200 0.317 >= 1.00 1.58 >= 0.400", "DRI >= 6.78", "HIC15 >= 1.23 >= 0.456 >= 0.567 1.200 to 1.213 565",
        "undecided whether additional evaluation is required",
    ):  # fmt: skip
        assert expected in page.text, expected
    assert 'class="strip good"' not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_vertical_only_seat_is_a_lower_bound_and_its_vertical_is_none(tmp_path):
    vertical = seat(lower_bound=True, horizontal="missing", zone="undecided", zone_reason="vertical only")
    text = page_of(tmp_path, report(seat=vertical)).text
    for expected in ("A(8), m/s² >= 0.0187", "Vertical only", "at most 4 h 0 min left", "seat 0.100 0.500", "DRI 6.78"):
        assert expected in text, expected


def test_a_dead_axis_makes_the_horizontal_figures_alone_lower_bounds(tmp_path):
    given = seat(
        lower_bound=True, projected_lower_bound=True, horizontal="yaw_given",
        aw_weighted_mps2={"x": 0.0313, "y": 0.0211, "z": 0.412},
        vdv_weighted_mps175={"x": 0.213, "y": 0.111, "z": 2.317},
    )  # fmt: skip
    text = page_of(tmp_path, report(seat=given, sensors=losing("seat", Losses(0, 0.0, 0.0, 0.0, 30.0)))).text
    for expected in (
        "x >= 0.0313 >= 0.213 1.4 >= 0.0438 >= 0.298",
        "y >= 0.0211 >= 0.111",
        "z 0.412 2.32 1.0 0.412 2.32",
    ):
        assert expected in text, expected


@pytest.mark.parametrize(
    ("zone", "tone", "headline"),
    [
        ("below_action_value", "good", "Below the action values so far"),
        ("above_action_value", "warn", "Action value reached"),
        ("above_limit_value", "bad", "Limit value reached"),
        ("undecided", "none", "Undecided"),
    ],
)
def test_page_and_terminal_show_the_zone_in_words_and_green_for_one_alone(tmp_path, zone, tone, headline):
    changed = report(seat=seat(zone=zone, zone_reason=f"because of {zone}"))
    verdict = seat_verdict(changed.seat, NO_LOSSES)
    assert verdict.tone == tone
    assert headline in verdict.headline
    page_of(tmp_path, changed)
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert re.findall(r'class="strip (\w+)"', source) == [tone, "none"]
    text = summary(changed)
    assert f"SEAT: {headline.upper()}" in text
    assert f"Because of {zone}." in text
    assert "also ISO 2631-1 caution zone: below the action values so far" in text


def test_without_a_seat_there_is_no_verdict():
    verdict = seat_verdict(None, NO_LOSSES)
    assert (verdict.tone, verdict.reasons) == ("none", ())
    assert "nothing counted" in verdict.headline
    assert "seat: nothing counted" in summary(report(seat=None))


def test_a_reached_limit_is_reported_even_without_times():
    reached = seat(
        zone="above_action_value", lower_bound=True, withheld="17 samples are clipped at the seat",
        time_to_action_value_s=None, time_to_limit_value_s=None,
    )  # fmt: skip
    assert time_left("action", reached) == "Action value: reached."
    assert time_left("limit", reached) == "Limit value: time left withheld, because 17 samples are clipped at the seat."
    assert time_left("limit", replace(reached, zone="above_limit_value")) == "Limit value: reached."


def test_time_left_of_a_lower_bound_is_at_most_that():
    assert "Action value: 4 h 0 min left" in time_left("action", seat())
    assert "Action value: at most 4 h 0 min left" in time_left("action", seat(lower_bound=True))
    assert "never reached" in time_left("action", seat(time_to_action_value_s=None))


def test_projections_carry_their_length(tmp_path):
    assert "projected" not in summary(report())
    projected = seat(a8_projected_8h_mps2=0.412, vdv_projected_8h_mps175=4.634, projected_from_s=1815.0)
    changed = report(seat=projected)
    text = page_of(tmp_path, changed).text
    assert "A(8) projected, m/s² 0.412 to 8 h, from 30 min counted" in text
    assert "VDV projected, m/s¹·⁷⁵ 4.63 to 8 h, from 30 min counted" in text
    assert "projected to 8 h from 30 min counted: A(8) 0.412 m/s^2, VDV 4.63 m/s^1.75" in summary(changed)
    changed = report(seat=replace(projected, horizontal="missing", projected_lower_bound=True))
    assert "A(8) projected, m/s² >= 0.412" in page_of(tmp_path, changed).text
    assert "A(8) >= 0.412 m/s^2, VDV >= 4.63 m/s^1.75" in summary(changed)


def test_shocks_that_need_additional_evaluation_are_flagged(tmp_path):
    page_of(tmp_path, report())
    assert '<p class="flag">' not in (tmp_path / "report.html").read_text(encoding="utf-8")
    changed = report(seat=seat(shock_ratios=ratios(crest=11.2, mtvv=1.6)))
    warning = (
        "Shocks: additional evaluation required (ISO 2631-1:1997, axis z): crest factor 11.2 > 9 (6.2.2),"
        " MTVV/aw 1.60 > 1.5 (6.3.3)."
    )
    assert warning in page_of(tmp_path, changed).text
    assert '<p class="flag">' in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert warning in summary(changed)


def test_unmeasured_ratios_do_not_exclude_shocks():
    assert shocks(seat(axis="worst_direction", shock_ratios=ratios(None, None))) == (
        "Shocks: undecided whether additional evaluation is required (ISO 2631-1:1997, axis worst direction):"
        " crest factor and MTVV/aw not measured."
    )


def test_lower_bounds_do_not_exclude_shocks():
    """Text and JSON say the same: what is above its threshold stays above, the others are undecided."""
    bound = seat(lower_bound=True, shock_ratios=ratios(crest=11.2))
    found = exposure_document(report(seat=bound))["seat"]["shock_ratios"]
    assert found["crest_factor"]["exceeded"] is True and found["mtvv_over_aw"]["exceeded"] is None
    assert exposure_document(report())["seat"]["shock_ratios"]["mtvv_over_aw"]["exceeded"] is False
    assert "undecided" in shocks(seat(lower_bound=True))


def test_a_set_that_states_no_a8_shows_none(tmp_path):
    changed = report(limits=Limits(EU_LIMITS.additional[0]))
    assert "A(8), m/s² 0.0187 – –" in page_of(tmp_path, changed).text
    assert "A(8) so far 0.0187 m/s^2 of no value stated, VDV so far 2.32 m/s^1.75 of 8.5 / 17" in summary(changed)


def test_a_simulated_recording_is_marked(tmp_path):
    assert MADE_BY_MODEL in page_of(tmp_path, report(is_made_by_model=True)).text


def test_a_page_of_a_nearly_empty_record_is_drawn(tmp_path):
    empty = report(
        sensors={}, predicted={}, measured_low_passed={}, residual={}, seat=None, dri=None, hic15=None, hic36=None
    )
    text = page_of(tmp_path, empty, Traces(), empty_drawings).text
    for expected in (
        "nothing counted at the seat",
        "No measurement to compare",
        "No measured instant",
        "Predictions come from a model: none",
    ):
        assert expected in text


def test_a_page_without_known_shares_and_of_a_diverging_model(tmp_path):
    quiet = report()
    changed = report(
        residual={**quiet.residual, "neck": Residual(0.123, None)}, sensors={**quiet.sensors, "seat": channel(0.0)}
    )
    stamps, predicted, measured = record(1000)
    predicted[500] = 1e200
    measured[:, 1:] = np.nan
    traces = Traces()
    feed(traces, stamps, predicted, measured, [300])
    text = page_of(tmp_path, changed, traces, nullcontext).text
    assert "neck 0.123 –" in text
    assert "not measured" in text


def test_a_page_of_one_instant(tmp_path):
    traces = Traces()
    feed(traces, *(part[:1] for part in record(2000)), [])
    page_of(tmp_path, report(), traces, empty_drawings)


# --- what can go wrong -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fails", ["write", "replace"])
def test_a_failed_write_leaves_no_page(tmp_path, monkeypatch, fails):
    path = tmp_path / "report.html"
    path.write_text("the report of yesterday")

    def full(*arguments: object, **more: object) -> None:
        raise OSError(28, "No space left on device")

    if fails == "replace":
        monkeypatch.setattr(Path, "replace", full)
    else:
        monkeypatch.setattr("os.fsync", full)
    with (
        empty_drawings(),
        pytest.raises(InputError, match=r"report\.html: cannot be written \(No space left on device\)"),
    ):
        write_replay_report(path, report())
    assert list(tmp_path.iterdir()) == []


def test_a_missing_directory_is_one_line(tmp_path):
    with empty_drawings(), pytest.raises(InputError, match="cannot be written"):
        write_replay_report(tmp_path / "nowhere" / "report.html", report())


@pytest.mark.parametrize("missing", ["jinja2", "matplotlib"])
def test_a_missing_library_is_named_with_its_remedy(tmp_path, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(InputError, match=rf"reports need {missing}: pip install 'biodyn_ros\[reports\]'"):
        write_replay_report(tmp_path / "report.html", report(), Traces())
    assert list(tmp_path.iterdir()) == []


# --- words and numbers -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "expected"),
    [(None, "–"), (float("nan"), "–"), (0.0, "0"), (0.01234, "0.0123"), (1.0, "1.00"), (17.64, "17.6"), (564.6, "565"),
     (123456.0, "123456"), (1e-5, "1e-05"), (-2.5, "-2.50"), (9.996, "10.0"), (0.0009996, "0.00100")],
)  # fmt: skip
def test_numbers_have_three_digits(value, expected):
    assert number(value) == expected


@pytest.mark.parametrize(
    ("estimate", "expected"),
    [
        ((12.5, 5.0, 31.0), ("12.5", "5.00", "31.0")),  # wide: as numbers are
        ((12.518, 12.512, 12.523), ("12.518", "12.512", "12.523")),
        ((10.0004, 9.998, 10.003), ("10.000", "9.998", "10.003")),
        ((0.01, 0.0099996, 0.0100004), ("0.0100000", "0.0099996", "0.0100004")),
        ((4.0, 4.0, 4.0), ("4.00", "4.00", "4.00")),
        ((2.0, 1.0, float("inf")), ("2.00", "1.00", "inf")),
        ((1e-5, 0.9e-5, 1.1e-5), ("1e-05", "9e-06", "1.1e-05")),
        ((3.0, None, 4.0), ("3.00", "–", "4.00")),
        ((3.0, 2.0, float("nan")), ("3.00", "2.00", "–")),
    ],
)
def test_the_ends_of_an_interval_are_distinguishable(estimate, expected):
    assert with_interval(*estimate) == expected


def test_a_bound_of_a_missing_value_is_empty():
    assert bound(None, lower=True) == "–"
    assert bound(2.0, lower=True) == ">= 2.00"


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (8.42, "8.4 s"),
        (59.96, "59.9 s"),
        (119.9, "1 min"),
        (720.0, "12 min"),
        (3599.0, "59 min"),
        (12000.0, "3 h 20 min"),
        (1e9, "more than 24 h"),
    ],
)
def test_durations_are_readable_and_rounded_down(seconds, expected):
    assert duration(seconds) == expected


def test_at_most_never_promises_more_than() -> None:
    assert left("limit", seat(time_to_limit_value_s=150_000.0, lower_bound=True)) == "at most 41 h left"
    assert left("limit", seat(time_to_limit_value_s=150_000.0)) == "more than 24 h left"


def test_doubtful_data_withhold_the_time_left_in_every_sentence() -> None:
    for limit in ("action", "limit"):
        assert any(
            f"{limit.capitalize()} value: " in line and " left" in line
            for line in seat_verdict(seat(), NO_LOSSES).reasons
        )
    doubted = seat_verdict(seat(), NO_LOSSES, "two publishers send to the seat")
    assert doubted.tone == "none" and not any(" left, if" in line for line in doubted.reasons)
    assert sum("withheld, because two publishers send" in line for line in doubted.reasons) == 2
    assert "below" not in " ".join(doubted.reasons)


def test_the_aw_of_a_stuck_sensor_is_a_lower_bound(tmp_path):
    changed = report(sensors=losing("head", NO_LOSSES._replace(flat_s=30.0)))
    text = page_of(tmp_path, changed).text
    shown = f">= {number(changed.sensors['head'].dose.aw_mps2)}"
    assert shown in text and shown in summary(changed)


@pytest.mark.parametrize(("text", "expected"), [("a b", "A b."), ("is it?", "Is it?"), ("2 s are", "2 s are.")])
def test_sentences_have_a_capital_and_a_full_stop(text, expected):
    assert sentence(text) == expected


def test_after_losses_within_strong_motion_a_time_is_about_and_the_doubt_is_amber() -> None:
    lost = NO_LOSSES._replace(filled_s=0.04, suspect_s=1.85)
    below = seat(suspect_s=1.85, lower_bound=True, is_estimate=True)
    assert left("action", below) == "about 4 h 0 min left"
    verdict = seat_verdict(below, lost)
    assert verdict.tone == "good"
    (lower,) = [reason for reason in verdict.reasons if "lower bounds" in reason]
    assert lower.endswith(": at the seat 0.040 s missing, 1.850 s left out after losses within strong motion.")
    doubted = seat(
        zone="undecided",
        may_be_reached="limit",
        suspect_s=1.85,
        lower_bound=True,
        is_estimate=True,
        withheld="it is so",
    )
    verdict = seat_verdict(doubted, lost)
    assert (verdict.tone, verdict.headline) == ("warn", "Undecided: the limit value may be reached")
    projected = seat(
        a8_projected_8h_mps2=0.4,
        vdv_projected_8h_mps175=8.0,
        projected_from_s=1300.0,
        suspect_s=1.85,
        lower_bound=True,
        is_estimate=True,
    )
    text = summary(report(seat=projected))
    assert "VDV 8.00 m/s^1.75, which losses within strong motion make uncertain" in text
    assert "SEAT: UNDECIDED: THE LIMIT VALUE MAY BE REACHED" in summary(report(seat=doubted))
