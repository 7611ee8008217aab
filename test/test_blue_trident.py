"""Import of Blue Trident exports: every number of the bag from a motion that is known, real exports, broken ones."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from listed import assert_listed
from streams import info, subject
from trident import (
    LOW_HZ,
    RAIL,
    TAKE,
    UNIX_US,
    Floats,
    G,
    Motion,
    Wide,
    capture_u_files,
    high_g,
    imported,
    low_g,
    nexus_text,
    samples,
    shock,
    still,
    write_capture_u,
)

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.conditioner import ConditioningSettings
from biodyn_core.conditioning.dual_range import DualRangeSettings
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.topics import INPUT
from biodyn_ros.blue_trident import ImportOptions, document_of, import_blue_trident, rows, text_of
from biodyn_ros.blue_trident import high_g as high_g_module
from biodyn_ros.blue_trident.nexus import parse_start
from biodyn_ros.reading.recordings import read_recordings
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.replay.replaying import ReplayOptions, replay

SERIALS = {name: f"TS-0237{number}" for number, name in enumerate(SENSORS)}


def messages(bag: Path, sensor: str) -> list[Any]:
    """The same messages through rosbags, which knows nothing of ours."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with open_bag(bag) as reader:
        raw = [data for block in reader.blocks([INPUT[sensor]]) for data in block.messages()]
    return [store.deserialize_cdr(data, IMU_TYPE) for data in raw]


# --- Capture.U --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, Any]]:
    """Six sensors that start one after the other, a shock of 60 g, and their bag."""
    place = tmp_path_factory.mktemp("drive")
    for number, serial in enumerate(SERIALS.values()):
        wide = Wide(bias=(4.0 - number, -7.0 + number, 9.0), gain=1.03, delay_s=0.0031)
        capture_u_files(place / "csv", serial, shock((3.0,)), 5.0, wide, starts_s=0.07 * number, seed=number)
    (place / "csv/notes.txt").write_text("a windy day")
    bag = place / "drive.mcap"
    return place / "csv", bag, imported(place / "csv", bag, SERIALS)


def test_six_sensors_become_six_topics(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, bag, document = drive
    with open_bag(bag) as reader:
        assert {topic.name: topic.type for topic in reader.topics} == dict.fromkeys(INPUT.values(), IMU_TYPE)
        assert not reader.recovered and not reader.warnings
    assert list(document["sensors"]) == list(SENSORS) and document["missing"] == []
    for number, (name, row) in enumerate(document["sensors"].items()):
        assert row["serial"] == SERIALS[name] and row["samples"] == 5625 and row["gaps"] == 0
        assert row["rate_hz"] == pytest.approx(LOW_HZ, rel=1e-5)
        assert row["first_ns"] == 1000 * (UNIX_US + 70_000 * number)
        assert sum(row["left_out"].values()) == 0


def test_stamps_are_unix_time_and_units_are_si(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, bag, _ = drive
    for number, name in enumerate(("seat", "pelvis")):
        t = 0.07 * number + np.arange(5625) / LOW_HZ
        stamps, accel, gyro = samples(bag, name)
        assert np.array_equal(stamps, 1000 * (UNIX_US + np.rint(1e6 * t).astype(np.int64)))
        expected = np.column_stack([np.sin(t), 0.5 * np.cos(t), 0.1 * t])
        assert np.abs(gyro - expected).max() < 1e-7
        quiet = np.abs(t - 3.0) > 0.05
        written = low_g(shock((3.0,)), t, np.random.default_rng(number))
        assert np.abs(accel - written)[quiet].max() < 1e-6


def test_covariances_mark_known_and_unknown_quantities(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, bag, document = drive
    found = messages(bag, "head")
    assert {message.header.frame_id for message in found} == {"head"}
    assert all(message.orientation_covariance[0] == -1.0 for message in found)
    assert all((message.angular_velocity_covariance == 0.0).all() for message in found)
    variance = np.array([message.linear_acceleration_covariance.reshape(3, 3) for message in found])
    marked = np.flatnonzero(variance[:, 2, 2] > 0.0)
    t = 0.35 + np.arange(5625) / LOW_HZ
    truth = shock((3.0,))(t)
    assert set(np.flatnonzero(np.abs(truth[:, 2]) > RAIL + 1.0)) <= set(marked)
    assert marked.size == document["sensors"]["head"]["from_high_g"] < 30
    assert np.abs(t[marked] - 3.0055).max() < 0.013
    # The other axes never came near their rail.
    variance[:, 2, 2] = 0.0
    assert not variance.any()


def test_a_clipped_shock_is_recovered_from_high_g(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, bag, document = drive
    for number, name in enumerate(SENSORS):
        t = 0.07 * number + np.arange(5625) / LOW_HZ
        _, accel, _ = samples(bag, name)
        truth = shock((3.0,))(t)
        near = np.abs(t - 3.0055) < 0.02
        assert accel[near, 2].max() == pytest.approx(truth[near, 2].max(), rel=0.02)
        assert (accel - truth)[near, 2].sum() == pytest.approx(0.0, abs=0.02 * truth[near, 2].sum())
        high = document["sensors"][name]["high_g"]
        assert high["taken_over"] == 1 and high["left"] == 0
        assert high["gain"][2] == pytest.approx(1.03, abs=0.015) and high["delay_s"] == pytest.approx(
            0.0031, abs=0.0004
        )
        assert high["bias_mps2"] == pytest.approx([4.0 - number, -7.0 + number, 9.0], abs=0.2)


def calm(peak_g: float = 60.0) -> Motion:
    """A shock in a ride of a tenth of the usual motion: too little for a gain or a delay."""

    def force(t: Floats) -> Floats:
        gravity = np.array([0.0, 0.0, G])
        return shock((3.0,), peak_g)(t) - 0.9 * (shock((3.0,), 0.0)(t) - gravity)

    return force


@pytest.mark.parametrize("wide", [Wide(gain=0.9), Wide(gain=1.1), Wide(delay_s=0.002), Wide(delay_s=-0.002)])
def test_an_undetermined_gain_or_delay_is_noted_and_in_the_variance(tmp_path: Path, wide: Wide) -> None:
    capture_u_files(tmp_path / "csv", "TS-1", calm(), 9.0, wide)
    outcome = import_blue_trident(tmp_path / "csv", tmp_path / "b.mcap", ImportOptions({"seat": "TS-1"}))
    document = document_of(outcome)
    note = (
        "seat (TS-1): the motion does not determine high-g gain of z (1 within 10 % assumed) and delay (0 within 2 ms"
        " assumed): the covariance contains these errors"
    )
    assert note in document["warnings"]
    assert f"note: {note}" in text_of(outcome) and "gain 1 (assumed), 1 (assumed), 1 (assumed)" in text_of(outcome)
    high = document["sensors"]["seat"]["high_g"]
    assert high["gain_determined"] == [False] * 3 and high["gain_error"] == [0.1] * 3
    assert high["delay_determined"] is False and high["delay_error_s"] == 0.002
    stamps, accel, _ = samples(tmp_path / "b.mcap", "seat")
    truth = calm()(1e-9 * (stamps - 1000 * UNIX_US))
    variance = np.array(
        [message.linear_acceleration_covariance[8] for message in messages(tmp_path / "b.mcap", "seat")]
    )
    clipped = np.abs(truth[:, 2]) > RAIL
    error = np.abs(accel - truth)[clipped, 2]
    assert error.max() > 50.0 and (error < 2.0 * np.sqrt(variance[clipped])).all()


def test_a_determined_gain_and_delay_have_no_note(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, _, document = drive
    assert not any("does not determine" in line for line in document["warnings"])
    for row in document["sensors"].values():
        assert row["high_g"]["gain_determined"][2] and row["high_g"]["delay_determined"]
        assert row["high_g"]["gain_error"][2] < 0.01 and row["high_g"]["delay_error_s"] < 0.0002


def test_files_md_lists_the_document(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    assert_listed("import-blue-trident", drive[2])


def test_the_bag_has_its_provenance(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    place, bag, document = drive
    with open_bag(bag) as reader:
        about, marks = reader.metadata("biodyn"), reader.metadata("biodyn_from_high_g")
    assert about["made_by"] == "biodyn import-blue-trident" and about["format"] == "Capture.U" and about["take"] == TAKE
    files = {Path(row["path"]).name: row for row in json.loads(about["files"])}
    assert len(files) == 12
    for name, row in files.items():
        assert row["sha256"] == hashlib.sha256((place / name).read_bytes()).hexdigest()
    low = files[f"anna_{SERIALS['neck']}_{TAKE}_lowg.csv"]
    assert low["holds"] == [{"serial": SERIALS["neck"], "channel": "low", "accel_unit": "m/s/s", "gyro_unit": "deg/s"}]
    assert json.loads(about["sensors"]) == document["sensors"]
    ((first, last, axes),) = json.loads(marks["seat"])
    assert axes == "z" and 0 < last - first < 30_000_000
    assert first <= 1000 * UNIX_US + 3_005_500_000 <= last


def test_unread_files_are_named(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, _, document = drive
    aside = "\n".join(document["aside"])
    assert aside.count("magnetometer") == 6 and "notes.txt" in aside


def test_the_text_names_sensors_and_unread_files(tmp_path: Path) -> None:
    capture_u_files(tmp_path / "csv", SERIALS["seat"], shock((3.0,)), 2.0, None)
    (tmp_path / "csv/notes.txt").write_text("a windy day")
    how = ImportOptions({"seat": SERIALS["seat"]})
    text = text_of(import_blue_trident(tmp_path / "csv", tmp_path / "b.mcap", how))
    assert "notes.txt" in text and SERIALS["seat"] in text


def test_samples_from_high_g_do_not_count_as_clipped(drive: tuple[Path, Path, dict[str, Any]]) -> None:
    _, bag, _ = drive
    document = info(bag)
    assert [row["clipped"] for row in document["topics"]] == [0] * 6
    assert any(line.startswith("seat: counts as clipped from 1952") for line in document["warnings"])
    replayed = replay(bag, subject()).document
    assert replayed["sensors"]["seat"]["clipped_samples"] == 0 and not replayed["sensors"]["seat"]["lower_bound"]
    assert replayed["sensors"]["seat"]["peak_mps2"] > 1.4 * RAIL
    (recording,) = read_recordings(bag, "rail")
    assert not any("clipped, masked" in line for line in recording.warnings)
    # Whoever gives a limit is heard.
    strict = info(bag, ReadingOptions(conditioning=ConditioningSettings(saturation_mps2=150.0)))
    assert min(row["clipped"] for row in strict["topics"]) > 5


@pytest.mark.parametrize(
    ("stored_limit", "clipped"),
    [
        ('{"imu/seat/data": 400.0}', 0),
        ('{"imu/head/data": 400.0}', 3),
        ('{"imu/seat/data": 1e9}', 3),
        ('{"imu/seat/data": NaN}', 3),
        ('{"imu/seat/data": true}', 3),
        ('{"imu/seat/data": "400"}', 3),
        ("[400.0]", 3),
        ("[" * 5000, 3),
        ("400", 3),
        ("", 3),
    ],
)
def test_a_valid_limit_of_a_bag_is_applied(stored_limit: str, clipped: int, tmp_path: Path) -> None:
    stamps = 10**9 + np.arange(2000) * 1_000_000
    accel = np.tile([0.0, 0.0, G], (2000, 1))
    accel[1500:1503, 2] = 200.0
    with BagWriter(tmp_path / "b.mcap") as writer:
        writer.add_topic(INPUT["seat"], IMU_TYPE)
        writer.write(INPUT["seat"], stamps, encode_imu(stamps, accel, None, "seat"))
        writer.add_metadata("biodyn", {"saturation_mps2": stored_limit})
    assert info(tmp_path / "b.mcap")["topics"][0]["clipped"] == clipped
    # With the topic mapped to another sensor, the limit of the bag applies to that sensor.
    renamed = ReadingOptions({"head": INPUT["seat"]})
    assert info(tmp_path / "b.mcap", renamed)["topics"][0]["clipped"] == clipped


def test_without_high_g_the_shock_stays_clipped(drive: tuple[Path, Path, dict[str, Any]], tmp_path: Path) -> None:
    place, _, _ = drive
    bag = tmp_path / "clipped.mcap"
    document = imported(place, bag, {"seat": SERIALS["seat"]}, high_g=False)
    t = np.arange(5625) / LOW_HZ
    expected = int((np.abs(low_g(shock((3.0,)), t, np.random.default_rng(0))) >= 156.8).any(axis=1).sum())
    assert document["sensors"]["seat"]["clipped"] == expected > 5
    assert info(bag)["topics"][0]["clipped"] == expected
    replayed = replay(bag, subject(), ReplayOptions()).document
    assert replayed["sensors"]["seat"]["clipped_samples"] == expected and replayed["sensors"]["seat"]["lower_bound"]
    assert any("high-g is switched off" in line for line in document["warnings"])


def test_only_the_sensor_without_high_g_is_flagged(tmp_path: Path) -> None:
    for name, wide in (("seat", Wide()), ("head", None)):
        capture_u_files(tmp_path / "csv", SERIALS[name], shock((3.0,)), wide=wide, seed=3)
    bag = tmp_path / "two.mcap"
    document = imported(tmp_path / "csv", bag, {name: SERIALS[name] for name in ("seat", "head")})
    assert document["sensors"]["seat"]["clipped"] == 0 < document["sensors"]["head"]["clipped"]
    clipped = {row["sensor"]: row["clipped"] for row in info(bag)["topics"]}
    assert clipped == {"seat": 0, "head": document["sensors"]["head"]["clipped"]}
    assert any("no high-g file of this sensor" in line for line in document["warnings"])


def test_a_shock_missing_from_high_g_leaves_its_sensor_clipped(tmp_path: Path) -> None:
    """One of two shocks lies in a loss of high-g: the sensor has the default limit, so that both shocks count."""
    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], shock((3.0, 4.5)), seed=4)
    high = low.with_name(low.name.replace("lowg", "highg"))
    lines = high.read_text().splitlines()
    lost = [line for line in lines[1:] if not 4.49 < (int(line.split(",")[0]) - UNIX_US) * 1e-6 < 4.52]
    high.write_text("\n".join([lines[0], *lost, ""]))
    bag = tmp_path / "one.mcap"
    document = imported(tmp_path / "csv", bag, {"seat": SERIALS["seat"]})
    row = document["sensors"]["seat"]
    assert row["high_g"]["taken_over"] == 1 == row["high_g"]["left"] and row["clipped"] > 5 and row["from_high_g"] > 5
    assert info(bag)["topics"][0]["clipped"] > row["clipped"]
    assert any("counts the high-g samples as clipped too" in line for line in document["warnings"])


def test_a_span_beside_a_replaced_one_stays_clipped(tmp_path: Path) -> None:
    """Two peaks 6 samples apart, and high-g is lost behind the second: its span lies where the first one fades."""

    def force(t: Floats) -> Floats:
        out = shock((99.0,))(t)
        for at_s, peak_mps2 in ((6.0, 300.0), (6.0 + 6 / LOW_HZ, 400.0)):
            out[:, 2] += peak_mps2 * np.exp(-0.5 * ((t - at_s) / 0.00085) ** 2)
        return out

    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], force, 8.0)
    high = low.with_name(low.name.replace("lowg", "highg"))
    lines = high.read_text().splitlines()
    kept = [line for line in lines[1:] if not 6.0178 < (int(line.split(",")[0]) - UNIX_US) * 1e-6 < 6.18]
    high.write_text("\n".join([lines[0], *kept, ""]))
    bag = tmp_path / "one.mcap"
    row = imported(tmp_path / "csv", bag, {"seat": SERIALS["seat"]})["sensors"]["seat"]
    assert row["high_g"]["taken_over"] == 1 == row["high_g"]["left"] and row["clipped"] == 3
    with open_bag(bag) as reader:
        assert "saturation_mps2" not in reader.metadata("biodyn")
    accel = samples(bag, "seat")[1][6750:, 2]
    assert (np.abs(accel[5:8] - RAIL) < 0.1).all() and accel[:3].max() > 280.0


@pytest.mark.parametrize(("ahead_us", "size"), [(1_000_000_000, 1 << 22), (1_000_000_000, 73), (-100_000, 1 << 22)])
def test_a_wrong_stamp_hides_no_later_shock_from_high_g(
    ahead_us: int, size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One row of low-g between two shocks, also as the last one of a block."""
    monkeypatch.setattr(rows, "BLOCK_BYTES", size * 100)
    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], shock((1.6, 7.0)), 8.0)
    lines = low.read_text().splitlines()
    stamp, _, others = lines[4500].partition(",")
    lines[4500] = f"{int(stamp) + ahead_us},{others}"
    low.write_text("\n".join([*lines, ""]))
    row = imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": SERIALS["seat"]})["sensors"]["seat"]
    assert row["high_g"]["taken_over"] == 2 and row["clipped"] == 0


def test_a_group_of_shocks_is_not_cut_within_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A group may last 2 s: the second shock begins before, along z, and hits x after."""
    monkeypatch.setattr(high_g_module, "GROUP_S", 2.0)
    along_z, along_x = shock((3.0, 4.998)), shock((5.002,), axis=0)
    rest = shock((99.0,))
    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], lambda t: along_z(t) + along_x(t) - rest(t), 7.0)
    row = imported(low.parent, tmp_path / "b.mcap", {"seat": SERIALS["seat"]})["sensors"]["seat"]
    assert row["high_g"]["taken_over"] == 3 and row["clipped"] == 0


@pytest.mark.parametrize(("at_s", "replaced"), [((3.0,), 1), ((99.0,), 0)])
def test_a_reading_that_is_stuck_at_the_end_of_the_range_has_its_own_reason(
    at_s: tuple[float, ...], replaced: int, tmp_path: Path
) -> None:
    def stuck(t: Floats) -> Floats:
        return np.where(((t > 4.5) & (t < 6.0))[:, None], [0.0, 0.0, 400.0], shock(at_s)(t))

    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], stuck, 7.0)
    document = imported(low.parent, tmp_path / "b.mcap", {"seat": SERIALS["seat"]})
    assert document["sensors"]["seat"]["high_g"]["taken_over"] == replaced
    reason = "remain clipped: at the end of the range for over 1 s at a time, a fault that high-g does not replace"
    assert any(line.endswith(reason) for line in document["warnings"])


def test_high_g_of_another_motion_is_not_used(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], shock((3.0,)), seed=5)
    t = 0.0137 + np.arange(9000) / 1600.0
    other = high_g(shock((9.0,)), t, Wide(), np.random.default_rng(1))
    write_capture_u(low.with_name(low.name.replace("lowg", "highg")), t, other)
    document = imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": SERIALS["seat"]})
    row = document["sensors"]["seat"]
    assert row["from_high_g"] == 0 < row["clipped"] and row["high_g"]["left"] == 1
    assert any("inconsistent there" in line for line in document["warnings"])


def test_any_cut_into_blocks_gives_the_same_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    both = ("seat", "head")
    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], shock((1.3,)), 2.0)
    capture_u_files(tmp_path / "csv", SERIALS["head"], shock((1.3,)), 2.0, starts_s=0.2, seed=2)
    spoilt = low.read_text().splitlines()
    spoilt[700], spoilt[900] = "1,2,3", spoilt[900].replace(",", ",x", 1)
    low.write_text("\n".join(spoilt) + "\n")
    found = []
    for size in (1 << 22, 1 << 14, 2999):
        monkeypatch.setattr(rows, "BLOCK_BYTES", size)
        bag = tmp_path / f"{size}.mcap"
        document = imported(tmp_path / "csv", bag, {name: SERIALS[name] for name in both})
        assert [row["ragged_rows"] for row in document["files"] if row["path"] == str(low)] == [1]
        with open_bag(bag) as reader:
            raw = [[data for block in reader.blocks([INPUT[name]]) for data in block.messages()] for name in both]
        found.append((raw, document["sensors"]))
    assert found[0] == found[1] == found[2]
    assert found[0][1]["seat"]["samples"] == 2249 and found[0][1]["seat"]["from_high_g"] > 5


def test_an_incomplete_file_is_read_up_to_its_last_complete_row(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", SERIALS["seat"], shock((9.0,)), 2.0, None)
    whole = low.read_bytes()
    cut = whole[: whole.rindex(b",") + 3]
    low.write_bytes(cut)

    def grow(done: int, total: int) -> None:
        low.write_bytes(whole)

    how = ImportOptions({"seat": SERIALS["seat"]})
    document = document_of(import_blue_trident(tmp_path / "csv", tmp_path / "b.mcap", how, grow))
    assert document["sensors"]["seat"]["samples"] == 2249
    (file,) = document["files"]
    assert file["cut"] and file["bytes"] == len(cut) and file["sha256"] == hashlib.sha256(cut).hexdigest()
    assert any("the last line is incomplete" in line for line in document["warnings"])


# --- Nexus ------------------------------------------------------------------------------------------------------------

_VARIANTS: dict[str, tuple[dict[str, Any], str, bytes]] = {
    "as Nexus writes it": ({}, "utf-8", b"\xef\xbb\xbf"),
    "without a mark": ({"top": "\n"}, "utf-8", b""),
    "without blank lines": ({"top": ""}, "utf-8", b"\xef\xbb\xbf"),
    "saved again by Excel": ({"top": "", "trailing": ",,,,"}, "utf-8", b"\xef\xbb\xbf"),
    "in a code page": ({"top": ""}, "latin-1", b""),
    "with Unix lines": ({"end": "\n"}, "utf-8", b""),
    "in m/s^2": ({"units": ("m/s^2", "deg/s")}, "utf-8", b""),
    "a rate with decimals": ({"rate": "250.0"}, "utf-8", b""),
}


@pytest.mark.parametrize("variant", _VARIANTS)
def test_every_layout_of_nexus_gives_the_same_messages(variant: str, tmp_path: Path) -> None:
    how, encoding, mark = _VARIANTS[variant]
    one, other = still(400), still(400, (G, 0.0, 0.0), seed=2)
    file = tmp_path / "Trial 01.csv"
    file.write_bytes(mark + nexus_text({"TS-01874": one, "TS-01902": other}, **how).encode(encoding))
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874", "head": "TS-01902"})
    for name, truth in (("seat", one), ("head", other)):
        stamps, accel, gyro = samples(tmp_path / "b.mcap", name)
        # Nexus counts frames from 1, here of five samples each.
        assert np.array_equal(stamps, 4_000_000 * np.arange(5, 405))
        assert np.abs(accel - truth[:, :3]).max() < 1e-4 and np.abs(gyro - np.deg2rad(truth[:, 3:6])).max() < 1e-6
        assert document["sensors"][name]["rate_hz"] == pytest.approx(250.0)
    assert document["format"] == "Nexus" and document["take"] == "Trial 01"
    assert any("no time of day" in line for line in document["warnings"])


def test_rows_padded_by_excel_and_blank_rows_are_read(tmp_path: Path) -> None:
    text = nexus_text({"TS-01874": still(60)}).split("\r\n")
    longer = [line + ",,," if number > 6 and line else line for number, line in enumerate(text)]
    longer.insert(30, ",,,")
    file = tmp_path / "t.csv"
    file.write_text("\r\n".join(longer))
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874"})
    assert document["sensors"]["seat"]["samples"] == 60 and document["files"][0]["ragged_rows"] == 0


def test_a_start_sets_the_first_row_s_time(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_text(nexus_text({"TS-01874": still(60)}, first_frame=300))
    start_ns = parse_start("2026-05-12T10:32:00.25+02:00")
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874"}, start_ns=start_ns)
    stamps, _, _ = samples(tmp_path / "b.mcap", "seat")
    assert np.array_equal(stamps, 1_778_574_720_250_000_000 + 4_000_000 * np.arange(60))
    assert "2026-05-12T08:32:00.25" in document["start"]
    imported(file, tmp_path / "c.mcap", {"seat": "TS-01874"})
    assert samples(tmp_path / "c.mcap", "seat")[0][0] == 300 * 5 * 4_000_000


def test_zeros_are_dropped_or_left_as_gaps_and_counted(tmp_path: Path) -> None:
    values = still(500)
    values[:40] = values[200:230] = values[460:] = 0.0
    # The resampler changes the adjacent rows.
    values[40], values[199], values[459] = 0.4 * values[40], 0.9 * values[199], 0.5 * values[459]
    file = tmp_path / "t.csv"
    file.write_text(nexus_text({"TS-01902": values, "TS-01874": still(500, seed=2)}))
    document = imported(file, tmp_path / "b.mcap", {"head": "TS-01902", "seat": "TS-01874"})
    row = document["sensors"]["head"]
    assert row["left_out"] == {"late_start": 40, "dropouts": 30, "early_end": 40, "faded": 3, "unreadable": 0}
    assert row["samples"] == 500 - 113 and row["gaps"] == 1
    stamps, accel, _ = samples(tmp_path / "b.mcap", "head")
    kept = np.r_[41:199, 230:459]
    assert np.array_equal(stamps, 4_000_000 * (kept + 5)) and np.abs(accel[:, 2] - G).max() < 0.2
    assert document["sensors"]["seat"]["samples"] == 500
    warnings = " ".join(document["warnings"])
    for expected in ("40 of zeros before it started", "30 of zeros during", "3 mixed with zeros by Nexus"):
        assert expected in warnings


def test_a_sensor_of_zeros_alone_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_text(nexus_text({"TS-01902": np.zeros((50, 15)), "TS-01874": still(50)}))
    with pytest.raises(InputError, match=r"TS-01902 \(head\) has no sample: remove it from the mapping"):
        imported(file, tmp_path / "b.mcap", {"seat": "TS-01874", "head": "TS-01902"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.csv"]


def test_a_shock_in_nexus_is_taken_over_without_a_filter(tmp_path: Path) -> None:
    t = np.arange(3000) / 250.0
    truth = shock((6.0,), 40.0, 0.04)(t)
    values = still(3000)
    values[:, :3] = np.clip(truth, -RAIL, RAIL)
    values[:, 12:] = truth + [1.0, 2.0, 9.0] + 0.3 * np.random.default_rng(1).standard_normal((3000, 3))
    file = tmp_path / "t.csv"
    file.write_text(nexus_text({"TS-01874": values}))
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874"})
    _, accel, _ = samples(tmp_path / "b.mcap", "seat")
    assert np.abs(accel - truth).max() < 2.5 and document["sensors"]["seat"]["clipped"] == 0
    assert document["sensors"]["seat"]["high_g"]["bias_mps2"] == pytest.approx([1.0, 2.0, 9.0], abs=0.3)


def test_a_rail_below_the_limit_is_reported_and_a_given_one_is_stored_in_the_bag(tmp_path: Path) -> None:
    values = still(1500)
    values[1200:1210, 2] = 153.25
    file = tmp_path / "t.csv"
    file.write_text(nexus_text({"TS-01874": values}))
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874"})
    assert any("153.25 m/s^2, repeats as in saturation" in line for line in document["warnings"])
    assert info(tmp_path / "b.mcap")["topics"][0]["clipped"] == 0
    settings = DualRangeSettings(saturation_mps2=153.2)
    document = imported(file, tmp_path / "c.mcap", {"seat": "TS-01874"}, settings=settings, high_g=False)
    assert document["sensors"]["seat"]["clipped"] == 10 == info(tmp_path / "c.mcap")["topics"][0]["clipped"]


def test_a_sensor_without_gyro_is_marked_in_every_message(tmp_path: Path) -> None:
    lines = nexus_text({"TS-01874": still(60)}).split("\r\n")
    lines = [line.replace("TS-01874 - gyro", "Force") for line in lines]
    file = tmp_path / "t.csv"
    file.write_text("\r\n".join(lines))
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874"})
    assert all(message.angular_velocity_covariance[0] == -1.0 for message in messages(tmp_path / "b.mcap", "seat"))
    assert any("no gyro" in line for line in document["warnings"])


def test_the_next_section_ends_the_list_of_devices(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_text(
        nexus_text({"TS-01874": still(60)}) + "\r\nTrajectories\r\n100\r\nFrame,Sub Frame\r\n1,0\r\n2,0\r\n"
    )
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874"})
    assert document["sensors"]["seat"]["samples"] == 60 and document["files"][0]["ragged_rows"] == 0
    assert any(line.startswith("t.csv: what follows Trajectories in line ") for line in document["warnings"])


@pytest.mark.parametrize("start_ns", [None, 10**18])
def test_a_damaged_sub_frame_changes_no_other_stamp(start_ns: int | None, tmp_path: Path) -> None:
    text, file = nexus_text({"TS-1": still(200)}), tmp_path / "t.csv"
    file.write_text(text)
    imported(file, tmp_path / "whole.mcap", {"seat": "TS-1"}, start_ns=start_ns)
    file.write_text(text.replace("\r\n1,0,", "\r\n1,7,").replace("\r\n11,3,", "\r\n11,93,"))
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-1"}, start_ns=start_ns)
    whole, stamps = (samples(tmp_path / name, "seat")[0] for name in ("whole.mcap", "b.mcap"))
    expected = np.delete(whole, [0, 53])
    assert np.array_equal(np.diff(stamps), np.diff(expected)) and document["files"][0]["untimed_rows"] == 2
    assert start_ns is not None or np.array_equal(stamps, expected)
