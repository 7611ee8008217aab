"""Fit of a subject to bags: results, held-out bags and refusals."""

import dataclasses
import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace

import fitting
import numpy as np
import pytest
import yaml
from listed import assert_listed
from mcap.reader import make_reader
from mcap.writer import Writer
from provenances import with_spread
from streams import simulated, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameter_spread import parameter_spread
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.usual_residual import usual_residuals
from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from biodyn_core.pipeline.intervals import prediction_spread
from biodyn_ros.base.topics import INPUT
from biodyn_ros.commands.cli import main
from biodyn_ros.fit.document import fit_document, fitted_subject, provenance
from biodyn_ros.fit.fitting import FitOptions, check_output, choose, fit_bags, parse_cases, write_fitted
from biodyn_ros.fit.report import Report, clock_warnings, reuse_warnings
from biodyn_ros.fit.text import text_of
from biodyn_ros.reading.events import BagEvent
from biodyn_ros.reading.provenance import Source, bag_sha256, role_of, source_of

SUBJECT = subject()
QUICK = FitSettings(swarm=SwarmSettings(particles=12, iterations=15, starts=1), refined_starts=1, evaluations=100)
SMALL = [
    "--particles", "10", "--iterations", "10", "--starts", "1", "--refined-starts", "1", "--evaluations", "40",
    "--no-report",
]  # fmt: skip


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two repetitions of a rail, a road and one that is held out."""
    cases = {"rail_1": "rail", "rail_2": "rail", "road": "road", "spare": "rail"}
    return simulated(tmp_path_factory.mktemp("bags"), 5.0, cases)


@pytest.fixture(scope="module")
def fitted(bags: dict[str, Path]) -> Report:
    options = FitOptions(
        settings=QUICK, held_out=(str(bags["spare"]),), cases={str(bags["spare"]): "rail"},
        profiles=("natural_frequency_hz[head]",),
    )  # fmt: skip
    return fit_bags([bags["rail_1"], bags["rail_2"], bags["road"]], SUBJECT, options)


def test_a_head_that_is_too_short_to_be_fitted_decides_nothing() -> None:
    """The stronger repetition has the head for 0.3 s only: fitted to it, the head would be in no fit."""
    seat = fitting.seat_motion("road", 4.0, 1)
    long, short = (np.outer(scale * seat, np.ones(5)) for scale in (1.0, 2.0))
    short[: round(3.7 * fitting.RATE_HZ), -1] = np.nan
    events = []
    for name, accel in (("long", long), ("short", short)):
        recording = fitting.recording(seat, accel)
        case = Case.of(recording, fitting.SPECTRUM, fitting.LINES)
        events.append((BagEvent(name, Source(name), recording, False), case))
    for order in (events, events[::-1]):
        fitted_to, spare = choose(order)
        assert [event.bag for event, _ in fitted_to] == ["long"] and [event.bag for event, _ in spare] == ["short"]
    assert choose(events[1:]) == (events[1:], [])


def test_the_document_has_its_keys(fitted: Report) -> None:
    document = json.loads(json.dumps(fit_document(fitted), allow_nan=False))
    assert_listed("fit.json", document)
    least = {
        "subject", "cases", "idealized", "weights", "cv", "intervals", "identifiable", "evaluations", "seconds", "seed",
        "version",
    }  # fmt: skip
    assert least <= document.keys()
    assert [case["case"] for case in document["cases"]] == ["rail", "road"]
    for case in document["cases"]:
        assert {"bag", "error", "parameters", "at_bound"} <= case.keys()
        for key in ("nrmse_rms", "nrmse_range"):
            assert list(case["error"][key]) == list(MEASURED_SEGMENTS)
        assert case["error"]["objective"] > 0.0
        assert case["error"]["mean"] <= case["joint"]["mean"] * 1.2
    assert sum(document["weights"].values()) == pytest.approx(1.0)
    assert list(document["intervals"]) == [p.name for p in PARAMETERS[:14]]
    assert {interval["unit"] for interval in document["intervals"].values()} == {"Hz", "-", "rad/s"}


def test_intervals_contain_the_estimates_and_frequencies_the_truth(fitted: Report) -> None:
    truth, document = SUBJECT.parameters.vector(), fit_document(fitted)
    for (name, interval), true in zip(document["intervals"].items(), truth[:14], strict=True):
        assert interval["lower"] <= interval["value"] <= interval["upper"], name
        if name.startswith("natural_frequency_hz") and document["identifiable"][name] == "identifiable":
            assert interval["value"] == pytest.approx(true, rel=0.03)
    assert document["identifiable"]["natural_frequency_hz[head]"] == "identifiable"
    drawn, interval = (document[key]["natural_frequency_hz[head]"] for key in ("profiles", "intervals"))
    assert drawn["lower"] == pytest.approx(interval["lower"], rel=0.01)
    assert drawn["upper"] == pytest.approx(interval["upper"], rel=0.01)


def test_one_repetition_is_fitted_and_the_other_predicted(fitted: Report, bags: dict[str, Path]) -> None:
    document = fit_document(fitted)
    fitted_to = [case["bag"] for case in document["cases"]]
    others = {event["bag"]: event["why"] for event in document["held_out"]}
    chosen = fitted_to[0]
    assert chosen in (str(bags["rail_1"]), str(bags["rail_2"])) and fitted_to[1] == str(bags["road"])
    unchosen = ({str(bags["rail_1"]), str(bags["rail_2"])} - {chosen}).pop()
    assert others == {unchosen: "another repetition", str(bags["spare"]): "held out"}
    for event in document["held_out"]:
        assert 0.0 < event["joint"]["mean"] < 10.0
    assert document["mass_matrix"]["better"] == "segment"
    assert document["mass_matrix"]["judged_by"] == "held_out"


def test_the_subject_file_has_the_provenance_of_its_bags(fitted: Report, bags: dict[str, Path], tmp_path: Path) -> None:
    write_fitted(fitted, tmp_path / "anna.yaml")
    written = load_subject(tmp_path / "anna.yaml")
    assert written.parameters == fitted_subject(fitted).parameters
    assert role_of(written, source_of(bags["road"])) == "fitted"
    assert role_of(written, source_of(bags["spare"])) == "held_out"
    moved = shutil.copy(bags["road"], tmp_path / "another_name.mcap")
    assert role_of(written, source_of(moved)) == "fitted"
    assert role_of(SUBJECT, source_of(bags["road"])) is None
    assert json.loads((tmp_path / "anna.fit.json").read_text()) == fit_document(fitted)
    kept = yaml.safe_load((tmp_path / "anna.yaml").read_text())["provenance"]
    assert kept["intervals"]["natural_frequency_hz[head]"][0] < written.parameters.natural_frequency_hz[5]
    assert kept["seed"] == 0 and kept["result"] == "joint" and len(kept["held_out"]) == 2


def test_the_subject_file_has_what_intervals_need(fitted: Report, tmp_path: Path) -> None:
    """The covariance is that of the fit; the held-out events are too short for a usual residual, and that is said."""
    write_fitted(fitted, tmp_path / "anna.yaml")
    spread, why = parameter_spread(load_subject(tmp_path / "anna.yaml").provenance)
    assert why == "" and spread is not None and spread.names == fitted.uncertainty.names
    np.testing.assert_allclose(spread.covariance, fitted.uncertainty.covariance)
    assert "no residual of held-out events" in prediction_spread(load_subject(tmp_path / "anna.yaml"))[1]
    laws, _ = usual_residuals(with_spread(SUBJECT).provenance)
    longer = dataclasses.replace(fitted, usual_residual=laws)
    assert prediction_spread(fitted_subject(longer))[1] == ""
    found = fitted.identification
    other = dataclasses.replace(found, settings=dataclasses.replace(found.settings, result="idealized"))
    idealized = dataclasses.replace(longer, identification=other)
    assert idealized.result == "idealized" and "no covariance" in prediction_spread(fitted_subject(idealized))[1]


def test_recordings_of_a_given_effect_count_as_fitted(fitted: Report, bags: dict[str, Path]) -> None:
    """The recordings to which a given effect was fitted are not held out, though theta is fitted to others."""
    of_old = {"bag": "old.mcap", "sha256": bag_sha256(bags["spare"])}
    known = {"fitted": [of_old, {"bag": "road.mcap", "sha256": bag_sha256(bags["road"])}]}
    given = Subject.from_dict(
        SUBJECT.to_dict() | {"effects": [{"name": "lift_off", "site": "pelvis"}], "provenance": known}
    )
    kept = provenance(dataclasses.replace(fitted, given=given))["fitted"]
    assert [each["sha256"] for each in kept].count(of_old["sha256"]) == 1 and len(kept) == 3
    without = dataclasses.replace(fitted, given=dataclasses.replace(given, effects=()))
    assert len(provenance(without)["fitted"]) == 2
    event = fitted.held_out[0]
    spare = dataclasses.replace(event.bag, bag="spare.mcap", source=Source(of_old["sha256"]), held_out=True)
    (warning,) = reuse_warnings(given, [(spare, event.case)])
    assert warning == "spare.mcap: held out, but an effect of the given subject was fitted to it"


def test_validation_on_a_fitted_bag_is_undecided(
    fitted: Report, bags: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_fitted(fitted, tmp_path / "anna.yaml")
    for name, expected in (("road", True), ("spare", False)):
        assert main(["validate", str(bags[name]), "--subject", str(tmp_path / "anna.yaml"), "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        assert ("fitted_to" in {finding["what"] for finding in document["findings"]}) is expected
        if expected:
            assert document["verdict"] != "agrees"


def test_the_text_has_errors_intervals_and_unknowns(fitted: Report) -> None:
    text = text_of(fitted)
    assert "rail (another repetition)" in text and "rail (held out)" in text
    assert "mass scale: fixed; accelerations do not determine it" in text
    assert "made by the model itself" in text
    (profile,) = (line for line in text.splitlines() if line.startswith("profile: natural frequency, head"))
    assert "10." in profile
    pinned = dataclasses.replace(fitted, not_profiled=("rayleigh_rad_per_s",))
    assert "profile: Rayleigh damping" in text_of(pinned) and "lies on its bound" in text_of(pinned)
    assert all(len(line) < 200 for line in text.splitlines() if not line.startswith("warning"))
    alone = dataclasses.replace(fitted, events=tuple(fitted.fitted))
    assert "nothing was held out" in text_of(alone)
    assert "no 95 % interval: 20 s or more of a segment" in text
    laws, _ = usual_residuals(with_spread(SUBJECT).provenance)
    assert "95 % intervals; the usual residual is from pelvis 100 s" in text_of(
        dataclasses.replace(fitted, usual_residual=laws)
    )
    pitching = dataclasses.replace(SUBJECT, effects=(CATALOGUE["pitch"].sized("seat", 0.15),))
    joint = dataclasses.replace(fitted.joint, subject=pitching)
    assert "no 95 % interval: its effect pitch needs more than the vertical acceleration of the seat" in text_of(
        dataclasses.replace(
            fitted, identification=dataclasses.replace(fitted.identification, joint=joint), usual_residual=laws
        )
    )


def diverging(report: Report, use: str, *, both: bool = False) -> Report:
    """The report as if the model diverged in the events of this use: under `cascade`, or under both mass matrices."""
    lost = np.full(len(MEASURED_SEGMENTS), np.nan)
    events = tuple(
        dataclasses.replace(
            event,
            errors={
                name: dataclasses.replace(error, nrmse_rms_percent=lost, nrmse_range_percent=lost)
                for name, error in event.errors.items()
            },
        )
        if event.use == use
        else event
        for event in report.events
    )
    percent = {"segment": math.inf if both else 5.0, "cascade": math.inf}
    return dataclasses.replace(
        report, events=events, mass_matrix_percent=percent, better_mass_matrix=None if both else "segment"
    )


def test_errors_where_the_model_diverges_are_null_in_the_files(fitted: Report, tmp_path: Path) -> None:
    write_fitted(diverging(fitted, "held out"), tmp_path / "anna.yaml")
    document = json.loads((tmp_path / "anna.fit.json").read_text())
    repetition, lost = document["held_out"]
    assert repetition["joint"]["mean"] > 0.0
    unknown = dict.fromkeys(MEASURED_SEGMENTS)
    assert lost["joint"] == {"nrmse_rms": unknown, "nrmse_range": unknown, "mean": None}
    assert document["mass_matrix"]["error_percent"] == {"segment": 5.0, "cascade": None}
    assert document["mass_matrix"]["better"] == "segment"
    # The fusion of single fits can diverge in an event that it is of.
    write_fitted(diverging(fitted, "fitted"), tmp_path / "ben.yaml")
    assert json.loads((tmp_path / "ben.fit.json").read_text())["idealized"]["error_percent"] is None
    assert load_subject(tmp_path / "ben.yaml").provenance["fitted"][0]["nrmse_rms_percent"] is None


def test_an_event_in_which_the_model_diverges_has_a_line(fitted: Report, bags: dict[str, Path]) -> None:
    text = text_of(diverging(fitted, "held out"))
    expected = f"the model diverges in rail (held out, {bags['spare']}) with the parameters of: joint, idealized"
    assert f"\n{expected}; its error there is not known\n" in text
    assert "mass matrix: segment predicts events held out better (segment 5.00 %, cascade diverges)" in text
    both = text_of(diverging(fitted, "held out", both=True))
    assert "mass matrix: not compared, because the model diverges with both on events held out" in both
    assert "inf" not in text + both and "diverges" not in text_of(fitted)


def test_a_missing_segment_is_excluded_with_a_warning(bags: dict[str, Path], tmp_path: Path) -> None:
    bag = only(bags["spare"], tmp_path / "rail.mcap", ("seat", "neck", "head"))
    found = fit_bags([bag], SUBJECT, FitOptions(settings=QUICK))
    document = fit_document(found)
    (case,) = document["cases"]
    assert case["error"]["nrmse_rms"]["pelvis"] is None and case["error"]["nrmse_rms"]["head"] > 0.0
    assert set(case["not_fitted"]) == {"pelvis", "lower_torso", "upper_torso"}
    assert any("pelvis" in line for line in document["warnings"])
    assert document["idealized"]["weighted_error_percent"] > 0.0
    assert "–" in text_of(found)


def only(bag: Path, copy: Path, sensors: tuple[str, ...]) -> Path:
    """A copy of a bag with the topics of some sensors, by the mcap package."""
    with bag.open("rb") as source, copy.open("wb") as target:
        writer = Writer(target)
        writer.start()
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(source).iter_messages([INPUT[sensor] for sensor in sensors]):
            if channel.topic not in channels:
                of = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, of)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    return copy


def test_the_command_fits_a_subject_without_parameters(
    bags: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    person = tmp_path / "new.yaml"
    person.write_text("schema: 1\nname: new\nbody_mass_kg: 58.6\nstature_m: 1.73\nmass_matrix: segment\n")
    output = tmp_path / "fitted.yaml"
    command = ["fit", str(bags["rail_1"]), "--subject", str(person), "-o", str(output), "--executor", "none", *SMALL]
    assert main([*command, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["subject"] == "new" and load_subject(output).name == "new"
    assert not list(tmp_path.glob("*.checkpoint.json")) and not list(tmp_path.glob(".*"))
    with pytest.raises(InputError, match="'parameters' is missing"):
        load_subject(person)


def test_a_clock_beyond_the_linear_range_is_named() -> None:
    """Each delay is that at the middle of a case: with 60 s compared and 100 ppm it is 3 ms larger at its ends."""
    case = SimpleNamespace(name="road_1", rate_hz=1000.0, begin=2000, measured_mps2=np.zeros((62_000, 5)))
    delays = np.zeros((1, 5, 2))
    delays[0, :, 0], delays[0, 0, 1] = [1e-3, -1.9e-3, -2.1e-3, np.nan, 1.9e-3], 1e-4
    found = SimpleNamespace(cases=[case], joint=SimpleNamespace(clock_delays_s=delays))
    pelvis, upper = clock_warnings(found)  # type: ignore[arg-type]
    assert pelvis.startswith(
        "road_1: pelvis fits best with a clock that is 1.0 ms late and drifts by 100 ppm; above 2 ms"
    )
    assert upper.startswith("road_1: upper_torso fits best with a clock that is 2.1 ms early and drifts by 0 ppm")
    found.joint.clock_delays_s = np.empty((0, 5, 2))
    assert not list(clock_warnings(found))  # type: ignore[arg-type]


def test_settings_of_the_paper_are_an_option(bags: dict[str, Path], tmp_path: Path) -> None:
    small = ["--particles", "30", "--iterations", "10", "--evaluations", "40", "--executor", "none", "--no-report"]
    command = ["fit", str(bags["rail_1"]), "--subject", "subject_1", "--paper", "-o", str(tmp_path / "p.yaml"), *small]
    assert main(command) == 0
    document = json.loads((tmp_path / "p.fit.json").read_text())
    settings = document["settings"]
    assert (settings["refine"], settings["lambda_2"], settings["particles"]) == ("nelder-mead", 0.002, 30)
    assert document["result"] == "idealized" and "mass_scale" in document["intervals"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--subject", "subject_1"], "BAG... and --subject are needed"),
        (["{rail_1}"], "BAG... and --subject are needed"),
        (["{rail_1}", "{rail_1}", "--subject", "subject_1"], "given twice"),
        (["{rail_1}", "--hold-out", "{rail_1}", "--subject", "subject_1"], "given twice"),
        (["{rail_1}", "--case", "rail", "--subject", "subject_1"], "expected BAG=CASE"),
        (["{rail_1}", "--case", "other.mcap=road", "--subject", "subject_1"], "no such bag is given"),
        (["{rail_1}", "--profile", "f_n", "--subject", "subject_1"], "not a fitted parameter"),
        (["{rail_1}", "--executor", "cloud", "--subject", "subject_1"], "executor 'cloud'"),
        (["{rail_1}", "--refine", "nelder-mead", "--subject", "subject_1"], "nelder-mead estimates no clocks"),
        (
            ["{rail_1}", "--identifiable", "0.3", "--subject", "subject_1"],
            "weakly is 0.25, less than identifiable, 0.3",
        ),
        (["{rail_1}", "--lambda-2", "-1", "--subject", "subject_1"], "lambda_2 is -1"),
        (["missing.mcap", "--subject", "subject_1"], "missing.mcap: cannot be read"),
        (["{rail_1}", "--subject", "nobody"], "no subject file nobody"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, bags: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [text.format(**{name: str(path) for name, path in bags.items()}) for text in arguments]
    assert main(["fit", *given, "-o", str(tmp_path / "out.yaml")]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_an_output_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for output, message in (
        (tmp_path / "out.txt", "ends in .yaml"),
        (tmp_path / "file" / "out.yaml", "file: is a file; the results need a directory"),
    ):
        with pytest.raises(InputError, match=message):
            check_output(output)
    (tmp_path / "dir.yaml").mkdir()
    with pytest.raises(InputError, match="is a directory"):
        check_output(tmp_path / "dir.yaml")


@pytest.mark.parametrize("name", ["anna.yaml", "session.yaml"])
def test_a_fit_replaces_no_input(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither the given subject nor an events file, whose sessions it would take away."""
    anna, events = tmp_path / "anna.yaml", tmp_path / "session.yaml"
    anna.write_text("schema: 1\nname: anna\nbody_mass_kg: 58.6\nstature_m: 1.73\nmass_matrix: segment\n")
    events.write_text("schema: 1\n")
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert main(["fit", str(events), "--subject", str(anna), "-o", str(tmp_path / name), *SMALL]) == 2
    error = capsys.readouterr().err
    assert f"{name}: is an input, and a result would replace it" in error and error.count("\n") == 1
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


def test_the_same_recording_by_two_names_is_refused(bags: dict[str, Path], tmp_path: Path) -> None:
    twin = Path(shutil.copy(bags["rail_1"], tmp_path / "rail_9.mcap"))
    with pytest.raises(InputError, match=r"rail_9\.mcap: the same recording as .*rail_1"):
        fit_bags([bags["rail_1"], twin], SUBJECT, FitOptions(settings=QUICK))


def test_cases_are_read_from_pairs() -> None:
    assert parse_cases(["a=b.mcap=rail"]) == {"a=b.mcap": "rail"}
    with pytest.raises(InputError, match="given twice"):
        parse_cases(["a=rail", "a=road"])


def test_bounds_of_table_1_hold_for_every_result(fitted: Report) -> None:
    theta = fitted_subject(fitted).parameters.vector()
    assert ((theta >= LOWER) & (theta <= UPPER)).all()
    assert np.isfinite(theta).all()
