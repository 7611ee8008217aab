"""The exposure file: its path, its permissions, which content is continued, and a node that is killed."""

from __future__ import annotations

import dataclasses
import json
import pickle
import signal
import stat
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros import STARTUP_S, Sensors, child, ros_graph
from std_msgs.msg import Float64
from streams import RATE_HZ, in_turn, noisy_streams, run, subject

from biodyn_core.base.digests import digest
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.body.subject import load_subject
from biodyn_core.exposure.checkpoint import ExposureCheckpoint
from biodyn_core.exposure.meters import Dose
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag.cdr import encode_imu
from biodyn_ros.base import topics
from biodyn_ros.base.resources import subject_file
from biodyn_ros.node.exposure_store import ExposureStore, StateFile, identity_of, state_path
from biodyn_ros.node.first_stamps import FirstStamps

IDENTITY = identity_of(subject(), topics.INPUT)


def new() -> ContinuedExposure:
    """An exposure at zero."""
    return ContinuedExposure(Pipeline(subject()))


@cache
def three_seconds() -> bytes:
    """An exposure that has counted three seconds, to be copied."""
    return pickle.dumps(ContinuedExposure(run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline))


def counted() -> ContinuedExposure:
    """An exposure of its own that has counted three seconds."""
    exposure: ContinuedExposure = pickle.loads(three_seconds())  # noqa: S301 - written here
    return exposure


def seat_dose(exposure: ContinuedExposure) -> Dose:
    """The seat's dose since reset."""
    return exposure.pipeline.exposure().sensors[SEAT]


def checkpoint() -> ExposureCheckpoint:
    """The checkpoint of three counted seconds."""
    found = counted().checkpoint(IDENTITY)
    assert found is not None
    return found


def store(path: Path, **others: str) -> ExposureStore:
    """A store of the subject's exposure."""
    return ExposureStore(StateFile(path), IDENTITY | others, 12.0, "fitting")


def begun(file: ExposureStore, exposure: ContinuedExposure, first_ns: dict[str, int], seconds: float = 1.0) -> str:
    """The message of the store behind messages of some sensors in turn, from their first stamps on."""
    for number in range(round(seconds * RATE_HZ)):
        for sensor, begin_ns in first_ns.items():
            stamp_ns = begin_ns + round(1e9 * number / RATE_HZ)
            if message := file.begin(exposure, sensor, np.array([stamp_ns])):
                return message
    return ""


def after(seconds: float, *sensors: str) -> dict[str, int]:
    """Stamps of sensors, all by default, so long after their newest stored ones."""
    stored = checkpoint().sensors
    return {name: stored[name].newest_ns + round(1e9 * seconds) for name in sensors or stored}


def test_the_path_is_given_or_in_the_user_s_state_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    assert state_path("none", "/biodyn") is None
    assert state_path("/var/lib/x.json", "/biodyn") == Path("/var/lib/x.json")
    monkeypatch.setenv("XDG_STATE_HOME", "/s")
    assert state_path("", "/car_2/biodyn") == Path("/s/biodyn/car_2.biodyn.json")
    assert state_path("", "/biodyn", 7) == Path("/s/biodyn/biodyn.domain_7.json")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "/home/anna")
    assert state_path("", "/biodyn") == Path("/home/anna/.local/state/biodyn/biodyn.json")
    with pytest.raises(InputError, match="there is no home directory, give a path"):
        state_path("~nobody_of_this_name/x", "/biodyn")


def test_a_saved_file_is_readable_by_its_owner_alone(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "deep" / "state.json")
    file.save(checkpoint())
    file.close(checkpoint())
    assert stat.S_IMODE(file.path.stat().st_mode) == 0o600
    assert sorted(path.name for path in file.path.parent.iterdir()) == [".state.json.lock", "state.json"]
    found = StateFile(file.path).read()
    assert found is not None and found.to_dict() == checkpoint().to_dict()


def test_two_nodes_do_not_share_a_file(tmp_path: Path) -> None:
    first = store(tmp_path / "state.json")
    with pytest.raises(
        InputError, match=r"state\.json: another node stores its exposure there, give each node its own"
    ):
        StateFile(tmp_path / "state.json")
    StateFile(tmp_path / "other.json").close(None)
    first.close(counted())
    StateFile(tmp_path / "state.json").close(None)


def test_a_stored_exposure_is_continued(tmp_path: Path) -> None:
    first = store(tmp_path / "state.json")
    assert not first.pending
    first.close(counted())
    second, exposure = store(tmp_path / "state.json"), new()
    assert second.pending
    second.save(exposure)  # before the first sample the file stays
    assert "continues" in begun(second, exposure, after(1.0, SEAT)) and second.resumed
    assert seat_dose(exposure).vdv_mps175 == pytest.approx(seat_dose(counted()).vdv_mps175)


def test_reset_before_the_first_sample_sets_the_stored_exposure_aside(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    store(path).close(counted())
    second, exposure = store(path), new()
    exposure.reset()
    assert "the stored exposure is now in" in second.reset() and path.with_name("state.json.before").exists()
    assert not second.pending and not second.resumed and not path.exists()
    run(noisy_streams(), in_turn(noisy_streams()), finish=False, pipeline=exposure.pipeline)
    assert seat_dose(exposure).seconds == seat_dose(counted()).seconds


def test_reset_before_the_next_counted_sample_deletes_the_file(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    store(path).close(counted())
    second, exposure = store(path), new()
    begun(second, exposure, after(1.0, SEAT))
    exposure.reset()
    assert second.reset() == "" and not second.resumed
    second.close(exposure)
    assert [path.name for path in tmp_path.iterdir()] == [".state.json.lock"]


def test_age_is_by_the_sensor_s_own_clock(tmp_path: Path) -> None:
    """A clock that is a day ahead makes no exposure a day old."""
    ahead_ns = 24 * 3600 * 10**9
    streams = tuple(
        dataclasses.replace(one, stamps_ns=one.stamps_ns + ahead_ns * (one.sensor == "neck")) for one in noisy_streams()
    )
    store(tmp_path / "state.json").close(ContinuedExposure(run(streams, in_turn(streams), finish=False).pipeline))
    stamps_ns = {one.sensor: int(one.stamps_ns[-1]) + 10**9 for one in streams}
    for first in (SEAT, "neck"):
        assert "continues" in begun(store(tmp_path / "state.json"), new(), {first: stamps_ns[first]})


HOUR_S = 3600.0


@pytest.mark.parametrize(
    ("held_out", "others"),
    [
        ("pelvis", {"pelvis": 12_300_000_000}),  # the clock of its driver is not set yet
        ("neck", {"neck": 40_000_000_000}),  # seconds since boot, of a sensor that the file lacks
        ("neck", {"neck": 1_767_225_600 * 10**9 + 30 * 24 * 3600 * 10**9}),
    ],
)
def test_one_sensor_with_a_clock_of_its_own_does_not_end_the_exposure(tmp_path: Path, held_out: str, others) -> None:
    path, present = tmp_path / "state.json", {name for name in SENSORS if name != "neck"}
    streams = [one for one in noisy_streams() if one.sensor in present]
    store(path).close(ContinuedExposure(run(streams, in_turn(streams), finish=False).pipeline))
    second, exposure = store(path), new()
    assert begun(second, exposure, others) == "" and second.pending
    assert "continues" in begun(second, exposure, after(60.0, SEAT)) and second.resumed


def test_a_stray_first_stamp_does_not_end_the_exposure(tmp_path: Path) -> None:
    store(tmp_path / "state.json").close(counted())
    second, exposure = store(tmp_path / "state.json"), new()
    assert second.begin(exposure, SEAT, np.array([12_300_000_000])) == ""
    assert "continues" in begun(second, exposure, after(60.0, SEAT))


@pytest.mark.parametrize("rate_hz", [100.0, 1129.3, 2500.0])
def test_samples_are_held_for_ten_seconds_at_any_rate(rate_hz: float) -> None:
    stored = checkpoint()
    first, begin_ns = FirstStamps(stored, 12.0), stored.sensors[SEAT].newest_ns + round(13 * 3600e9)
    stamps_ns = begin_ns + np.rint(1e9 * np.arange(round(15.0 * rate_hz)) / rate_hz).astype(np.int64)
    early = round(9.8 * rate_hz)
    assert first.add(SEAT, stamps_ns[:early]) is None
    later = stamps_ns[early:, None]
    held = early + next(n for n, stamp_ns in enumerate(later) if first.add(SEAT, stamp_ns) is not None)
    assert held / rate_hz == pytest.approx(10.0, abs=0.1)


def test_a_sensor_that_returns_after_a_chain_of_restarts_does_not_end_the_exposure(tmp_path: Path) -> None:
    """The neck last sent 13 hours ago, the others minutes ago."""
    document = checkpoint().to_dict()
    for key in ("newest_ns", "told_ns"):
        document["sensors"]["neck"][key] -= round(13.0 * HOUR_S * 1e9)
    for first in ({"neck": 60.0} | dict.fromkeys(SENSORS, 60.0), {"neck": 60.0}):
        path = tmp_path / "state.json"
        StateFile(path).close(ExposureCheckpoint.from_dict(document))
        stamps_ns = {name: after(seconds, SEAT)[SEAT] for name, seconds in first.items()}
        assert "continues" in begun(store(path), new(), stamps_ns, 11.0)


def test_an_exposure_that_no_sensor_fits_is_set_aside_after_ten_seconds(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    store(path).close(counted())
    second, exposure = store(path), new()
    assert begun(second, exposure, after(13.0 * HOUR_S, SEAT), 9.5) == "" and second.pending
    assert (
        "13.0 h older" in begun(second, exposure, after(13.0 * HOUR_S, SEAT))
        and path.with_name("state.json.before").exists()
    )


def test_a_directory_is_refused_as_exposure_file(tmp_path: Path) -> None:
    (tmp_path / "exposures").mkdir()
    (tmp_path / "exposures" / "other").write_text("x")
    with pytest.raises(InputError, match="exposures: is a directory, state_file names a file"):
        StateFile(tmp_path / "exposures")
    assert (tmp_path / "exposures" / "other").read_text() == "x"


def signed(text: str) -> str:
    """The file with the digest of its content."""
    document = json.loads(text)
    return json.dumps(document | {"digest": digest(document["kept"])})


def earlier(text: str) -> str:
    """The file as the version before wrote it: without the time of dead axes."""
    document = json.loads(text)
    for one in document["kept"]["sensors"].values():
        del one["lost"][-1]
    return json.dumps(document | {"schema": 5})


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda text: text[:100], "is damaged: not valid JSON"),
        (lambda text: text.replace('"schema": 6', '"schema": 7'), "schema is 7, this version reads 6"),
        (lambda text: signed(earlier(text)), "schema is 5, this version reads 6"),
        (lambda text: "{}", "has the keys "),
        (lambda text: signed(text.replace(IDENTITY["subject"], "somebody")), "the stored exposure has other subject"),
        (lambda text: signed(text.replace(IDENTITY["sensors"], "others")), "the stored exposure has other sensors"),
        (lambda text: text.replace('"clipped": 0', '"clipped": 1').replace("0.", "1."), "is damaged, its digest"),
        (lambda text: signed(text.replace('"pelvis"', '"knee"')), "not a stored exposure"),
    ],
)
def test_a_file_that_is_not_continued_is_renamed(tmp_path: Path, spoil, why: str) -> None:
    path = tmp_path / "state.json"
    store(path).close(counted())
    path.write_text(spoil(path.read_text()))
    text, second, exposure = path.read_text(), store(path), new()
    message = begun(second, exposure, after(1.0))
    assert why in message and "starts at zero" in message and "\n" not in message and not second.resumed
    assert exposure.pipeline.exposure().sensors == {}
    assert path.with_name("state.json.before").read_text() == text and not path.exists()
    second.close(exposure)
    path.write_text("another")
    begun(store(path), exposure, {SEAT: 1})
    assert path.with_name("state.json.before").read_text() == text
    assert path.with_name("state.json.before1").read_text() == "another"


@pytest.mark.parametrize(
    ("policy", "identity", "hours", "why"),
    [
        ("fitting", IDENTITY, 11.9, ""),
        ("fitting", IDENTITY, 12.1, "12.1 h older"),
        ("fitting", IDENTITY, -13.0, "13.0 h newer"),
        ("fitting", IDENTITY | {"subject": "other"}, 0.0, "the stored exposure has other subject"),
        ("any", IDENTITY | {"subject": "other"}, 100.0, ""),
        ("none", IDENTITY, 0.0, "kept_exposure is none"),
    ],
)
def test_age_and_identity_decide_unless_the_policy_is_another(
    tmp_path: Path, policy, identity, hours: float, why: str
) -> None:
    path = tmp_path / "state.json"
    store(path).close(counted())
    message = begun(ExposureStore(StateFile(path), identity, 12.0, policy), new(), after(3600.0 * hours))
    assert message.startswith("exposure starts at zero: " if why else "exposure continues") and why in message


def test_provenance_is_no_part_of_the_identity() -> None:
    fitted = dataclasses.replace(subject(), provenance={"bags": ["x"]})
    assert identity_of(fitted, topics.INPUT) == IDENTITY
    assert identity_of(load_subject(subject_file("subject_2")), topics.INPUT)["subject"] != IDENTITY["subject"]


def test_a_path_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="the directory cannot be created"):
        StateFile(tmp_path / "file" / "state.json")
    file = StateFile(tmp_path / "state.json")
    (tmp_path / ".state.json.part").mkdir()  # in the way of what is written
    blocked = ExposureStore(file, IDENTITY, 12.0, "fitting")
    with pytest.raises(InputError, match="cannot be written"):
        blocked.close(counted())
    assert "cannot be written" in blocked.failure


@pytest.mark.timeout(240)
def test_a_killed_node_continues_as_a_lower_bound(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    streams = noisy_streams(5.0)
    given = ("--ros-args", "-p", f"state_file:={path}")
    with ros_graph() as graph:
        vdv = graph.collect(graph.node(), Float64, "/biodyn/exposure/seat/vdv")
        sensors = Sensors(graph, SENSORS, streams)
        with child(graph, "live", *given) as live:
            graph.wait(sensors.matched, "six inputs matched", STARTUP_S)
            graph.spin(0.5)
            sensors.send(6 * 3000)
            graph.wait(lambda: path.exists() and newest(path) > 0, "exposure is stored")
            graph.spin(3.0)  # longer than from one writing to the next
            before, reached = vdv[-1].data, newest(path)
            live.send_signal(signal.SIGKILL)
            live.wait(20)
    with ros_graph() as graph:  # another: DDS needs many seconds to miss a node that was killed
        tester = graph.node()
        vdv = graph.collect(tester, Float64, "/biodyn/exposure/seat/vdv")
        diagnostics = graph.collect(tester, DiagnosticArray, topics.DIAGNOSTICS)
        sensors = Sensors(graph, SENSORS, streams)
        sensors.leave_out(6 * (3000 + 1130))  # a second passes
        with child(graph, "live", *given) as live:
            graph.wait(sensors.matched, "six inputs matched again", STARTUP_S)
            graph.spin(0.5)
            stray = encode_imu(np.array([12_300_000_000]), np.full((1, 3), 9.81), np.zeros((1, 3)), "imu")
            sensors.outputs["pelvis"].publish(bytes(stray[0]))
            graph.spin(0.5)
            sensors.send()
            graph.wait(lambda: vdv, "exposure continues")
            assert vdv[0].data >= before > 0.0
            count = len(diagnostics)
            graph.wait(lambda: len(diagnostics) > count + 2, "diagnostics")
            values = {s.name: {v.key: v.value for v in s.values} for s in diagnostics[-1].status}
            assert values["biodyn: exposure"]["went_on"] == "true"
            first_left = int(streams[0].stamps_ns[3000 + 1130])
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
