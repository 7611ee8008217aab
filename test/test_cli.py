"""The command line: results where they belong, bad input in one clear line, exit code 2, nothing half-written."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from listed import assert_listed
from pages import empty_drawings
from streams import accel_stamped, noisy_streams, subject

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEGMENTS, SENSORS
from biodyn_core.body.synthesis import imu_streams
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag import BagWriter, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base import topics
from biodyn_ros.base.resources import bag_file, subject_file
from biodyn_ros.commands.cli import main
from biodyn_ros.reading.seat_motion import read_seat_motion
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import exposure_report
from biodyn_ros.simulate import START_NS, motion_of_cases

BAG = str(bag_file("subject_1.mcap"))


@pytest.fixture(autouse=True)
def _empty_drawings() -> Iterator[None]:
    """These tests read the words of pages; the tests of the pages check the drawings."""
    with empty_drawings():
        yield


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run a command in-process: (exit code, stdout, stderr)."""
    try:
        code = main([str(argument) for argument in arguments])
    except SystemExit as error:  # argparse
        code = int(error.code or 0)
    out = capsys.readouterr()
    return code, out.out, out.err


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command that must fail with one clear line and exit code 2; return the line."""
    code, out, errors = run(capsys, *arguments)
    assert code == 2, errors
    assert out == ""
    assert "Traceback" not in errors
    assert len(errors.strip().splitlines()) == 1, errors
    return errors.strip()


def figures(capsys: pytest.CaptureFixture[str], bag: Path, out: Path) -> dict[str, Any]:
    """The document of a replay that writes nothing but it."""
    given = ("--subject", "subject_1", "-o", out, "--no-report", "--no-predicted", "--json")
    code, text, errors = run(capsys, "replay", bag, *given)
    assert code == 0, errors
    return json.loads(text)


def write_bag(path: Path, sensors: tuple[str, ...] = SENSORS, change: Any = None, namespace: str = "") -> Path:
    """A small bag of the noisy streams; `change` may alter a sensor's (stamps, acceleration)."""
    with BagWriter(path) as writer:
        for stream in noisy_streams():
            if stream.sensor in sensors:
                stamps, accel = stream.stamps_ns, stream.accel_mps2
                if change:
                    stamps, accel = change(stream.sensor, stamps.copy(), accel.copy())
                topic = namespace + topics.INPUT[stream.sensor]
                writer.add_topic(topic, IMU_TYPE)
                log_ns = np.where(stamps == 0, stream.stamps_ns[: len(stamps)], stamps)
                writer.write(topic, log_ns, encode_imu(stamps, accel, np.zeros_like(accel), "imu"))
    return path


def test_replay_writes_bag_figures_and_report(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, _ = run(capsys, "replay", BAG, "--subject", "subject_1", "-o", tmp_path / "out")
    assert code == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["exposure.json", "predicted.mcap", "report.html"]
    document = json.loads((tmp_path / "out" / "exposure.json").read_text(encoding="utf-8"))
    assert_listed("exposure.json", document)
    assert set(document["sensors"]) == set(SENSORS)
    assert set(document["predicted"]) == set(SEGMENTS)
    assert set(document["residual"]) == set(MEASURED_SEGMENTS)
    assert {p["status"] for p in document["predicted"].values()} == {"not_validated"}
    assert "made by the model itself" in document["bag_made_by_model"]
    assert "made by the model itself" in out
    with open_bag(tmp_path / "out" / "predicted.mcap") as reader:
        names = {topic.name for topic in reader.topics}
        written = (*topics.PREDICTED.values(), *topics.MEASURED.values(), topics.PREDICTED_BLOCK, topics.MEASURED_BLOCK)
        assert names == {topics.absolute(topic) for topic in written}
        (head,) = [b.messages() for b in reader.blocks(["/biodyn/predicted/head/accel"])][:1]
    assert np.abs(accel_stamped(head)[1][:, 2]).max() < 100.0


def test_json_is_the_same_document_and_nothing_else_is_on_stdout(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ("replay", BAG, "--subject", "subject_1", "-o", tmp_path, "--no-predicted", "--no-report", "--json")
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    assert json.loads(out) == json.loads((tmp_path / "exposure.json").read_text(encoding="utf-8"))
    assert [p.name for p in tmp_path.iterdir()] == ["exposure.json"]


def test_the_limit_assessment_is_in_json_and_in_words(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag.mcap")
    code, out, errors = run(capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out", "--no-predicted")
    assert code == 0, errors
    document = json.loads((tmp_path / "out" / "exposure.json").read_text(encoding="utf-8"))
    seat = document["seat"]
    assert document["limits"] == {
        "source": "2002/44/EC", "action_a8_mps2": 0.5, "action_vdv_mps175": 9.1, "limit_a8_mps2": 1.15,
        "limit_vdv_mps175": 21.0,
    }  # fmt: skip
    (iso,) = document["limits_beside"]
    assert (iso["source"], iso["limit_a8_mps2"], iso["limit_vdv_mps175"]) == ("ISO 2631-1 caution zone", None, 17.0)
    assert iso["zone"] == "below_action_value"
    assert iso["time_to_limit_value_s"] > 0.0
    assert seat["zone"] == "below_action_value"
    assert "below the action values of 0.5 and 9.1 (2002/44/EC)" in seat["zone_reason"]
    assert seat["axis"] == (seat["a8_axis"] if seat["governing"] == "a8" else seat["vdv_axis"])
    assert seat["a8_projected_8h_mps2"] is None
    assert seat["projected_from_s"] is None
    assert set(seat["shock_ratios"]) == {"axis", "crest_factor", "mtvv_over_aw", "vdv_over_aw_t"}
    assert "SEAT: BELOW THE ACTION VALUES SO FAR" in out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert 'class="strip good"' in page
    assert "Below the action values so far" in page


def test_a_short_record_is_projected_on_request(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag.mcap")
    code, out, _ = run(
        capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out", "--no-report", "--no-predicted",
        "--json", "--project",
    )  # fmt: skip
    assert code == 0
    seat = json.loads(out)["seat"]
    times = 8.0 * 3600.0 / seat["projected_from_s"]
    assert times > 1000.0
    assert seat["a8_projected_8h_mps2"] == pytest.approx(seat["a8_so_far_mps2"] * times**0.5)
    assert seat["vdv_projected_8h_mps175"] == pytest.approx(seat["vdv_so_far_mps175"] * times**0.25)


def vertical_only(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A seat sensor of one axis."""
    if sensor == "seat":
        accel = np.column_stack([np.zeros((len(accel), 2)), np.linalg.norm(accel, axis=1)])
    return stamps, accel


def clipped_once(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One reading of the seat at the end of its range."""
    if sensor == "seat":
        accel[3000, 0] = 160.0
    return stamps, accel


def stuck(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The seat repeats its last reading to the end."""
    if sensor == "seat":
        accel[-2400:] = accel[-2400]
    return stamps, accel


def ended_early(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The seat stops more than a second before the others."""
    cut = -1500 if sensor == "seat" else len(stamps)
    return stamps[:cut], accel[:cut]


def low_gain(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The seat reads a fifth too little."""
    return stamps, 0.8 * accel if sensor == "seat" else accel


def not_finite_tail(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All sensors send no numbers any more after a while."""
    accel[2000:] = np.nan
    return stamps, accel


def unset_tail(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All sensors send no stamps any more after a while."""
    stamps[2000:] = 0
    return stamps, accel


@pytest.mark.parametrize(
    ("change", "because"),
    [
        (not_finite_tail, "seat's samples are unusable"),
        (vertical_only, "vertical only"),
        (clipped_once, "1 sample is clipped"),
        (stuck, "missing"),
        (ended_early, "fallen silent"),
        (low_gain, "for gravity"),
    ],
)
def test_an_incomplete_seat_is_undecided_in_every_output(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, change: Any, because: str
) -> None:
    bag = write_bag(tmp_path / "bag.mcap", change=change)
    # The page has the zone of the document, however that came about.
    given = ("--no-predicted",) if change in (vertical_only, clipped_once) else ("--no-predicted", "--no-report")
    code, out, errors = run(capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out", *given)
    assert code == 0, errors
    document = json.loads((tmp_path / "out" / "exposure.json").read_text(encoding="utf-8"))
    assert document["seat"]["zone"] == document["limits_beside"][0]["zone"] == "undecided"
    assert because in document["seat"]["zone_reason"]
    assert (document["seat"]["horizontal"] == "missing") == (change is vertical_only)
    assert "SEAT: UNDECIDED" in out
    assert ("Vertical only" in out) == (change is vertical_only)
    if "--no-report" in given:
        return
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert 'class="strip good"' not in page
    if change is vertical_only:
        assert "Vertical only" in page


def test_given_limits_decide_and_the_others_are_listed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text(
        "decides: mine\nsets:\n"
        "  - {source: theirs, action_a8_mps2: 5, limit_a8_mps2: 6}\n"
        "  - {source: mine, action_vdv_mps175: 1.0e-6, limit_vdv_mps175: 2.0e-6}\n",
        encoding="utf-8",
    )
    bag = write_bag(tmp_path / "bag.mcap")
    given = ("--subject", "subject_1", "-o", tmp_path / "out", "--no-report", "--no-predicted", "--limits", limits)
    code, out, errors = run(capsys, "replay", bag, *given, "--json")
    assert code == 0, errors
    document = json.loads(out)
    assert (document["limits"]["source"], document["seat"]["zone"]) == ("mine", "above_limit_value")
    assert [(each["source"], each["zone"]) for each in document["limits_beside"]] == [("theirs", "below_action_value")]
    limits.write_text("decides: nobody\nsets: []\n", encoding="utf-8")
    assert "limits.yaml: a list of sets" in refused(capsys, "replay", bag, *given)


def test_replay_again_replaces_its_own_files_and_removes_those_that_are_not_requested(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Beside the figures of another ride a page of an earlier replay would pass for its page."""
    bag, out = write_bag(tmp_path / "bag.mcap"), tmp_path / "out"
    for _ in range(2):
        code, _, errors = run(capsys, "replay", bag, "--subject", "subject_2", "-o", out)
        assert code == 0, errors
    assert {path.name for path in out.iterdir()} == {"predicted.mcap", "exposure.json", "report.html"}
    figures(capsys, bag, out)
    assert {path.name for path in out.iterdir()} == {"exposure.json"}


@pytest.mark.parametrize("given", [(), ("--no-predicted",)])
@pytest.mark.parametrize("linked", [False, True])
def test_a_replay_into_the_place_of_its_bag_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, given: tuple[str, ...], linked: bool
) -> None:
    bag = write_bag(tmp_path / "predicted.mcap")
    before = bag.read_bytes()
    named = tmp_path / "drive.mcap"
    named.symlink_to(bag)
    line = refused(
        capsys, "replay", named if linked else bag, "--subject", "subject_1", "-o", tmp_path, "--no-report", *given
    )
    assert "is an input, and a result would replace it" in line
    assert bag.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.mcap", "predicted.mcap"]


@pytest.mark.parametrize("given", [(), ("--no-predicted",)])
def test_a_replay_never_replaces_a_directory(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, given: tuple[str, ...]
) -> None:
    recording = tmp_path / "predicted.mcap"
    recording.mkdir()
    write_bag(recording / "drive_0.mcap")
    line = refused(capsys, "replay", recording, "--subject", "subject_1", "-o", tmp_path, "--no-report", *given)
    assert "predicted.mcap: is a directory" in line
    assert [path.name for path in recording.iterdir()] == ["drive_0.mcap"]


def test_a_file_of_a_recording_is_not_replaced(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "predicted.mcap")
    before = bag.read_bytes()
    line = refused(capsys, "replay", tmp_path, "--subject", "subject_1", "-o", tmp_path, "--no-report")
    assert "is an input" in line
    assert bag.read_bytes() == before


@pytest.mark.parametrize(
    ("command", "name"), [("trace", "subject.yaml"), ("subject", "subject.yaml"), ("subject", "fitted.yaml")]
)
def test_the_given_subject_is_not_replaced(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str, name: str
) -> None:
    given = tmp_path / name
    shutil.copyfile(subject_file("subject_1"), given)
    line = refused(capsys, command, BAG, "--subject", given, "-o", tmp_path, "--no-report")
    assert "is an input, and a result would replace it" in line
    assert given.read_bytes() == subject_file("subject_1").read_bytes()


def test_a_bag_name_that_is_not_utf8_is_replayed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / os.fsdecode(b"dr\xffive.mcap"))
    code, out, errors = run(capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out", "--no-report")
    assert code == 0, errors
    assert r"dr\udcffive.mcap" in out
    with open_bag(tmp_path / "out" / "predicted.mcap") as reader:
        assert reader.metadata("biodyn")["bag"].endswith(r"dr\udcffive.mcap")


def test_a_closed_output_pipe_is_no_failure() -> None:
    for arguments in ("--help", "replay -h", "compare subject_1 subject_2"):
        line = f"{shlex.quote(sys.executable)} -m biodyn_ros.commands.cli {arguments} | true; echo ${{PIPESTATUS[0]}}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
        assert (done.stdout, done.stderr) == ("0\n", "")


def test_a_remapped_namespace_and_a_mapped_topic_are_found(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag.mcap", namespace="/car/left/")
    arguments = ("--subject", "subject_1", "-o", tmp_path / "out", "--no-report", "--no-predicted", "--json")
    code, out, _ = run(capsys, "replay", bag, *arguments)
    assert code == 0
    named = json.loads(out)
    code, out, _ = run(capsys, "replay", bag, *arguments, "--map", "head=/car/left/imu/neck/data")
    assert code == 0
    swapped = json.loads(out)
    assert swapped["sensors"]["head"]["vdv_mps175"] == named["sensors"]["neck"]["vdv_mps175"]
    assert "neck" not in swapped["sensors"]
    assert any("neck: not in the bag" in line for line in swapped["warnings"])


def test_simulate_is_reproducible_and_looks_like_imus(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        arguments = ("--subject", "subject_2", "--case", "rail", "--seconds", 3, "--seed", seed)
        code, _, errors = run(capsys, "simulate", *arguments, "-o", tmp_path / f"{name}.mcap")
        assert code == 0, errors
    blocks = {name: gathered(tmp_path / f"{name}.mcap") for name in "abc"}
    for topic in topics.INPUT.values():
        np.testing.assert_array_equal(blocks["a"][topic], blocks["b"][topic])
        assert not np.array_equal(blocks["a"][topic], blocks["c"][topic])
        still = blocks["a"][topic][:1000]
        assert np.linalg.norm(still.mean(axis=0)) == pytest.approx(9.807, abs=0.3)
        assert 0.02 < still.std(axis=0).max() < 0.1
        assert np.abs(blocks["a"][topic]).max() < 16 * 9.81
    peak = np.abs(np.linalg.norm(blocks["a"]["imu/seat/data"], axis=1) - 9.81).max() / 9.81
    assert 2.0 < peak < 9.0


def gathered(path: Path) -> dict[str, np.ndarray]:
    """All accelerations by topic."""
    parts: dict[str, list[np.ndarray]] = {}
    with open_bag(path) as reader:
        for topic, block in imu_blocks(reader, [t.name for t in reader.topics]):
            parts.setdefault(topic, []).append(block.accel_mps2)
    return {topic: np.concatenate(blocks) for topic, blocks in parts.items()}


@cache
def replayed_road() -> dict[str, Any]:
    """The figures of two seconds of road without a bag in between."""
    streams = imu_streams(
        subject(), motion_of_cases(["road"], 2.0, 0), np.random.default_rng([0, 1]), start_ns=START_NS
    )
    pipeline = Pipeline(subject())
    for stream in streams:
        pipeline.push(stream.sensor, stream.stamps_ns, stream.accel_mps2)
    document = exposure_document(exposure_report(pipeline))
    return json.loads(json.dumps(document["sensors"]))


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_every_compression_replays_to_the_same_figures(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, compression: str
) -> None:
    arguments = ("--subject", "subject_1", "--case", "road", "--seconds", 2, "--compression", compression)
    assert run(capsys, "simulate", *arguments, "-o", tmp_path / "bag")[0] == 0
    code, out, _ = run(
        capsys, "replay", tmp_path / "bag", "--subject", "subject_1", "-o", tmp_path / "out", "--no-report",
        "--no-predicted", "--json",
    )  # fmt: skip
    assert code == 0
    figures = json.loads(out)["sensors"]
    assert figures == replayed_road()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("comma2k19_car_imu_104hz/imu.csv", ()),
        ("bratislava_tram_bus_500hz/L3_StnVinohrady_Riazanska.csv", ("--seat-rate", "500")),
        ("rosbag2_real_imu/av_start_position_A", ("--map", "seat=/ins/imu")),
        ("rosbag2_real_imu/byu_SO_bag", ("--map", "seat=/coug2/modem_imu")),
    ],
)
def test_measured_seat_motions_drive_a_simulation(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, shared_data: Path, name: str, options: tuple[str, ...]
) -> None:
    bag = tmp_path / "bag.mcap"
    given = ("--subject", "subject_1", "--seat", shared_data / name, "--seconds", 12, *options)
    code, _, errors = run(capsys, "simulate", *given, "-o", bag)
    if "byu" in name:  # no seat motion, and its stamps are all zero: the recorder's times served
        assert code == 2
        assert "a rate of 10.1 Hz is too low for a seat motion" in errors
        assert not bag.exists()
        return
    assert code == 0, errors
    document = figures(capsys, bag, tmp_path / "out")
    assert document["seconds"] == pytest.approx(12.0 + 2.0 * (1.0 + 0.25), abs=0.1)  # rest, and its change to motion
    assert all(row["nrmse_rms_percent"] < 60.0 for row in document["residual"].values())
    assert 0.01 < document["sensors"]["seat"]["aw_mps2"] < 2.0


def test_the_real_tram_has_the_published_weighted_rms(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, shared_data: Path
) -> None:
    # SOURCE.txt: Wk rms 0.148 m/s^2, VDV 1.03 m/s^1.75 over the whole record, in the frequency domain.
    tram = shared_data / "bratislava_tram_bus_500hz" / "L3_StnVinohrady_Riazanska.csv"
    bag, perfect = tmp_path / "bag.mcap", ("--noise-mps2", 0, "--bias-mps2", 0, "--tilt-deg", 0, "--rate-hz", 500)
    given = ("--subject", "subject_1", "--seat", tram, "--seat-rate", 500, *perfect)
    assert run(capsys, "simulate", *given, "-o", bag)[0] == 0
    seat = figures(capsys, bag, tmp_path / "out")["sensors"]["seat"]
    assert seat["aw_mps2"] == pytest.approx(0.148, rel=0.02)
    assert seat["vdv_mps175"] == pytest.approx(1.03, rel=0.02)


# --- bad input -------------------------------------------------------------------------------------------------------


def test_no_seat_sensor(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag.mcap", ("pelvis", "head"))
    error = refused(capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out")
    assert "no seat sensor among" in error
    assert "--map seat=TOPIC" in error
    assert not (tmp_path / "out" / "predicted.mcap").exists()


def test_a_bag_without_imu_or_without_anything(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with BagWriter(tmp_path / "text.mcap") as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String")
        payload = np.frombuffer(b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00\x00\x00", dtype=np.uint8)[None, :]
        writer.write("/chatter", np.array([1]), payload)
    error = refused(capsys, "replay", tmp_path / "text.mcap", "--subject", "subject_1", "-o", tmp_path / "out")
    assert "no sensor_msgs/msg/Imu in the bag" in error
    assert "/chatter" in error
    with BagWriter(tmp_path / "empty.mcap"):
        pass
    error = refused(capsys, "replay", tmp_path / "empty.mcap", "--subject", "subject_1", "-o", tmp_path / "out")
    assert "no sensor_msgs/msg/Imu in the bag" in error
    assert "empty.mcap" in refused(capsys, "play", tmp_path / "empty.mcap")
    assert "missing.mcap" in refused(capsys, "replay", tmp_path / "missing.mcap", "--subject", "subject_1", "-o", "x")


def test_a_rate_that_does_not_fit(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    def slow(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (stamps[0] + (stamps - stamps[0]) * 10, accel) if sensor == "seat" else (stamps, accel)

    bag = write_bag(tmp_path / "bag.mcap", change=slow)
    error = refused(capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out")
    assert "seat: a rate of 112.9 Hz does not fit" in error


def test_without_stamps_log_time_is_used_with_a_warning(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = tmp_path / "bag.mcap"
    with BagWriter(bag) as writer:
        for stream in noisy_streams():
            topic = topics.INPUT[stream.sensor]
            writer.add_topic(topic, IMU_TYPE)
            payload = encode_imu(0 * stream.stamps_ns, stream.accel_mps2, stream.gyro_radps, "")
            writer.write(topic, stream.stamps_ns, payload)
    document = figures(capsys, bag, tmp_path / "out")
    assert "seat: header stamps are zero: log time is used instead" in document["warnings"]
    code, out, _ = run(
        capsys, "replay", bag, "--subject", "subject_1", "-o", tmp_path / "out", "--time", "log", "--no-report",
        "--no-predicted", "--json",
    )  # fmt: skip
    assert code == 0
    assert json.loads(out)["sensors"] == document["sensors"]


def test_nan_samples_are_rejected_and_counted(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    def spoil(sensor: str, stamps: np.ndarray, accel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        accel[2000:2005, 2] = np.nan
        accel[2100] = np.inf
        return stamps, accel

    bag = write_bag(tmp_path / "bag.mcap", change=spoil)
    arguments = ("-o", tmp_path / "out", "--no-report", "--no-predicted", "--json")
    code, out, _ = run(capsys, "replay", bag, "--subject", "subject_1", *arguments)
    document = json.loads(out)
    assert code == 0
    assert document["sensors"]["seat"]["lower_bound"] is True
    assert document["sensors"]["seat"]["missing_s"] == pytest.approx(6 / 1129.3, rel=1e-3)
    assert any("seat: 0.005 s missing" in line for line in document["warnings"])


@pytest.mark.parametrize(
    ("change", "cause"),
    [(not_finite_tail, "readings that are no numbers, or impossible"), (unset_tail, "stamps never set")],
)
def test_a_record_that_ends_with_unusable_samples_is_a_lower_bound_with_warnings(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, change: Any, cause: str
) -> None:
    document = figures(capsys, write_bag(tmp_path / "bag.mcap", change=change), tmp_path / "out")
    lost = len(noisy_streams()[0].stamps_ns) - 2000
    assert document["seat"]["zone"] == "undecided"
    assert document["seat"]["time_to_action_value_s"] is None
    for name in SENSORS:
        assert document["sensors"][name]["lower_bound"] is True
        assert document["sensors"][name]["missing_s"] == pytest.approx(lost / 1129.3, abs=2e-3)
        assert f"{name}: {lost} samples rejected: {lost} {cause}" in document["warnings"]
        begin = f"{name}: the last {lost / 1129.3:.1f}"
        assert any(line.startswith(begin) and "no usable sample" in line for line in document["warnings"])


def test_an_ascii_terminal_gets_escapes() -> None:
    """In the C locale the standard streams have another way with errors than elsewhere."""
    given = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-m", "biodyn_ros.commands.cli", "info", str(BAG)]
    done = subprocess.run(command, env=given, capture_output=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, b"") and b"\\u" in done.stdout


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("colour: blue\n", "unknown key 'colour'"),
        ("schema: 2\n", "schema"),
    ],
)
def test_a_subject_that_does_not_fit_names_file_and_key(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, change: str, expected: str
) -> None:
    path = tmp_path / "mine.yaml"
    text = subject_file("subject_1").read_text(encoding="utf-8")
    path.write_text(text.replace("schema: 1\n", "") + change if "schema" in change else text + change, encoding="utf-8")
    line = refused(capsys, "replay", BAG, "--subject", path, "-o", tmp_path / "out")
    assert "mine.yaml" in line
    assert expected in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("replay", BAG, "--subject", "nobody", "-o", "x"), "no subject file nobody"),
        (
            ("replay", BAG, "--subject", "subject_1", "-o", "x", "--map", "knee=/a"),
            "--map knee=/a: expected sensor=topic",
        ),
        (("replay", BAG, "--subject", "subject_1", "-o", "x", "--map", "head=/a"), "no such Imu topic"),
        (
            ("replay", BAG, "--subject", "subject_1", "-o", "x", "--cutoff-hz", "3"),
            "cutoff_hz is 3, allowed are 5 to 200",
        ),
        (("replay", BAG, "--subject", "subject_1", "-o", "x", "--window-s", "nan"), "window_s is nan"),
        (("simulate", "--subject", "subject_1", "--case", "lunar", "-o", "x.mcap"), "case 'lunar' is unknown"),
        (
            ("simulate", "--subject", "subject_1", "--case", "road", "--seconds", "0.5", "-o", "x.mcap"),
            "0.5 s is not made",
        ),
        (
            ("simulate", "--subject", "subject_1", "--case", "road", "--seed", "-1", "-o", "x.mcap"),
            "'-1' is not a whole number >= 0",
        ),
        (("fit", BAG, "--subject", "subject_1", "--seed", "-1", "-o", "x.yaml"), "'-1' is not a whole number >= 0"),
        (("trace", BAG, "--subject", "subject_1", "--seed", "1.5", "-o", "x"), "'1.5' is not a whole number >= 0"),
        (
            ("simulate", "--subject", "subject_1", "--case", "road", "--seconds", "0", "-o", "x.mcap"),
            "a case of 0 s is not",
        ),
        (
            ("simulate", "--subject", "subject_1", "--seat", BAG, "--seconds", "nan", "-o", "x.mcap"),
            "nan s of a motion are not used, at least 2 s are needed",
        ),
        (
            ("simulate", "--subject", "subject_1", "--case", "road", "--jitter-ms", "9", "-o", "x.mcap"),
            "jitter_ms is 9",
        ),
        (("simulate", "--subject", "subject_1", "--seat", "none.csv", "-o", "x.mcap"), "none.csv: cannot be read"),
        (
            ("simulate", "--subject", "subject_1", "--case", "rail", "-o", ""),
            "-o is an empty text: give a file or directory",
        ),
        (
            ("simulate", "--subject", "subject_1", "--case", "rail", "--map", "seat=/foo", "-o", "x.mcap"),
            "--map and --time need a bag given by --seat: omit them",
        ),
        (
            ("simulate", "--subject", "subject_1", "--seat", "none.csv", "--time", "log", "-o", "x.mcap"),
            "--map and --time need a bag given by --seat: omit them",
        ),
        (
            ("simulate", "--subject", "subject_1", "--seat", "none.csv", "--seat-rate", "0", "-o", "x.mcap"),
            "--seat-rate 0: expected a positive number of Hz",
        ),
        (
            ("simulate", "--subject", "subject_1", "--case", "road", "--seat-rate", "500", "-o", "x.mcap"),
            "--seat-rate needs a CSV file given by --seat",
        ),
        (("trace", BAG, "--subject", "subject_1", "-o", "/"), "/: has no name, which DIR.kept.json needs"),
        (("trace", "none.mcap", "--subject", "subject_1", "--fresh", "-o", "."), "none.mcap"),
        (("trace", "--subject", "subject_1", "-o", "x"), "no bag is given: give at least one"),
        (
            ("validate", BAG, "--subject", "subject_1", "--lowest-hz", "8", "--highest-hz", "8.2", "-o", "x"),
            "lowest_hz 8 to highest_hz 8.2 holds less than two lines of 0.5 Hz: widen it, or lengthen segment_s",
        ),
        (("play", BAG, "--rate", "0"), "rate is 0, allowed are 0.01 to 100"),
    ],
)
def test_bad_arguments_are_one_clear_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    expected: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert expected in refused(capsys, *arguments)
    assert [p.name for p in tmp_path.rglob("*.mcap")] == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x,y,z\n1,2,3\n1,2\n", "line 3: has 2 values, the header has 3 names"),
        ("x,y,z\n1,2,3\n\n1,high,3\n", "line 4: y is 'high', a number is needed"),
        ("x,y,z\n\n\n", "rows of 3 numbers are needed, there is none"),
        ("t,ax_g,ay_g,az_g\n0,0,0,1\n1,0,0,1\n", "ax_g is in g, m/s^2 is needed"),
        ("t,ax [mg],ay [mg],az [mg]\n0,0,0,1\n1,0,0,1\n", "ax [mg] is in mg, m/s^2 is needed"),
        ("t,x,y,z\n0,0,0,1.01\n3,0,0,0.99\n", "the mean acceleration is 1.00, so the values are in g"),
        ("t,angular_velocity_x,angular_velocity_y,angular_velocity_z\n0,0,0,1\n3,0,0,1\n", "no acceleration columns"),
        ("t,altitude\n0,200\n3,201\n", "no acceleration columns"),
        ("t,ax,ay\n0,0,0\n3,0,0\n", "no acceleration columns"),
        ("x,y,z\n1,2,3\n1,nan,3\n", "line 3: y is nan, a finite number is needed"),
        ("x,y,z\n\n1,2,3\n\n1,nan,3\n", "line 5: y is nan, a finite number is needed"),
        ("t,p,q\n0,2,3\n1,2,3\n", "no acceleration columns"),
        ("x,y,z\n0,0,9.8\n0,0,9.8\n", "no time column"),
        ("t,x,y,z\n0,0,0,9.8\n0.5,0,0,9.8\n", "at least 2 s of motion"),
        ("", "a header line and rows"),
    ],
)
def test_a_broken_seat_file_is_one_clear_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, expected: str
) -> None:
    path = tmp_path / "seat.csv"
    path.write_text(text, encoding="utf-8")
    line = refused(capsys, "simulate", "--subject", "subject_1", "--seat", path, "-o", tmp_path / "bag.mcap")
    assert "seat.csv" in line
    assert expected in line
    assert not (tmp_path / "bag.mcap").exists()


@pytest.mark.parametrize(
    "header",
    [
        "t,x,y,z", "t,ax,ay,az", "t,a_forward,a_left,a_up", "t,acc_x,acc_y,acc_z", "t,Accel X,Accel Y,Accel Z",
        "t,linear_acceleration_x,linear_acceleration_y,linear_acceleration_z", "t,ax [m/s^2],ay [m/s^2],az [m/s^2]",
        "t,ax_mps2,ay_mps2,az_mps2", "t,acceleration.x,acceleration.y,acceleration.z",
    ],
)  # fmt: skip
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_columns_of_acceleration_are_known_by_their_names_in_any_order(
    header: str, order: tuple[int, ...], tmp_path: Path
) -> None:
    at_s = np.arange(400) / 100.0
    moving = np.column_stack([np.sin(3.0 * at_s), 0.5 * np.cos(5.0 * at_s), 2.0 * np.sin(9.0 * at_s)])
    time_name, *names = header.split(",")
    columns = np.column_stack([at_s, (moving + np.array([0.0, 0.0, 9.81]))[:, order]])
    rates = np.random.default_rng(1).normal(size=(400, 3))  # of a gyro, beside it
    head = ",".join([time_name, *(names[k] for k in order), "angular_velocity_x,angular_velocity_y,angular_velocity_z"])
    np.savetxt(tmp_path / "seat.csv", np.hstack([columns, rates]), delimiter=",", header=head, comments="")
    motion = read_seat_motion(tmp_path / "seat.csv", None, {})
    np.testing.assert_allclose(motion.accel_mps2[:, 2], moving[:, 2], atol=0.15)


def test_forward_right_and_down_is_turned_up(tmp_path: Path) -> None:
    at_s = np.arange(400) / 100.0
    rows = np.column_stack([at_s, 0.0 * at_s, 0.0 * at_s, -np.sin(9.0 * at_s)])
    np.savetxt(tmp_path / "seat.csv", rows, delimiter=",", header="t,a_forward,a_right,a_down", comments="")
    motion = read_seat_motion(tmp_path / "seat.csv", None, {})
    assert np.corrcoef(motion.accel_mps2[:, 2], np.sin(9.0 * at_s))[0, 1] > 0.999


# --- compare and validate --------------------------------------------------------------------------------------------


def test_compare_gives_the_deviations_of_table_6(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "compare", "subject_1", "subject_2", "--json")
    document = json.loads(out)
    assert code == 0
    rows = {(row["quantity"], row["segment"]): row["percent"] for row in document["convergent"]}
    assert rows["natural_frequency_hz", "head"] == pytest.approx(2.49, abs=0.15)
    code, out, _ = run(capsys, "compare", "subject_1", "subject_2", "--threshold", "1")
    assert code == 0 and "head" in out
    assert "different models" in refused(capsys, "compare", "subject_1", "subject_1_as_printed")


def test_validate_writes_its_output_and_names_disagreements(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arguments = ("validate", BAG, "--subject", "subject_1", "-o", tmp_path / "out", "--json")
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    assert json.loads(out) == json.loads((tmp_path / "out" / "validate.json").read_text(encoding="utf-8"))
    # All agrees, but one shock is no basis for a transmissibility.
    assert json.loads(out)["verdict"] == "undecided"
    assert [(one["status"], one["what"]) for one in json.loads(out)["findings"]] == [("undecided", "stht")]
    code, out, _ = run(capsys, "validate", BAG, "--subject", "subject_2")
    assert code == 0 and "verdict: disagrees" in out and "head: error" in out


def test_validate_refuses_in_one_line_and_writes_nothing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    missing = tmp_path / "missing.mcap"
    assert "missing.mcap" in refused(capsys, "validate", missing, "--subject", "subject_1", "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()
