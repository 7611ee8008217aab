"""The command that traces: its bags, files and lines."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
import types
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from listed import assert_listed
from pages import no_drawings
from provenances import with_spread
from streams import simulated
from traces import EVENTS, SUBJECT, found

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.usual_residual import PROVENANCE, UsualResidual, usual_residuals
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Case
from biodyn_core.tracing import trace as trace_module
from biodyn_core.tracing.findings import (
    Trace,
)
from biodyn_core.tracing.probability import VERSION, learned_from, learned_text, packaged
from biodyn_ros.base.files import check_directory
from biodyn_ros.commands.cli import main
from biodyn_ros.reading.events import BagEvent
from biodyn_ros.reading.provenance import MADE_BY_MODEL, Source, role_of, source_of
from biodyn_ros.trace import tracing
from biodyn_ros.trace.document import trace_document, traced_subject
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.tracing import TraceOptions, deal, stage_lines, trace_bags, write_traced
from biodyn_ros.trace.wording import (
    tone,
)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two repetitions of a rail and one road."""
    return simulated(tmp_path_factory.mktemp("bags"), 4.0, {"rail_1": "rail", "rail_2": "rail", "road": "road"})


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A trace that always finds the stop, and its arguments."""
    given: dict[str, Any] = {}

    def trace(
        train: Any, held_out: Any, subject: Any, settings: Any, seed: int, on_stage: Any, checkpoint: Any, parallel: Any
    ) -> Trace:
        given.update(train=train, held_out=held_out, subject=subject, settings=settings, seed=seed)
        on_stage("screening", 0.0)
        on_stage("screening", 1.0)
        on_stage("refitting", 0.5)
        named = [
            dataclasses.replace(EVENTS[{"train": 0, "choose": 2, "held_out": 3}[use]], name=case.name, case=case.case)
            for use, cases in (("train", train), ("choose", held_out[:-1]), ("held_out", held_out[-1:]))
            for case in cases
        ]
        whole = found(given.get("verdict", "effect"), events=tuple(named), seed=seed, given=subject)
        before = dataclasses.replace(whole.before, effects=subject.effects)
        after = dataclasses.replace(whole.after, effects=(*subject.effects, *whole.after.effects))
        return dataclasses.replace(whole, before=before, after=after)

    module = types.ModuleType("biodyn_core.tracing.trace")
    module.trace = trace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "biodyn_core.tracing.trace", module)
    return given


@pytest.fixture
def traced(bags: dict[str, Path], calls: dict[str, Any]) -> Report:
    """The trace of all bags, which are read once."""
    return _traced(tuple(bags.values()))


@cache
def _traced(bags: tuple[Path, ...]) -> Report:
    return trace_bags(list(bags), SUBJECT)


def test_every_second_bag_of_a_condition_is_held_out() -> None:
    def held_out(**cases: str) -> list[str]:
        events = [
            (BagEvent(bag, Source(bag), types.SimpleNamespace(), False), types.SimpleNamespace(case=case))  # type: ignore[arg-type]
            for bag, case in cases.items()
        ]
        given = [event.bag for event, _ in events]
        dealt = [event for event, _ in deal(events)]
        assert sorted(event.bag for event in dealt) == sorted(given)
        assert [event.bag for event in dealt] == sorted(given, key=lambda bag: (bag in out(dealt), given.index(bag)))
        return out(dealt)

    def out(events: list[BagEvent]) -> list[str]:
        return [event.bag for event in events if event.held_out]

    bags = {"rail_1": "rail", "road_1": "road", "rail_2": "rail", "rail_3": "rail", "own": "own"}
    assert held_out(**bags) == ["rail_2"]
    assert held_out(**bags | {"own": "road"}) == ["rail_2", "own"]


def test_bags_become_cases_with_channels_and_their_roles(bags: dict[str, Path], calls: dict[str, Any]) -> None:
    traced = trace_bags(list(bags.values()), SUBJECT, TraceOptions(seed=3))
    assert [case.case for case in calls["train"]] == ["rail", "road"]
    assert [case.name for case in calls["held_out"]] == [str(bags["rail_2"])]
    assert "seat.x" in calls["train"][0].channels and calls["seed"] == 3
    document = trace_document(traced)
    assert [(Path(of["bag"]).name, of["use"]) for of in document["bags"]] == [
        ("rail_1.mcap", "train"), ("road.mcap", "train"), ("rail_2.mcap", "held_out"),
    ]  # fmt: skip
    assert "held out rail_2.mcap" in document["dealt"] and document["seconds"] > 0.0
    assert [line for line in document["warnings"] if "made by the model" in line] == [
        f"3 of 3 recordings: {MADE_BY_MODEL}"
    ]
    none = dataclasses.replace(traced.trace, verdict="none", rounds=())  # no other answer in its set
    unexplained = dataclasses.replace(traced.trace, verdict="unexplained")
    assert tone(dataclasses.replace(traced, trace=none)) == "none"  # no green for recordings of the model itself
    assert tone(Report(none)) == "good"
    assert tone(dataclasses.replace(traced, trace=unexplained)) == "bad"
    assert_listed("trace.json", document)
    alone = trace_bags([bags["road"]], SUBJECT)
    assert "nothing is held out" in (alone.dealt or "") and calls["held_out"] == []
    named = trace_bags([bags["rail_1"]], SUBJECT, TraceOptions(held_out=(str(bags["road"]),)))
    assert named.dealt is None and len(calls["held_out"]) == 1


def test_written_files_are_complete_and_have_the_bags(
    bags: dict[str, Path], calls: dict[str, Any], traced: Report, tmp_path: Path
) -> None:
    out = tmp_path / "new" / "out"
    with no_drawings():
        write_traced(traced, out)
    assert sorted(path.name for path in out.iterdir()) == ["subject.yaml", "trace.html", "trace.json"]
    assert json.loads((out / "trace.json").read_text()) == json.loads(json.dumps(trace_document(traced)))
    written = load_subject(out / "subject.yaml")
    assert written.effects[0].effect.name == "stop" and written.provenance["made_by"] == "biodyn trace"
    assert role_of(written, source_of(bags["rail_1"])) == role_of(written, source_of(bags["road"])) == "fitted"
    assert role_of(written, source_of(bags["rail_2"])) == "held_out"
    assert written.provenance["fitted"][0]["nrmse_rms_percent"] == 3.0
    assert written.provenance["error"]["before"] == {"train": 14.0, "held_out": 15.0}
    assert written.provenance["effects"] == {"stop at pelvis": {"gap_m": [0.0115, 0.0126]}}
    # These bags are not new for a further trace, and the origin of the first effect stays in the file.
    again = trace_bags([bags["rail_2"]], written, TraceOptions(held_out=(str(bags["road"]),)))
    assert any("had been fitted to it" in line for line in again.warnings)
    assert role_of(traced_subject(again), source_of(bags["rail_1"])) == "fitted"


def test_a_traced_subject_has_the_usual_residual_of_the_reported_events(
    traced: Report, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those that neither fitted nor chose; these bags are too short for a law of their own."""
    laws, _ = usual_residuals(with_spread(SUBJECT).provenance)
    seen = []

    def of_events(subject: Subject, cases: list[Case]) -> dict[str, UsualResidual]:
        seen.append((subject.effects, [case.case for case in cases]))
        return laws

    assert PROVENANCE not in traced_subject(traced).provenance
    monkeypatch.setattr("biodyn_ros.trace.document.usual_residual", of_events)
    assert usual_residuals(traced_subject(traced).provenance) == (laws, "")
    assert seen == [(traced.trace.after.effects, ["rail"])]


def test_the_usual_residual_is_without_sensors_that_the_trace_leaves_out(
    bags: dict[str, Path], calls: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The head fails in every event; its residual is no error of the model."""
    head = MEASURED_SEGMENTS.index("head")

    def without_head(case: Case, *_: object) -> tuple[Case, list[str]]:
        others = np.arange(len(MEASURED_SEGMENTS)) != head
        return dataclasses.replace(case, compared=case.compared & others, energy=case.energy * others), ["head failed"]

    seen: list[Case] = []
    monkeypatch.setattr("biodyn_ros.trace.tracing.without_failed_sensors", without_head)
    monkeypatch.setattr("biodyn_ros.trace.document.usual_residual", lambda _, cases: seen.extend(cases) or {})
    traced_subject(trace_bags(list(bags.values()), SUBJECT))
    (case,) = seen
    assert not case.compared[:, head].any() and case.compared[:, 0].any()


def test_the_provenance_has_only_effects_that_the_subject_has(traced: Report) -> None:
    (intervals,) = traced.trace.intervals
    line = AppliedEffect(CATALOGUE["periodic"], "head", {p.name: p.size for p in CATALOGUE["periodic"].parameters})
    beside = dataclasses.replace(traced.trace, effects=(line, *traced.trace.effects), intervals=((), intervals))
    written = traced_subject(dataclasses.replace(traced, trace=beside))
    assert set(written.provenance["effects"]) == {"stop at pelvis"}


@pytest.mark.parametrize("verdict", ["none", "unexplained", "not_decidable"])
def test_without_an_added_effect_the_subject_is_the_given_one(
    verdict: str, bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Byte by byte, in place of the file of an earlier trace; a file without parameters gets none."""
    fitted = "# Anna\n" + dataclasses.replace(SUBJECT, provenance={"made_by": "biodyn fit"}).to_yaml()
    unfitted = "schema: 1\nname: anna\nbody_mass_kg: 60\nstature_m: 1.7\nmass_matrix: segment\n"
    out, anna = tmp_path / "out", tmp_path / "anna.yaml"
    command = ["trace", str(bags["road"]), "--subject", str(anna), "-o", str(out), "--no-report"]
    calls["verdict"] = verdict
    out.mkdir()
    for text in (fitted, unfitted):
        anna.write_text(text, encoding="utf-8")
        (out / "subject.yaml").write_text("of an earlier trace")
        assert main(command) == 0
        assert (out / "subject.yaml").read_text(encoding="utf-8") == text
        assert json.loads((out / "trace.json").read_text())["subject_written"] == "as_given"
        assert "subject.yaml: equals the given subject" in capsys.readouterr().out
    traced = trace_bags([bags["road"]], SUBJECT)
    assert traced_subject(traced) is SUBJECT


def test_the_subject_is_written_before_the_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interruption between both files leaves the old verdict or the new subject, never the other way round."""
    monkeypatch.setattr(tracing, "write_json", lambda path, document: {}["interrupted"])
    (tmp_path / "subject.yaml").write_text("of the trace before")
    with pytest.raises(KeyError, match="interrupted"):
        write_traced(Report(found("none")), tmp_path)
    assert load_subject(tmp_path / "subject.yaml").name == SUBJECT.name


def test_the_use_of_each_bag_is_printed_before_the_computation(
    bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    begun: list[str] = []
    method = sys.modules["biodyn_core.tracing.trace"].trace

    def trace(*given: Any, **options: Any) -> Trace:
        begun.append(capsys.readouterr().err)
        return method(*given, **options)

    monkeypatch.setattr(sys.modules["biodyn_core.tracing.trace"], "trace", trace)
    command = [
        "trace",
        "--subject",
        "subject_1",
        "--executor",
        "none",
        "-o",
        str(tmp_path / "out"),
        "--no-report",
        "--json",
    ]
    assert main([*command, *map(str, bags.values())]) == 0
    assert main([*command, str(bags["road"]), "--hold-out", str(bags["rail_2"]), str(bags["rail_1"])]) == 0
    by_default, by_name = begun
    assert by_default.splitlines() == [
        f"parameters are fitted to: {bags['rail_1']}, {bags['road']}",
        f"held out (by default, every second bag of a condition), the effect is chosen by: {bags['rail_2']}",
        "held out, errors are reported of: none",
    ]
    assert by_name.splitlines() == [
        f"parameters are fitted to: {bags['road']}",
        f"held out (by name), the effect is chosen by: {bags['rail_2']}",
        f"held out, errors are reported of: {bags['rail_1']}",
    ]


def test_a_bag_for_choosing_counts_as_fitted(bags: dict[str, Path], calls: dict[str, Any]) -> None:
    spare = (str(bags["rail_2"]), str(bags["road"]))
    traced = trace_bags([bags["rail_1"]], SUBJECT, TraceOptions(held_out=spare))
    assert [of["use"] for of in trace_document(traced)["bags"]] == ["train", "choose", "held_out"]
    assert role_of(traced_subject(traced), source_of(bags["rail_2"])) == "fitted"
    assert role_of(traced_subject(traced), source_of(bags["road"])) == "held_out"


def test_validate_reports_a_bag_that_the_trace_was_fitted_to(
    bags: dict[str, Path], traced: Report, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_traced(traced, tmp_path / "out", report=False)
    assert not (tmp_path / "out" / "trace.html").exists()
    for name, expected in (("road", True), ("rail_2", False)):
        assert main(["validate", str(bags[name]), "--subject", str(tmp_path / "out" / "subject.yaml"), "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        assert ("fitted_to" in {finding["what"] for finding in document["findings"]}) is expected


def test_a_failing_page_keeps_the_other_files(tmp_path: Path) -> None:
    trace = found(verdict="unknown")
    (tmp_path / "trace.html").write_text("of the trace before")
    with pytest.raises(InputError, match=r"trace\.html: cannot be drawn \(KeyError"):
        write_traced(Report(trace), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["subject.yaml", "trace.json"]


def test_each_stage_has_its_line() -> None:
    seen: list[str] = []

    class Line:
        def __init__(self, what: str) -> None:
            self.what = what

        def __enter__(self) -> Any:
            return lambda done, total: seen.append(f"{self.what} {done}/{total}")

        def __exit__(self, *_: object) -> None:
            seen.append(f"{self.what} ends")

    with stage_lines(Line) as on_stage:
        on_stage("screening", 0.5)
        on_stage("refitting", 0.0)
        on_stage("refitting", 1.0)
    assert seen == ["screening 500/1000", "screening ends", "refitting 0/1000", "refitting 1000/1000", "refitting ends"]


def test_the_command_traces_and_prints(
    bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["trace", str(bags["rail_1"]), "--hold-out", str(bags["road"]), "--subject", "subject_1", "--seed", "5"]
    assert main([*command, "-o", str(tmp_path / "a"), "--json", "--no-report"]) == 0
    assert json.loads(capsys.readouterr().out)["seed"] == calls["seed"] == 5
    with no_drawings():
        assert main([*command, "-o", str(tmp_path / "b"), "--case", f"{bags['road']}=gravel"]) == 0
    assert capsys.readouterr().out.startswith("Missing in the model: stop")
    assert calls["held_out"][0].case == "gravel"
    assert main([*command, "-o", str(tmp_path / "c"), "--no-report", "--shocks", "2", "--most-effects", "1"]) == 0
    assert (calls["settings"].floor.shocks, calls["settings"].most_effects) == (2, 1)
    assert (tmp_path / "b" / "trace.html").exists() and not (tmp_path / "c" / "trace.html").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--subject", "subject_1"], "no bag is given"),
        (["{rail_1}", "--subject", "nobody"], "no subject file nobody"),
        (["{rail_1}", "{rail_1}", "--subject", "subject_1"], "given twice"),
        (["{rail_1}", "--hold-out", "{rail_1}", "--subject", "subject_1"], "given twice"),
        (["{rail_1}", "{twin}", "--subject", "subject_1"], "the same recording as"),
        (["{rail_1}", "--hold-out", "{twin}", "--subject", "subject_1"], "the same recording as"),
        (["{rail_1}", "--case", "rail", "--subject", "subject_1"], "expected BAG=CASE"),
        (["{rail_1}", "--case", "other.mcap=road", "--subject", "subject_1"], "no such bag is given"),
        (["missing.mcap", "--subject", "subject_1"], "missing.mcap: cannot be read"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    names = {name: str(path) for name, path in bags.items()}
    names["twin"] = shutil.copy(bags["rail_1"], tmp_path / "rail_9.mcap")
    given = [text.format(**names) for text in arguments]
    assert main(["trace", *given, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists() and not calls


def test_a_learned_model_of_another_version_is_refused_and_nothing_is_written(
    bags: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = learned_text(packaged()).replace(f'"version": {VERSION}', '"version": 99')
    monkeypatch.setattr(trace_module, "packaged", lambda: learned_from(text, "learned.json"))
    given = [str(bags[name]) for name in ("rail_1", "rail_2", "road")]
    assert main(["trace", *given, "--subject", "subject_1", "-o", str(tmp_path / "out")]) == 2
    *_, error = capsys.readouterr().err.splitlines()
    assert error.endswith(f"learned.json: version 99 of the learned model, allowed is {VERSION}; run make train")
    assert not list(tmp_path.iterdir())


def test_an_output_that_is_a_file_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main(["trace", "missing.mcap", "--subject", "subject_1", "-o", str(place)]) == 2
        assert "file: is a file; the results need a directory" in capsys.readouterr().err
    check_directory(tmp_path / "new" / "out")
