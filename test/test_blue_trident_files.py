"""Import of files: refusals in one line, damage, the command, and real exports of Nexus."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from streams import info, subject
from trident import TAKE, G, capture_u_files, imported, nexus_text, samples, shock, still, write_capture_u

from biodyn_core.base.errors import MAX_CHARACTERS, InputError
from biodyn_core.conditioning.conditioner import ConditioningSettings
from biodyn_core.conditioning.dual_range import DualRangeSettings, Stretch
from biodyn_core.conditioning.range_alignment import align, bias, levels
from biodyn_ros.bag import open_bag
from biodyn_ros.base.topics import INPUT
from biodyn_ros.blue_trident import rows
from biodyn_ros.blue_trident.rows import _is_even
from biodyn_ros.commands.cli import main
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.replay.replaying import ReplayOptions, replay

Floats = NDArray[np.float64]


def place_of(directory: Path) -> Path:
    """Two sensors of Capture.U, one of them in two takes, and a file of Nexus."""
    for serial, take in (("TS-00001", TAKE), ("TS-00002", TAKE), ("TS-00002", "2021-06-01")):
        capture_u_files(directory, serial, shock((9.0,)), 0.5, None, take=take)
    (directory / "trial.csv").write_text(nexus_text({"TS-01874": still(60)}))
    return directory


# --- what is chosen ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mapping", "take", "wanted"),
    [
        ({}, None, "no sensor is mapped; serials: TS-00001, TS-00002, TS-01874: use --map seat=TS-00001"),
        ({"seat": "TS-9"}, None, "--map seat=TS-9: no such serial; serials: TS-00001, TS-00002, TS-01874"),
        ({"seat": "1847"}, None, "TS-01874; did you mean 1874?"),
        ({"seat": "2"}, "1999", "--take 1999: no such take"),
        ({"seat": "TS-00001", "head": "00001"}, None, "--map head=TS-00001: the serial is also mapped to seat"),
        ({"seat": "TS-00002"}, None, f"TS-00002 (seat) has several takes: {TAKE}, 2021-06-01: choose with --take"),
        ({"seat": "TS-00002"}, "1999", f"--take 1999: no such take; takes: {TAKE}, 2021-06-01"),
        ({"seat": "TS-00001"}, "2021-06", f"--take 2021-06: no such take; takes: {TAKE}"),
        ({"seat": "TS-00001", "head": "TS-01874"}, None, "Capture.U and Nexus have different clocks"),
    ],
)
def test_invalid_input_is_refused_in_one_line(
    mapping: dict[str, str], take: str | None, wanted: str, tmp_path: Path
) -> None:
    place = place_of(tmp_path / "csv")
    with pytest.raises(InputError) as message:
        imported(place, tmp_path / "b.mcap", mapping, take=take)
    assert wanted in str(message.value) and "\n" not in str(message.value)
    assert [path.name for path in tmp_path.iterdir()] == ["csv"]


def test_a_unique_end_of_a_serial_is_sufficient(tmp_path: Path) -> None:
    for serial in ("TS-01874", "TS-11875", "TS-21875"):
        capture_u_files(tmp_path / "csv", serial, shock((9.0,)), 0.5, None)
    document = imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "1874", "head": "11875"})
    assert {name: row["serial"] for name, row in document["sensors"].items()} == {
        "seat": "TS-01874",
        "head": "TS-11875",
    }
    with pytest.raises(InputError, match="--map seat=1875: TS-11875, TS-21875 end with it: give a complete serial"):
        imported(tmp_path / "csv", tmp_path / "c.mcap", {"seat": "1875"})
    assert not (tmp_path / "c.mcap").exists()


def test_a_take_is_chosen_by_its_beginning(tmp_path: Path) -> None:
    document = imported(place_of(tmp_path / "csv"), tmp_path / "b.mcap", {"seat": "TS-00002"}, take="2021-06")
    assert document["take"] == "2021-06-01" and document["not_mapped"] == ["TS-00001", "TS-01874"]
    assert "not mapped: pelvis, lower_torso, upper_torso, neck, head" in document["warnings"]


def test_a_bag_without_a_seat_is_written_with_a_warning(tmp_path: Path) -> None:
    document = imported(place_of(tmp_path / "csv"), tmp_path / "b.mcap", {"head": "TS-00001"})
    assert any(line.startswith("seat: not mapped, needed for every prediction") for line in document["warnings"])


def test_recordings_of_different_times_are_refused_for_one_bag(tmp_path: Path) -> None:
    capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 1.0, None)
    capture_u_files(tmp_path / "csv", "TS-2", shock((9.0,)), 1.0, None, starts_s=60.0)
    with pytest.raises(InputError, match=r"seat \(TS-1\) ends 59.0 s before head \(TS-2\) starts"):
        imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1", "head": "TS-2"})


def test_one_channel_in_two_files_is_refused(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 0.5, None)
    low.with_name(f"copy_{low.name}").write_bytes(low.read_bytes())
    with pytest.raises(InputError, match=r"TS-1 \(seat\) has a channel twice: anna_.*, copy_anna_.*: remove one"):
        imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1"})


def test_sensors_of_different_trials_of_nexus_are_not_merged(tmp_path: Path) -> None:
    (tmp_path / "csv").mkdir()
    for number in (1, 2):
        (tmp_path / "csv" / f"trial_{number}.csv").write_text(nexus_text({f"TS-{number}": still(60, seed=number)}))
    with pytest.raises(InputError, match=r"several trials of Nexus: trial_1, trial_2: .*choose one with --take TAKE"):
        imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1", "head": "TS-2"})
    document = imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1"})
    assert document["take"] == "trial_1" and document["sensors"]["seat"]["samples"] == 60


def test_high_g_alone_is_no_recording(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 0.5)
    low.unlink()
    with pytest.raises(InputError, match=r"TS-1 \(seat\) has no low-g file in this take"):
        imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1"})


# --- what is broken ---------------------------------------------------------------------------------------------------

GOOD = nexus_text({"TS-1": still(20)})
BROKEN: dict[str, tuple[bytes, str]] = {
    "UTF-16": (GOOD.encode("utf-16"), "is UTF-16: save it as CSV UTF-8"),
    "NUL": (b"Devices\r\n250\0\r\n", "contains NUL bytes"),
    "empty": (b"", "no export of Capture.U or Nexus"),
    "another table": (b"a,b\n1,2\n", "neither unix_timestamp_microsec nor Devices"),
    "semicolons": (b"Devices;;\n250;;\n;;TS-1 - accel\n", "separated by semicolons"),
    "semicolons of a whole export": (GOOD.replace(",", ";").encode(), "separated by semicolons"),
    "semicolons of Capture.U": (b"unix_timestamp_microsec;time_s;ax_m/s/s\n1;0;9,8\n", "separated by semicolons"),
    "no header": (b"Devices\n250\n", "no line that starts with Frame,Sub Frame between names and units"),
    "no rate": (GOOD.replace("250\r", "fast\r").encode(), "no rate above the names"),
    "an absurd rate": (GOOD.replace("250\r", "1e300\r").encode(), "the rate is 1e300 Hz, allowed: 10 to"),
    "a rate of nan": (GOOD.replace("250\r", "nan\r").encode(), "the rate is nan"),
    "an unknown unit": (GOOD.replace("mm/s²", "furlong").encode(), "unit 'furlong' is unknown"),
    "two units": (GOOD.replace("mm/s²", "m/s²", 1).encode(), "has the units m/s², mm/s², mm/s²: give one unit"),
    "no sensor": (GOOD.replace("accel", "force").encode(), "no sensor with a channel '"),
    "a sensor twice": (
        nexus_text({"TS-1": still(20), "TS-2": still(20)}).replace("TS-2", "TS-1").encode(),
        "TS-1 - accel is given twice",
    ),
    "a line without end": (GOOD.encode() + b"1," * (3 << 20), "a line has more than 4 MiB"),
    "columns without end": (GOOD.replace("Frame", "," * 10**6 + "Frame").encode(), "no line that starts with Frame"),
    "a million cells": (GOOD.encode() + b"9," * 10**6 + b"\n", ""),
    "all rows ragged": (re.sub(r"(?m)^\d+,\d,", "", GOOD).encode(), "has no sample"),
    "numbers beyond bounds": (nexus_text({"TS-1": 1e300 * (1.0 + still(20))}).encode(), "has no sample"),
    "frames beyond bounds": (nexus_text({"TS-1": still(20)}, first_frame=10**15).encode(), "has no sample"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_line_and_leaves_no_bag(name: str, tmp_path: Path) -> None:
    data, wanted = BROKEN[name]
    file = tmp_path / "t.csv"
    file.write_bytes(data)
    if not wanted:
        document = imported(file, tmp_path / "b.mcap", {"seat": "TS-1"})
        assert document["sensors"]["seat"]["samples"] == 20 and document["files"][0]["ragged_rows"] == 1
        return
    with pytest.raises(InputError) as message:
        imported(file, tmp_path / "b.mcap", {"seat": "TS-1"})
    assert wanted in str(message.value) and "\n" not in str(message.value) and len(str(message.value)) <= MAX_CHARACTERS
    assert [path.name for path in tmp_path.iterdir()] == ["t.csv"]


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("ax_m/s/s", "ax_furlong", "have several units: ['furlong', 'm/s/s']"),
        ("az_m/s/s", "z", "no column az among unix_timestamp_microsec, time_s"),
        ("m/s/s", "yd", "unit 'yd' is unknown; known units: m/s/s"),
        ("deg/s", "rpm", "unit 'rpm' is unknown; known units: deg/s"),
    ],
)
def test_an_unknown_header_of_capture_u_is_refused(old: str, new: str, wanted: str, tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", "TS-1", shock(), 0.5, None)
    low.write_text(low.read_text().replace(old, new))
    with pytest.raises(InputError) as message:
        imported(low, tmp_path / "b.mcap", {"seat": "TS-1"})
    assert wanted in str(message.value)
    with pytest.raises(InputError, match=r"no export of Capture.U or Nexus; .*lowg.csv"):
        imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1"})


def test_other_columns_and_units_of_capture_u_are_understood(tmp_path: Path) -> None:
    t, up = np.arange(200) / 500.0, np.linspace(0.9, 1.1, 200)
    values = np.column_stack([np.zeros(200), np.zeros(200), up, np.full(200, 30.0)])
    low = write_capture_u(tmp_path / "a_TS-1_x_LOWG.csv", t, values, "ax_g,ay_g,az_g,temperature")
    row = imported(low, tmp_path / "b.mcap", {"seat": "TS-1"})["sensors"]["seat"]
    assert row["gyro"] is False and row["rate_hz"] == pytest.approx(500.0)
    assert samples(tmp_path / "b.mcap", "seat")[1][:, 2] == pytest.approx(up * G, abs=1e-5)


@pytest.mark.parametrize("old", [".", ",0."])
def test_rows_with_more_cells_than_names_are_not_read_shifted(old: str, tmp_path: Path) -> None:
    """Decimal commas, and a cell too many in each row."""
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 0.5, None)
    names, _, numbers = low.read_text().partition("\n")
    low.write_text(f"{names}\n{numbers.replace(old, old.replace('.', ',') + '1')}")
    with pytest.raises(InputError, match="has no sample: its rows have a wrong number of cells: export with decimal"):
        imported(low, tmp_path / "b.mcap", {"seat": "TS-1"})


def test_a_line_of_words_is_one_damaged_row_of_capture_u(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 2.0, None)
    lines = low.read_text().splitlines()
    low.write_text("\n".join([*lines[:500], "nan", *lines[500:], ""]))
    document = imported(low, tmp_path / "b.mcap", {"seat": "TS-1"})
    assert document["sensors"]["seat"]["samples"] == 2250 and document["files"][0]["ragged_rows"] == 1


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_empty_cells_beyond_the_names_are_read_fast(end: str) -> None:
    even = "1,2,,," + end + "3,4,,," + end
    assert _is_even(even.encode(), 2) and _is_even(even.encode(), 5)
    assert not _is_even(even.replace("4,,", "4,,5").encode(), 2)


def test_impossible_stamps_are_left_out(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 0.5, None)
    lines = low.read_text().splitlines()
    for at, stamp in ((5, "nan"), (6, "-5"), (7, "1e300"), (8, ""), (9, "99999999999999999999")):
        lines[at] = stamp + "," + lines[at].partition(",")[2]
    low.write_text("\n".join([*lines, ""]))
    row = imported(low, tmp_path / "b.mcap", {"seat": "TS-1"})["sensors"]["seat"]
    assert row["samples"] == 562 - 5 and row["gaps"] == 1


def test_stamps_truncated_by_excel_are_refused(tmp_path: Path) -> None:
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 0.5, None)
    lines = low.read_text().splitlines()
    short = [f"{float(line.partition(',')[0]):.5E},{line.partition(',')[2]}" for line in lines[1:]]
    low.write_text("\n".join([lines[0], *short, ""]))
    with pytest.raises(InputError, match="stamps do not increase: Excel rounds them"):
        imported(low, tmp_path / "b.mcap", {"seat": "TS-1"})


@pytest.mark.parametrize("size", [1 << 22, 4000])
def test_a_last_stamp_that_is_cut_short_ends_no_recording(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rows, "BLOCK_BYTES", size)
    capture_u_files(tmp_path / "csv", "TS-2", shock((9.0,)), 1.0, None)
    low = capture_u_files(tmp_path / "csv", "TS-1", shock((9.0,)), 1.0, None)
    lines = low.read_text().splitlines()
    lines[-1] = lines[-1][:15] + lines[-1][16:]
    low.write_text("\n".join([*lines, ""]))
    document = imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1", "head": "TS-2"})
    row = document["sensors"]["seat"]
    assert row["samples"] == 1125 and row["gaps"] == 0 and row["seconds"] == pytest.approx(1.0, abs=0.003)
    assert "seat (TS-1): 1 stamp does not increase: written unchanged, rejected by replay" in document["warnings"]


def test_a_damaged_byte_in_a_row_does_not_change_the_units(tmp_path: Path) -> None:
    data = nexus_text({"TS-1": still(60)}).encode().replace(b"\r\n3,1,", b"\r\n3,\xff\0,")
    (tmp_path / "t.csv").write_bytes(data)
    document = imported(tmp_path / "t.csv", tmp_path / "b.mcap", {"seat": "TS-1"})
    assert document["sensors"]["seat"]["samples"] == 59 and document["sensors"]["seat"]["gaps"] == 1


def test_sensors_that_start_far_apart_keep_their_order_in_the_bag(tmp_path: Path) -> None:
    capture_u_files(tmp_path / "csv", "TS-1", shock((99.0,)), 9.0, None)
    capture_u_files(tmp_path / "csv", "TS-2", shock((99.0,)), 3.0, None, starts_s=7.0)
    imported(tmp_path / "csv", tmp_path / "b.mcap", {"seat": "TS-1", "head": "TS-2"})
    with open_bag(tmp_path / "b.mcap") as reader:
        logged = [(block.log_ns[0], block.log_ns[-1]) for block in reader.blocks([INPUT["seat"], INPUT["head"]])]
        assert reader.message_count == 9 * 1125 + 3 * 1125
    begins = np.array([first for first, _ in logged])
    assert (np.diff(begins) > -1_000_000_000).all()


def test_only_damaged_rows_are_dropped(tmp_path: Path) -> None:
    lines = nexus_text({"TS-01874": still(200), "TS-01902": still(200, seed=2)}).split("\r\n")
    at = next(number for number, line in enumerate(lines) if line.startswith("Frame,")) + 2
    cells = lines[at + 20].split(",")
    cells[2] = "#REF!"
    lines[at + 20] = ",".join(cells)
    lines[at + 40] = lines[at + 40].rpartition(",")[0]
    cells = lines[at + 60].split(",")
    cells[2:17] = [""] * 15
    lines[at + 60] = ",".join(cells)
    lines[at + 80] = "x" + lines[at + 80]
    file = tmp_path / "t.csv"
    file.write_text("\r\n".join(lines)[:-40])
    document = imported(file, tmp_path / "b.mcap", {"seat": "TS-01874", "head": "TS-01902"})
    # The seat lacks a cell, a row, a sensor's cells, a frame and the last line; the head all but two of these.
    assert document["sensors"]["seat"]["samples"] == 200 - 5 and document["sensors"]["head"]["samples"] == 200 - 3
    (row,) = document["files"]
    assert row["ragged_rows"] == 1 and row["cut"]
    assert row["untimed_rows"] == 1 and row["cells_no_number"] == 2  # #REF!, and the frame that is no number
    assert any(f"first in line {at + 21}" in line for line in document["warnings"])


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_prints_json_and_writes_the_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = place_of(tmp_path / "csv")
    (tmp_path / "who.yaml").write_text("head: TS-00001\n")
    words = ["import-blue-trident", str(place), "-o", str(tmp_path / "bag"), "--map", "seat=TS-00002", "--take", TAKE]
    assert main([*words, "--map-file", str(tmp_path / "who.yaml"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["sensors"]) == ["seat", "head"] and document["version"]
    assert (tmp_path / "bag/metadata.yaml").is_file()
    assert main(words) == 2
    assert "exists already: choose another name or remove it" in capsys.readouterr().err
    words[3] = str(tmp_path / "other.mcap")
    assert main(words) == 0
    assert "seat    TS-00002" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("extra", "wanted"),
    [
        (["--map", "seat=TS-00001", "--map", "head=TS-00001"], "sensor or serial is given twice"),
        (["--map", "chair=TS-00001"], "expected sensor=serial with a sensor of seat"),
        (["--map-file", "{}/absent.yaml"], "absent.yaml: cannot be read"),
        (["--map-file", "{}/list.yaml"], "expected lines such as 'seat: TS-02374'"),
        (["--map-file", "{}/number.yaml"], "seat: 2374 is no serial number"),
        (["--map", "seat=TS-00001", "--start", "yesterday"], "expected a time such as 2026-05-12T10:32:00+02:00"),
        (["--map", "seat=TS-00001", "--start", "2026-05-12T10:32:00"], "has no time zone"),
        (["--map", "seat=TS-00001", "--start", "1e300"], "between 1970 and 2038"),
        (["--map", "seat=TS-00001", "--start", "1600000000"], "exports of Capture.U have Unix time"),
        (["--map", "seat=TS-00001", "--saturation-mps2", "1"], "saturation_mps2 is 1, allowed are 10 to 5000 m/s^2"),
    ],
)
def test_invalid_options_of_the_command_are_refused(
    extra: list[str], wanted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = place_of(tmp_path / "csv")
    (tmp_path / "list.yaml").write_text("- seat\n")
    (tmp_path / "number.yaml").write_text("seat: 2374\n")
    words = [word.format(tmp_path) for word in extra]
    assert main(["import-blue-trident", str(place), "-o", str(tmp_path / "b.mcap"), *words]) == 2
    message = capsys.readouterr().err
    assert message.startswith("biodyn import-blue-trident: ") and wanted in message and message.count("\n") == 1
    assert not list(tmp_path.glob("*.mcap")) and not list(tmp_path.glob(".*"))


# --- real recordings --------------------------------------------------------------------------------------------------

REAL: dict[str, tuple[dict[str, str], dict[str, tuple[int, int]]]] = {
    "Extra": ({"seat": "TS-01874"}, {"seat": (3230, 0)}),
    "BraccioLineareVelocita01": ({"seat": "TS-01902"}, {"seat": (1926, 0)}),
    "MovimentoGambe01": ({"seat": "TS-01874", "head": "TS-01902"}, {"seat": (4420, 0), "head": (4420, 64)}),
}
"""Rows, and rows of zeros at the end, counted by a script of its own. The last one before the end or the zeros has half
to nine tenths of its neighbour's gravity and field in all four."""


def real(name: str, shared_data: Path) -> tuple[Path, list[str], Floats]:
    """An export, the names above its columns, and all its numbers, read line by line."""
    file = shared_data / "bluetrident_nexus_export" / f"{name}.csv"
    lines = file.read_text(encoding="utf-8-sig").splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("Frame,"))
    table = [[float(cell) for cell in line.split(",")] for line in lines[at + 2 :] if line.strip()]
    return file, lines[at - 1].split(","), np.array(table)


@pytest.mark.parametrize("name", REAL)
def test_a_real_export_of_nexus(name: str, shared_data: Path, tmp_path: Path) -> None:
    mapping, expected = REAL[name]
    file, names, table = real(name, shared_data)
    bag = tmp_path / "b.mcap"
    document = imported(file, bag, mapping)
    for sensor, (count, zeros) in expected.items():
        row = document["sensors"][sensor]
        assert row["samples"] == count - zeros - 1 and row["rate_hz"] == pytest.approx(250.0)
        assert row["left_out"] == {"late_start": 0, "dropouts": 0, "early_end": zeros, "faded": 1, "unreadable": 0}
        stamps, accel, gyro = samples(bag, sensor)
        first = names.index(f"{mapping[sensor]} - accel")
        raw = table[: row["samples"], first : first + 15]
        assert np.abs(accel - raw[:, :3] / 1000.0).max() < 1e-9
        size = np.linalg.norm(gyro, axis=1)
        assert 9.6 < np.median(np.linalg.norm(accel[size < np.quantile(size, 0.1)], axis=1)) < 9.95
        check_gyro(stamps, gyro, np.deg2rad(raw[:, 9:12]))
    # An arm that moves from the first second on, for eight seconds, is not at rest within the default patience.
    soon = ConditioningSettings(rest_patience_s=3.0)
    seen = info(bag, ReadingOptions(conditioning=soon))
    assert [row["sensor"] for row in seen["topics"]] == list(expected) and seen["replay"]["refusal"] is None
    replayed = replay(bag, subject(), ReplayOptions(conditioning=soon)).document
    assert replayed["sensors"]["seat"]["clipped_samples"] == 0 and replayed["sensors"]["seat"]["aw_mps2"] > 0.1


def check_gyro(stamps: NDArray[np.int64], gyro: Floats, angle: Floats) -> None:
    """The angular rate is the derivative of the global angle, a rotation vector by the filter of Nexus."""
    turned = Rotation.from_rotvec(angle)
    seconds = 1e-9 * (stamps[5:] - stamps[:-5])
    by_angle = (turned[:-5].inv() * turned[5:]).magnitude() / seconds
    by_gyro = np.linalg.norm(np.column_stack([np.convolve(axis, np.ones(6) / 6, "valid") for axis in gyro.T]), axis=1)
    fast = by_gyro > 1.0
    assert fast.sum() > 100
    assert np.median(by_angle[fast] / by_gyro[fast]) == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize(("first", "expected"), [(2, (1.0, 0.6, 8.9)), (17, (-0.5, 6.0, 9.3))])
def test_real_high_g_agrees_with_low_g_but_for_its_bias(
    first: int, expected: tuple[float, float, float], shared_data: Path
) -> None:
    """A runner's ankles, peaks up to 14 g; the biases are those of an ordinary regression, made elsewhere."""
    _, _, table = real("MovimentoGambe01", shared_data)
    low, high = 1e-3 * table[:4300, first : first + 3], 1e-3 * table[:4300, first + 12 : first + 15]
    t = np.arange(len(low)) / 250.0
    stretch = Stretch(t, low, t, high, 250.0, shared=True)
    settings: Any = DualRangeSettings(saturation_mps2=100.0)
    found, means = align([stretch], settings), levels(stretch, settings)
    assert means is not None and np.abs(np.array(found.gain) - 1.0).max() < 0.05
    assert bias(means, found) == pytest.approx(expected, abs=0.6)
