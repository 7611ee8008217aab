"""The file that keeps exposure: where it is, who may read it, what of it is believed, and a node that is killed."""

from __future__ import annotations

import dataclasses
import json
import signal
import stat
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros import STARTUP_S, Sensors, child, ros_graph
from std_msgs.msg import Float64
from streams import RATE_HZ, in_turn, noisy_streams, run, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.body.subject import load_subject
from biodyn_core.exposure.exposure_store import ExposureCheckpoint, digest
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.base import topics
from biodyn_ros.base.resources import subject_file
from biodyn_ros.node.state import ExposureStore, StateFile, belongs_to, refused, state_path

BELONGS = belongs_to(subject(), topics.INPUT)


def counted() -> Pipeline:
    """A pipeline that has counted three seconds."""
    return run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline


def kept() -> ExposureCheckpoint:
    """Its exposure."""
    found = counted().kept(BELONGS)
    assert found is not None
    return found


def keeper(path: Path, **others: str) -> ExposureStore:
    """A keeper of the subject's exposure."""
    return ExposureStore(StateFile(path), BELONGS | others, 12.0, "fitting")


def test_the_place_is_given_or_the_user_s_own_by_the_name_of_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    assert state_path("none", "/biodyn") is None
    assert state_path("/var/lib/x.json", "/biodyn") == Path("/var/lib/x.json")
    monkeypatch.setenv("XDG_STATE_HOME", "/s")
    assert state_path("", "/car_2/biodyn") == Path("/s/biodyn/car_2.biodyn.json")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "/home/anna")
    assert state_path("", "/biodyn") == Path("/home/anna/.local/state/biodyn/biodyn.json")
    with pytest.raises(InputError, match="there is no home here, give a place"):
        state_path("~nobody_of_this_name/x", "/biodyn")


def test_what_is_saved_is_read_by_its_owner_alone(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "deep" / "state.json")
    file.save(kept())
    file.close(kept())
    assert stat.S_IMODE(file.path.stat().st_mode) == 0o600
    assert [path.name for path in file.path.parent.iterdir()] == ["state.json"]
    found = StateFile(file.path).read()
    assert found is not None and found.to_dict() == kept().to_dict()


def test_a_keeper_goes_on_and_what_it_keeps_adds_up(tmp_path: Path) -> None:
    first = keeper(tmp_path / "state.json")
    assert not first.waits
    first.close(counted())
    second, pipeline = keeper(tmp_path / "state.json"), Pipeline(subject())
    assert second.waits
    second.keep(pipeline)  # nothing has come: what is there stays
    assert "goes on" in second.begin(pipeline, SEAT, kept().newest_ns + 10**9) and second.resumed
    assert pipeline.exposure().sensors[SEAT].vdv_mps175 == pytest.approx(counted().exposure().sensors[SEAT].vdv_mps175)


def test_reset_before_the_first_sample_forgets_what_was_kept_of_whoever_sat_there(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    keeper(path).close(counted())
    next_one, pipeline = keeper(path), Pipeline(subject())
    pipeline.reset()
    assert "what was kept is in" in next_one.reset() and path.with_name("state.json.before").exists()
    assert not next_one.waits and not next_one.resumed and not path.exists()
    run(noisy_streams(), in_turn(noisy_streams()), finish=False, pipeline=pipeline)
    assert pipeline.exposure().sensors[SEAT].seconds == counted().exposure().sensors[SEAT].seconds


def test_reset_before_anything_counts_again_forgets_it_too(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    keeper(path).close(counted())
    second, pipeline = keeper(path), Pipeline(subject())
    second.begin(pipeline, SEAT, kept().newest_ns + 10**9)
    pipeline.reset()
    assert second.reset() == "" and not second.resumed
    second.close(pipeline)
    assert list(tmp_path.iterdir()) == []


def test_age_is_told_by_the_sensor_s_own_clock(tmp_path: Path) -> None:
    """One that runs a day ahead makes nothing a day old."""
    ahead_ns = 24 * 3600 * 10**9
    streams = tuple(
        dataclasses.replace(one, stamps_ns=one.stamps_ns + ahead_ns * (one.sensor == "neck")) for one in noisy_streams()
    )
    keeper(tmp_path / "state.json").close(run(streams, in_turn(streams), finish=False).pipeline)
    stamps_ns = {one.sensor: int(one.stamps_ns[-1]) + 10**9 for one in streams}
    for first in (SEAT, "neck"):
        assert "goes on" in keeper(tmp_path / "state.json").begin(Pipeline(subject()), first, stamps_ns[first])


def test_a_directory_is_no_file_to_keep_exposure_in(tmp_path: Path) -> None:
    (tmp_path / "exposures").mkdir()
    (tmp_path / "exposures" / "other").write_text("x")
    with pytest.raises(InputError, match="exposures: is a directory, state_file names a file"):
        StateFile(tmp_path / "exposures")
    assert (tmp_path / "exposures" / "other").read_text() == "x"


def signed(text: str) -> str:
    """The file with the digest of what it holds."""
    document = json.loads(text)
    return json.dumps(document | {"digest": digest(document["kept"])})


def earlier(text: str) -> str:
    """The file as the version before wrote it: without the linear MTVV and the windows of HIC."""
    document = json.loads(text)
    for sensor in document["kept"]["sensors"].values():
        meters = sensor["meters"]
        meters["vertical"] = [[*row[:4], row[5]] for row in meters["vertical"]]
        meters |= {name: [row[:1] for row in meters[name]] for name in ("hic15", "hic36") if name in meters}
    return json.dumps(document | {"schema": 3})


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda text: text[:100], "is damaged, it is no JSON"),
        (lambda text: text.replace('"schema": 4', '"schema": 7'), "schema is 7, this version reads 4"),
        (lambda text: signed(earlier(text)), "schema is 3, this version reads 4"),
        (lambda text: "{}", "has the keys "),
        (lambda text: signed(text.replace(BELONGS["subject"], "somebody")), "it is of other subject"),
        (lambda text: signed(text.replace(BELONGS["sensors"], "others")), "it is of other sensors"),
        (lambda text: text.replace('"clipped": 0', '"clipped": 1').replace("0.", "1."), "is damaged, its digest"),
        (lambda text: signed(text.replace('"pelvis"', '"knee"')), "no exposure that was kept"),
    ],
)
def test_what_is_not_believed_is_set_aside_and_nothing_is_lost(tmp_path: Path, spoil, why: str) -> None:
    path = tmp_path / "state.json"
    keeper(path).close(counted())
    path.write_text(spoil(path.read_text()))
    text, again, pipeline = path.read_text(), keeper(path), Pipeline(subject())
    said = again.begin(pipeline, SEAT, kept().newest_ns + 10**9)
    assert why in said and "begins anew" in said and "\n" not in said and not again.resumed
    assert pipeline.exposure().sensors == {}
    assert path.with_name("state.json.before").read_text() == text and not path.exists()
    path.write_text("another")
    keeper(path).begin(pipeline, SEAT, 1)
    assert path.with_name("state.json.before").read_text() == text
    assert path.with_name("state.json.before1").read_text() == "another"


@pytest.mark.parametrize(
    ("believed", "belongs", "hours", "why"),
    [
        ("fitting", BELONGS, 11.9, ""),
        ("fitting", BELONGS, 12.1, "12.1 h older"),
        ("fitting", BELONGS, -13.0, "13.0 h newer"),
        ("fitting", BELONGS | {"subject": "other"}, 0.0, "it is of other subject"),
        ("any", BELONGS | {"subject": "other"}, 100.0, ""),
        ("none", BELONGS, 0.0, "kept_exposure is none"),
    ],
)
def test_age_and_owner_decide_unless_asked_otherwise(believed, belongs, hours: float, why: str) -> None:
    found = kept()
    said = refused(found, belongs, hours, 12.0, believed)
    assert (why in said) if why else said == ""


def test_provenance_is_not_the_person() -> None:
    fitted = dataclasses.replace(subject(), provenance={"bags": ["x"]})
    assert belongs_to(fitted, topics.INPUT) == BELONGS
    assert belongs_to(load_subject(subject_file("subject_2")), topics.INPUT)["subject"] != BELONGS["subject"]


def test_a_place_that_cannot_be_written_to_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made a directory"):
        StateFile(tmp_path / "file" / "state.json")
    file = StateFile(tmp_path / "state.json")
    (tmp_path / ".state.json.part").mkdir()  # in the way of what is written
    one = ExposureStore(file, BELONGS, 12.0, "fitting")
    with pytest.raises(InputError, match="cannot be written"):
        one.close(counted())
    assert "cannot be written" in one.failed


@pytest.mark.timeout(240)
def test_a_node_that_is_killed_goes_on_as_a_lower_bound(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    streams = noisy_streams(12.0)
    given = ("--ros-args", "-p", f"state_file:={path}")
    with ros_graph() as graph:
        tester = graph.node()
        vdv = graph.collect(tester, Float64, "/biodyn/exposure/seat/vdv")
        diagnostics = graph.collect(tester, DiagnosticArray, topics.DIAGNOSTICS)
        sensors = Sensors(graph, SENSORS, streams)
        with child(graph, "live", *given) as live:
            graph.wait(sensors.matched, "six inputs matched", STARTUP_S)
            graph.spin(0.5)
            sensors.send(6 * 6000)
            graph.wait(lambda: path.exists() and newest(path) > 0, "exposure is kept")
            graph.spin(3.0)  # longer than from one writing to the next
            before, reached = vdv[-1].data, newest(path)
            live.send_signal(signal.SIGKILL)
            live.wait(20)
        graph.wait(lambda: not sensors.matched(), "it is gone", 60.0)
        sensors.leave_out(6 * 1130)  # a second passes
        vdv.clear()
        with child(graph, "live", *given) as live:
            graph.wait(sensors.matched, "six inputs matched again", STARTUP_S)
            graph.spin(0.5)
            sensors.send()
            graph.wait(lambda: vdv, "exposure goes on")
            assert vdv[0].data >= before > 0.0
            count = len(diagnostics)
            graph.wait(lambda: len(diagnostics) > count + 2, "diagnostics")
            values = {s.name: {v.key: v.value for v in s.values} for s in diagnostics[-1].status}
            assert values["biodyn: exposure"]["went_on"] == "true"
            first_left = int(streams[0].stamps_ns[6000 + 1130])
            assert values["biodyn: seat"]["lower_bound"] == "true"
            expected = 1e-9 * (first_left - reached)
            assert float(values["biodyn: seat"]["missing_s"]) == pytest.approx(expected, abs=0.02)
            assert expected == pytest.approx(1130 / RATE_HZ, abs=0.02)
            live.send_signal(signal.SIGINT)
            assert live.wait(20) == 0
    assert newest(path) == int(streams[0].stamps_ns[-1])


def newest(path: Path) -> int:
    """The seat's newest stamp in the file."""
    return int(json.loads(path.read_text())["kept"]["sensors"][SEAT]["newest_ns"])
