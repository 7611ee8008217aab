"""Parts of bags: their reference, samples, gravity, and what counts as the same recording."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from logged import write_with_rosbags
from rosbags.rosbag2 import StoragePlugin

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SENSORS
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis_settings import SensorSettings
from biodyn_core.recording.recording import Recording
from biodyn_ros.bag import BagReader, BagWriter, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.progress import ignore_progress
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.topics import INPUT
from biodyn_ros.reading.events import check_bags
from biodyn_ros.reading.gravity import gravity_by_bag, gravity_of_part
from biodyn_ros.reading.parts import BagPart, part_of
from biodyn_ros.reading.provenance import Source, effect_recordings, role_of, source_of
from biodyn_ros.reading.recordings import RecordingOptions, case_of, read_recordings
from biodyn_ros.reading.sensors import ReadingOptions, open_sensors
from biodyn_ros.replay.replaying import replay
from biodyn_ros.simulate import motion_of_cases, simulate_bag

SUBJECT = load_subject(subject_file("subject_1"))
OPTIONS = ReadingOptions()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rest, road and rail, 26 s, in chunks of about two seconds."""
    path = tmp_path_factory.mktemp("parts") / "drive.mcap"
    simulate_bag(path, SUBJECT, motion_of_cases(["road", "rail"], 12.0, seed=3), 3, SensorSettings())
    return path


def read(bag: str | Path | BagPart) -> Recording:
    (found,) = read_recordings(bag, options=RecordingOptions(channels=True))
    return found


# --- reference -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a.mcap", BagPart(Path("a.mcap"))),
        ("a.mcap@1..2.5", BagPart(Path("a.mcap"), 1.0, 2.5)),
        ("a.mcap@10..", BagPart(Path("a.mcap"), 10.0)),
        ("a.mcap@..20", BagPart(Path("a.mcap"), 0.0, 20.0)),
        ("x@1..2/b.mcap@3..4", BagPart(Path("x@1..2/b.mcap"), 3.0, 4.0)),
        ("me@home.mcap", BagPart(Path("me@home.mcap"))),
    ],
)
def test_a_reference_is_read(text: str, part: BagPart) -> None:
    assert part_of(text) == part


@given(
    st.floats(0.0, 1e5).map(lambda at: round(at, 2)),
    st.one_of(st.just(math.inf), st.floats(0.5, 1e4).map(lambda at: round(at, 2))),
)
def test_a_reference_names_its_part(begin_s: float, length_s: float) -> None:
    part = BagPart(Path("a.mcap"), begin_s, round(begin_s + length_s, 2) if length_s < math.inf else math.inf)
    assert part_of(str(part)) == part


@pytest.mark.parametrize(("share", "leap_s"), [(0.02, 0.0), (-0.02, 0.0), (0.0, 30.0)])
def test_a_part_is_whole_where_stamps_and_log_times_move_apart(tmp_path: Path, share: float, leap_s: float) -> None:
    """A driver that counts samples, and a clock that is set: 20 min, logged evenly."""
    rate_hz, path = 50.0, tmp_path / "long.mcap"
    at_s = np.arange(round(1200.0 * rate_hz)) / rate_hz
    stamped_s = (1.0 + share) * at_s + leap_s * (at_s > 60.0)
    stamps_ns, log_ns = (10**18 + np.rint(1e9 * each).astype(np.int64) for each in (stamped_s, at_s))
    accel = np.tile([0.0, 0.0, 9.81], (at_s.size, 1))
    with BagWriter(path) as writer:
        writer.add_topic(INPUT[SEAT], IMU_TYPE)
        for a in range(0, at_s.size, 500):
            messages = encode_imu(stamps_ns[a : a + 500], accel[a : a + 500], None, "imu")
            writer.write(INPUT[SEAT], log_ns[a : a + 500], messages)
    end_s = math.floor(stamped_s[-1])
    for part in (f"{end_s - 20}..{end_s}", f"{end_s - 20}..", "600..620"):
        begin_s, _, end = part.partition("..")
        wanted = (stamped_s >= float(begin_s)) & (stamped_s <= float(end or "inf"))
        with open_sensors(f"{path}@{part}", OPTIONS) as sensors:
            found = sum(len(block.stamps_ns) for _, block in sensors.blocks(ignore_progress))
        assert found == pytest.approx(wanted.sum(), abs=1), part


@pytest.mark.parametrize("stray_s", [100.0, -1e9])
def test_a_stray_first_stamp_does_not_shift_a_part(tmp_path: Path, stray_s: float) -> None:
    """As of a driver whose clock is set after its first message."""
    path, rate_hz = tmp_path / "stray.mcap", 100.0
    log_ns = 1_700_000_000 * 10**9 + np.rint(1e9 * np.arange(3000) / rate_hz).astype(np.int64)
    stamps_ns = log_ns.copy()
    stamps_ns[0] += round(1e9 * stray_s)
    with BagWriter(path) as writer:
        writer.add_topic(INPUT[SEAT], IMU_TYPE)
        writer.write(INPUT[SEAT], log_ns, encode_imu(stamps_ns, np.tile([0.0, 0.0, 9.81], (3000, 1)), None, "imu"))
    with open_sensors(f"{path}@10..20", OPTIONS) as sensors:
        found = np.concatenate([block.stamps_ns for _, block in sensors.blocks(ignore_progress)])
    assert (found[0] - log_ns[0]) / 1e9 == pytest.approx(10.0, abs=0.02) and len(found) >= 1000


def test_a_file_of_that_name_is_no_reference(tmp_path: Path) -> None:
    (tmp_path / "a@1..2").touch()
    assert part_of(str(tmp_path / "a@1..2")).is_whole


def test_a_part_without_length_is_refused() -> None:
    with pytest.raises(InputError, match=r"a\.mcap@5\.\.5.*needs an end at least 0\.5 s after its start"):
        part_of("a.mcap@5..5")


# --- samples ---------------------------------------------------------------------------------------------------------


def test_a_part_has_the_samples_of_the_whole(bag: Path) -> None:
    whole, part = read(bag), read(f"{bag}@6..20")
    first = int(np.searchsorted(whole.stamps_ns, part.stamps_ns[0]))
    there = slice(first, first + part.stamps_ns.size)
    assert np.abs(part.stamps_ns - whole.stamps_ns[there]).max() < 200_000
    assert part.stamps_ns.size / part.rate_hz == pytest.approx(14.0, abs=0.2)
    # The level is that of the part, and the tilt begins at 0 there.
    assert np.abs(part.seat_mps2 - whole.seat_mps2[there])[300:-300].max() < 0.02 * np.abs(whole.seat_mps2).max()
    for column, name in enumerate(MEASURED_SEGMENTS):
        apart = part.measured_mps2[300:-300, column] - whole.measured_mps2[there][300:-300, column]
        assert np.sqrt(np.mean(apart**2)) < 0.03 * np.nanstd(whole.measured_mps2[:, column]), name
    assert not np.isnan(part.measured_mps2[whole.begin :]).any()


def test_only_chunks_with_the_part_are_read(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    chunks = BagReader.chunks

    def counted(self: BagReader, *given: object) -> object:
        for chunk in chunks(self, *given):  # type: ignore[arg-type]
            taken.append(chunk.start_ns)
            yield chunk

    with open_sensors(f"{bag}@0..3", OPTIONS) as sensors:
        monkeypatch.setattr(BagReader, "chunks", counted)
        monkeypatch.setattr("biodyn_ros.reading.parts.LATE_S", 0.0)
        assert sum(len(block) for _, block in sensors.blocks(ignore_progress)) < 7 * 3.6 * 1130
    with open_bag(bag) as reader:
        assert len(taken) < len(list(chunks(reader)))


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_chunks_are_chosen_by_log_time(tmp_path: Path, bag: Path, plugin: StoragePlugin) -> None:
    """Both storages, and log times that lag behind the stamps by four seconds; the first 15 s of the bag."""
    path = tmp_path / "late"
    with open_bag(bag) as reader:
        logged = [
            (block.topic, log_ns + 4 * 10**9, message)
            for block in reader.blocks()
            for log_ns, message in zip(block.log_ns.tolist(), block.messages(), strict=True)
            if log_ns - reader.start_ns < 15 * 10**9
        ]
    write_with_rosbags(path, sorted(logged, key=lambda one: one[1]), plugin)
    late, prompt = read(f"{path}@6..10"), read(f"{bag}@6..10")
    assert np.array_equal(late.stamps_ns, prompt.stamps_ns) and np.array_equal(late.seat_mps2, prompt.seat_mps2)


@pytest.mark.parametrize("reference", ["@30..40", "@20..40", "@26.5.."])
def test_a_part_outside_the_bag_is_refused(bag: Path, reference: str) -> None:
    with pytest.raises(InputError, match=r"outside the bag, which has 26\.\d+ s"):
        read(f"{bag}{reference}")


def test_progress_ends_at_the_end_of_the_part(bag: Path) -> None:
    seen: list[tuple[int, int]] = []
    with open_sensors(f"{bag}@5..9", OPTIONS) as sensors:
        for _ in sensors.blocks(lambda done, total: seen.append((done, total))):
            pass
    with open_bag(bag) as reader:
        every = sum(len(block) for _, block in imu_blocks(reader, INPUT.values()))
    assert seen[-1][1] < 0.2 * every and seen[-1][0] > 0.9 * seen[-1][1]


def test_the_drift_of_a_clock_is_corrected_from_the_begin_of_the_bag(bag: Path) -> None:
    """The clock of the head is fast by 500 ppm: 5 ms at 10 s; the seat's stay."""
    part = BagPart(bag, 10.0, 20.0)
    drifting = dataclasses.replace(part, clock_ppm={"head": 500.0})
    stamps = {}
    for name, one in (("plain", part), ("corrected", drifting)):
        with open_sensors(one, OPTIONS) as sensors:
            blocks = [(sensor, block.stamps_ns) for sensor, block in sensors.blocks(ignore_progress)]
        stamps[name] = {
            sensor: np.concatenate([found for of, found in blocks if of == sensor]) for sensor in ("seat", "head")
        }
    assert np.array_equal(stamps["plain"]["seat"], stamps["corrected"]["seat"])
    with open_sensors(bag, OPTIONS) as sensors:
        begin_ns, _ = sensors.first_of_seat()
    late = stamps["corrected"]["head"] - begin_ns
    # The first sample of the corrected part is one that was stamped 5 ms later.
    original = np.rint(late / (1.0 - 5e-4)).astype(np.int64) + begin_ns
    assert np.abs(original[:, None] - stamps["plain"]["head"][:40]).min(axis=1)[0] < 1000
    assert original[0] - stamps["plain"]["head"][0] == pytest.approx(5e6, abs=1e6)


# --- gravity ---------------------------------------------------------------------------------------------------------


def test_the_gravity_of_a_part_is_that_of_the_rest_of_its_bag(bag: Path) -> None:
    whole, searched, stated = gravity_by_bag(
        [bag, f"{bag}@6..20", BagPart(bag, 6.0, 20.0, rest_s=(0.0, 0.9))], OPTIONS, {}
    )
    for sensor in SENSORS:
        assert searched[sensor].origin == stated[sensor].origin == "session"
        assert searched[sensor].mean_mps2 == pytest.approx(whole[sensor].mean_mps2, abs=0.02)
        assert stated[sensor].rates_radps is not None and stated[sensor].warning(vertical_given=False) is None


def test_a_rest_in_motion_gives_no_gravity(bag: Path) -> None:
    """All sensors move by far more than an engine shakes them: the first rest of the bag is used."""
    part = BagPart(bag, 6.0, 20.0, rest_s=(16.0, 18.0))
    with open_sensors(part, OPTIONS) as sensors:
        found = gravity_of_part(part, sensors, OPTIONS, {})
    right = gravity_by_bag([bag], OPTIONS, {})[0]
    assert all(found[sensor].mean_mps2 == pytest.approx(right[sensor].mean_mps2, abs=0.02) for sensor in SENSORS)


def test_a_part_is_replayed(bag: Path) -> None:
    part, whole = replay(f"{bag}@6..20", SUBJECT), replay(bag, SUBJECT)
    assert part.report.run.seconds == pytest.approx(14.0, abs=0.1)
    assert part.report.bag == f"{bag}@6..20"
    assert part.report.uncounted_s < 0.01 < whole.report.uncounted_s
    # It begins in motion, so the model settles for 2 s; the whole bag begins at rest.
    settles = [[line for line in one.report.warnings if "settles from rest" in line] for one in (part, whole)]
    assert len(settles[0]) == 1 and "2.00 s" in settles[0][0] and not settles[1]


# --- identity --------------------------------------------------------------------------------------------------------


def fitted_to(*sources: Source) -> Subject:
    return dataclasses.replace(SUBJECT, provenance={"fitted": [{"bag": "x"} | one.to_dict() for one in sources]})


def test_a_part_keeps_its_role(bag: Path, tmp_path: Path) -> None:
    source = source_of(f"{bag}@6..20")
    subject = fitted_to(source)
    assert role_of(subject, source) == "fitted"
    assert role_of(subject, source_of(f"{bag}@19..25")) == "fitted" == role_of(subject, source_of(bag))
    assert role_of(subject, source_of(f"{bag}@20..25")) is None
    copied = tmp_path / "other.mcap"
    copied.write_bytes(bag.read_bytes())
    assert role_of(subject, source_of(f"{copied}@7..8")) == "fitted"


def test_a_source_survives_its_file() -> None:
    for source in (Source("a"), Source("a", 1.0, 2.0), Source("a", 3.0)):
        assert Source.of_dict(source.to_dict()) == source
    assert Source.of_dict({"sha256": 1}) is None and Source.of_dict({"sha256": "a", "end_s": "x"}) is None
    assert Source("a").to_dict() == {"sha256": "a"}


def test_recordings_of_an_effect_stay_unless_they_overlap() -> None:
    subject = dataclasses.replace(fitted_to(Source("a", 0.0, 5.0), Source("b")), effects=("any",))
    kept = effect_recordings(subject, [Source("a", 4.0, 9.0)])
    assert [each["sha256"] for each in kept] == ["b"]
    assert len(effect_recordings(subject, [Source("a", 5.0, 9.0)])) == 2


def test_parts_with_time_in_common_are_given_once(bag: Path) -> None:
    check_bags([f"{bag}@0..5", f"{bag}@5..9"], [], ())
    with pytest.raises(InputError, match=r"@4\.\.9: overlaps .*@0\.\.5: give each part once"):
        check_bags([f"{bag}@0..5"], [f"{bag}@4..9"], ())


def test_a_part_has_the_case_of_its_bag_or_its_own() -> None:
    assert case_of("rail_2.mcap@3..4") == "rail" and case_of(BagPart(Path("rail.mcap"), case="kerb")) == "kerb"
