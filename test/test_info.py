"""`biodyn info` on bags whose content is known: rates, clocks, gaps, rejected samples, and the refusal of replay."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from listed import assert_listed
from streams import info, info_report, noisy_streams, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base import topics
from biodyn_ros.base.resources import bag_file
from biodyn_ros.commands.cli import main
from biodyn_ros.info.text import text_of
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.reading.stamps import choose_times
from biodyn_ros.replay.replaying import ReplayOptions, replay

START_NS = 1_700_000_000_000_000_000
UP = (0.0, 0.0, 9.81)
CONTRACT = (
    "topic", "sensor", "messages", "rate_hz", "clock_ppm", "offset_ms", "jitter_ms", "gaps", "rejected", "clipped",
    "gravity_mps2", "vertical",
)  # fmt: skip

Stream = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Header stamps, log times, accelerations."""


def still(
    seconds: float = 30.0, rate_hz: float = 500.0, ppm: float = 0.0, late_s: float = 0.002, seed: int = 0
) -> Stream:
    """A sensor at rest whose clock is `ppm` fast, logged `late_s` later and a bit."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    header = START_NS + np.rint(t * (1e9 + 1e3 * ppm)).astype(np.int64)
    log = START_NS + np.rint((t + late_s + rng.exponential(2e-4, t.size)) * 1e9).astype(np.int64)
    return header, log, UP + 0.02 * rng.normal(size=(t.size, 3))


def write(path: Path, streams: dict[str, Stream]) -> Path:
    """A bag of Imu topics by name; the name of a sensor means its default topic."""
    with BagWriter(path) as writer:
        for name in streams:
            writer.add_topic(topics.INPUT.get(name, name), IMU_TYPE)
        for name, (header, log, accel) in streams.items():
            writer.write(topics.INPUT.get(name, name), log, encode_imu(header, accel, np.zeros_like(accel), "imu"))
    return path


def by_sensor(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["sensor"] or row["topic"]: row for row in document["topics"]}


def test_all_figures_of_a_known_recording_are_correct(tmp_path: Path) -> None:
    header, log, accel = still(ppm=40.0)
    header, log, accel = (np.delete(a, slice(5000, 5100), axis=0) for a in (header, log, accel))  # 0.2 s lost
    accel[7000, 1] = 160.0
    accel[8000] = np.nan
    header[8100] = 0
    header[8200], accel[8200] = header[8199], accel[8199]
    bag = write(tmp_path / "a.mcap", {"seat": (header, log, accel), "/spare": still(rate_hz=10.0)})
    document = info(bag)
    assert (document["storage"], document["recovered"]) == ("mcap", False)
    assert document["messages"] == header.size + 300
    assert document["seconds"] == pytest.approx(30.0, abs=0.1)
    seat, spare = by_sensor(document)["seat"], by_sensor(document)["/spare"]
    assert set(CONTRACT) <= set(seat)
    assert (seat["messages"], seat["time"]) == (header.size, "header")
    assert seat["rate_hz"] == pytest.approx(500.0 / (1 + 40e-6), rel=1e-6)
    assert seat["clock_ppm"] == pytest.approx(40.0, abs=max(seat["clock_ppm_error"], 1.0))
    assert seat["clock_ppm_error"] < 2.0
    assert seat["offset_ms"] == pytest.approx(2.0, abs=0.1)
    assert seat["median_step_ms"] == pytest.approx(2.0, rel=1e-3)
    assert seat["longest_step_ms"] == pytest.approx(202.0, rel=1e-3)
    assert (seat["gaps"], seat["gap_s"]) == (1, pytest.approx(0.2, abs=1e-3))
    assert seat["rejected_by_cause"] == {"unset": 1, "non_finite": 1, "duplicate": 1, "late": 0, "stray": 0}
    assert (seat["rejected"], seat["clipped"]) == (3, 1)
    assert seat["gravity_mps2"] == pytest.approx(9.81, abs=0.01)
    assert seat["vertical"] == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    assert (spare["sensor"], spare["rate_hz"]) == (None, pytest.approx(10.0, rel=1e-4))
    text = text_of(info_report(bag))
    assert "seat: rejected 1 unset, 1 non finite, 1 duplicate" in text
    assert "replay: uses seat; not in the bag: pelvis" in text


@pytest.mark.parametrize("at", [100, 5000])
def test_samples_are_rejected_during_rest_as_later(tmp_path: Path, at: int) -> None:
    header, log, accel = still()
    accel[at : at + 3] = np.nan
    header[at + 10] = 0
    header[at + 21], accel[at + 21] = header[at + 20], accel[at + 20]
    document = info(write(tmp_path / "a.mcap", {"seat": (header, log, accel)}))
    seat = by_sensor(document)["seat"]
    assert seat["rejected_by_cause"] == {"unset": 1, "non_finite": 3, "duplicate": 1, "late": 0, "stray": 0}


def test_topics_of_any_rate_have_the_status_of_replay(tmp_path: Path) -> None:
    bag = write(tmp_path / "a.mcap", {"/imu": still(rate_hz=31.0)})
    document = info(bag)
    assert "give it with --map seat=TOPIC" in document["replay"]["refusal"]
    document = info(bag, ReadingOptions({"seat": "/imu"}))
    assert by_sensor(document)["seat"]["rate_hz"] == pytest.approx(31.0, rel=1e-4)
    with pytest.raises(InputError) as refused:
        replay(bag, subject(), ReplayOptions({"seat": "/imu"}))
    assert document["replay"]["refusal"] == str(refused.value)
    assert "a rate of 31 Hz does not fit, 250 to 20000 Hz are needed" in document["replay"]["refusal"]
    with pytest.raises(InputError, match="--map seat=/none: no such Imu topic"):
        info(bag, ReadingOptions({"seat": "/none"}))


def test_two_topics_that_may_be_one_sensor_are_both_shown(tmp_path: Path) -> None:
    bag = write(tmp_path / "a.mcap", {f"/{who}/{topics.INPUT['seat']}": still(3.0) for who in ("left", "right")})
    document = info(bag)
    assert [row["sensor"] for row in document["topics"]] == [None, None]
    assert "match the seat: choose one with --map seat=TOPIC" in document["replay"]["refusal"]


def test_a_bag_without_imu_lists_its_topics(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "a.mcap") as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String")
        writer.write("/chatter", np.array([1, 2]), np.zeros((2, 12), dtype=np.uint8))
    document = info(tmp_path / "a.mcap")
    assert document["topics"] == []
    assert document["other_topics"] == [{"topic": "/chatter", "type": "std_msgs/msg/String", "messages": 2}]
    assert "no sensor_msgs/msg/Imu in the bag" in document["replay"]["refusal"]
    assert "std_msgs/msg/String" in text_of(info_report(tmp_path / "a.mcap"))


def test_json_on_stdout_and_a_table_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    bag = str(bag_file("subject_1.mcap"))
    assert main(["info", bag, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads(json.dumps(info(bag)))
    assert_listed("info", document)
    assert [row["sensor"] for row in document["topics"]] == list(SENSORS)
    assert document["replay"] == {"refusal": None, "sensors": list(SENSORS), "missing": [], "faults": []}
    # Its log times are copies of the stamps, so they give no figure.
    assert {row["clock_ppm"] for row in document["topics"]} == {None}
    assert any("log times repeat the header stamps" in line for line in document["warnings"])
    assert main(["info", bag]) == 0
    out = capsys.readouterr().out
    assert all(sensor in out for sensor in SENSORS)
    assert max(len(line) for line in out.splitlines()) < 160


def test_drifting_clocks_are_reported_by_info_and_replay(tmp_path: Path) -> None:
    streams = {"seat": still(120.0, ppm=20.0), "head": still(120.0, ppm=-30.0, seed=1)}
    bag = write(tmp_path / "a.mcap", streams)
    line = "header clocks drift apart by 6.0 ms over 120 s (ppm against log time: seat +20.0, head -30.0): the residual"
    assert any(text.startswith(line) and "--time log" in text for text in info(bag)["warnings"])
    assert any(text.startswith(line) for text in replay(bag, subject()).document["warnings"])
    by_log = replay(bag, subject(), ReplayOptions(time="log")).document["warnings"]
    assert not any("drift apart" in text for text in by_log)


def test_equal_clocks_are_not_reported(tmp_path: Path) -> None:
    streams = {"seat": still(120.0, ppm=20.0), "head": still(120.0, ppm=19.0, seed=1)}
    warnings = info(write(tmp_path / "a.mcap", streams))["warnings"]
    assert not any("clock" in text or "stamps" in text for text in warnings), warnings


def test_different_offsets_from_log_time_are_reported(tmp_path: Path) -> None:
    streams = {"seat": still(), "head": still(late_s=0.02, seed=1)}
    warnings = info(write(tmp_path / "a.mcap", streams))["warnings"]
    assert any("differs between sensors (ms: seat 2.0, head 20.0)" in text for text in warnings), warnings


@pytest.mark.parametrize("value", [0, START_NS])
def test_log_time_replaces_zero_or_constant_stamps(tmp_path: Path, value: int) -> None:
    header, log, accel = still()
    bag = write(tmp_path / "a.mcap", {"seat": (np.full_like(header, value), log, accel), "head": still(seed=1)})
    document = info(bag)
    seat, head = by_sensor(document)["seat"], by_sensor(document)["head"]
    assert (seat["time"], head["time"]) == ("log", "header")
    assert seat["rate_hz"] == pytest.approx(500.0, rel=1e-3)
    assert seat["rejected"] == 0
    why = "are zero" if value == 0 else "do not change"
    expected = f"seat: header stamps {why}: log time is used instead"
    mixed = "seat by log time, others by header time, and log time is 2.0 ms later"
    replayed = replay(bag, subject()).document
    for warnings in (document["warnings"], replayed["warnings"]):
        assert expected in warnings
        assert any(text.startswith(mixed) for text in warnings)
    assert replayed["seconds"] == pytest.approx(30.0, abs=0.1)
    assert replayed["time"] == {"seat": "log", "head": "header"}
    assert info(bag, ReadingOptions(time="log"))["warnings"] == []


def test_time_is_chosen_for_late_and_short_topics(tmp_path: Path) -> None:
    header, log, accel = still(20.0)
    late = tuple(a[-2000:] for a in (0 * header, log, accel))
    pair = tuple(a[:2] for a in (header, log, accel))
    bag = tmp_path / "a.mcap"
    with BagWriter(bag, chunk_bytes=20_000) as writer:
        for name, (stamps, logged, values) in {"/a": (header, log, accel), "/late": late, "/pair": pair}.items():
            writer.add_topic(name, IMU_TYPE)
            writer.write(name, logged, encode_imu(stamps, values, values, "imu"))
    with open_bag(bag) as reader:
        times = choose_times(reader, ["/a", "/late", "/pair"], "header")
        assert {topic: choice.time for topic, choice in times.items()} == {
            "/a": "header", "/late": "log", "/pair": "header",
        }  # fmt: skip
        assert {choice.time for choice in choose_times(reader, ["/a", "/late"], "log").values()} == {"log"}


def test_quantised_stamps_and_a_set_clock_are_reported(tmp_path: Path) -> None:
    header, log, accel = still(60.0, 233.0)
    leaping = header.copy()
    leaping[6000:] += 3600 * 10**9
    bag = write(tmp_path / "a.mcap", {"seat": (header // 10**7 * 10**7, log, accel), "head": (leaping, log, accel)})
    document = info(bag)
    assert by_sensor(document)["seat"]["quantum_ms"] == pytest.approx(10.0)
    assert any("seat: header stamps are quantised to 10 ms" in text for text in document["warnings"])
    assert any("head: header time jumped against log time once" in text for text in document["warnings"])


def test_stamps_that_count_samples_are_distinguished_from_a_clock(tmp_path: Path) -> None:
    bag = write(tmp_path / "a.mcap", {"seat": still(ppm=3000.0)})
    (line,) = info(bag)["warnings"]
    assert re.match(r"seat: its header stamps drift by \+(2999|3000|3001) ppm against log time", line)


def test_a_cut_bag_is_reported_with_its_recovered_length(tmp_path: Path) -> None:
    data = bag_file("subject_1.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 6 // 10])
    document = info(cut)
    assert document["recovered"]
    assert sum(row["messages"] for row in document["topics"]) == document["messages"]
    expected = f"recovered {document['messages']} messages, up to {document['seconds']:.3f} s after the first"
    assert any(expected in line for line in document["warnings"])
    first = text_of(info_report(cut)).splitlines()[0]
    assert first.startswith(f"{cut}: mcap, recovered, {document['messages']} messages")


def test_a_noisy_recording_is_surveyed_as_replay_conditions_it(tmp_path: Path) -> None:
    bag = write(tmp_path / "a.mcap", {s.sensor: (s.stamps_ns, s.stamps_ns, s.accel_mps2) for s in noisy_streams()})
    document, pipeline = info(bag), replay(bag, subject()).pipeline
    for name, row in by_sensor(document).items():
        status = pipeline.status(name)
        assert row["rate_hz"] == pytest.approx(status.rate_hz, rel=1e-9)
        assert (row["gravity_mps2"], row["vertical"]) == (status.gravity_mps2, list(status.vertical))
        assert (row["rejected"], row["clipped"]) == (status.rejected, status.clipped)


def test_a_sensor_at_the_end_of_its_range_is_surveyed_as_replay_conditions_it(tmp_path: Path) -> None:
    streams = noisy_streams(8.0, "rail")
    ends = np.array([13.0, 200.0, 14.0, 200.0, 16.0, 20.0])  # of which some end below what the settings call clipped
    accel = [np.clip(4.0 * s.accel_mps2, -end, end) for s, end in zip(streams, ends, strict=True)]
    for s, values in zip(streams, accel, strict=True):
        rest = s.stamps_ns < s.stamps_ns[0] + 10**9
        values[rest] = s.accel_mps2[rest]
    bag = write(
        tmp_path / "a.mcap", {s.sensor: (s.stamps_ns, s.stamps_ns, a) for s, a in zip(streams, accel, strict=True)}
    )
    document, pipeline = info(bag), replay(bag, subject()).pipeline
    statuses = {name: pipeline.status(name) for name in by_sensor(document)}
    clipped = {name: row["clipped"] for name, row in by_sensor(document).items()}
    assert clipped == {name: status.clipped for name, status in statuses.items()}
    assert sum(clipped.values()) > 0
    for status in statuses.values():
        assert all(any(text in line for line in document["warnings"]) for text in status.warnings)


def test_a_refusal_leaves_no_files(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    slow = write(tmp_path / "slow.mcap", {"seat": still(rate_hz=100.0)})
    for bag in (tmp_path / "missing.mcap", slow):
        out = tmp_path / "deep" / "out"
        assert main(["replay", str(bag), "--subject", "subject_1", "-o", str(out)]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
        assert not (tmp_path / "deep").exists()
    assert main(["replay", str(slow), "--subject", "subject_1", "-o", str(slow)]) == 2
    assert "is a file; the results need a directory" in capsys.readouterr().err


def test_a_failing_replay_removes_its_partial_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from biodyn_ros.replay import replaying as module

    bag = write(tmp_path / "a.mcap", {"seat": still(10.0)})

    def fails(*arguments: object) -> None:
        assert (tmp_path / "deep" / "out").is_dir()  # there were predictions by then
        raise InputError("no")

    monkeypatch.setattr(module, "check_seat", fails)
    with pytest.raises(InputError):
        module.replay_to_directory(bag, subject(), tmp_path / "deep" / "out", report=False)
    assert not (tmp_path / "deep").exists()
    (tmp_path / "kept").mkdir()
    monkeypatch.setattr(module, "check_seat", lambda *a: (_ for _ in ()).throw(InputError("no")))
    with pytest.raises(InputError):
        module.replay_to_directory(bag, subject(), tmp_path / "kept", report=False)
    assert list((tmp_path / "kept").iterdir()) == []
