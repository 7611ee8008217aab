"""The pages of validations, fits, campaigns and replays: their numbers and curves are those of the documents.

Missing values are reported; names from outside stay text.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_report
import test_streamed_spectra as streamed
from pages import NASTY, Page, assert_self_contained, empty_drawings, lines, svg_text
from provenances import with_spread
from streams import simulated, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS, UNFITTED
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.profiles import Profile
from biodyn_core.identification.settings import FitSettings
from biodyn_core.identification.uncertainty import Estimate
from biodyn_core.pipeline.frames import NO_PREDICTED, Frames
from biodyn_core.recording.recording import Recording
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.wording import INTERVAL_MEANS, number, with_interval
from biodyn_ros.commands.cli import main
from biodyn_ros.fit import campaign as campaigns
from biodyn_ros.fit import page as fit_report
from biodyn_ros.fit.campaign import fit_campaign
from biodyn_ros.fit.campaign_file import load_campaign
from biodyn_ros.fit.campaign_page import campaign_page, campaign_verdict, write_campaign_page
from biodyn_ros.fit.campaign_results import CampaignReport, Row
from biodyn_ros.fit.document import fit_document
from biodyn_ros.fit.drawings import ESTIMATE_COLOUR, correlation, intervals, place, profiles, subjects
from biodyn_ros.fit.fitting import FitOptions, fit_bags, write_fitted
from biodyn_ros.fit.page import compared_events, fit_page, limitations, write_fit_page
from biodyn_ros.fit.report import Report as FitReport
from biodyn_ros.fit.summary import FitSummary, fit_verdict, read_summary, summary_of
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.replay.page import frequency_parts
from biodyn_ros.replay.traces import Traces
from biodyn_ros.reports.frequency import driving_point, residual_channels, transmissibility, waterfall
from biodyn_ros.reports.pages import render
from biodyn_ros.validate import page as validate_report
from biodyn_ros.validate.document import validation_document
from biodyn_ros.validate.page import residual_waterfall, strongest_event, tone, validation_page
from biodyn_ros.validate.report import Report
from biodyn_ros.validate.validating import validate_recordings, write_validated

RATE_HZ = 400.0
ODD = f"{NASTY}\udcff"
PERSON = "<b>anna</b> $y$"
DARK, ORANGE = "#1f2933", "#d9480f"

Document = dict[str, Any]


# --- validation ------------------------------------------------------------------------------------------------------


def recording(seconds: float = 12.0) -> Recording:
    """Output of perfect sensors on subject 1 in a noise of 1 to 40 Hz with one blow; the neck has no sensor."""
    rng = np.random.default_rng(5)
    frequency = np.fft.rfftfreq(round(seconds * RATE_HZ), 1.0 / RATE_HZ)
    spectrum = ((frequency > 1.0) & (frequency < 40.0)) * np.exp(2j * np.pi * rng.random(frequency.size))
    seat = np.fft.irfft(spectrum, round(seconds * RATE_HZ))
    seat *= np.minimum(np.arange(seat.size) / 200.0, 1.0) / seat.std()
    seat[3000:3008] += 20.0
    measured = Chain.of(subject()).simulate(seat, RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    measured[:, MEASURED_SEGMENTS.index("neck")] = np.nan
    stamps = np.arange(seat.size) * 2_500_000
    return Recording("event", "rail", RATE_HZ, stamps, seat, measured, ("neck: no <i>sensor</i>",))


@pytest.fixture(scope="module")
def validated() -> Report:
    who = dataclasses.replace(with_spread(load_subject(subject_file("subject_2"))), name=PERSON)
    return validate_recordings([recording()], who, bag=ODD)


@pytest.fixture(scope="module")
def validation(validated: Report) -> str:
    return validation_page(validated)


def test_the_page_of_a_validation_has_the_numbers_of_its_document(validated: Report, validation: str) -> None:
    text, document = Page(validation.encode("utf-8", "backslashreplace").decode()).text, validation_document(validated)
    assert "Disagrees with the measurement" in text and '<section class="strip bad"' in validation
    for finding in document["findings"]:
        assert finding["text"][1:] in text
    for name, error in document["error"]["segments"].items():
        if error is None:
            assert f"{name} not measured" in text
            continue
        row = [number(error[key]) for key in ("rms_mps2", "measured_rms_mps2", "nrmse_rms_percent")]
        assert " ".join([name.replace("_", " "), *row]) in text
    point = document["driving_point"]["predicted"]
    for key in ("peak", "peak_by_body_mass", "peak_by_upper_body_mass", "impedance_peak"):
        assert f"{number(point[key]['magnitude'])} {number(point[key]['frequency_hz'])}" in text
    assert f"ratio of peaks {number(document['stht']['peak_ratio'])}" in text
    percents = {name: of["nrmse_rms_percent"] for name, of in document["error"]["segments"].items() if of}
    worst = max(percents, key=percents.__getitem__)
    mean = number(sum(percents.values()) / len(percents))
    worst_said = f"worst {worst.replace('_', ' ')} {number(percents[worst])}"
    assert f"error over time, % of rms mean {mean}, {worst_said} 20 each" in text
    for segment, of in document["exposure"]["segments"].items():
        for side in ("measured", "predicted"):
            if of[side]:
                assert f"{number(of[side]['vdv_mps175'])} {side}" in svg_text(validation), segment
    assert number(document["exposure"]["dri"]["compression"]) in svg_text(validation)
    assert "Limitations" in text and "No force was measured" in text
    assert "with its 95 % interval" in text and INTERVAL_MEANS in text


def test_every_drawing_of_a_validation_names_quantity_and_unit(validation: str) -> None:
    drawings = re.findall(r"<svg.*?</svg>", validation, flags=re.DOTALL)
    expected = (
        ("vertical acceleration, m/s²", "seconds since the first predicted instant", "not measured"),
        ("|segment / seat|, no unit", "coherence", "frequency, Hz", "not measured", "central torso"),
        ("amplitude, m/s²", "PSD, (m/s²)²/Hz", "Hz", "seat", "not measured"),
        ("|head / seat|, no unit", "|force / acceleration|, kg", "|force / velocity|, N s/m", "phase, degrees",
         "over body mass, no unit"),
        ("VDV, Wk-weighted, vertical, m/s¹·⁷⁵", "neck"),
        ("DRI of the measured seat, no unit", "HIC of the head, g^2.5 s", "HIC15 |vertical|", "17.7"),
        ("frequency, Hz", "power, dB re 1 (m/s²)²/Hz", "predicted minus measured"),
    )  # fmt: skip
    assert len(drawings) == len(expected)
    for drawing, texts in zip(drawings, expected, strict=True):
        for text in texts:
            assert text in svg_text(drawing), text


def test_a_validation_is_one_file_that_is_the_same_again(validated: Report, validation: str) -> None:
    assert_self_contained(validation)
    found = residual_waterfall(validated.validation)
    for svg in (
        driving_point(validation_document(validated)),
        waterfall(found, residual_channels(validation_document(validated)["error"]["worst_segment"]), 0),
    ):
        assert svg in validation


def test_names_from_outside_are_text_on_a_validation(validation: str) -> None:
    page = Page(validation.encode("utf-8", "backslashreplace").decode())
    assert not {"script", "i"} & set(page.tags) and "<b>anna" not in validation
    assert f"Validation of {PERSON} on {NASTY}\\udcff" in page.text and "neck: no <i>sensor</i>" in page.text


@pytest.fixture(scope="module")
def responses(validated: Report) -> str:
    """The drawn transmissibilities of the validation."""
    return transmissibility(validation_document(validated), 0.5)


def test_the_drawn_transmissibility_is_the_documents(validated: Report, responses: str) -> None:
    document, svg = validation_document(validated), responses
    (found,) = (line for line in lines(svg, DARK, 1.7)[:1])
    of = document["transmissibility"]["head"]["measured"]
    frequency = np.array(document["spectra"]["frequency_hz"])
    shown = frequency[0] * (max(frequency[-1], 50.0) / frequency[0]) ** found.points[:, 0]
    loudest = int(np.argmax(found.points[:, 1]))
    assert shown[loudest] == pytest.approx(document["stht"]["measured"]["frequency_hz"], rel=0.01)
    ratio = np.log10(max(of["magnitude"]) / of["magnitude"][0])
    heights = found.points[loudest, 1] - found.points[0, 1]
    assert ratio / heights == pytest.approx(3.0, abs=0.02)  # the panel is three decades high
    assert not found.dashed
    assert all(line.dashed for line in lines(svg, ORANGE, 1.3))


def test_incoherent_lines_are_thin(validated: Report, responses: str) -> None:
    document = copy.deepcopy(validation_document(validated))
    known_lines = len(lines(responses, DARK, 1.7))
    document["transmissibility"]["head"]["measured"]["coherence"] = [0.1] * len(document["spectra"]["frequency_hz"])
    svg = transmissibility(document, 0.5)
    assert len(lines(svg, DARK, 0.6)) == 4  # of four measured segments
    assert len(lines(svg, DARK, 1.7)) == known_lines - 1  # the coherence beneath stays
    refused = document | {"driving_point": {"refused": "set as_printed"}}
    assert svg_text(driving_point(refused)).count("refused, see below") == 4


def test_a_recording_made_by_the_model_is_never_green() -> None:
    assert tone("agrees", is_made_by_model=False) == "good" and tone("agrees", is_made_by_model=True) == "none"


def test_the_event_that_is_drawn_is_the_strongest(validated: Report) -> None:
    event, whole = strongest_event(validated.validation), recording()
    head = whole.measured_mps2[:, MEASURED_SEGMENTS.index("head")]
    strongest = max(np.abs(whole.seat_mps2[800:]).max(), np.abs(head[800:]).max())
    assert event is not None and event.peak_mps2 == strongest
    assert abs(event.peak_ns - 3004 * 2_500_000) < 200_000_000
    assert np.isnan(event.measured_mps2[:, 1 + MEASURED_SEGMENTS.index("neck")]).all()


def test_a_validation_is_written_first_and_drawn_after(
    validated: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(validate_report, "validation_page", lambda found: f"page of {ODD}")
    write_validated(validated, tmp_path / "with")
    assert (tmp_path / "with" / "validate.html").read_text() == f"page of {NASTY}\\udcff"
    write_validated(validated, tmp_path / "without", report=False)
    assert [path.name for path in (tmp_path / "without").iterdir()] == ["validate.json"]

    monkeypatch.setattr(validate_report, "validation_page", lambda found: {}["nothing"])
    with pytest.raises(InputError, match=r"validate\.html: cannot be drawn \(KeyError: 'nothing'\); all other results"):
        write_validated(validated, tmp_path / "with")
    assert [path.name for path in (tmp_path / "with").iterdir()] == ["validate.json"]


# --- fit -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> FitReport:
    """Of a road and a rail, another road held out; names that are a nuisance."""
    cases = {"<script>road": "road", "rail": "rail", "spare": "road"}
    bags = simulated(tmp_path_factory.mktemp("bags"), 3.0, cases)
    swarm = SwarmSettings(particles=20, iterations=20, starts=1)
    settings = FitSettings(swarm=swarm, refined_starts=1, evaluations=60)
    given = dataclasses.replace(load_subject(subject_file("subject_2")), name=PERSON)
    options = FitOptions(settings=settings, held_out=(str(bags["spare"]),), cases={str(bags["spare"]): "road"})
    return fit_bags([bags["<script>road"], bags["rail"]], given, options)


@pytest.fixture(scope="module")
def page(fitted: FitReport) -> str:
    return fit_page(fitted)


def test_the_page_of_a_fit_has_the_numbers_of_its_document(fitted: FitReport, page: str) -> None:
    text, document = Page(page).text, fit_document(fitted)
    held_out = document["held_out"][0]["joint"]
    assert f"not fitted to with a mean error of {number(held_out['mean'])} % of their rms" in text
    assert " ".join(["joint", *map(number, held_out["nrmse_rms"].values()), number(held_out["mean"])]) in text
    for name, of in document["intervals"].items():
        if not of["at_bound"]:
            unit = "" if of["unit"] == "-" else f" {of['unit']}"
            value, lower, upper = with_interval(of["value"], of["lower"], of["upper"])
            assert lower != upper, name
            expected = f"{value} ({lower} to {upper}){unit}, "
            assert expected + document["identifiable"][name] in svg_text(page), name
    assert "None requested: use --profile NAME" in text and "The mass scale was fixed" in text
    assert text.count(MADE_BY_MODEL) == 1 and "3 of 3 recordings: " in text


def test_a_person_without_parameters_is_compared_with_the_middle_of_table_1(fitted: FitReport, page: str) -> None:
    unfitted = dataclasses.replace(fitted, given=dataclasses.replace(fitted.given, parameters=UNFITTED))
    with empty_drawings():
        other = Page(fit_page(unfitted)).text
    assert "given subject" in Page(page).text and "middle of Table 1" not in Page(page).text
    assert "middle of Table 1" in other and "given subject" not in other


def test_every_drawing_of_a_fit_names_quantity_and_unit(page: str) -> None:
    drawings = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    expected = (
        ("place between the bounds of Table 1, logarithmic, no unit", "natural frequency, head", "stiffening scale"),
        (
            "vertical acceleration; below, model minus measured; m/s²",
            "s since the start of the event",
            "residual, % of rms",
        ),
        ("power spectral density, (m/s²)²/Hz", "Hz", "upper torso"),
        ("correlation of the estimates' logarithms, no unit", "damping ratio, neck"),
    )
    assert len(drawings) == len(expected)
    for drawing, texts in zip(drawings, expected, strict=True):
        for text in texts:
            assert text in svg_text(drawing), text


def test_a_fit_is_one_file_that_is_the_same_again(fitted: FitReport, page: str) -> None:
    assert_self_contained(page)
    assert "script" not in Page(page).tags and f"Fit of {PERSON}" in Page(page).text
    assert drawn_intervals(fitted) in page and correlation(fitted.uncertainty) in page


def drawn_intervals(fitted: FitReport) -> str:
    return intervals(fitted.uncertainty.estimates, [fit.subject.parameters for fit in fitted.identification.fits])


def inside(fitted: FitReport) -> tuple[Estimate, ...]:
    """The estimates as if all were identifiable and none lay on a bound."""
    sure = {"at_bound": False, "identifiability": "identifiable"}
    return tuple(dataclasses.replace(each, **sure) for each in fitted.uncertainty.estimates)


def test_drawn_intervals_lie_where_the_document_has_them(fitted: FitReport) -> None:
    svg, document = intervals(inside(fitted), []), fit_document(fitted)
    drawn = [line.points[:, 0] for line in lines(svg, ESTIMATE_COLOUR, 2.2) if len(line.points) == 2]
    assert len(drawn) == len(document["intervals"]) == 14
    low, high = -0.11, 1.66
    bounds = {parameter.name: (parameter.lower, parameter.upper) for parameter in PARAMETERS}
    for (name, of), ends in zip(document["intervals"].items(), drawn, strict=True):
        lower, upper = bounds[name]
        expected = [math.log(of[end] / lower) / math.log(upper / lower) for end in ("lower", "upper")]
        np.testing.assert_allclose(low + (high - low) * ends, expected, atol=2e-4)
    assert place("natural_frequency_hz[pelvis]", math.sqrt(5.0 * 15.0)) == pytest.approx(0.5)


def test_a_parameter_on_its_bound_has_no_interval_and_keeps_a_fit_from_green(fitted: FitReport) -> None:
    good = FitSummary((2.0,), (3.0,), inside(fitted), "segment", None, 1, 1, is_made_by_model=False)
    assert fit_verdict(good).tone == "good"
    assert fit_verdict(dataclasses.replace(good, is_made_by_model=True)).tone == "none"
    pinned = [dataclasses.replace(each, at_bound=each.name == "damping_ratio[head]") for each in good.estimates]
    summary = dataclasses.replace(good, estimates=tuple(pinned))
    found = fit_verdict(summary)
    assert found.tone == "warn" and any("On a bound of Table 1" in line for line in found.reasons)
    assert "damping ratio, head" in found.reasons[-1]
    (value,) = (each.value for each in pinned if each.at_bound)
    assert f"{number(value)}, on its bound" in svg_text(intervals(pinned, []))
    unknown = [dataclasses.replace(each, identifiability="not identifiable") for each in good.estimates]
    reasons = fit_verdict(dataclasses.replace(good, estimates=tuple(unknown))).reasons
    assert "Not identifiable from these recordings: all 14 parameters." in reasons
    assert fit_verdict(dataclasses.replace(summary, held_out=(25.0,))).tone == "bad"
    alone = fit_verdict(dataclasses.replace(summary, held_out=()))
    assert "not known" in alone.headline and alone.tone == "none"


def test_the_summary_of_a_fit_is_that_of_its_file(fitted: FitReport, tmp_path: Path) -> None:
    write_fitted(fitted, tmp_path / "anna.yaml")
    read, summary = read_summary(tmp_path / "anna.fit.json"), summary_of(fitted)
    for one, other in zip(read.estimates, summary.estimates, strict=True):
        assert one.half_width == pytest.approx(other.half_width, rel=1e-12)
    estimates = tuple(
        dataclasses.replace(one, half_width=other.half_width)
        for one, other in zip(read.estimates, summary.estimates, strict=True)
    )
    assert dataclasses.replace(read, estimates=estimates) == summary
    document = json.loads((tmp_path / "anna.fit.json").read_text())
    document["held_out"][0][document["result"]]["mean"] = None  # as for an unstable prediction
    (tmp_path / "anna.fit.json").write_text(json.dumps(document))
    found = fit_verdict(read_summary(tmp_path / "anna.fit.json"))
    assert (found.tone, found.headline) == ("bad", "The model diverges in 1 of 3 events")
    assert "inf" not in " ".join(found.reasons)
    (tmp_path / "anna.fit.json").write_text("[3]")
    with pytest.raises(InputError, match=r"^.*anna\.fit\.json: is not a fit\.json of biodyn; fit the subject again$"):
        read_summary(tmp_path / "anna.fit.json")


def test_the_page_of_a_fit_that_diverges_draws_no_prediction_there(
    fitted: FitReport, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = np.full(len(MEASURED_SEGMENTS), np.nan)
    *events, held_out = fitted.events
    errors = {
        name: dataclasses.replace(error, nrmse_rms_percent=lost, nrmse_range_percent=lost)
        for name, error in held_out.errors.items()
    }
    diverging = dataclasses.replace(fitted, events=(*events, dataclasses.replace(held_out, errors=errors)))

    def predictions(subject: Subject, cases: Sequence[Case]) -> Iterator[np.ndarray]:
        given = subject == fitted.given
        return (np.where(given, case.measured_mps2, 1e200 * case.measured_mps2) for case in cases)

    monkeypatch.setattr(fit_report, "predictions", predictions)
    (compared,) = compared_events(diverging, diverging.held_out)
    assert np.isnan(compared.after_mps2).all() and np.isfinite(compared.before_mps2).any()
    with empty_drawings():
        source = fit_page(diverging)
    text = Page(source).text
    assert "joint – – – – – diverges" in text and "The model diverges in 1 of 3 events" in text
    assert "There is no spectrum: a model diverges in each event." in text
    assert "inf" not in re.findall(r"[a-z]+", text) and "nan" not in re.findall(r"width: ([a-z]+)", source)


def test_one_case_and_unmeasured_segments_are_limitations(fitted: FitReport) -> None:
    event = fitted.fitted[0]
    energy = np.where(np.array(MEASURED_SEGMENTS) == "lower_torso", 0.0, event.case.energy)
    one = dataclasses.replace(event, case=dataclasses.replace(event.case, energy=energy))
    limits = " ".join(limitations(dataclasses.replace(fitted, events=(one,))))
    assert "One case alone" in limits and "lower torso" in limits
    assert len(lines(intervals(fitted.uncertainty.estimates, []), DARK, 0.9)) == 0
    assert len(lines(drawn_intervals(fitted), DARK, 0.9)) == 2 * 14  # a tick for each case and parameter


def test_profiles_show_the_mark_and_open_sides(fitted: FitReport) -> None:
    name = "natural_frequency_hz[head]"
    profile = Profile(name, np.array([8.0, 10.0, 11.0]), np.array([4e-5, 0.0, 1e-5]), 2e-5, 8.9, None)
    assert fitted.profiles == () and profiles(()) is None
    svg = profiles([profile])
    assert svg is not None
    for text in ("natural frequency, head", "value, Hz", "over the 95 % limit, no unit", "open"):
        assert text in svg_text(svg)
    (curve,) = lines(svg, ESTIMATE_COLOUR, 1.3)
    x, y = curve.points.T
    assert (x[1] - x[0]) / (x[2] - x[1]) == pytest.approx(2.0, rel=0.01)
    assert (y[0] - y[1]) / (y[2] - y[1]) == pytest.approx(4.0, rel=0.01)


def test_the_correlation_is_that_of_the_covariance(fitted: FitReport) -> None:
    document = fit_document(fitted)
    found, names = np.array(document["correlation"]["matrix"]), document["correlation"]["names"]
    assert found.shape == (len(names), len(names)) and set(names) <= set(document["intervals"])
    np.testing.assert_allclose(np.diag(found), 1.0)
    np.testing.assert_allclose(found, found.T)
    half = {name: of["half_width_percent"] for name, of in document["intervals"].items()}
    assert all(half[name] is not None for name in names)
    pair = np.array([[4.0, -0.873 * 6.0], [-0.873 * 6.0, 9.0]])
    names = ("natural_frequency_hz[head]", "damping_ratio[head]")
    assert "-0.87" in svg_text(correlation(dataclasses.replace(fitted.uncertainty, names=names, covariance=pair)))
    alone = dataclasses.replace(fitted.uncertainty, names=names[1:], covariance=np.ones((1, 1)))
    assert correlation(alone) is None


def test_a_fit_draws_the_recordings_that_its_document_counts(fitted: FitReport) -> None:
    events, document = {event.name: event for event in compared_events(fitted, fitted.events)}, fit_document(fitted)
    for recording in (*document["cases"], *document["held_out"]):
        path = recording["bag"]
        event = events[Path(path).name if Path(path).name in events else path]
        for column, percent in enumerate(recording["joint"]["nrmse_rms"].values()):
            here = np.isfinite(event.measured_mps2[:, column])
            measured, after = (values[here, column] for values in (event.measured_mps2, event.after_mps2))
            assert 100.0 * np.linalg.norm(after - measured) / np.linalg.norm(measured) == pytest.approx(percent)
        assert event.before.mean_percent > event.after.mean_percent


def test_a_drawing_that_fails_costs_no_fit(fitted: FitReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output = tmp_path / "anna.yaml"
    (tmp_path / "anna.fit.html").write_text("the page of yesterday")
    write_fitted(fitted, output)
    monkeypatch.setattr(fit_report, "fit_page", lambda found: {}["nothing"])
    with pytest.raises(InputError, match=r"anna\.fit\.html: cannot be drawn \(KeyError: 'nothing'\)"):
        write_fit_page(fitted, output)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["anna.fit.json", "anna.yaml"]
    monkeypatch.setattr(fit_report, "fit_page", lambda found: "a page")
    write_fit_page(fitted, output)
    assert (tmp_path / "anna.fit.html").read_text() == "a page"


@pytest.mark.parametrize("missing", ["jinja2", "matplotlib"])
@pytest.mark.parametrize(
    "command",
    [
        ["fit", "no.mcap", "--subject", "subject_1", "-o", "{}/a.yaml"],
        ["fit", "--campaign", "{}/campaign.yaml", "-o", "{}/out", "--executor", "none"],
        ["validate", "no.mcap", "--subject", "subject_1", "-o", "{}/out"],
    ],
)
def test_a_missing_library_is_reported_before_the_work(
    command: list[str],
    missing: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "x.mcap").write_bytes(b"")
    (tmp_path / "campaign.yaml").write_text("subjects: [{subject: subject_1, bags: [x.mcap]}]")
    monkeypatch.setitem(sys.modules, missing, None)
    given = [part.format(tmp_path) for part in command]
    assert main(given) == 2
    error = capsys.readouterr().err
    assert f"reports need {missing}: pip install 'biodyn_ros[reports]', or use --no-report" in error
    assert main([*given, "--no-report"]) == 2
    assert missing not in capsys.readouterr().err


# --- campaign --------------------------------------------------------------------------------------------------------


def row(name: str, **more: Any) -> Row:
    return Row(name, PERSON, ["a"], [], **more)


def test_the_page_of_a_campaign_has_every_subject(fitted: FitReport, tmp_path: Path) -> None:
    document = fit_document(fitted)
    for name, of in (("anna+1", document), ("ben", document | {"held_out": []})):
        (tmp_path / f"{name}.fit.json").write_text(json.dumps(of))
    done = {"state": "done", "seconds": 3.0}
    rows = (
        row("anna+1", result="anna+1.yaml", page="anna+1.fit.html", mean_error_percent=2.5, **done),
        row("ben", result="ben.yaml", mean_error_percent=4.5, error="the page cannot be drawn <b>", **done),
        row("carl", state="failed", error=f"{ODD}: cannot be read"),
        row("dora"),
    )
    campaign = CampaignReport(ODD, rows)
    write_campaign_page(campaign, tmp_path)
    source = (tmp_path / "campaign.html").read_text()
    text = Page(source).text
    assert_self_contained(source)
    unseen = number(document["held_out"][0]["joint"]["mean"])
    for expected in (
        "2 of 4 subjects fitted", "Failed, --resume tries them again: carl.", "Not begun, or not finished: dora.",
        "Error on the events fitted to: 2.50 to 4.50 %", f"On events not fitted to: {unseen} %",
        f"done 1 and 0 held out 3.00 2.50 {unseen}",
        "since nothing was held out: ben", f"{NASTY}\\udcff: cannot be read", PERSON, "failed 1 and 0 held out – – –",
    ):  # fmt: skip
        assert expected in text, expected
    assert 'href="anna%2B1.fit.html"' in source and "script" not in Page(source).tags
    assert "place between the bounds of Table 1, logarithmic, no unit" in svg_text(source)
    assert campaign_page(campaign, tmp_path).encode("utf-8", "backslashreplace") == source.encode()
    lost = json.loads(json.dumps(document))
    lost["held_out"][0][lost["result"]]["mean"] = None
    (tmp_path / "ben.fit.json").write_text(json.dumps(lost))
    diverging = Page(campaign_page(campaign, tmp_path)).text
    assert "done 1 and 0 held out 3.00 4.50 diverges" in diverging and "inf" not in re.findall(r"[a-z]+", diverging)
    assert f"On events not fitted to: {unseen} %" in diverging and "Diverges in an event: ben." in diverging
    (tmp_path / "ben.fit.json").write_text("{}")
    with pytest.raises(InputError, match=r"ben\.fit\.json: is not a fit\.json of biodyn"):
        campaign_page(campaign, tmp_path)
    assert subjects([]) is not None


@pytest.mark.parametrize(
    ("tones", "tone"),
    [(("good", "good"), "good"), (("good", "none"), "none"), (("warn", "none"), "warn"), (("bad", "good"), "bad")],
)
def test_a_campaign_is_no_greener_than_its_subjects(tones: tuple[str, str], tone: str) -> None:
    good = FitSummary((2.5,), (3.0,), (), "segment", None, 1, 1, is_made_by_model=False)
    of_tone = {
        "good": good,
        "none": dataclasses.replace(good, is_made_by_model=True),
        "warn": dataclasses.replace(good, better_mass_matrix="cascade"),
        "bad": dataclasses.replace(good, held_out=(25.0,)),
    }
    fits = {name: of_tone[each] for name, each in zip(("anna", "ben"), tones, strict=True)}
    assert [fit_verdict(fit).tone for fit in fits.values()] == list(tones)
    rows = tuple(row(name, state="done", mean_error_percent=2.5) for name in fits)
    found = campaign_verdict(CampaignReport("", rows), fits)
    assert found.tone == tone
    assert any("not fitted to: anna" in line for line in found.reasons) == ("bad" in tones)
    failed = CampaignReport("", (*rows, row("carl", state="failed")))
    assert campaign_verdict(failed, fits).tone == "bad"
    assert not any("different models" in line for line in found.reasons)
    mixed = campaign_verdict(CampaignReport("", rows), fits | {"ben": dataclasses.replace(good, mass_matrix="cascade")})
    (line,) = (line for line in mixed.reasons if "different models" in line)
    assert line.endswith("by mass matrix: segment: anna; cascade: ben.")
    belted = dataclasses.replace(good, effects=(("friction", "neck"), ("harness", "pelvis")))
    mixed = campaign_verdict(CampaignReport("", rows), fits | {"ben": belted})
    (line,) = (line for line in mixed.reasons if "different models" in line)
    assert line.endswith("by effects: none: anna; friction (neck) and harness (pelvis): ben.")


def test_a_page_that_cannot_be_drawn_costs_no_subject(
    fitted: FitReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    (tmp_path / "campaign.yaml").write_text(
        "subjects: [{subject: subject_1, bags: [a.mcap]}, {subject: subject_2, bags: [a.mcap]}]"
    )
    pages = {"subject_1": f"page of {ODD}"}
    names = iter(["subject_1", "nothing"])
    monkeypatch.setattr(campaigns, "fingerprint", lambda entry, options: entry.name)
    monkeypatch.setattr(campaigns, "fit_bags", lambda *given: fitted)
    monkeypatch.setattr(fit_report, "fit_page", lambda found: pages[next(names)])
    first, second = fit_campaign(load_campaign(tmp_path / "campaign.yaml"), tmp_path / "out", report=True).rows
    assert [each.state for each in (first, second)] == ["done", "done"]
    assert (first.page, first.error) == ("subject_1.fit.html", None)
    assert second.page is None and "the page cannot be drawn (KeyError: 'nothing')" in second.error
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "campaign.json", "subject_1.fit.html", "subject_1.fit.json", "subject_1.yaml", "subject_2.fit.json",
        "subject_2.yaml",
    ]  # fmt: skip


# --- replay ----------------------------------------------------------------------------------------------------------


def test_a_replay_shows_its_spectra() -> None:
    traces = Traces()
    traces.add(Frames(NO_PREDICTED, streamed.frames()))
    report = test_report.report()
    parts = frequency_parts(report, traces, streamed.START_NS)
    svg = parts["transmissibility_svg"]
    measured = [line for line in lines(svg, DARK, 1.7) if np.ptp(line.points[:, 1]) < 0.01]
    heights = {round(float(line.points[:, 1].mean()), 2) for line in measured}
    # Decades 0.1 to 10 hold gains of 3, 1, 0.25 and 2; the coherences beneath are 1 of 1.08.
    assert heights == {round((math.log10(gain) + 1.0) / 2.0, 2) for gain in streamed.GAIN.values()} | {0.93}
    assert svg_text(svg).count("not measured") == 1  # the lower torso
    assert "amplitude, m/s²" in svg_text(parts["powers_svg"])
    assert "head, measured" in svg_text(parts["waterfall_svg"])
    assert "data:image/png;base64," in parts["waterfall_svg"]
    for name, (dose, _) in report.predicted.items():
        assert f"{number(dose.vdv_mps175)} predicted" in svg_text(parts["doses_svg"]), name
    assert frequency_parts(dataclasses.replace(report, predicted={}), Traces(), 0)["doses_svg"] is None


def test_nothing_undefined_passes_a_template() -> None:
    import jinja2

    with pytest.raises(jinja2.UndefinedError):
        render("campaign.html.j2")
