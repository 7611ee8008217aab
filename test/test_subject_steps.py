"""`biodyn subject`: all steps in one go, used again while they fit, reasons where a step is not possible; campaigns."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import chores
import pytest
import yaml
from listed import assert_listed
from pages import Page, empty_drawings
from session_bags import session_bag

from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import serial_map
from biodyn_core.body.parameters import UNFITTED
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from biodyn_core.sessions.settings import SessionSettings
from biodyn_core.tracing.settings import TraceSettings
from biodyn_ros.base.progress import silent
from biodyn_ros.base.resources import subject_file
from biodyn_ros.commands.cli import main
from biodyn_ros.events.finding import SessionOptions
from biodyn_ros.fit import fitting
from biodyn_ros.fit.fitting import FitOptions
from biodyn_ros.fit.report import Report
from biodyn_ros.fit.summary import FitSummary, summary_of
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.reading.provenance import role_of, source_of
from biodyn_ros.reports.verdict import Verdict
from biodyn_ros.subject import making
from biodyn_ros.subject.making import Helpers, MadeSubject, SubjectOptions, make_subject
from biodyn_ros.subject.page import subject_page, write_page
from biodyn_ros.subject.page import verdict_of as subject_verdict
from biodyn_ros.subject.people import Person, PersonRow, check_failed, load_people, make_people
from biodyn_ros.subject.people_page import people_page, text_of, verdict_of
from biodyn_ros.subject.steps import Step, StepLog, key_of
from biodyn_ros.subject.text import document_of
from biodyn_ros.subject.text import text_of as subject_text
from biodyn_ros.subject.uses import used_events
from biodyn_ros.subject.wording import sentence_of
from biodyn_ros.trace.tracing import TraceOptions
from biodyn_ros.work.executors import executor_of

CLUSTER_WORKERS = 1
DRIVE_S = 8.0
"""Every event of a short session reads the whole bag, and half of the seconds take a quarter of the time."""
SUBJECT = load_subject(subject_file("subject_1"))
UNKNOWN = dataclasses.replace(SUBJECT, name="anna", parameters=UNFITTED)
QUICK = FitSettings(swarm=SwarmSettings(particles=10, iterations=10, starts=1), refined_starts=1, evaluations=20)
# The session is too short for a verdict, so the refit is all that a trace computes.
REFIT = dataclasses.replace(QUICK, phase1="pooled", clocks="trusted")
SESSION = SessionOptions(session=SessionSettings(steady_least_s=6.0))
OPTIONS = SubjectOptions(
    session=SESSION, fit=FitOptions(settings=QUICK), trace=TraceOptions(settings=TraceSettings(base=REFIT)),
    report=False,
)  # fmt: skip


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session_bag(tmp_path_factory.mktemp("session") / "session.mcap", drive_s=DRIVE_S)


def make(
    bag: Path, directory: Path, given: Subject = UNKNOWN, options: SubjectOptions = OPTIONS
) -> tuple[MadeSubject, list[str]]:
    """A made subject, and the lines that were said."""
    lines: list[str] = []
    return make_subject([str(bag)], given, directory, options, Helpers(None, serial_map, silent, lines.append)), lines


@pytest.fixture(scope="module")
def reports() -> list[Report]:
    """The report of the fit of `made`."""
    return []


@pytest.fixture(scope="module")
def made(bag: Path, tmp_path_factory: pytest.TempPathFactory, reports: list[Report]) -> MadeSubject:
    def fit_bags(*given: Any) -> Report:
        reports.append(fitting.fit_bags(*given))
        return reports[-1]

    with empty_drawings(), pytest.MonkeyPatch.context() as patched:
        patched.setattr(making, "fit_bags", fit_bags)
        return make(bag, tmp_path_factory.mktemp("made"), options=dataclasses.replace(OPTIONS, report=True))[0]


def copied(made: MadeSubject, name: str) -> Path:
    """A copy of its directory, from where the bag has the same relative path."""
    return Path(shutil.copytree(made.directory, made.directory.with_name(name)))


def refuse_steps(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """These steps fail, and take no time."""

    def refuse(*_: object) -> None:
        raise InputError("not here")

    for name in names:
        monkeypatch.setattr(making, name, refuse)


@dataclasses.dataclass(frozen=True)
class Roads:
    """Three roads: one to fit, one to choose, one to report and to validate on; made after an interruption."""

    bag: Path
    directory: Path
    interrupted: list[str]
    made: MadeSubject
    lines: list[str]


ROADS = dataclasses.replace(OPTIONS, session=dataclasses.replace(OPTIONS.session, allowed=("one-condition",)))


@pytest.fixture(scope="module")
def roads(tmp_path_factory: pytest.TempPathFactory) -> Roads:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    place = tmp_path_factory.mktemp("roads")
    bag, directory = session_bag(place / "roads.mcap", cases=("road", "road", "road"), drive_s=DRIVE_S), place / "made"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(making, "fit_bags", interrupted)
        with pytest.raises(KeyboardInterrupt):
            make(bag, directory, options=ROADS)
    before = [step["name"] for step in json.loads((directory / "subject.json").read_text())["steps"]]
    return Roads(bag, directory, before, *make(bag, directory, options=ROADS))


# --- one subject -----------------------------------------------------------------------------------------------------


def test_all_steps_are_done_and_nothing_is_fitted_to_and_reported_on(made: MadeSubject, bag: Path) -> None:
    assert [(step.name, step.state) for step in made.steps.values()] == [
        ("events", "done"), ("fit", "done"), ("validate", "done"), ("trace", "done"),
    ]  # fmt: skip
    result = load_subject(made.directory / "subject.yaml")
    assert made.used is not None and result.parameters != SUBJECT.parameters
    fitted = json.loads((made.directory / "fitted.fit.json").read_text())
    for part in made.used.fit:
        assert role_of(result, source_of(part)) == "fitted"
    held = {event["bag"] for event in fitted["held_out"] if event["why"] == "held out"}
    assert held == {str(part) for part in made.used.held_out}
    assert not held & {case["bag"] for case in fitted["cases"]}
    traced = json.loads((made.directory / "trace" / "trace.json").read_text())
    assert {each["use"] for each in traced["bags"] if each["bag"] in held} <= {"choose", "held_out"}


def test_the_page_tells_every_step_with_links_that_exist(made: MadeSubject) -> None:
    with empty_drawings():
        write_page(made, report=True)
    source = (made.directory / "index.html").read_text()
    page = Page(source)
    for title in ("1. Events", "2. Fit", "3. Validation", "4. Missing effect", "Use of the events"):
        assert title in page.text
    links = [part.split('"')[0] for part in source.split('href="')[1:]]
    assert {"events.html", "events.yaml", "fitted.fit.html", "fitted.yaml", "trace/trace.html", "subject.yaml"} <= set(
        links
    )
    assert all((made.directory / link).exists() for link in links if "://" not in link and not link.startswith("#"))
    write_page(made, report=False)
    assert not (made.directory / "index.html").exists()


def test_the_page_has_no_link_to_the_files_of_a_step_that_failed(made: MadeSubject) -> None:
    """They are those of an earlier run, of other data."""
    failed = dataclasses.replace(made.steps["trace"], state="failed", reason="rail_3: the simulation is unstable")
    with empty_drawings():
        page = subject_page(dataclasses.replace(made, steps={**made.steps, "trace": failed}))
    assert (made.directory / "trace" / "trace.html").exists() and "rail_3" in page
    assert "trace/trace" not in page and "fitted.fit.html" in page


def test_steps_are_used_again_while_they_fit(made: MadeSubject, bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = copied(made, "again")
    again, lines = make(bag, directory)
    assert lines == [f"{name}: done, used again" for name in ("events", "fit", "validate", "trace")]
    assert_listed("subject", document_of(again))
    refuse_steps(monkeypatch, "fit_bags", "validate", "trace_bags")  # those that are not used again
    tried = ["events: done, used again", "fit: failed, not here"]
    (directory / "fitted.yaml").unlink()
    assert make(bag, directory)[1][:2] == tried
    shutil.copy(made.directory / "fitted.yaml", directory)
    assert make(bag, directory)[1][1:] == [f"{name}: done, used again" for name in ("fit", "validate", "trace")]
    # An event that was deleted by hand is not used, and what depends on it is done again.
    document = yaml.safe_load((directory / "events.yaml").read_text())
    gone = document["events"].pop(0)["name"]
    (directory / "events.yaml").write_text(yaml.safe_dump(document))
    edited, lines = make(bag, directory)
    assert lines[:2] == tried and not any("used again" in line for line in lines[2:])
    assert edited.used is not None and gone not in {part.name for part in (*edited.used.fit, *edited.used.held_out)}


def test_a_changed_subject_is_no_result_of_the_fit(
    made: MadeSubject, reports: list[Report], bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the errors of the fit would be shown for it."""
    directory = copied(made, "changed")
    path = directory / "fitted.yaml"
    changed = path.read_text().replace("body_mass_kg: 58.6", "body_mass_kg: 90.0")
    assert changed != path.read_text()
    path.write_text(changed)
    monkeypatch.setattr(making, "fit_bags", lambda *_: reports[0])
    _, lines = make(bag, directory)
    assert lines[1] == "fit: the earlier fitted.yaml is kept as fitted.earlier.yaml"
    assert (directory / "fitted.earlier.yaml").read_text() == changed
    assert path.read_text() == (made.directory / "fitted.yaml").read_text()
    assert lines[3:] == [f"{name}: done, used again" for name in ("validate", "trace")]


def test_the_fit_states_how_many_of_its_events_it_was_fitted_to(made: MadeSubject) -> None:
    assert made.used is not None
    step = made.steps["fit"]
    assert step.facts["fitted_events"] == len({part.case for part in made.used.fit}) == 3
    more = dataclasses.replace(made.used, fit=(*made.used.fit[:3], *made.used.fit[:3]))
    text = "fitted to the representative event of each condition, 3 of 6; mean error "
    assert sentence_of(step, more).startswith(text)
    few = dataclasses.replace(made.used, fit=made.used.fit[:3])
    assert sentence_of(step, few).startswith("mean error ")
    late = dataclasses.replace(step, facts=dict(step.facts) | {"clocks": ["road_1: head fits best with a clock"]})
    assert sentence_of(late, few).endswith("; road_1: head fits best with a clock")


def test_an_interrupted_run_continues(roads: Roads, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--allow one-condition"):
        make(roads.bag, tmp_path / "refused")
    found, lines = roads.made, roads.lines
    assert roads.interrupted == ["events"]
    assert lines[0] == "events: done, used again" and lines[1].startswith("fit: done")
    (event,) = found.steps["validate"].facts["events"]
    assert found.used is not None and event["name"] == found.used.report[0].name and event["mean_percent"] > 0.0
    assert (roads.directory / "validate" / event["name"] / "validate.json").exists()
    text = subject_text(found)
    assert "3 events in " in text and "1 event that nothing was fitted to" in text
    with empty_drawings():
        assert event["name"] in Page(subject_page(found)).text


def test_uses_that_the_trace_has_changed_are_stated(roads: Roads, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the event for choosing, the trace chooses by the one that was dealt to report."""
    found, directory = roads.made, copied(roads.made, "changed")
    assert found.used is not None
    uses = dict(found.used.uses)
    assert sorted(uses.values()) == ["choose", "fit", "report"] and found.steps["trace"].facts["uses"] == uses
    assert "as dealt" not in subject_text(found)

    def without_first(
        train: Sequence[Case], held_out: Sequence[Case], *_: object
    ) -> tuple[list[Case], list[Case], list[str]]:
        return list(train), list(held_out)[1:], ["a sensor failed"]

    monkeypatch.setattr("biodyn_core.tracing.data_checks.usable", without_first)
    (directory / "trace" / "trace.json").unlink()
    changed, lines = make(roads.bag, directory, options=ROADS)
    assert lines[:3] == [f"{name}: done, used again" for name in ("events", "fit", "validate")]
    choose, report = (next(event for event, use in uses.items() if use == one) for one in ("choose", "report"))
    assert changed.steps["trace"].facts["uses"] == {**{e: u for e, u in uses.items() if u == "fit"}, report: "choose"}
    assert "; 2 events not used as dealt" in subject_text(changed)
    with empty_drawings():
        write_page(changed, report=True)
    text = Page((directory / "index.html").read_text()).text
    assert "report (in the trace: choose)" in text and "choose (in the trace: not used)" in text and choose in text


def test_a_step_that_fails_has_its_reason_and_the_rest_goes_on(made: MadeSubject, bag: Path) -> None:
    """The fit has a profile of no parameter; the trace has the given subject."""
    directory = copied(made, "refused")
    refused = dataclasses.replace(OPTIONS.fit, profiles=("nothing",))
    found, lines = make(bag, directory, options=dataclasses.replace(OPTIONS, fit=refused))
    assert not any("used again" in line for line in lines[1:])
    states = {step.name: step.state for step in found.steps.values()}
    assert states == {"events": "done", "fit": "failed", "validate": "skipped", "trace": "done"}
    assert "'nothing' is not a fitted parameter" in found.steps["fit"].reason
    assert not (directory / "subject.yaml").exists()
    with empty_drawings():
        write_page(found, report=True)
    text = Page((directory / "index.html").read_text()).text
    assert "There is no resulting subject" in text and "without a fit there is nothing to validate" in text


def test_a_fit_that_diverges_in_an_event_has_no_mean_error(
    made: MadeSubject, reports: list[Report], bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverging(report: Report) -> FitSummary:
        return dataclasses.replace(summary_of(report), held_out=(3.0, math.inf))

    directory = copied(made, "diverging")
    (directory / "fitted.yaml").unlink()
    monkeypatch.setattr(making, "fit_bags", lambda *_: reports[0])
    monkeypatch.setattr(making, "summary_of", diverging)
    refuse_steps(monkeypatch, "validate", "trace_bags")
    found, lines = make(bag, directory)
    assert found.steps["fit"].state == "done" and not found.steps["fit"].again
    assert any(line.startswith("fit: done") for line in lines)
    steps = {step["name"]: step for step in json.loads((directory / "subject.json").read_text())["steps"]}
    assert steps["fit"]["facts"]["held_out_percent"] is None and steps["fit"]["facts"]["fitted_percent"] > 0.0
    assert steps["fit"]["facts"]["unstable_events"] == 1


def test_an_edited_table_of_conditions_is_read_again(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_steps(monkeypatch, "fit_bags", "trace_bags")
    table = tmp_path / "cases.csv"
    options = dataclasses.replace(OPTIONS, session=dataclasses.replace(OPTIONS.session, cases=str(table)))
    for case in ("gravel", "cobbles"):
        table.write_text(f"start,end,case\n0,20,{case}\n")
        found, _ = make(bag, tmp_path / "out", options=options)
        assert found.used is not None and case in {part.case for part in (*found.used.fit, *found.used.held_out)}


def test_a_session_without_events_is_refused(tmp_path: Path) -> None:
    short = session_bag(tmp_path / "still.mcap", cases=())
    with pytest.raises(InputError, match=r"still\.mcap: no event in 7\.0 s"):
        make(short, tmp_path / "out")


def test_a_damaged_log_is_one_line(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "subject.json").write_text("{")
    with pytest.raises(InputError, match=r"subject\.json: .*; remove it to start anew"):
        make(bag, tmp_path)


def test_a_log_of_another_version_is_not_used(tmp_path: Path) -> None:
    path = tmp_path / "subject.json"
    path.write_text(json.dumps({"schema": 1, "version": "0", "steps": []}))
    log = StepLog(path)
    assert log.run("fit", key_of(1), [], dict).state == "done" and log.steps["fit"].again is False
    assert (
        StepLog(path).run("fit", key_of(1), [], dict).again and not StepLog(path).run("fit", key_of(2), [], dict).again
    )


def test_a_log_without_the_number_of_diverging_events_is_not_used(tmp_path: Path) -> None:
    """Of schema 2; else a fit that diverges would be used again as one that does not."""
    path = tmp_path / "subject.json"
    StepLog(path).run("fit", key_of(1), [], dict)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"schema": 2}))
    assert not StepLog(path).run("fit", key_of(1), [], dict).again


def test_a_failed_repeat_forgets_no_finished_step_and_no_edited_events(made: MadeSubject, bag: Path) -> None:
    """A table that does not exist, the original options again, and another setting, after an edit by hand."""
    directory = copied(made, "repeated")
    path = directory / "events.yaml"
    edited = path.read_text() + "# seen by Anna\n"
    path.write_text(edited)
    missing = dataclasses.replace(OPTIONS.session, cases=str(directory / "condition.csv"))
    with pytest.raises(InputError, match=r"condition\.csv: cannot be read"):
        make(bag, directory, options=dataclasses.replace(OPTIONS, session=missing))
    stored = json.loads((directory / "subject.json").read_text())
    assert [(step["name"], step["state"]) for step in stored["steps"]] == [("events", "failed")]
    assert [step["name"] for step in stored["kept"]] == ["events", "fit", "validate", "trace"]
    _, lines = make(bag, directory)
    assert lines == [f"{name}: done, used again" for name in ("events", "fit", "validate", "trace")]
    assert path.read_text() == edited
    finer = dataclasses.replace(SESSION.session, shock_g=0.81)
    other = dataclasses.replace(OPTIONS.session, session=finer)
    _, lines = make(bag, directory, options=dataclasses.replace(OPTIONS, session=other))
    assert lines[0] == "events: the earlier events.yaml is kept as events.earlier.yaml"
    assert (directory / "events.earlier.yaml").read_text() == edited != path.read_text()
    make(bag, directory)
    assert not (directory / "events.earlier_2.yaml").exists()  # a file that nobody edited is not kept


def test_a_step_is_used_again_until_another_run_writes_its_files(tmp_path: Path) -> None:
    def first() -> Step:
        return StepLog(tmp_path / "subject.json").run("fit", "first", [], dict)

    def other(writes: bool, error: type[BaseException]) -> None:
        log = StepLog(tmp_path / "subject.json")

        def work() -> dict[str, object]:
            if writes:
                log.forget("fit")
            raise error("stopped")

        log.run("fit", "other", [], work)

    assert not first().again
    other(writes=False, error=InputError)
    assert first().again
    with pytest.raises(KeyboardInterrupt):
        other(writes=True, error=KeyboardInterrupt)
    assert not first().again


# --- uses ------------------------------------------------------------------------------------------------------------


def test_events_are_chosen_over_all_levels_and_dealt() -> None:
    parts = [BagPart(Path("a"), 10.0 * k, 10.0 * k + 5.0, "road", level_mps2=0.1 * k, name=f"r{k}") for k in range(40)]
    used = used_events(parts, 12, seed=0)
    levels = sorted(part.level_mps2 for part in (*used.fit, *used.held_out))
    assert len(levels) == 12 and used.unused == 28 and (levels[0], levels[-1]) == (0.0, pytest.approx(3.9))
    assert (len(used.fit), len(used.report)) == (6, 3)
    assert [used.uses[str(part)] for part in used.held_out] == ["choose", "report"] * 3
    assert used_events(parts, 12, seed=1).uses != used.uses == used_events(parts, 12, seed=0).uses


# --- command ---------------------------------------------------------------------------------------------------------


def test_the_command_says_what_is_missing(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for line, message in (
        ([str(bag), "-o", "x"], "SESSION... and --subject are needed, or --campaign alone"),
        ([str(bag), "--subject", "subject_1", "-o", "x", "--per-case", "2"], "--per-case 2: allowed are 3 to 200"),
        (["--campaign", str(tmp_path / "no.yaml"), "-o", "x"], "no.yaml: cannot be read"),
    ):
        assert main(["subject", *line]) == 2
        assert message in capsys.readouterr().err


# --- people ----------------------------------------------------------------------------------------------------------


def people_file(folder: Path, text: str) -> Path:
    path = folder / "people.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("people: []", "people: expected a list of at least one person"),
        ("people: [{subject: subject_1}]", r"people\[0\]: key 'sessions' is missing"),
        ("people: [{subject: subjct_1, sessions: [a.mcap]}]", r"people\[0\]\.subject: no subject file subjct_1"),
        ("people: [{subject: subject_1, sessions: [a.mcap]}]", r"sessions: there is no .*a\.mcap: paths are relative"),
        ("people: [{subject: subject_1, sessions: [s.mcap], name: a/b}]", "'a/b' cannot be the name of a directory"),
        ("people: [{subject: subject_1, sessions: [s.mcap], cases: x.csv}]", r"cases: there is no .*x\.csv"),
        (
            "people: [{subject: subject_1, sessions: [s.mcap]}, {subject: subject_1, sessions: [s.mcap]}]",
            "two people have the name subject_1: set a name",
        ),
        (
            "people: [{subject: subject_1, sessions: [s.mcap]}, {subject: subject_2, sessions: [./s.mcap]}]",
            "s.mcap is a session of subject_1 and of subject_2: remove it from one",
        ),
    ],
)
def test_a_wrong_file_of_people_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "s.mcap").touch()
    with pytest.raises(InputError, match=message) as error:
        load_people(people_file(tmp_path, text))
    assert "\n" not in str(error.value)


def test_people_are_read_with_paths_from_their_file(tmp_path: Path) -> None:
    (tmp_path / "s.mcap").touch()
    (person,) = load_people(people_file(tmp_path, "people: [{subject: subject_1, sessions: [s.mcap], name: anna}]"))
    assert person == Person("anna", subject_file("subject_1"), SUBJECT, (str(tmp_path / "s.mcap"),), "seat")


@pytest.mark.parametrize("file", ["subject.yaml", "fitted.yaml", "trace/subject.yaml"])
def test_the_given_file_of_a_person_is_never_a_result(
    tmp_path: Path, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the folder of the results, under the name of a result."""
    given = tmp_path / "anna" / file  # the directory of another person
    given.parent.mkdir(parents=True)
    given.write_text(SUBJECT.to_yaml())
    for name in ("s.mcap", "t.mcap"):
        (tmp_path / name).touch()
    campaign = people_file(
        tmp_path,
        f"people: [{{subject: anna/{file}, sessions: [s.mcap], name: ben}},"
        f" {{subject: subject_1, sessions: [t.mcap], name: anna}}]",
    )
    assert main(["subject", "--campaign", str(campaign), "-o", str(tmp_path)]) == 2
    assert f"anna/{file}: is an input, and a result would replace it" in capsys.readouterr().err
    assert given.read_text() == SUBJECT.to_yaml()
    assert main(["subject", str(tmp_path / "s.mcap"), "--subject", str(given), "-o", str(tmp_path / "anna")]) == 2
    assert "a result would replace it" in capsys.readouterr().err


def test_one_that_fails_does_not_stop_the_others(
    made: MadeSubject, reports: list[Report], bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A subject without validation and trace is done too."""
    monkeypatch.setattr(making, "fit_bags", lambda *_: reports[0])
    refuse_steps(monkeypatch, "validate", "trace_bags")
    still = session_bag(tmp_path / "still.mcap", cases=())
    people = [
        Person("ben", Path("ben.yaml"), UNKNOWN, (str(still),), "seat"),
        Person("anna", Path("anna.yaml"), UNKNOWN, (str(bag),), "seat"),
    ]
    seen: list[tuple[int, int]] = []
    rows = make_people(people, tmp_path / "out", OPTIONS, None, lambda done, total: seen.append((done, total)))
    assert [(row.name, row.state) for row in rows] == [("ben", "failed"), ("anna", "done")]
    assert "no event in" in rows[0].error and seen == [(1, 2), (2, 2)]
    stored = json.loads((tmp_path / "out" / "people.json").read_text())["people"]
    assert [each["name"] for each in stored] == ["ben", "anna"]
    assert "ben" in text_of(rows) and verdict_of(rows).headline == "1 of 2 people done"
    with empty_drawings():
        assert "no event in" in Page(people_page(rows, tmp_path / "out")).text


def errors(fitted: float | None, held_out: float | None, unstable: int) -> dict[str, float | None]:
    """The facts of a fit."""
    return {
        "fitted_percent": fitted,
        "held_out_percent": held_out,
        "fitted_events": 1,
        "unstable_events": unstable,
        "clocks": [],
    }


def invented(name: str, directory: Path, **steps: Step) -> MadeSubject:
    """A made subject of steps that are not run; those not given are done without a remark."""
    done = {
        "events": Step("events", "done", facts={"seconds": 600.0, "rests": 2}),
        "fit": Step("fit", "done", facts=errors(8.0, 12.0, 0)),
        "validate": Step("validate", "done", facts={"events": []}),
        "trace": Step("trace", "done", facts={"verdict": "none", "headline": "Nothing is missing.", "adds": False}),
    }
    return MadeSubject(name, directory, done | steps, None)


@pytest.mark.parametrize(
    ("facts", "sentence"),
    [
        (
            errors(8.0, 12.0, 0),
            "mean error 8.00 % of the rms in the events fitted to, 12.0 % of the rms in the events not fitted to",
        ),
        (errors(8.0, None, 0), "mean error 8.00 % of the rms in the events fitted to"),
        (
            errors(None, 12.0, 1),
            "the fitted model diverges in 1 event; mean error 12.0 % of the rms in the events not fitted to",
        ),
        (errors(None, None, 3), "the fitted model diverges in 3 events"),
    ],
)
def test_a_fit_that_diverges_is_said_with_its_tone(
    tmp_path: Path, facts: dict[str, float | None], sentence: str
) -> None:
    made = invented("anna", tmp_path, fit=Step("fit", "done", facts=facts))
    assert f"fit       done     {sentence}\n" in subject_text(made)
    diverges = sentence.partition(";")[0]
    reasons = (f"Fit: {diverges}.",) if facts["unstable_events"] else ()
    found = subject_verdict(made)
    assert (found.tone, found.reasons) == ("bad" if reasons else "none", reasons)
    of_all = verdict_of([PersonRow("anna", "done", document=document_of(made))])
    assert (of_all.tone, of_all.reasons) == (found.tone, tuple(f"anna: {diverges}." for _ in reasons))


def test_a_mean_over_some_of_the_validated_events_says_so(tmp_path: Path) -> None:
    compared = [{"name": name, "verdict": "agrees", "reason": "", "mean_percent": 5.0} for name in ("a", "b")]
    lost = {"name": "c", "verdict": "not possible", "reason": "the model diverges", "mean_percent": None}
    for events, text in (
        (compared, "2 events that nothing was fitted to: 2 agrees; mean error 5.00 %\n"),
        ([*compared, lost], "2 agrees, 1 not possible; mean error 5.00 % in the 2 compared\n"),
        ([lost], "1 event that nothing was fitted to: 1 not possible\n"),
    ):
        step = Step("validate", "done", facts={"events": events})
        assert text in subject_text(invented("anna", tmp_path, validate=step))


def test_a_person_without_a_fit_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `biodyn subject` of that person alone, which has the exit code 2; ben has a fit, and his trace failed."""
    unfitted = invented("anna", tmp_path, fit=Step("fit", "failed", reason="road_1: no segment has 1 s to compare"))
    untraced = invented("ben", tmp_path, trace=Step("trace", "failed", reason="one event"))
    documents = {made.name: document_of(made) for made in (unfitted, untraced)}
    monkeypatch.setattr("biodyn_ros.subject.people.make_person", lambda person, *_: documents[person.name])
    people = [Person(name, Path(f"{name}.yaml"), UNKNOWN, ("session.mcap",), "seat") for name in documents]
    rows = make_people(people, tmp_path / "out", OPTIONS, None, lambda done, total: None)
    assert [(row.name, row.state) for row in rows] == [("anna", "failed"), ("ben", "done")]
    assert [row.document for row in rows] == list(documents.values())
    stored = json.loads((tmp_path / "out" / "people.json").read_text())["people"]
    assert [each["state"] for each in stored] == ["failed", "done"]
    reason = "anna: fit: road_1: no segment has 1 s to compare."
    assert verdict_of(rows) == Verdict("warn", "1 of 2 people done", (reason,))
    with pytest.raises(InputError, match=r"^1 of 2 people failed: anna; see"):
        check_failed(rows, tmp_path / "out")


@pytest.mark.parametrize(
    "where",
    [
        "processes:1",
        pytest.param("cluster", marks=pytest.mark.slow),  # the same calls; test_work has a cluster
    ],
)
def test_a_campaign_ends_complete_although_a_worker_is_killed(
    tmp_path: Path, where: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = request.getfixturevalue("cluster") if where == "cluster" else where
    monkeypatch.setattr("biodyn_ros.subject.people.make_person", chores.make_or_die_once)
    people = [
        Person(name, Path(f"{name}.yaml"), UNKNOWN, ("session.mcap",), "seat") for name in ("anna", "ben", "carl")
    ]
    with executor_of(address) as executor:
        rows = make_people(people, tmp_path, OPTIONS, executor, lambda done, total: None)
    assert (tmp_path / "died").exists() and [row.state for row in rows] == ["done", "done", "done"]
    assert [(tmp_path / name / "made").read_text() for name in ("anna", "ben", "carl")] == ["anna", "ben", "carl"]
