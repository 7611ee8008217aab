"""Exposures of a validation: losses within strong motion raise no dose and no injury criterion."""

from __future__ import annotations

import dataclasses

import naive
import numpy as np
import pytest
from listed import assert_listed
from streams import subject

from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.synthesis import SensorSettings, imu_streams, load_case
from biodyn_core.recording.recording import WARM_UP_S, Recorder, Recording
from biodyn_ros.validate.document import validation_document
from biodyn_ros.validate.page import validation_page
from biodyn_ros.validate.report import Report
from biodyn_ros.validate.text import text_of
from biodyn_ros.validate.validating import validate_recordings

RATE_HZ = 1000.0
HEAD = MEASURED_SEGMENTS.index("head")
STRIKE_S, SECONDS = 5.0, 12.0


def struck(peak_g: float = 4.0, length_s: float = 0.02) -> Recording:
    """A seat that moves little but for a half-sine at STRIKE_S, and the body of the model itself on it."""
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    seat = 0.1 * np.sin(2.0 * np.pi * 3.0 * time)
    here = (time > STRIKE_S) & (time < STRIKE_S + length_s)
    seat += np.where(here, peak_g * naive.GRAVITY * np.sin(np.pi * (time - STRIKE_S) / length_s), 0.0)
    measured = Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    return Recording("shock", "rail", RATE_HZ, np.arange(seat.size) * 1_000_000, seat, measured, ())


def with_seat_lost(whole: Recording, begin: int, end: int) -> Recording:
    """Samples of the seat that a straight line replaces, with the segments masked while the model settles."""
    seat, measured = whole.seat_mps2.copy(), whole.measured_mps2.copy()
    seat[begin:end] = np.interp(np.arange(begin, end), [begin - 1, end], seat[[begin - 1, end]])
    measured[begin : end + round(WARM_UP_S * RATE_HZ)] = np.nan
    lost = np.where((np.arange(seat.size) >= begin) & (np.arange(seat.size) < end), end - begin, 0)
    invalid_s = (end - begin) / RATE_HZ
    return dataclasses.replace(whole, seat_mps2=seat, measured_mps2=measured, seat_lost=lost, seat_invalid_s=invalid_s)


def with_head_masked(whole: Recording, begin: int, end: int) -> Recording:
    measured = whole.measured_mps2.copy()
    measured[begin:end, HEAD] = np.nan
    return dataclasses.replace(whole, measured_mps2=measured)


def report_of(recording: Recording) -> Report:
    return validate_recordings([recording], subject())


def exposure_of(recording: Recording) -> dict:
    return validation_document(report_of(recording))["exposure"]


def test_a_loss_at_the_peak_of_a_shock_raises_no_figure_of_the_seat():
    """45 ms from the peak on; with the line across them VDV is 1.3 times the true one."""
    whole = struck()
    begin = round((STRIKE_S + 0.01) * RATE_HZ)
    lost = with_seat_lost(whole, begin, begin + 45)
    raised = (np.sum(naive.weighted("Wk", lost.seat_mps2, RATE_HZ) ** 4) / RATE_HZ) ** 0.25
    true, found = exposure_of(whole), exposure_of(lost)
    assert true["seat"]["suspect_s"] == 0.0 and true["seat"]["lower_bound"] is False
    assert raised > 1.25 * true["seat"]["vdv_mps175"]
    assert found["seat"]["suspect_s"] == pytest.approx(
        1.8, abs=0.05
    )  # 40 times 45 ms, from the last strong sample near it
    assert found["seat"]["vdv_mps175"] > 0.2 * true["seat"]["vdv_mps175"]  # up to the loss all is counted
    assert found["seat"]["lower_bound"] is True and found["dri"]["lower_bound"] is True
    for key in ("aw_mps2", "vdv_mps175", "peak_mps2", "mtvv_mps2"):
        assert found["seat"][key] <= 1.04 * true["seat"][key], key
    for key in ("as_printed", "compression"):
        assert found["dri"][key] <= 1.04 * true["dri"][key], key
    assert found["seat"]["counted_s"] == true["seat"]["counted_s"]
    assert all(each["lower_bound"] for each in found["segments"].values())


LONG = {"peak_g": 3.0, "length_s": 0.4}


def true_vdv(accel_mps2: np.ndarray) -> float:
    return float((np.sum(naive.weighted("Wk", accel_mps2, RATE_HZ) ** 4) / RATE_HZ) ** 0.25)


def assert_head_is_not_raised(found: dict, whole: Recording) -> None:
    """The head's figures are at most the true ones, and its samples from the restart on are suspect."""
    head, true_head = found["segments"]["head"], exposure_of(whole)["segments"]["head"]
    assert head["suspect_s"] == pytest.approx(2.0) and head["lower_bound"] is True
    for side in ("measured", "predicted"):
        for key in ("aw_mps2", "vdv_mps175", "peak_mps2"):
            assert head[side][key] <= 1.001 * true_head[side][key], (side, key)


def test_a_restart_within_a_long_shock_raises_no_dose_of_its_segment():
    """The head is masked up to the peak of its motion; its weighting restarts there as if it came from rest."""
    whole = struck(**LONG)
    peak = int(np.abs(whole.measured_mps2[:, HEAD]).argmax())
    masked = with_head_masked(whole, peak - 20, peak)
    restarted = true_vdv(np.append(np.zeros(peak), whole.measured_mps2[peak:, HEAD]))
    assert restarted > 1.1 * true_vdv(whole.measured_mps2[:, HEAD])
    found = exposure_of(masked)
    assert_head_is_not_raised(found, whole)
    (row,) = (row for row in text_of(report_of(masked)).splitlines() if row.startswith("head  "))
    assert row.count(">=") == 4  # the means too: the time of suspect samples counts
    neck = found["segments"]["neck"]
    assert neck == exposure_of(whole)["segments"]["neck"] and neck["suspect_s"] == 0.0


def test_a_sensor_that_begins_within_a_shock_raises_no_dose():
    whole = struck(**LONG)
    peak = int(np.abs(whole.measured_mps2[:, HEAD]).argmax())
    assert_head_is_not_raised(exposure_of(with_head_masked(whole, 0, peak)), whole)


def test_the_begin_of_a_later_run_within_a_shock_raises_no_dose():
    """The second run begins so that its warm-up ends at the peak of the head's motion."""
    whole = struck(**LONG)
    begin = int(np.abs(whole.measured_mps2[:, HEAD]).argmax()) - round(WARM_UP_S * RATE_HZ)
    later = dataclasses.replace(
        whole,
        stamps_ns=whole.stamps_ns[begin:] + 20_000_000_000,
        seat_mps2=whole.seat_mps2[begin:],
        measured_mps2=whole.measured_mps2[begin:],
    )
    calm = struck(peak_g=0.0)
    found = validation_document(validate_recordings([calm, later], subject()))["exposure"]
    assert_head_is_not_raised(found, whole)


@pytest.mark.parametrize("name", ["hic15", "hic36"])
@pytest.mark.parametrize("before_s", [0.03, 0.05])
def test_a_mask_near_a_shock_takes_nothing_of_it(name, before_s):
    """Twenty milliseconds of the head are masked shortly before the shock."""
    whole = struck()
    begin = round((STRIKE_S - before_s) * RATE_HZ)
    true, found = exposure_of(whole), exposure_of(with_head_masked(whole, begin, begin + 20))
    assert found["segments"]["head"]["suspect_s"] == 0.0 and found["segments"]["head"]["lower_bound"] is True
    vdv, true_vdv = (one["segments"]["head"]["measured"]["vdv_mps175"] for one in (found, true))
    assert vdv == pytest.approx(true_vdv, rel=2e-3)  # the motion after the seat's is small
    for side in ("measured", "predicted"):
        assert found[name][side]["vertical"] == pytest.approx(true[name][side]["vertical"], rel=1e-6)


def test_a_restart_of_both_sides_is_no_disagreement():
    """The model itself is measured, with noise; the head is masked within each of three shocks."""
    whole = struck(peak_g=2.0, length_s=0.05)
    rng = np.random.default_rng(1)
    noisy = dataclasses.replace(
        whole, measured_mps2=whole.measured_mps2 + rng.normal(0.0, 0.05, (whole.seat_mps2.size, 5))
    )
    peak = int(np.abs(noisy.measured_mps2[:, HEAD]).argmax())
    report = report_of(with_head_masked(noisy, peak - 5, peak))
    assert report.validation.exposures.suspect_s["head"] > 1.9
    assert not [finding for finding in report.findings if finding.what in ("vdv", "left_out")]


def test_the_warm_up_of_a_later_run_leaves_out_nothing_more():
    """A gap in strong motion: the seat is suspect for 2 s, in which the model settles and nothing is compared."""
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    seat = np.where(time < 0.2, 6.0 * np.sin(2.0 * np.pi * 4.0 * time), 0.1 * np.sin(2.0 * np.pi * 4.0 * time))
    later = dataclasses.replace(
        struck(peak_g=0.0),
        stamps_ns=np.arange(seat.size) * 1_000_000 + 20_000_000_000,
        seat_mps2=seat,
        measured_mps2=Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX],
    )
    found = validation_document(validate_recordings([struck(peak_g=0.0), later], subject()))["exposure"]
    assert found["seat"]["suspect_s"] == pytest.approx(2.0, abs=0.05)
    assert all(each["suspect_s"] == 0.0 for each in found["segments"].values())


def test_no_verdict_is_agreement_where_the_strongest_motion_is_suspect():
    whole = struck()
    begin = round((STRIKE_S + 0.01) * RATE_HZ)
    report = report_of(with_seat_lost(whole, begin, begin + 45))
    texts = [finding.text for finding in report.findings if finding.what == "left_out"]
    assert len(texts) == len(MEASURED_SEGMENTS) and all("the VDV of the seat is up to " in text for text in texts)
    assert report.verdict != "agrees"


@pytest.mark.parametrize(("share", "is_left_out"), [(0.2, False), (0.5, True), (0.65, True)])
def test_a_mask_that_ends_in_a_shock_hides_no_left_out_motion(share, is_left_out):
    """The seat's weighting does not restart there: its VDV would be 1.4 times that of all samples."""
    whole = struck(**LONG)
    end = round((STRIKE_S + share * LONG["length_s"]) * RATE_HZ)
    found = report_of(with_head_masked(whole, end - 1000, end)).findings
    assert bool([one for one in found if (one.what, one.segment) == ("left_out", "head")]) == is_left_out


def test_a_loss_of_3_ms_is_left_out_of_both_injury_criteria():
    """It is suspect, and too short to be masked."""
    whole = struck(length_s=0.1)
    begin = round((STRIKE_S + 0.025) * RATE_HZ)
    lost = with_seat_lost(whole, begin, begin + 3)
    lost = dataclasses.replace(lost, measured_mps2=whole.measured_mps2, seat_invalid_s=0.0)
    for key in ("hic15", "hic36"):
        found = exposure_of(lost)[key]
        assert found["measured"]["vertical"] == pytest.approx(found["predicted"]["vertical"], rel=0.02)
        assert found["measured"]["vertical"] < exposure_of(whole)[key]["measured"]["vertical"]


def test_a_recorded_loss_is_stated_in_document_text_and_page():
    streams = imu_streams(
        subject(), load_case("rail", 8.0, np.random.default_rng(3)), np.random.default_rng(1), SensorSettings()
    )
    recorder = Recorder("rail", "rail_1")
    for stream in streams:
        there = np.ones(stream.stamps_ns.size, dtype=bool)
        if stream.sensor == "seat":
            felt = np.abs(stream.accel_mps2 - stream.accel_mps2[:1000].mean(axis=0)).max(axis=1)
            felt[:4000] = 0.0  # rest and warm-up
            at = int(felt.argmax())
            there[at : at + 20] = False
        recorder.push(stream.sensor, stream.stamps_ns[there], stream.accel_mps2[there])
    recordings = recorder.finish()
    assert max(one.seat_losses.max() for one in recordings) == 20
    report = validate_recordings(recordings, subject())
    document = validation_document(report)
    assert_listed("validate.json", document, frozenset({"bag_made_by_model"}))
    suspect_s = document["exposure"]["seat"]["suspect_s"]
    assert suspect_s == pytest.approx(40 * 20 / recordings[0].rate_hz, abs=0.07)  # and the loss and 50 ms at most
    warning = f"doses and DRI leave out, after losses within strong motion, seat {suspect_s:.3f} s"
    (line,) = (line for line in report.warnings if line.startswith("doses and DRI"))
    assert line.startswith(warning)
    assert f"warning: {line}" in text_of(report)
    assert line in validation_page(report)
    (row,) = (row for row in text_of(report).splitlines() if row.startswith("head  "))
    assert row.count(">=") == 2
