"""Validation: recordings with known deviations from the model, and the resulting documents and texts."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cache

import naive
import numpy as np
import pytest
from listed import assert_listed
from pages import no_drawings
from provenances import with_spread
from streams import independent_streams, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEGMENTS
from biodyn_core.body import usual_residual
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import SensorSettings, imu_streams, load_case
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.effects import CATALOGUE
from biodyn_core.recording.recording import WARM_UP_S, Recorder, Recording
from biodyn_core.signals.octaves import N_BANDS
from biodyn_core.signals.response import Peak, SpectrumSettings, cross_spectra
from biodyn_core.validation.validation import HeadPeaks, PeakRatio
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.wording import INTERVAL_MEANS
from biodyn_ros.commands.cli import main
from biodyn_ros.replay.replaying import replay
from biodyn_ros.simulate import simulate_bag
from biodyn_ros.validate.document import validation_document
from biodyn_ros.validate.findings import head_findings, verdict
from biodyn_ros.validate.page import validation_page
from biodyn_ros.validate.report import Report
from biodyn_ros.validate.settings import ValidationSettings
from biodyn_ros.validate.text import text_of
from biodyn_ros.validate.validating import ValidateOptions, validate, validate_recordings, write_validated

RATE_HZ = 1000.0
BEHIND = round(WARM_UP_S * RATE_HZ)
HEAD = MEASURED_SEGMENTS.index("head")
NECK = MEASURED_SEGMENTS.index("neck")


@cache
def event(seconds: float = 20.0, seed: int = 1, slow: float = 1.0, fast: float = 1.0) -> Recording:
    """Recording of ideal sensors; slow and fast: rms of the seat, m/s^2, at 1 to 10 Hz and at 15 to 45 Hz."""
    frequency = np.fft.rfftfreq(round(seconds * RATE_HZ), 1.0 / RATE_HZ)
    rng = np.random.default_rng(seed)
    seat = np.zeros(round(seconds * RATE_HZ))
    for rms, low, high in ((slow, 1.0, 10.0), (fast, 15.0, 45.0)):
        lines = (frequency > low) & (frequency < high)
        noise = np.fft.irfft(lines * np.exp(2j * np.pi * rng.random(frequency.size)), seat.size)
        seat += rms * noise / noise.std()
    seat *= np.minimum(np.arange(seat.size) / 500.0, 1.0)
    measured = Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    stamps = np.arange(seat.size) * 1_000_000
    return Recording("event", "rail", RATE_HZ, stamps, seat, measured, ("neck: something was odd",))


def with_measured(recording: Recording, change) -> Recording:
    measured = recording.measured_mps2.copy()
    change(measured)
    return dataclasses.replace(recording, measured_mps2=measured)


def report_of(*recordings: Recording, who: str = "subject_1", **options) -> Report:
    return validate_recordings(recordings, load_subject(subject_file(who)), ValidateOptions(**options))


def document_of(*recordings: Recording, who: str = "subject_1", **options) -> dict:
    return validation_document(report_of(*recordings, who=who, **options))


def kinds(document: dict) -> set[tuple[str, str, str]]:
    return {(finding["status"], finding["what"], finding["segment"]) for finding in document["findings"]}


# --- intervals of predictions --------------------------------------------------------------------------------------


def test_a_fitted_subject_has_intervals_of_its_predicted_figures():
    who = with_spread(subject())
    report = validate_recordings([event()], who)
    exposure = validation_document(report)["exposure"]
    assert exposure["no_interval"] is None
    factors = []
    for segment in exposure["segments"].values():
        predicted = segment["predicted"]
        assert "vdv_interval_mps175" not in (segment["measured"] or {})
        for figure in ("aw_{}mps2", "vdv_{}mps175", "peak_{}mps2"):
            lower, upper = predicted[figure.format("interval_")]
            assert lower * upper == pytest.approx(predicted[figure.format("")] ** 2)
            factors.append(upper / lower)
    assert min(factors) > 1.02 and max(factors) < 1.5
    assert "VDV m/s^1.75 measured predicted  95 % interval" in text_of(report)
    assert INTERVAL_MEANS in text_of(report)


def test_the_interval_is_that_of_a_replay_of_the_same_motion(tmp_path):
    """The causal filters of a replay change the shape of a signal and little of its spectrum."""
    bag, who = tmp_path / "road.mcap", with_spread(subject())
    simulate_bag(bag, subject(), load_case("road", 10.0, np.random.default_rng(3)), 3, SensorSettings())
    here = validation_document(validate(bag, who))["exposure"]["segments"]
    there = replay(bag, who).document["predicted"]
    for name, segment in here.items():
        (lower, upper), (lowest, uppermost) = (
            one["vdv_interval_mps175"] for one in (segment["predicted"], there[name])
        )
        assert upper / lower == pytest.approx(uppermost / lowest, rel=0.01)


def test_a_sensor_effect_changes_the_comparison_and_not_the_predicted_figures():
    """The sensor of the head reads 29 % too much, as the subject says; a factor of 1.25 is allowed for doses."""

    def louder(measured: np.ndarray) -> None:
        measured[:, HEAD] *= 1.29

    who = with_spread(subject())
    faulty = dataclasses.replace(who, effects=(CATALOGUE["gain"].sized("head", 0.29),))
    report = validate_recordings([with_measured(event(), louder)], faulty)
    document, plain = validation_document(report), validation_document(validate_recordings([event()], who))
    of_figures, of_plain = (one["exposure"]["segments"]["head"]["predicted"] for one in (document, plain))
    assert of_figures.keys() == of_plain.keys()
    for key, value in of_plain.items():
        assert of_figures[key] == pytest.approx(value), key
    assert document["exposure"]["hic15"]["predicted"] == plain["exposure"]["hic15"]["predicted"]
    assert document["error"]["segments"]["head"]["nrmse_rms_percent"] < 1e-6
    assert document["stht"]["peak_ratio"] == pytest.approx(1.0)
    assert ("disagrees", "vdv", "head") not in kinds(document)
    unknown = validate_recordings([event()], faulty)
    (finding,) = (each for each in unknown.findings if (each.what, each.segment) == ("vdv", "head"))
    assert finding.text.startswith("head: predicted VDV, as its sensor would read it, is 1.29 times the measured one")


def test_an_effect_of_other_axes_has_no_interval_and_a_reason(tmp_path):
    bag, pitch = tmp_path / "road.mcap", CATALOGUE["pitch"]
    simulate_bag(bag, subject(), load_case("road", 5.0, np.random.default_rng(3)), 3, SensorSettings())
    who = dataclasses.replace(with_spread(subject()), effects=(pitch.sized("seat", 0.1),))
    exposure = validation_document(validate(bag, who))["exposure"]
    assert exposure["no_interval"] == "its effect pitch needs more than the vertical acceleration of the seat"
    without = dataclasses.replace(who, effects=(pitch.sized("seat", 0.0),))
    assert validation_document(validate(bag, without))["exposure"]["no_interval"] is None


def test_without_a_fit_there_is_no_interval_and_a_reason():
    report = report_of(event())
    exposure = validation_document(report)["exposure"]
    assert "no covariance" in exposure["no_interval"]
    assert exposure["segments"]["head"]["predicted"]["vdv_interval_mps175"] is None
    assert "Predictions for subject_1 have no 95 % interval: its file has no covariance" in text_of(report)
    assert "predicted  95 % interval" not in text_of(report)


# --- agreement and disagreement -----------------------------------------------------------------------------------


def test_the_model_agrees_with_itself():
    document = document_of(event())
    assert document["verdict"] == "agrees"
    assert document["findings"] == []
    for error in document["error"]["segments"].values():
        assert error["nrmse_rms_percent"] == pytest.approx(0.0, abs=1e-9)
    for doses in document["exposure"]["segments"].values():
        assert (doses["measured"] or {}).items() <= doses["predicted"].items()
    assert document["stht"]["peak_ratio"] == 1.0
    assert document["exposure"]["hic15"]["measured"] == document["exposure"]["hic15"]["predicted"]


def test_another_integrator_agrees_too():
    recorder = Recorder("road", "drive")
    for stream in independent_streams(5.0):
        recorder.push(stream.sensor, stream.stamps_ns, stream.accel_mps2)
    document = document_of(*recorder.finish())
    assert document["error"]["mean_nrmse_rms_percent"] < 0.02
    for name in MEASURED_SEGMENTS:
        doses = document["exposure"]["segments"][name]
        assert doses["predicted"]["vdv_mps175"] == pytest.approx(doses["measured"]["vdv_mps175"], rel=2e-4)


def test_a_wrong_transmissibility_disagrees_despite_a_small_error_over_time():
    """As in the paper: 2.6 times too much at the head around its resonance, and a small error."""
    good = event(slow=0.03, fast=3.0)

    def damp(measured: np.ndarray) -> None:
        spectrum = np.fft.rfft(measured[:, HEAD])
        frequency = np.fft.rfftfreq(len(measured), 1.0 / RATE_HZ)
        spectrum[frequency < 12.0] /= 2.6
        measured[:, HEAD] = np.fft.irfft(spectrum, len(measured))

    report = report_of(with_measured(good, damp))
    document = validation_document(report)
    assert document["error"]["segments"]["head"]["nrmse_rms_percent"] < 20.0
    assert document["stht"]["peak_ratio"] == pytest.approx(2.6, rel=0.02)
    assert document["stht"]["measured"]["frequency_hz"] == pytest.approx(4.0, abs=0.5)
    assert ("disagrees", "stht", "head") in kinds(document)
    assert document["verdict"] == "disagrees"
    assert "ratio 2.6" in text_of(report)


def test_low_coherence_is_undecided():
    rng = np.random.default_rng(2)

    def drown(measured: np.ndarray) -> None:
        measured[:, HEAD] = 30.0 * rng.standard_normal(len(measured))

    document = document_of(with_measured(event(), drown))
    assert document["stht"]["peak_ratio"] is None
    assert ("undecided", "stht", "head") in kinds(document)


def test_a_short_event_is_undecided():
    report = report_of(event(seconds=4.5))
    document = validation_document(report)
    assert document["spectra"]["averages"]["head"] == pytest.approx(1.0)
    assert document["error"]["mean_nrmse_rms_percent"] < 1e-6
    assert document["verdict"] == "undecided"
    assert "apparent mass, predicted: the coherence is too low" in text_of(report)


def test_a_hidden_peak_of_the_prediction_is_undecided():
    rng = np.random.default_rng(3)

    def drown_slow(measured: np.ndarray) -> None:
        spectrum = np.fft.rfft(30.0 * rng.standard_normal(len(measured)))
        frequency = np.fft.rfftfreq(len(measured), 1.0 / RATE_HZ)
        measured[:, HEAD] += np.fft.irfft(np.where(frequency < 6.0, spectrum, 0.0), len(measured))

    document = document_of(with_measured(event(slow=0.3), drown_slow))
    assert ("undecided", "stht_peak_hidden", "head") in kinds(document)
    assert document["stht"]["predicted_anywhere"]["frequency_hz"] == pytest.approx(4.0, abs=0.5)


def test_another_person_disagrees():
    document = document_of(event(), who="subject_2")
    assert {("disagrees", "nrmse", name) for name in MEASURED_SEGMENTS} <= kinds(document)


@pytest.mark.parametrize(
    ("ratio", "error", "statuses"),
    [
        (1.0, 0.05, set()),
        (1.24, 0.05, set()),
        (1.26, 0.05, {"disagrees"}),
        (1 / 1.26, 0.05, {"disagrees"}),
        (1.1, 0.2, {"undecided"}),
        (1.4, 0.2, {"undecided"}),
        (2.0, 0.2, {"disagrees"}),
        (0.5, 0.2, {"disagrees"}),
    ],
)
def test_a_peak_disagrees_only_beyond_its_standard_error(ratio, error, statuses):
    peak = Peak(frequency_hz=4.0, magnitude=1.0)
    head = HeadPeaks(0.5, 1.0, peak, peak, peak, peak, PeakRatio(ratio, error, 1.0, coherence=0.9, is_distinct=True))
    found = list(head_findings(head, 20.0, ValidationSettings()))
    assert {finding.status for finding in found} == statuses
    assert verdict(found) == next(iter(statuses), "agrees")


def test_peaks_at_different_frequencies_disagree():
    document = document_of(event(), who="subject_1_as_printed")
    assert ("disagrees", "stht_frequency", "head") in kinds(document)


@pytest.mark.parametrize(("is_distinct", "status"), [(True, "disagrees"), (False, "undecided")])
def test_peaks_at_different_frequencies_disagree_only_beyond_their_errors(is_distinct, status):
    low, high = Peak(4.0, 1.0), Peak(8.0, 1.0)
    head = HeadPeaks(0.5, 1.0, low, high, high, high, PeakRatio(1.0, 0.05, 2.0, 0.9, is_distinct))
    (found,) = head_findings(head, 20.0, ValidationSettings())
    assert (found.status, found.what) == (status, "stht_frequency")


def test_another_motion_within_one_shock_is_not_called_coherent():
    """The head nods by itself, 15 % of its motion, while the seat has its only shock: no peak is known from that."""
    whole = event(14.0)
    burst = np.exp(-0.5 * ((np.arange(14000) - 8000) / 150.0) ** 2)
    seat = whole.seat_mps2 * (5.0 * burst + 0.01)
    moved = Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    for seed in range(5):
        nod = event(14.0, 100 + seed, slow=0.3, fast=0.3).seat_mps2 * burst
        nod *= 0.15 * moved[:, HEAD].std() / nod.std()
        measured = moved.copy()
        measured[:, HEAD] += nod
        document = document_of(dataclasses.replace(whole, seat_mps2=seat, measured_mps2=measured))
        assert document["spectra"]["averages"]["head"] < 1.5
        found = {(status, what) for status, what, _ in kinds(document)}
        assert found == {("undecided", "stht")} and document["verdict"] == "undecided"
        predicted = document["driving_point"]["predicted"]["peak"]
        assert predicted is not None and predicted["frequency_hz"] < 12.0  # no noise is in a prediction


# --- the figures -----------------------------------------------------------------------------------------------------


def test_errors_in_both_normalisations():
    def larger(measured: np.ndarray) -> None:
        measured *= 1.25

    recording = event()
    document = document_of(with_measured(recording, larger))
    truth = 1.25 * recording.measured_mps2[BEHIND:, HEAD]
    error = document["error"]["segments"]["head"]
    assert error["nrmse_rms_percent"] == pytest.approx(20.0)
    rms = math.sqrt(float(np.mean(truth**2)))
    assert error["nrmse_range_percent"] == pytest.approx(20.0 * rms / (truth.max() - truth.min()))
    assert error["rms_mps2"] == pytest.approx(0.2 * rms)
    assert error["compared_s"] == pytest.approx(18.0)
    assert document["error"]["mean_nrmse_rms_percent"] == pytest.approx(20.0)


def test_the_worst_segment_is_named_beside_the_mean():
    """The measured neck is halved: its error is 100 % of its rms, that of the others zero."""

    def halve(measured: np.ndarray) -> None:
        measured[:, NECK] *= 0.5

    report = report_of(with_measured(event(), halve))
    document = validation_document(report)
    error = document["error"]
    assert error["worst_segment"] == "neck"
    assert error["worst_nrmse_rms_percent"] == error["segments"]["neck"]["nrmse_rms_percent"]
    assert error["worst_nrmse_rms_percent"] == pytest.approx(100.0, rel=1e-6)
    assert error["mean_nrmse_rms_percent"] == pytest.approx(20.0, rel=1e-6)
    assert "error/rms: mean 20.0 %, worst neck 100 %" in text_of(report).splitlines()[:4]


def test_doses_and_injury_criteria_scale_by_their_exponents():
    def double(measured: np.ndarray) -> None:
        measured[:, HEAD] *= 2.0

    document = document_of(with_measured(event(), double))
    head = document["exposure"]["segments"]["head"]
    for key in ("aw_mps2", "vdv_mps175", "mtvv_linear_mps2", "mtvv_exponential_mps2", "peak_mps2"):
        assert head["measured"][key] == pytest.approx(2.0 * head["predicted"][key])
    hic = document["exposure"]["hic15"]
    assert hic["measured"]["vertical"] == pytest.approx(2.0**2.5 * hic["predicted"]["vertical"])
    # There is no resultant of one axis. Twice the motion has its largest HIC in the same window.
    assert set(hic["measured"]) - {"windows_s"} == set(hic["measured"]["windows_s"]) == {"as_printed", "vertical"}
    assert hic["measured"]["windows_s"]["vertical"] == hic["predicted"]["windows_s"]["vertical"]
    assert ("disagrees", "vdv", "head") in kinds(document)
    assert document["exposure"]["segments"]["central_torso"]["measured"] is None


def test_figures_are_those_of_slow_twins():
    recording = event()
    document = document_of(recording)
    weighted = naive.weighted("Wk", recording.measured_mps2[:, NECK], RATE_HZ)[BEHIND:]
    neck = document["exposure"]["segments"]["neck"]["measured"]
    assert neck["aw_mps2"] == pytest.approx(np.sqrt(np.mean(weighted**2)), rel=2e-3)
    assert neck["vdv_mps175"] == pytest.approx((np.sum(weighted**4) / RATE_HZ) ** 0.25, rel=2e-3)
    head_g = np.abs(recording.measured_mps2[BEHIND : BEHIND + 4000, HEAD]) / naive.GRAVITY
    short = dataclasses.replace(
        recording,
        stamps_ns=recording.stamps_ns[: BEHIND + 4000],
        seat_mps2=recording.seat_mps2[: BEHIND + 4000],
        measured_mps2=recording.measured_mps2[: BEHIND + 4000],
    )
    hic = document_of(short)["exposure"]["hic15"]["measured"]["vertical"]
    assert hic == pytest.approx(naive.head_injury(head_g, RATE_HZ, 0.015), rel=0.02)


def test_the_dynamic_response_of_a_drop_matches_the_reference():
    time = np.arange(8000) / RATE_HZ
    pulse = np.where((time > 3.0) & (time < 3.08), -5.0 * naive.GRAVITY * np.sin(np.pi * (time - 3.0) / 0.08), 0.0)
    measured = Chain.of(subject()).simulate(pulse, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    drop = Recording("drop", "rail", RATE_HZ, np.arange(8000) * 1_000_000, pulse, measured, ())
    dri = document_of(drop)["exposure"]["dri"]
    assert dri["as_printed"] == pytest.approx(6.47, abs=0.01)
    assert dri["compression"] == pytest.approx(3.08, abs=0.01)


def test_arrays_follow_the_stated_frequency_grid():
    recording = event()
    settings = SpectrumSettings(segment_s=4.0, lowest_hz=0.5, highest_hz=30.0)
    document = document_of(recording, spectra=settings)
    grid = document["spectra"]["frequency_hz"]
    assert grid == pytest.approx(np.arange(0.5, 30.01, 0.25))
    assert document["spectra"]["step_hz"] == pytest.approx(0.25)
    parts = [(recording.seat_mps2[BEHIND:], recording.measured_mps2[BEHIND:])]
    truth = cross_spectra(parts, RATE_HZ, settings)
    head = document["transmissibility"]["head"]["measured"]
    assert head["magnitude"] == pytest.approx(np.abs(truth.h1[:, HEAD]), rel=1e-5)
    assert head["phase_deg"] == pytest.approx(truth.phase_deg[:, HEAD], rel=1e-5)
    assert head["coherence"] == pytest.approx(truth.coherence[:, HEAD], rel=1e-5)
    power = document["power_spectral_density"]
    assert power["head"]["measured"]["psd_mps2_squared_per_hz"] == pytest.approx(truth.output_psd[:, HEAD], rel=1e-5)
    assert power["seat"]["measured"]["psd_mps2_squared_per_hz"] == pytest.approx(truth.input_psd[:, HEAD], rel=1e-5)
    assert "measured" not in power["central_torso"]
    assert document["transmissibility"]["central_torso"]["measured"] is None
    assert all(len(each["linear"]["magnitude"]) == len(grid) for each in document["transmissibility"].values())


def test_the_driving_point_has_both_normalisations():
    subject_1 = subject()
    fine = SpectrumSettings(segment_s=8.0)
    document = document_of(event(seconds=100.0), seat_force="joint", spectra=fine)
    point = document["driving_point"]
    assert point["upper_body_mass_kg"] == pytest.approx(0.581 * 58.6 * subject_1.parameters.mass_scale)
    linear = point["linear"]
    assert linear["peak"]["magnitude"] == pytest.approx(60.4, abs=0.06)  # NOTES: at 3.75 Hz
    assert linear["peak"]["frequency_hz"] == pytest.approx(3.75)
    assert linear["peak_by_body_mass"]["magnitude"] == pytest.approx(linear["peak"]["magnitude"] / 58.6)
    assert linear["peak_by_upper_body_mass"]["magnitude"] == pytest.approx(
        linear["peak"]["magnitude"] / point["upper_body_mass_kg"]
    )
    predicted = point["predicted"]
    frequency = np.array(document["spectra"]["frequency_hz"])
    np.testing.assert_allclose(
        predicted["impedance_n_s_per_m"], 2.0 * np.pi * frequency * predicted["apparent_mass_kg"], rtol=1e-4
    )
    assert predicted["peak"]["magnitude"] == pytest.approx(60.4, rel=0.05)  # this seat is nearly linear
    # Between its bands the seat does not move: values there are no apparent mass, and never its peak.
    still = (frequency > 11.0) & (frequency < 14.0)
    assert np.array(predicted["apparent_mass_kg"])[still].max() > 70.0
    assert np.array(predicted["coherence"])[still].max() < 0.5
    assert point["printed_band"] == [0.80, 0.95]


@pytest.mark.parametrize(("form", "lacks"), [("inertia", False), ("joint", True), ("paper", True)])
def test_forms_of_the_force_without_effects_say_so(form, lacks):
    report = report_of(event(5.0), seat_force=form)
    assert (", without effects in joint 1:" in text_of(report)) == lacks
    with no_drawings():
        page = validation_page(report)
    assert ("without effects in joint 1 such as thixotropy" in page) == lacks


def test_forces_of_cascade_masses_need_an_option():
    refused = report_of(event(), who="subject_1_as_printed")
    assert "as_printed" in validation_document(refused)["driving_point"]["refused"]
    assert "as_printed" in text_of(refused)
    report = report_of(event(), who="subject_1_as_printed", as_printed=True)
    printed = validation_document(report)
    assert printed["driving_point"]["as_printed"] is True
    assert printed["driving_point"]["linear"]["peak"]["magnitude"] > 150.0
    assert "as printed" in text_of(report)


# --- masks, warm-up, runs --------------------------------------------------------------------------------------------


def test_the_warm_up_only_settles_the_filters():
    def spoil(measured: np.ndarray) -> None:
        measured[: BEHIND - 1000] = 1e3

    good, spoilt = document_of(event()), document_of(with_measured(event(), spoil))
    for part in ("error", "transmissibility", "power_spectral_density", "stht"):
        assert spoilt[part] == good[part]


def test_a_shock_in_the_warm_up_is_in_no_figure():
    """A running rms cannot exceed the largest value, and no window of HIC reaches back."""

    def strike(measured: np.ndarray) -> None:
        measured[BEHIND - 600 : BEHIND - 540, HEAD] += 60.0

    good, struck = (document_of(one)["exposure"] for one in (event(), with_measured(event(), strike)))
    head = struck["segments"]["head"]["measured"]
    for key in ("mtvv_linear_mps2", "mtvv_exponential_mps2"):
        assert head[key] < 0.8 * head["peak_mps2"], key
    # The weighting itself rings on a little.
    assert head["mtvv_linear_mps2"] == pytest.approx(good["segments"]["head"]["measured"]["mtvv_linear_mps2"], rel=0.3)
    assert struck["hic15"]["measured"]["vertical"] == good["hic15"]["measured"]["vertical"]


def test_the_interval_of_a_masked_segment_is_that_of_its_counted_part():
    """Slow motion, of which the model misses 2 %, and then fast motion, of which it misses 40 %."""
    law = UsualResidual((0.02,) * N_BANDS, (0.02, 0.02, 0.02, 0.4, 0.4, 0.4), 100)
    known = usual_residual.to_provenance(dict.fromkeys(MEASURED_SEGMENTS, law))
    who = dataclasses.replace(with_spread(subject()), provenance=with_spread(subject()).provenance | known)
    late = np.arange(20000) >= 11000
    seat = np.where(late, event(slow=0.01, fast=3.0).seat_mps2, event(slow=1.0, fast=0.01).seat_mps2)
    moved = Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    whole = dataclasses.replace(event(), seat_mps2=seat, measured_mps2=moved)

    def factor(recording: Recording, segment: str) -> float:
        predicted = validation_document(validate_recordings([recording], who))["exposure"]["segments"][segment]
        lower, upper = predicted["predicted"]["vdv_interval_mps175"]
        return math.log(upper / lower)

    def lose(measured: np.ndarray) -> None:
        measured[11000:, NECK] = np.nan

    early = dataclasses.replace(
        whole, seat_mps2=seat[:11000], measured_mps2=moved[:11000], stamps_ns=whole.stamps_ns[:11000]
    )
    masked = with_measured(whole, lose)
    assert factor(masked, "neck") == pytest.approx(factor(early, "neck"), rel=1e-3)
    assert factor(masked, "pelvis") == factor(whole, "pelvis") > 1.3 * factor(early, "pelvis")


def test_masked_samples_are_excluded_on_both_sides():
    def mask(measured: np.ndarray) -> None:
        measured[8000:9000, HEAD] = np.nan

    document = document_of(with_measured(event(), mask))
    head = document["exposure"]["segments"]["head"]
    assert head["lower_bound"] is True
    assert head["measured"].items() <= head["predicted"].items()
    assert head["measured"]["counted_s"] == pytest.approx(17.0)
    assert document["error"]["segments"]["head"]["compared_s"] == pytest.approx(17.0)
    assert document["exposure"]["segments"]["neck"]["lower_bound"] is False
    assert document["exposure"]["hic15"]["lower_bound"] is True
    segments = document["spectra"]["segments"]
    assert segments["neck"] == 17
    assert segments["head"] == 5 + 10  # two seconds every second, in 6 s and in 11 s
    assert document["stht"]["peak_ratio"] == 1.0
    assert document["verdict"] == "agrees"


def test_a_short_mask_makes_a_lower_bound_but_the_end_of_a_run_does_not():
    def mask(measured: np.ndarray) -> None:
        measured[8000:8031, HEAD] = np.nan  # one clipped sample, as far as a low-pass of 200 Hz reaches
        measured[-40:, NECK] = np.nan

    segments = document_of(with_measured(event(), mask))["exposure"]["segments"]
    assert segments["head"]["lower_bound"] is True and segments["neck"]["lower_bound"] is False


def test_missing_seat_samples_make_all_doses_lower_bounds():
    exposure = document_of(dataclasses.replace(event(), seat_invalid_s=0.04))["exposure"]
    marked = [exposure["seat"], exposure["dri"], exposure["hic15"], *exposure["segments"].values()]
    assert all(each["lower_bound"] is True for each in marked)
    exposure = document_of(event())["exposure"]
    assert exposure["seat"]["lower_bound"] is False and exposure["dri"]["lower_bound"] is False


def struck(begin_s: float, strikes_s: float, seconds: float = 8.0) -> Recording:
    """A run from begin_s on the clock, in which the seat moves little but for the drop of the reference."""
    time = begin_s + np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    seat = 0.02 * event(seconds, seed=4).seat_mps2
    here = (time > strikes_s) & (time < strikes_s + 0.08)
    seat -= np.where(here, 5.0 * naive.GRAVITY * np.sin(np.pi * (time - strikes_s) / 0.08), 0.0)
    measured = Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    return Recording("drop", "rail", RATE_HZ, np.rint(1e9 * time).astype(np.int64), seat, measured, ())


def test_a_shock_soon_after_a_gap_of_the_seat_stays_in_the_figures_of_the_seat():
    """Runs from 0 to 8 s and from 8.1 to 16.1 s with the reference drop at 9 s, in the warm-up of the second."""
    first, second = struck(0.0, strikes_s=9.0), struck(8.1, strikes_s=9.0)
    report = report_of(first, second)
    exposure = validation_document(report)["exposure"]
    assert exposure["dri"]["as_printed"] == pytest.approx(6.47, abs=0.1)
    assert exposure["dri"]["compression"] == pytest.approx(3.08, abs=0.1)
    assert exposure["seat"]["counted_s"] == pytest.approx(6.0 + 8.0)
    weighted = np.concatenate(
        [naive.weighted("Wk", run.seat_mps2, RATE_HZ)[begin:] for run, begin in ((first, BEHIND), (second, 0))]
    )
    assert exposure["seat"]["vdv_mps175"] == pytest.approx((np.sum(weighted**4) / RATE_HZ) ** 0.25, rel=2e-3)
    # The model settles after the gap, so no figure of a segment contains the shock.
    head = exposure["segments"]["head"]
    assert head["measured"]["counted_s"] == head["predicted"]["counted_s"] == pytest.approx(6.0 + 6.0)
    assert head["measured"]["vdv_mps175"] < 0.3 * exposure["seat"]["vdv_mps175"]


def test_a_gap_of_the_seat_makes_all_doses_lower_bounds():
    report = report_of(struck(0.0, strikes_s=9.0), struck(8.1, strikes_s=9.0))
    exposure = validation_document(report)["exposure"]
    marked = [exposure["seat"], exposure["dri"], exposure["hic15"], *exposure["segments"].values()]
    assert all(each["lower_bound"] is True for each in marked)
    assert exposure["dri"]["class_lower_bound"] is True
    (row,) = (line for line in text_of(report).splitlines() if line.startswith("head  "))
    assert row.count(">=") == 2
    left_out = document_of(dataclasses.replace(event(), left_out_s=2.5))["exposure"]
    assert left_out["seat"]["lower_bound"] is True and left_out["segments"]["neck"]["lower_bound"] is True


def test_no_verdict_is_agreement_without_the_strongest_motion_of_the_seat():
    """The model itself made both recordings; only the second is compared while the seat is struck."""
    settled = document_of(event(seed=1), struck(20.1, strikes_s=25.0))
    assert not [each for each in settled["findings"] if each["what"] == "left_out"]
    unsettled = document_of(event(seed=1, slow=0.3, fast=0.3), struck(20.1, strikes_s=21.0))
    assert {("undecided", "left_out", name) for name in MEASURED_SEGMENTS} <= kinds(unsettled)
    assert unsettled["verdict"] == "undecided"


def test_a_segment_that_is_masked_in_the_strongest_motion_of_the_seat_is_undecided():
    def lose(measured: np.ndarray) -> None:
        measured[4900:6500, HEAD] = np.nan

    document = document_of(with_measured(struck(0.0, strikes_s=5.0, seconds=20.0), lose))
    assert [each["segment"] for each in document["findings"] if each["what"] == "left_out"] == ["head"]
    (text,) = (each["text"] for each in document["findings"] if each["what"] == "left_out")
    assert text.startswith("head: not compared in the strongest motion: the VDV of the seat is ")


@pytest.mark.parametrize("rate_hz", [250.0, 300.0])
def test_a_complete_recording_of_slow_sensors_is_no_lower_bound(rate_hz):
    """Filter and interpolation of 250 Hz lack 0.2 s more at the end than the seat; a sensor that stops early, more."""
    sensors = SensorSettings(rate_hz=rate_hz, range_g=200.0)
    streams = imu_streams(
        subject(), load_case("road", 8.0, np.random.default_rng(3)), np.random.default_rng(1), sensors
    )

    def recorded(lost_s: float) -> dict:
        recorder = Recorder("road", "drive")
        for stream in streams:
            count = stream.stamps_ns.size - round(lost_s * rate_hz * (stream.sensor == "neck"))
            recorder.push(stream.sensor, stream.stamps_ns[:count], stream.accel_mps2[:count])
        return document_of(*recorder.finish())

    complete = recorded(0.0)
    assert not any(segment["lower_bound"] for segment in complete["exposure"]["segments"].values())
    assert not [line for line in complete["warnings"] if "nothing usable" in line]
    assert "lower_bound" not in complete["exposure"]["hic15"]
    early = recorded(0.2)
    assert [name for name, one in early["exposure"]["segments"].items() if one["lower_bound"]] == ["neck"]
    assert [line.split(":")[0] for line in early["warnings"] if "nothing usable" in line] == ["neck"]


def test_a_segment_with_few_compared_samples_is_undecided():
    def lose(measured: np.ndarray) -> None:
        measured[BEHIND + 400 :, NECK] = np.nan

    document = document_of(with_measured(event(), lose))
    assert ("undecided", "too_short", "neck") in kinds(document) and document["verdict"] == "undecided"

    def weaken(measured: np.ndarray) -> None:
        lose(measured)
        measured[:, NECK] *= 0.6

    assert document_of(with_measured(event(), weaken))["verdict"] == "undecided"


def test_the_bandwidth_of_injury_criteria_is_that_of_the_low_pass():
    assert document_of(event())["exposure"]["hic15"]["bandwidth_hz"] == 100.0


def test_a_segment_without_sensor_is_undecided():
    def lose(measured: np.ndarray) -> None:
        measured[:, HEAD] = np.nan

    report = report_of(with_measured(event(), lose))
    document = validation_document(report)
    assert document["error"]["segments"]["head"] is None
    assert document["transmissibility"]["head"]["measured"] is None
    assert document["exposure"]["hic15"]["measured"] is None
    assert ("undecided", "not_measured", "head") in kinds(document)
    assert document["verdict"] == "undecided"
    assert "not measured" in text_of(report)


def test_runs_of_one_event_are_pooled():
    first = event(seed=1)
    second = with_measured(event(seed=2), lambda measured: np.multiply(measured, 1.25, out=measured))
    second = dataclasses.replace(second, stamps_ns=second.stamps_ns + 21_000_000_000)
    document = document_of(first, second)
    truth = np.concatenate([first.measured_mps2[BEHIND:], second.measured_mps2[BEHIND:]])[:, HEAD]
    error = 0.2 * second.measured_mps2[BEHIND:, HEAD]
    share = 100.0 * math.sqrt(float(np.sum(error**2) / np.sum(truth**2)))
    assert document["error"]["segments"]["head"]["nrmse_rms_percent"] == pytest.approx(share)
    assert document["runs"] == 2
    assert document["seconds"] == pytest.approx(40.0)
    one, other = (document_of(r)["exposure"]["segments"]["head"]["measured"] for r in (first, second))
    both = document["exposure"]["segments"]["head"]["measured"]
    assert both["counted_s"] == pytest.approx(36.0)
    pooled = (one["vdv_mps175"] ** 4 + other["vdv_mps175"] ** 4) ** 0.25
    # The second run's filters start behind a break, in strong motion: 2 s are left out.
    assert 0.97 * pooled < both["vdv_mps175"] < pooled and document["exposure"]["segments"]["head"]["suspect_s"] == 2.0
    assert document["warnings"][:-1] == ["neck: something was odd"]


@pytest.mark.parametrize("pulse_s", [10.0, 16.0])
def test_the_window_in_a_later_run_has_the_time_of_the_clock(pulse_s: float) -> None:
    """Runs of 5 s begin at 0, 6 and 12 s; a pulse of the head at 10 s is 8 s after the first warm-up."""

    def run(begin_s: float) -> Recording:
        still = event(5.0)
        since_s = begin_s + 1e-9 * still.stamps_ns
        head = np.where(np.abs(since_s - pulse_s) < 0.0055, 50.0, 0.0)
        one = with_measured(still, lambda measured: np.copyto(measured[:, HEAD], head))
        return dataclasses.replace(one, stamps_ns=still.stamps_ns + round(1e9 * begin_s))

    hic = document_of(run(0.0), run(6.0), run(12.0))["exposure"]["hic15"]["measured"]
    assert np.mean(hic["windows_s"]["vertical"]) == pytest.approx(pulse_s - WARM_UP_S, abs=1e-6)


def test_a_model_that_diverges_is_refused():
    wild = dataclasses.replace(event(), seat_mps2=1e7 * event().seat_mps2)
    with pytest.raises(InputError, match="diverges: fit it again"), np.errstate(all="ignore"):
        document_of(wild)


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_bag_becomes_a_document(tmp_path):
    bag = tmp_path / "rail_1.mcap"
    simulate_bag(bag, subject(), load_case("rail", 8.0, np.random.default_rng(3)), 3, SensorSettings())
    validated = validate(bag, subject())
    write_validated(validated, tmp_path / "out" / "deep", report=False)
    written = json.loads((tmp_path / "out" / "deep" / "validate.json").read_text(encoding="utf-8"))
    assert written == json.loads(json.dumps(validation_document(validated), allow_nan=False))
    assert_listed("validate.json", written)
    assert written["case"] == "rail"
    assert written["path"] == "zero_phase"
    assert "made by the model itself" in written["bag_made_by_model"]
    assert "made by the model itself" in text_of(validated)
    assert written["error"]["mean_nrmse_rms_percent"] < 15.0  # offsets of the clocks, 0.2 ms
    assert set(written["transmissibility"]) == set(SEGMENTS)
    assert len(validated.validation.runs) == 1
    for name in MEASURED_SEGMENTS:
        doses = written["exposure"]["segments"][name]
        assert doses["predicted"]["vdv_mps175"] == pytest.approx(doses["measured"]["vdv_mps175"], rel=0.02)


def test_an_invalid_directory_is_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "file").touch()
    bag = tmp_path / "road.mcap"
    simulate_bag(bag, subject(), load_case("road", 6.0, np.random.default_rng(3)), 3, SensorSettings())
    assert main(["validate", str(bag), "--subject", "subject_1", "-o", str(tmp_path / "file")]) == 2
    refused = capsys.readouterr().err
    assert "is a file; the results need a directory" in refused and refused.count("\n") == 1


def test_a_refused_bag_leaves_no_directory(tmp_path, capsys):
    bag, out = tmp_path / "none.mcap", tmp_path / "out"
    assert main(["validate", str(bag), "--subject", "subject_1", "-o", str(out)]) == 2
    assert "cannot be read" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
