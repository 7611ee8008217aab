"""The events file and its command: what is written is read again, a wrong edit is one line, and fits use it."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from listed import assert_listed
from pages import NASTY, Page, empty_drawings
from session_bags import session_bag

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.sessions.findings import Fault
from biodyn_core.sessions.settings import SessionSettings
from biodyn_core.tracing.settings import FloorSettings
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.bag.cdr import STRING_TYPE
from biodyn_ros.base import topics
from biodyn_ros.commands.cli import main
from biodyn_ros.events.drawings import COLUMNS, decimated, timeline, timeline_rows
from biodyn_ros.events.finding import SessionOptions, find_events, find_sessions, read_spans, spans_of
from biodyn_ros.events.lacking import contents, lacking_for_fit, lacking_for_trace
from biodyn_ros.events.page import events_page, tilts_deg
from biodyn_ros.events.refusals import REFUSALS
from biodyn_ros.events.text import MOST_ROWS, text_of
from biodyn_ros.fit.campaign_file import load_campaign
from biodyn_ros.reading.dealing import TO_FIT, TO_TRACE, Dealable, deal
from biodyn_ros.reading.events_file import FoundSession, load_events, write_events
from biodyn_ros.reading.given import bags_of
from biodyn_ros.reading.gravity import gravity_by_bag
from biodyn_ros.reading.marks import Mark
from biodyn_ros.reading.parts import part_of
from biodyn_ros.reading.sensors import ReadingOptions, open_sensors

SMALL = ["--particles", "10", "--iterations", "5", "--starts", "1", "--refined-starts", "1", "--evaluations", "15"]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> FoundSession:
    """A session of drives between rests."""
    return find_events(session_bag(tmp_path_factory.mktemp("events") / "session.mcap"))


@pytest.fixture(scope="module")
def place(found: FoundSession) -> Path:
    """The directory of the session, with its events file."""
    at = found.bag.parent
    write_events([found], at / "session.events.yaml")
    return at


def test_the_file_holds_the_events(place: Path, found: FoundSession) -> None:
    parts = load_events(place / "session.events.yaml")
    events = found.findings.events
    assert [part.name for part in parts] == [event.name for event in events]
    for part, event in zip(parts, events, strict=True):
        assert (part.begin_s, part.end_s) == pytest.approx((event.begin_s, event.end_s), abs=0.006)
        assert part.case == event.case and part.path == place / "session.mcap"
        assert event.rest is not None and part.rest_s == pytest.approx(
            (found.findings.rests[event.rest].begin_s, found.findings.rests[event.rest].end_s), abs=0.006
        )
    assert {part.case for part in parts} == {"road", "pothole", "rail"}
    (session,) = yaml.safe_load((place / "session.events.yaml").read_text())["sessions"]
    assert len(session["gravity_mps2"]) == len(session["rests_s"])
    assert all(set(each) == set(SENSORS) for each in session["gravity_mps2"])
    assert all(tilt < 0.5 for each in tilts_deg(found.findings.rests) for tilt in each.values())
    assert len(found.findings.rests) == 5


def test_a_session_and_its_events_move_together(place: Path, tmp_path: Path) -> None:
    for name in ("session.mcap", "session.events.yaml"):
        shutil.copy(place / name, tmp_path / name)
    assert load_events(tmp_path / "session.events.yaml")[0].path == tmp_path / "session.mcap"


Edit = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda d: d.update(more=1), "unknown key 'more'"),
        (lambda d: d["events"][0].update(cas="road"), "event 1: unknown key 'cas', known are "),
        (lambda d: d["events"][0].pop("case"), "event 1: key 'case' is missing"),
        (lambda d: d["events"][1].update(start_s=d["events"][0]["end_s"] - 1.0), r"overlap: end the first by"),
        (lambda d: d["events"][0].update(end_s=9999.0), "event .*: start_s and end_s: .* is not within the bag"),
        (lambda d: d["events"][0].update(start_s=-1.0), "is not within the bag"),
        (lambda d: d["events"][0].update(start_s="x"), "'x' is no number"),
        (lambda d: d["events"][0].update(rest_s=[1.0]), "rest_s: expected two times"),
        (lambda d: d["events"][0].update(bag="other.mcap"), "bag 'other.mcap' is not among the sessions"),
        (lambda d: d["events"][1].update(name=d["events"][0]["name"]), "two events have the name"),
        (lambda d: d["sessions"][0].update(sha256="0"), "session.mcap has changed since its events were found"),
        (lambda d: d["sessions"][0].update(bag="gone.mcap"), "gone.mcap: no such bag: if it was moved"),
        (
            lambda d: d["sessions"][0].update(clock_ppm={"hed": 1.0}),
            "unknown sensor 'hed', known are .*; did you mean head?",
        ),
        (lambda d: d["sessions"][0].update(clock_ppm={"head": 2e3}), "head is 2000, allowed are -1000 to 1000"),
        (lambda d: d["sessions"][0].update(map={"hed": "a"}), "map of session.mcap: .*'hed'.*; did you mean head?"),
        (lambda d: d["sessions"][0].update(time="lo"), "time of session.mcap is 'lo', .*; did you mean log?"),
        (lambda d: d["events"][0].update(rest_bag="x"), "rest_bag 'x' is not among the sessions"),
        (
            lambda d: d["events"][0].update(name="../../elsewhere"),
            "name of an event: '../../elsewhere' cannot be a file's",
        ),
        (lambda d: d["events"][0].update(name="/tmp/elsewhere"), "cannot be a file's"),
        (lambda d: d["events"][0].update(name="a\0b"), "name is .*, expected one line without control characters"),
        (lambda d: d.update(events=[]), "has no events"),
        (lambda d: d.update(events={}), "events: expected a list"),
        (lambda d: d.update(schema=2), "schema is 2, this version reads 1: run biodyn events again"),
    ],
)
def test_a_wrong_edit_is_one_line(place: Path, tmp_path: Path, edit: Edit, message: str) -> None:
    document = yaml.safe_load((place / "session.events.yaml").read_text())
    (tmp_path / "session.mcap").symlink_to(place / "session.mcap")
    edit(document)
    path = tmp_path / "edited.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match=message) as error:
        load_events(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


def test_events_are_read_with_the_topics_and_the_clock_of_their_file(place: Path, tmp_path: Path) -> None:
    """The topics of neck and head exchanged, and log times: of an event, of its rest, and of its whole bag."""
    swapped = {"neck": "imu/head/data", "head": "imu/neck/data"}
    found = find_events(place / "session.mcap", SessionOptions(mapping=swapped, time="log"))
    write_events([found], tmp_path / "swapped.yaml")
    part = load_events(tmp_path / "swapped.yaml")[0]
    with open_sensors(part.beside(part.path), ReadingOptions()) as sensors:
        assert set(sensors.times.values()) == {"log"}
    (rest,) = gravity_by_bag([part], ReadingOptions(), {})
    (plain,) = gravity_by_bag([load_events(place / "session.events.yaml")[0]], ReadingOptions(), {})
    assert rest["neck"].mean_mps2 == pytest.approx(plain["head"].mean_mps2, abs=1e-3)
    with open_sensors(part, ReadingOptions(mapping=swapped, time="log")) as again:
        assert set(again.times.values()) == {"log"}
    with pytest.raises(InputError, match=r"its events were found with .*=imu/.*/data: omit --map"):
        gravity_by_bag([part], ReadingOptions(mapping={"head": "imu/head/data"}), {})
    with open_sensors(part, ReadingOptions(mapping={"seat": "/of/another/bag"})) as other:
        assert set(other.times.values()) == {"log"}
        assert "--map seat=/of/another/bag has no effect: no such Imu topic, its events were found with seat=imu/" in (
            "\n".join(other.bag_warnings())
        )
    mapping = {"seat": "/of/another/bag", "head": "imu/pelvis/data"}
    with pytest.raises(InputError, match=r"its events were found with head=imu/neck/data: omit --map"):
        gravity_by_bag([part], ReadingOptions(mapping=mapping), {})
    by_header = load_events(place / "session.events.yaml")[0]
    with open_sensors(by_header, ReadingOptions(mapping={"head": "imu/head/data"})) as same:
        assert set(same.times.values()) == {"header"}
    with pytest.raises(InputError, match="its events were found by header stamps: run biodyn events with --time log"):
        gravity_by_bag([by_header], ReadingOptions(time="log"), {})


def test_the_drift_of_a_file_is_corrected_for_every_clock(place: Path) -> None:
    part = dataclasses.replace(load_events(place / "session.events.yaml")[-1], time="log")

    def stamps_of(clock_ppm: dict[str, float]) -> dict[int, int]:
        with open_sensors(dataclasses.replace(part, clock_ppm=clock_ppm), ReadingOptions()) as sensors:
            blocks = [block for sensor, block in sensors.samples() if sensor == "head"]
        return {
            header: at for b in blocks for header, at in zip(b.header_ns.tolist(), b.stamps_ns.tolist(), strict=True)
        }

    plain, drifting = stamps_of({}), stamps_of({"head": 100.0})
    early_s = [1e-9 * (plain[header] - drifting[header]) for header in plain.keys() & drifting.keys()]
    assert 1e-4 * part.begin_s <= min(early_s) < max(early_s) <= 1e-4 * (part.end_s + 1.0) and part.begin_s > 10.0


def test_a_file_of_a_long_session_is_read(place: Path) -> None:
    """A day with an event each ten seconds has 1.8 MB."""
    text = (place / "session.events.yaml").read_text()
    (place / "long.yaml").write_text(text + f"# {'x' * 117}\n" * 15_000)
    assert load_events(place / "long.yaml") == load_events(place / "session.events.yaml")


def test_bags_parts_and_events_are_given_together(place: Path) -> None:
    given = bags_of([str(place / "session.events.yaml"), "a.mcap", "b.mcap@1..2"])
    assert given[-2] == "a.mcap" and str(given[-1]) == "b.mcap@1..2" and len(given) > 4


def test_a_campaign_of_fits_takes_parts_and_events_files(place: Path) -> None:
    path = place / "campaign.yaml"
    path.write_text(
        "subjects: [{subject: subject_1, bags: [session.events.yaml], hold_out: ['session.mcap@70..74'],"
        " cases: {'session.mcap@70..74': kerb}}]"
    )
    (entry,) = load_campaign(path).entries
    assert [part_of(bag).name for bag in entry.bags] == [
        part.name for part in load_events(place / "session.events.yaml")
    ]
    (held,) = entry.held_out
    assert entry.cases == {str(held): "kerb"} and part_of(held).end_s == 74.0
    path.write_text("subjects: [{subject: subject_1, bags: [session.events.yaml, 'session.mcap@7..9']}]")
    with pytest.raises(InputError, match=r"session\.mcap@7\.\.9 is given twice"):
        load_campaign(path)


# --- several files and folders ---------------------------------------------------------------------------------------


def cut(bag: Path, folder: Path, spans_s: list[tuple[float, float]], head_s: float = 0.0) -> Path:
    """A recording of several files, each with the messages logged between two times; the head joins at head_s."""
    folder.mkdir()
    with open_bag(bag) as reader:
        begin_ns = reader.start_ns or 0
        for number, (begin_s, end_s) in enumerate(spans_s):
            with BagWriter(folder / f"drive_{number}.mcap") as writer:
                for block in reader.blocks():
                    since_s = 1e-9 * (block.log_ns - begin_ns)
                    joins_s = head_s if "head" in block.topic else 0.0
                    rows = np.flatnonzero((since_s >= max(begin_s, joins_s)) & (since_s < end_s))
                    writer.add_topic(block.topic, block.type)
                    if rows.size:
                        messages = np.frombuffer(b"".join(block.messages()), np.uint8).reshape(len(block), -1)
                        writer.write(block.topic, block.log_ns[rows], messages[rows])
    return folder


def test_a_split_recording_is_one_session(place: Path, found: FoundSession, tmp_path: Path) -> None:
    folder = cut(place / "session.mcap", tmp_path / "split", [(0.0, 30.0), (30.0, 45.0), (45.0, 99.0)])
    split = find_events(folder)
    assert split.findings.events == found.findings.events and split.findings.rests == found.findings.rests
    assert split.warnings == tuple(line for line in found.warnings if "made by the model" not in line)


def test_seams_are_checked(place: Path, tmp_path: Path) -> None:
    with open_bag(cut(place / "session.mcap", tmp_path / "gap", [(0.0, 20.0), (24.0, 32.0)])) as reader:
        assert "drive_1.mcap begins 4.0 s after the end of drive_0.mcap: a part is missing" in reader.warnings
    gap = find_events(tmp_path / "gap")
    assert [fault.kind for fault in gap.findings.faults if fault.sensor == "seat"] == ["missing"]
    with open_bag(cut(place / "session.mcap", tmp_path / "back", [(0.0, 14.0), (4.0, 16.0)])) as reader:
        assert "drive_1.mcap begins 10.0 s before the end of drive_0.mcap: was a clock set?" in reader.warnings


def test_a_folder_without_rest_uses_the_rest_of_another(place: Path, tmp_path: Path) -> None:
    """The second folder begins in motion, 12 s after the rest at the end of the first."""
    first = cut(place / "session.mcap", tmp_path / "first", [(0.0, 22.0)])
    second = cut(place / "session.mcap", tmp_path / "second", [(24.0, 34.5)])
    with pytest.raises(InputError, match="the same recording"):
        find_sessions([first, first], SessionOptions(), lambda done, total: None)
    settings = SessionOptions(session=SessionSettings(steady_least_s=3.0))
    sessions = find_sessions([first, second], settings, lambda done, total: None)
    assert sessions[1].findings.rests == () and sessions[1].borrowed is not None
    write_events(sessions, tmp_path / "both.yaml")
    parts = [part for part in load_events(tmp_path / "both.yaml") if part.path == tmp_path / "second"]
    assert parts and all(part.rest_bag == tmp_path / "first" for part in parts)
    gravity, whole = gravity_by_bag([parts[0], place / "session.mcap"], ReadingOptions(), {})
    assert all(gravity[sensor].mean_mps2 == pytest.approx(whole[sensor].mean_mps2, abs=0.02) for sensor in whole)
    with empty_drawings():
        assert "of first" in Page(events_page(sessions)).text


def test_folders_that_overlap_in_time_are_reported(place: Path, tmp_path: Path) -> None:
    folders = [
        cut(place / "session.mcap", tmp_path / name, [s]) for name, s in (("a", (0.0, 40.0)), ("b", (17.0, 57.0)))
    ]
    sessions = find_sessions(folders, SessionOptions(), lambda done, total: None)
    assert all(any("overlap those of" in line for line in each.warnings) for each in sessions)
    names = [event.name for each in sessions for event in each.findings.events]
    assert len(names) == len(set(names))


# --- commands --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_subject_is_fitted_and_validated_on_events(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Dealt at random, fitted, and validated on a fitted and on a held-out event; roles are those of the parts."""
    events, fitted = str(place / "session.events.yaml"), tmp_path / "fitted.yaml"
    line = ["fit", events, "--subject", "subject_1", "-o", str(fitted), "--hold-out", "auto", "--no-report", *SMALL]
    assert main([*line, "--executor", "none", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert_listed("fit.json", document)
    assert document["dealt"].startswith("dealt at random (seed 0)")
    used = [case["bag"] for case in document["cases"]]
    assert len(used) == 3 and not {event["bag"] for event in document["held_out"]} & set(used)
    assert all("begin_s" in case and "end_s" in case for case in document["cases"])
    held_out = [event["bag"] for event in document["held_out"]]
    names = {str(part): part.name for part in load_events(events)}
    of_two = yaml.safe_load(Path(events).read_text())
    of_two["events"] = [one for one in of_two["events"] if one["name"] in (names[used[0]], names[held_out[0]])]
    (place / "two_roles.yaml").write_text(yaml.safe_dump(of_two))
    line = ["validate", str(place / "two_roles.yaml"), "--subject", str(fitted), "-o", str(tmp_path / "v"), "--json"]
    with empty_drawings():
        assert main(line) == 0
    each = json.loads(capsys.readouterr().out)["events"]
    assert {one["bag"]: one["role"] for one in each} == {used[0]: "fitted", held_out[0]: "held_out"}
    assert all((tmp_path / "v" / names[one["bag"]] / "validate.json").exists() for one in each)


def test_the_events_are_replayed_each_into_its_directory(place: Path, tmp_path: Path) -> None:
    document = yaml.safe_load((place / "session.events.yaml").read_text())
    document["events"] = document["events"][:2]
    path = place / "two.yaml"
    path.write_text(yaml.safe_dump(document))
    line = ["replay", str(path), "--subject", "subject_1", "-o", str(tmp_path), "--no-report", "--no-predicted"]
    assert main(line) == 0
    names = [event["name"] for event in document["events"]]
    assert sorted(names) == sorted(one.name for one in tmp_path.iterdir())
    assert all((tmp_path / name / "exposure.json").exists() for name in names)


def test_the_command_writes_file_and_page(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "new" / "a.events.yaml"
    table = tmp_path / "cases.csv"
    table.write_text("start, end, case\n0, 20, Kopfstein-Pflaster\n")
    line = ["events", str(place / "session.mcap"), "-o", str(output), "--cases", str(table)]
    with empty_drawings():
        assert main(line) == 0
    out = capsys.readouterr().out
    assert "kopfstein_pflaster_01" in out and "for trace: " in out
    assert load_events(output)[0].case == "kopfstein_pflaster"
    assert "kopfstein_pflaster" in Page(output.with_suffix(".html").read_text()).text
    assert main([*line, "--no-report", "--json"]) == 0
    assert not list(output.parent.glob("*.earlier*")), "the same events again"
    listed = yaml.safe_load(output.read_text())
    assert_listed("events", listed)
    assert json.loads(capsys.readouterr().out) == yaml.safe_load(output.read_text())
    assert not output.with_suffix(".html").exists()
    edited = output.read_text().replace("kopfstein_pflaster_01", "by_hand")
    output.write_text(edited)
    assert main([*line, "--no-report"]) == 0
    assert "the earlier a.events.yaml is kept as a.events.earlier.yaml" in capsys.readouterr().err
    assert (output.parent / "a.events.earlier.yaml").read_text() == edited != output.read_text()


DOUBTFUL = {
    "no-rest": ((24.0, 34.5), 0.0, "no rest in 10"),
    "one-condition": ((0.0, 22.0), 0.0, "all events are of one loading condition (road)"),
    "late-sensor": ((0.0, 40.0), 9.6, "head joins 9.5 s after the seat"),
}
"""The part of the session, when the head joins, and the line."""


@pytest.mark.parametrize("reason", DOUBTFUL)
def test_a_doubtful_session_is_refused_unless_it_is_allowed(
    reason: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set(DOUBTFUL) == set(REFUSALS)
    span_s, head_s, line = DOUBTFUL[reason]
    bag = cut(place / "session.mcap", tmp_path / "part", [span_s], head_s)
    output, others = tmp_path / "new" / "a.yaml", ",".join({*REFUSALS} - {reason})
    command = ["events", str(bag), "-o", str(output), "--steady-least-s", "3", "--no-report"]
    assert main([*command, "--allow", others]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and line in said and f"(--allow {reason})" in said
    assert not output.parent.exists()
    assert main([*command, "--allow", f"{others},{reason}"]) == 0
    assert load_events(output)


def test_an_unknown_reason_and_a_part_of_a_bag_are_refused(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for bag, reason, line in (("", "norest", "did you mean no-rest?"), ("@0..4", "", "events are found in whole bags")):
        output = tmp_path / "new" / "a.yaml"
        assert main(["events", f"{place / 'session.mcap'}{bag}", "-o", str(output), "--allow", reason]) == 2
        assert line in capsys.readouterr().err and not output.parent.exists()


# --- text and page ---------------------------------------------------------------------------------------------------


def test_the_page_shows_every_event_and_draws(found: FoundSession) -> None:
    page = Page(events_page([found]))
    for event in found.findings.events:
        assert event.name in page.text
    assert page.tags.count("svg") == 2


def test_names_of_a_page_are_escaped(found: FoundSession) -> None:
    with empty_drawings():
        source = events_page([FoundSession(Path(NASTY), "0", found.findings, (NASTY,))])
    assert "<script>" not in source and Page(source).text.count("rail") > 1


def test_rows_of_the_timeline_are_rests_conditions_and_faults(found: FoundSession) -> None:
    rows = timeline_rows(found.findings)
    assert [name for name, _, _ in rows][:1] == ["rest"] and {"road", "pothole", "rail"} <= {
        name for name, _, _ in rows
    }
    assert len(rows[0][1]) == len(found.findings.rests)
    assert str(timeline(found.findings)).startswith("<svg")


def test_a_long_curve_is_drawn_by_its_largest_values() -> None:
    values = np.zeros(10 * COLUMNS + 3)
    values[5_001] = 7.0
    time_s, drawn = decimated(values, 0.02, np.nanmax)
    assert drawn.size <= COLUMNS and drawn.max() == 7.0
    assert time_s[drawn.argmax()] == pytest.approx(5_001 * 0.02, abs=0.02 * 11)


def test_the_text_ends_with_what_is_lacking(found: FoundSession) -> None:
    text = text_of([found])
    assert f"{len(found.findings.events)} events" in text and "5 rests" in text
    assert len(text.splitlines()) < MOST_ROWS


def test_a_long_list_is_cut_and_faults_have_their_times(found: FoundSession) -> None:
    events = tuple(dataclasses.replace(found.findings.events[0], name=f"road_{k}") for k in range(MOST_ROWS + 5))
    faults = (Fault("head", "clipped", 1.0, 1.5), Fault("head", "clipped", 3.0, 3.5), Fault("neck", "stuck", 0.0, 2.0))
    findings = dataclasses.replace(found.findings, events=events, faults=faults, waterfall=None)
    text = text_of([dataclasses.replace(found, findings=findings)])
    assert "and 5 more" in text and f"road_{MOST_ROWS}" not in text
    assert "fault: head: clipped from 1.0 to 1.5 s and 1 more time" in text
    assert "fault: neck: stuck from 0.0 to 2.0 s" in text
    with empty_drawings():
        page = Page(events_page([dataclasses.replace(found, findings=findings)]))
    assert "The record is too short for a spectrum." in page.text and f"road_{MOST_ROWS}" in page.text
    assert [name for name, _, _ in timeline_rows(findings)][-2:] == ["fault: head", "fault: neck"]


def test_the_shopping_list_counts_half_of_the_events(found: FoundSession) -> None:
    has = contents(found.findings.events, FloorSettings())
    assert has.shocks == sum(len(event.shocks) for event in found.findings.events) and has.hard_shocks >= 3
    rich = FloorSettings(road_s=1.0, shocks=has.shocks // 2, hard_shocks=1)
    assert lacking_for_trace([found], rich) == []
    assert any("shocks" in line for line in lacking_for_trace([found], FloorSettings(shocks=1000)))
    assert lacking_for_fit([found]) == [
        f"{case}: one event, a second one is needed to hold out"
        for case in ("road", "pothole", "rail")
        if [event.case for event in found.findings.events].count(case) == 1
    ]


# --- conditions ------------------------------------------------------------------------------------------------------


def test_marks_name_conditions_up_to_the_next_mark() -> None:
    spans = spans_of([Mark("Gravel road", 5.0), Mark("end", 20.0), Mark("kerb", 30.0)], 60.0)
    assert [(span.begin_s, span.end_s, span.case) for span in spans] == [
        (5.0, 20.0, "gravel_road"),
        (30.0, 60.0, "kerb"),
    ]


def test_marks_of_the_node_about_the_fit_name_no_condition() -> None:
    marks = [Mark("gravel", 1.0), Mark("head: does not fit", 2.0), Mark("head: fits again", 3.0), Mark("end", 9.0)]
    assert [(span.begin_s, span.end_s, span.case) for span in spans_of(marks, 20.0)] == [(1.0, 9.0, "gravel")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("start,case\n1,road\n", "line 2: the columns start, end, case are needed"),
        ("start,end,case\n1,x,road\n", "line 2: start and end are seconds, not '1' and 'x'"),
        ("start,end,case\n1,2,road\n5,4,rail\n", "line 3: the end, 4 s, is not after the start, 5 s"),
        ("start,end,case\n\n\n0,20,a\nx,1,b\n", "line 5: start and end are seconds"),
        (
            "start,end,case\n15,30,rocks\n0,20,a\n",
            "a from 0 to 20 s and rocks from 15 to 30 s overlap: end the first by 15",
        ),
        ("\n\nstart,end,case\n0,610,5,gravel\n", "line 4: more cells than columns"),
        ("start,end,case,end\n0,20,a,30\n", "the column end is given twice"),
        ("start,end,case\n0,610,5,gravel\n", "line 2: more cells than columns: write decimal points"),
        ("start,end,case\n", "it has no rows: give start, end, case in each, or omit --cases"),
        ("start,end,case\n0,20,road\n20,30,---\n", "line 3: the case '---' has no letter or digit"),
        ('start,end,case\n0,20,"gravel\n20,30,road\n', "cannot be read as a table .*: is a quote not closed?"),
        (f'start,end,case\n0,20,"{"x" * 2**18}"\n', "cannot be read as a table .field larger than field limit"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "cases.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_spans(path)


def test_columns_of_a_table_have_names_in_any_case_and_order(tmp_path: Path) -> None:
    path = tmp_path / "cases.csv"
    path.write_text("\nCase , End,START\nroad,20,0.5,,\n")
    assert [(span.begin_s, span.end_s, span.case) for span in read_spans(path)] == [(0.5, 20.0, "road")]


def test_a_row_without_an_event_is_a_warning(place: Path, tmp_path: Path) -> None:
    table = tmp_path / "cases.csv"
    table.write_text("start,end,case\n0,60,gravel\n1000,2000,cobbles\n60,60.1,minutes\n")
    found = find_events(place / "session.mcap", SessionOptions(cases=str(table)))
    assert any("cobbles from 1000 to 2000 s has no event in a session of" in line for line in found.warnings)
    assert any("minutes from 60 to 60.1 s has no event" in line for line in found.warnings)
    assert not any("gravel" in line for line in found.warnings)


def test_a_table_is_of_one_session(place: Path, tmp_path: Path) -> None:
    table = tmp_path / "cases.csv"
    table.write_text("start,end,case\n0,60,gravel\n")
    bags = [place / "session.mcap", cut(place / "session.mcap", tmp_path / "part", [(0.0, 30.0)])]
    with pytest.raises(InputError, match=r"cases.csv: its times are of one session, 2 are given: run biodyn events"):
        find_sessions(bags, SessionOptions(cases=str(table)), lambda done, total: None)


@pytest.mark.parametrize(("seat_from_s", "gravel_from_s"), [(0.0, 1.0), (2.5, 10.0)])
def test_marks_of_the_bag_name_its_events(
    place: Path, tmp_path: Path, seat_from_s: float, gravel_from_s: float
) -> None:
    """A node with a namespace has marked gravel before the middle of the first road, and its end at 19 s."""
    bag = tmp_path / "marked.mcap"
    with open_bag(place / "session.mcap") as reader, BagWriter(bag) as writer:
        begin_ns = reader.start_ns or 0
        for block in reader.blocks():
            writer.add_topic(block.topic, block.type)
            messages = np.frombuffer(b"".join(block.messages()), np.uint8).reshape(len(block), -1)
            since_s = 1e-9 * (block.log_ns - begin_ns)
            kept = (since_s >= (seat_from_s if block.topic == topics.INPUT[SEAT] else 0.0)) & (since_s < 38.0)
            writer.write(block.topic, block.log_ns[kept], messages[kept])
        writer.add_topic("/car/biodyn/marks", STRING_TYPE)
        for at_s, name in ((gravel_from_s, "Gravel"), (gravel_from_s + 0.5, "!!"), (19.0, "end")):
            data = name.encode() + b"\0"
            message = bytes([0, 1, 0, 0]) + len(data).to_bytes(4, "little") + data
            stamp = np.array([begin_ns + round(1e9 * at_s)])
            writer.write("/car/biodyn/marks", stamp, np.frombuffer(message, np.uint8)[None])
    found = find_events(bag, SessionOptions(cases="marks"))
    assert [event.case for event in found.findings.events] == ["gravel", "pothole"]
    assert [line for line in found.warnings if line.startswith("the mark '!!' at ")]


def test_marks_of_a_bag_are_needed_to_name_by_them(place: Path) -> None:
    with pytest.raises(InputError, match=r"session\.mcap: has no marks"):
        find_events(place / "session.mcap", SessionOptions(cases="marks"))


# --- dealing ---------------------------------------------------------------------------------------------------------


def items(count: int, seed: int = 0) -> list[Dealable]:
    rng = np.random.default_rng(seed)
    return [Dealable(f"e{k}", ("road", "rail")[k % 2], float(rng.uniform(0.3, 3.0)), 60.0 * k) for k in range(count)]


def test_dealing_is_balanced_by_condition_level_and_time() -> None:
    every = items(48)
    drawn = deal(every, TO_TRACE, seed=3)
    for case in ("road", "rail"):
        uses = [use for of, use in drawn.values() if of == case]
        assert (uses.count("fit"), uses.count("choose"), uses.count("report")) == (12, 6, 6)
    for value in ("level_mps2", "time_s"):
        values = np.array([getattr(item, value) for item in every])
        for use in ("fit", "choose", "report"):
            mine = np.array([getattr(item, value) for item in every if drawn[item.bag][1] == use])
            assert abs(mine.mean() - values.mean()) < 0.15 * values.std()


def test_dealing_repeats_with_its_seed() -> None:
    every = items(24)
    assert deal(every, TO_TRACE, 1) == deal(every, TO_TRACE, 1) != deal(every, TO_TRACE, 2)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_few_events_are_fitted_to_first(count: int) -> None:
    one_case = [Dealable(f"e{k}", "road", 1.0 + k, float(k)) for k in range(count)]
    uses = [use for _, use in deal(one_case, TO_FIT, 0).values()]
    assert uses.count("fit") == (count + 1) // 2


def test_an_events_file_is_recognised_by_its_ending() -> None:
    assert part_of("a.mcap").is_whole
    with pytest.raises(InputError, match=r"gone\.yaml: cannot be read"):
        bags_of(["gone.yaml"])
