"""Every file of the shared recordings, through `biodyn info` and `biodyn replay`: a result, or one clear line.

The outcomes are stated here. Files that the tables do not list must at least give a result or one line.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recordings
from conftest import field_data
from streams import info, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.conditioner import ConditioningSettings
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.topics import INPUT
from biodyn_ros.commands.cli import main
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.replay.replaying import ReplayOptions, replay

RESULT = ""
NO_IMU, NO_SEAT = "no sensor_msgs/msg/Imu in the bag", "no seat sensor among {}: give it with --map seat=TOPIC"
FOREIGN = "is serialized as '{}', only 'cdr' \\(ROS 2\\) can be read"
NO_BAG = "no .mcap or .db3 file in this directory"

ROSBAG2 = "bags_odd/ros2_rosbag2/"
RESOURCES = f"{ROSBAG2}rosbag2_py/test/resources/mcap/"
BAGS = {
    "bags_odd/all_types/test_bag_mcap": (RESULT, NO_SEAT.format("/test/sensor_msgs/imu")),
    "bags_odd/all_types/test_bag_sqlite3": (RESULT, NO_SEAT.format("/test/sensor_msgs/imu")),
    "bags_odd/missing_file": (RESULT, NO_IMU),
    "bags_odd/plotjuggler": (RESULT, NO_SEAT.format("/imu")),
    f"{ROSBAG2}ros2bag/test/resources/empty_bag": (RESULT, NO_IMU),
    f"{RESOURCES}reindex_test_bags/multiple_files": (RESULT, NO_IMU),
    f"{RESOURCES}talker": (RESULT, NO_IMU),
    f"{RESOURCES}wbag": (RESULT, NO_IMU),
    f"{ROSBAG2}rosbag2_tests/resources/mcap/cdr_test": (RESULT, NO_IMU),
    "rosbag2_real_imu/av_start_position_A": (RESULT, NO_SEAT.format("/ins/imu")),
    "rosbag2_real_imu/byu_SO_bag": (RESULT, NO_SEAT.format("/coug2/modem_imu")),
}
"""Expected output of `info` and `replay` for a recording's directory and for each storage file in it."""

REFUSED = {
    "bags_odd/mcap2arrow": "several recordings, and no metadata.yaml that lists them",
    "bags_odd/mcap2arrow/no_summary.mcap": FOREIGN.format("json"),
    "bags_odd/mcap2arrow/with_summary.mcap": FOREIGN.format("json"),
    "bags_odd/mcap_crate": "several recordings, and no metadata.yaml that lists them",
    "bags_odd/mcap_crate/chunk_not_closed.mcap": "cut before its first complete chunk, nothing to recover",
    "bags_odd/mcap_crate/compressed.mcap": FOREIGN.format("ros1"),
    "bags_odd/plotjuggler/tilt_laser.bag": "a ROS 1 bag, only ROS 2 bags can be read: convert it",
    f"{ROSBAG2}rosbag2_tests/resources/mcap/wrong_rmw_test": FOREIGN.format("wrong_format"),
    f"{ROSBAG2}rosbag2_tests/resources/mcap/wrong_rmw_test/wrong_rmw_test_0.mcap": FOREIGN.format("wrong_format"),
    f"{ROSBAG2}rosbag2_tests/resources/sqlite3/wrong_rmw_test": FOREIGN.format("wrong_format"),
}
"""Refused by both commands."""

OF_ITS_OWN = {
    # Only metadata.yaml of its directory knows of the wrong format.
    f"{ROSBAG2}rosbag2_tests/resources/sqlite3/wrong_rmw_test/wrong_rmw_test_0.db3": (RESULT, NO_IMU),
}

BY_NAME = {
    "metadata.yaml": "the metadata of a recording: give its directory",
    ".db3-shm": "part of the database empty_bag_0.db3: give that file",
    ".db3-wal": "part of the database empty_bag_0.db3: give that file",
    ".csv": "biodyn simulate --seat",
    ".txt": "biodyn simulate --seat",
    ".npy": "neither an MCAP nor a sqlite3 file: give a .mcap, a .db3 or a rosbag2 directory",
    ".tar.gz": "an archive: unpack it",
}


def paths() -> list[str]:
    root = field_data()
    return sorted(p.relative_to(root).as_posix() for p in root.rglob("*")) if root.is_dir() else []


def expected(root: Path, name: str) -> tuple[str, str] | None:
    """Expected output of `info` and `replay` for a path; None if there is none."""
    path = root / name
    parent = Path(name).parent.as_posix()
    if found := BAGS.get(name) or OF_ITS_OWN.get(name):
        return found
    if pattern := REFUSED.get(name):
        return pattern, pattern
    if parent in BAGS and path.suffix in (".mcap", ".db3"):
        return BAGS[parent]
    for end, pattern in BY_NAME.items():
        if name.endswith(end):
            return pattern, pattern
    if path.is_dir() and not any(f.suffix in (".mcap", ".db3", ".bag") for f in path.iterdir()):
        return NO_BAG, NO_BAG
    return None


def output_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command: "" for a result, or the one line it refuses with."""
    code = main(list(arguments))
    out, errors = capsys.readouterr()
    if code == 0:
        assert out
        return RESULT
    assert (code, out) == (2, "")
    assert len(errors.strip().splitlines()) == 1, errors
    return errors.strip()


def test_the_shared_recordings_exist(shared_data: Path) -> None:
    """Skipped without the recordings: then the tests below have no files."""
    assert set(BAGS) | set(REFUSED) | set(OF_ITS_OWN) <= set(paths())


@pytest.mark.parametrize("name", paths())
def test_every_file_and_directory_gives_a_result_or_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, shared_data: Path, name: str
) -> None:
    path, out = shared_data / name, tmp_path / "out"
    beside = path if path.is_dir() else path.parent
    before = sorted(beside.iterdir())
    inform = output_of(capsys, "info", str(path))
    answer = output_of(capsys, "replay", str(path), "--subject", "subject_1", "-o", str(out))
    assert sorted(beside.iterdir()) == before
    assert out.exists() == (answer == RESULT)
    for output, wanted in zip((inform, answer), expected(shared_data, name) or (None, None), strict=True):
        if wanted is not None:
            assert (output == RESULT) == (wanted == RESULT), output
            assert re.search(wanted, output), output
            assert output == RESULT or str(path) in output


@pytest.mark.parametrize(
    ("name", "topic", "pattern"),
    [
        ("rosbag2_real_imu/av_start_position_A", "/ins/imu", "a rate of 31.97 Hz does not fit, 250 to 20000 Hz"),
        ("rosbag2_real_imu/byu_SO_bag", "/coug2/modem_imu", r"a rate of \S+ Hz does not fit, 250 to 20000 Hz"),
        ("bags_odd/plotjuggler", "/imu", "a rate of 25 Hz does not fit, 250 to 20000 Hz"),
        ("bags_odd/all_types/test_bag_mcap", "/test/sensor_msgs/imu", r"seat: gravity needs 0.8 s of samples"),
    ],
)
def test_a_topic_that_is_no_seat_is_refused_in_one_line_and_info_says_the_same(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, shared_data: Path, name: str, topic: str, pattern: str
) -> None:
    mapped = ("--map", f"seat={topic}")
    bag = str(shared_data / name)
    refusal = output_of(capsys, "replay", bag, "--subject", "subject_1", "-o", str(tmp_path / "out"), *mapped)
    assert re.search(pattern, refusal)
    assert main(["info", bag, *mapped, "--json"]) == 0
    assert refusal.endswith(json.loads(capsys.readouterr().out)["replay"]["refusal"])


def only_row(document: dict[str, Any]) -> dict[str, Any]:
    (row,) = document["topics"]
    return row


def test_real_imus_have_their_known_properties(shared_data: Path) -> None:
    document = info(shared_data / "rosbag2_real_imu/av_start_position_A")
    row = only_row(document)
    # SOURCE.txt: 32 Hz, gravity on -x, quantised to 10 ms (steps of 30 and 40), logged about 98 ms later.
    assert row["rate_hz"] == pytest.approx(32.0, abs=0.1)
    assert row["vertical"] == pytest.approx([-1.0, 0.0, 0.0], abs=0.06)
    assert row["gravity_mps2"] == pytest.approx(9.8, abs=0.05)
    assert row["quantum_ms"] == pytest.approx(10.0)
    assert row["median_step_ms"] == pytest.approx(30.0, abs=0.001)
    assert row["offset_ms"] == pytest.approx(95.0, abs=5.0)
    assert abs(row["clock_ppm"]) < 20.0 + row["clock_ppm_error"]
    assert (row["time"], row["rejected"], row["gaps"], row["messages"]) == ("header", 0, 0, 1264)
    assert any("quantised to 10 ms" in line for line in document["warnings"])

    document = info(shared_data / "rosbag2_real_imu/byu_SO_bag")
    row = only_row(document)
    # SOURCE.txt: header stamps are zero, 161 messages, mean size 10.08.
    assert (row["time"], row["messages"], row["rejected"]) == ("log", 161, 0)
    assert row["rate_hz"] == pytest.approx(10.0, abs=0.3)
    assert row["gravity_mps2"] == pytest.approx(10.08, abs=0.1)
    assert row["clock_ppm"] is None
    assert any("header stamps are zero: log time is used instead" in line for line in document["warnings"])

    document = info(shared_data / "bags_odd/plotjuggler")
    row = only_row(document)
    # SOURCE.txt: 25 Hz, constant fake values 151, 152, 153.
    assert row["rate_hz"] == pytest.approx(25.0, abs=0.01)
    assert row["gravity_mps2"] == pytest.approx(np.linalg.norm([151.0, 152.0, 153.0]))
    assert row["flat"] > 1500
    assert any("gravity at rest reads 263.28" in line for line in document["warnings"])


def test_real_databases_that_were_cut_are_read_as_far_as_they_go(tmp_path: Path, shared_data: Path) -> None:
    (file,) = (shared_data / "rosbag2_real_imu/av_start_position_A").glob("*.db3")
    data = file.read_bytes()
    cut, whole = tmp_path / "cut.db3", only_row(info(file))
    for share in (0.3, 0.6, 0.95):
        cut.write_bytes(data[: int(share * len(data))])
        document = info(cut)
        row = only_row(document)
        assert document["recovered"]
        assert row["messages"] == pytest.approx(share * whole["messages"], rel=0.05)
        assert (row["rejected"], row["clipped"], row["gravity_mps2"]) == (0, 0, whole["gravity_mps2"])
        warning = f"recovered {document['messages']} messages, up to {document['seconds']:.3f} s after the first"
        assert any(warning in line for line in document["warnings"])


def as_bag(path: Path, recording: recordings.Recording, sensors: tuple[str, ...] = ("seat",), seed: int = 0) -> Path:
    """A real recording as the Imu streams of some sensors, logged two milliseconds late on average."""
    stamps, accel = recording
    late = np.random.default_rng(seed).exponential(2e6, stamps.size).astype(np.int64)
    with BagWriter(path) as writer:
        for sensor in sensors:
            writer.add_topic(INPUT[sensor], IMU_TYPE)
            payload = encode_imu(stamps, accel, np.zeros_like(accel), f"imu_{sensor}")
            writer.write(INPUT[sensor], np.maximum.accumulate(stamps + late), payload)
    return path


def refused_for_its_rate(bag: Path) -> str:
    """The one line replay refuses a slow seat with, which info foretells."""
    with pytest.raises(InputError) as refusal:
        replay(bag, subject())
    assert info(bag)["replay"]["refusal"] == str(refusal.value)
    return str(refusal.value)


def test_a_tram_at_500_hz_is_surveyed_and_replayed(tmp_path: Path, shared_data: Path) -> None:
    stamps, accel = recordings.tram(shared_data, "L3_StnVinohrady_Riazanska.csv")
    bag = as_bag(tmp_path / "tram.mcap", (stamps[:15_000], accel[:15_000]), SENSORS)
    document = info(bag)
    assert [row["sensor"] for row in document["topics"]] == list(SENSORS)
    for row in document["topics"]:
        assert row["rate_hz"] == pytest.approx(500.0, rel=1e-6)
        assert row["gravity_mps2"] == pytest.approx(10.15, abs=0.1)
        assert row["vertical"][2] > 0.99
        assert (row["rejected"], row["gaps"], row["clipped"], row["quantum_ms"]) == (0, 0, 0, None)
        assert abs(row["clock_ppm"]) <= max(row["clock_ppm_error"], 1.0)
    warning = "no rest at the start: gravity is from the rest at 9.0 s"
    assert document["warnings"] == [f"{sensor}: {warning}" for sensor in SENSORS]
    replayed = replay(bag, subject()).document
    assert replayed["seconds"] == pytest.approx(30.0, abs=0.01)
    assert 0.01 < replayed["sensors"]["seat"]["aw_mps2"] < 0.5


def test_a_real_bus_reaches_a_limit_as_often_as_its_samples_do(tmp_path: Path, shared_data: Path) -> None:
    recording = recordings.tram(shared_data, "L20_3014_Zaluhy_Drobneho.csv")
    bag = as_bag(tmp_path / "bus.mcap", recording)
    beyond = int((np.abs(recording[1]) >= 13.0).any(axis=1).sum())
    assert beyond > 0
    settings = ConditioningSettings(saturation_mps2=13.0)
    assert only_row(info(bag, ReadingOptions(conditioning=settings)))["clipped"] == beyond
    replayed = replay(bag, subject(), ReplayOptions(conditioning=settings)).document
    assert replayed["sensors"]["seat"]["clipped_samples"] == beyond
    assert replayed["sensors"]["seat"]["lower_bound"]


def test_a_car_whose_steps_wander_is_called_uneven(tmp_path: Path, shared_data: Path) -> None:
    # SOURCE.txt: whole milliseconds, median step 8 ms, least 6, longest 120; gravity on -x.
    bag = as_bag(tmp_path / "baja.mcap", recordings.baja(shared_data))
    document = info(bag)
    row = only_row(document)
    assert row["messages"] == 3094
    assert (row["median_step_ms"], row["longest_step_ms"]) == (pytest.approx(8.0), pytest.approx(120.0))
    assert any("ms on average: sampling is uneven" in line for line in document["warnings"])
    assert row["quantum_ms"] == pytest.approx(1.0)
    assert row["rate_hz"] == pytest.approx(1e9 * 3093 / 32.335e9, rel=0.05)
    assert row["gaps"] >= 1
    assert row["vertical"][0] < -0.95
    assert abs(row["clock_ppm"]) < 20.0  # the stamps' clock is sound: it is the sampling that is not
    assert "250 to 20000 Hz are needed" in refused_for_its_rate(bag)


def test_a_telephone_without_gravity_still_has_a_clock(tmp_path: Path, shared_data: Path) -> None:
    # SOURCE.txt: 24750 samples in 247.5 s, steps of 0 to 20 ms; the application took gravity off.
    bag = as_bag(tmp_path / "android.mcap", recordings.android(shared_data))
    row = only_row(info(bag))
    assert row["rate_hz"] == pytest.approx(100.0, abs=1.0)
    assert (row["median_step_ms"], row["longest_step_ms"]) == (pytest.approx(10.0), pytest.approx(20.0))
    assert row["quantum_ms"] == pytest.approx(1.0)
    assert row["gravity_mps2"] < 1.0
    assert row["vertical"] is None
    # Its steps jitter between 0 and 20 ms: now and then a clock so disturbed takes a sample for one too many.
    assert row["rejected"] <= 0.005 * 24750
    assert "Hz does not fit, 250 to 20000 Hz are needed" in refused_for_its_rate(bag)


def test_a_parachute_opens_at_the_end_of_its_sensor_s_range(tmp_path: Path, shared_data: Path) -> None:
    # SOURCE.txt: 200 Hz with skips of 10 ms, peaks of 15.7 g in a range of 16 g.
    recording = recordings.parachute(shared_data)
    bag = as_bag(tmp_path / "parachute.mcap", recording)
    row = only_row(info(bag))
    assert row["rate_hz"] == pytest.approx(200.0, abs=0.1)
    assert (row["median_step_ms"], row["longest_step_ms"]) == (pytest.approx(5.0), pytest.approx(10.0))
    # It never rests, so its gravity is the mean of the record, all of which counts.
    assert row["filled"] == int((np.diff(recording[0]) == 10_000_000).sum())
    assert row["clipped"] == 0
    limit = ConditioningSettings(saturation_mps2=50.0)
    beyond = int((np.abs(recording[1]) >= 50.0).any(axis=1).sum())
    assert only_row(info(bag, ReadingOptions(conditioning=limit)))["clipped"] == beyond > 0
    assert "a rate of 200 Hz does not fit" in refused_for_its_rate(bag)


def test_a_car_on_the_highway_keeps_its_odd_rate(tmp_path: Path, shared_data: Path) -> None:
    # SOURCE.txt: 104.36 Hz by its steps of 9.58 to 9.64 ms, third axis down, no gaps, no duplicates.
    recording = recordings.comma(shared_data)
    bag = as_bag(tmp_path / "comma.mcap", recording)
    row = only_row(info(bag))
    mean_step_s = 1e-9 * (recording[0][-1] - recording[0][0]) / (len(recording[0]) - 1)
    assert row["rate_hz"] == pytest.approx(1.0 / mean_step_s, rel=1e-3)
    assert row["vertical"][2] < -0.99
    assert (row["rejected"], row["gaps"], row["filled"]) == (0, 0, 0)
    assert "a rate of 104." in refused_for_its_rate(bag)


def test_a_recording_copied_elsewhere_is_found_by_its_variable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, shared_data: Path
) -> None:
    shutil.copytree(shared_data / "iso2631_tables", tmp_path / "iso2631_tables")
    monkeypatch.setenv("BIODYN_DATA", str(tmp_path))
    assert field_data() == tmp_path
    assert "iso2631_tables/SOURCE.txt" in paths()
