"""Suggestions for unknown files, sensors, topics, serials and keys."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from expecting import refusal
from streams import noisy_streams, write_bag

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean, did_you_mean_file
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import load_case
from biodyn_core.exposure.limits import load_limits
from biodyn_core.identification.settings import FitSettings
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.bag import open_bag
from biodyn_ros.base.resources import subject_file
from biodyn_ros.blue_trident.exports import find_exports
from biodyn_ros.fit.campaign_file import load_campaign
from biodyn_ros.fit.fitting import FitOptions, check_profiles
from biodyn_ros.reading.events import check_bags
from biodyn_ros.reading.mapping import check_given, parse_map
from biodyn_ros.reading.seat_motion import read_seat_motion


@pytest.mark.parametrize(
    ("name", "known", "wanted"),
    [
        ("seet", ("seat", "head"), "; did you mean seat?"),
        ("HEAD", ("seat", "head"), "; did you mean head?"),
        ("wk", ("Wk", "Wd"), "; did you mean Wk?"),
        ("foot", ("seat", "head"), ""),
        (7, ("seat",), ""),
        ("seat", (), ""),
    ],
)
def test_the_nearest_name_is_suggested_and_none_where_none_is_near(
    name: object, known: tuple[str, ...], wanted: str
) -> None:
    assert did_you_mean(name, known) == wanted


def test_a_file_is_suggested_beside_the_first_part_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "road_1.mcap").touch()
    assert did_you_mean_file(tmp_path / "drive" / "road1.mcap") == f"; did you mean {tmp_path}/drive/road_1.mcap?"
    assert did_you_mean_file(tmp_path / "drives" / "road_1.mcap") == f"; did you mean {tmp_path}/drive?"
    (tmp_path / "drive" / "link.mcap").symlink_to("nowhere")
    assert did_you_mean_file(tmp_path / "drive" / "link.mcap") == ""
    assert did_you_mean_file(tmp_path / "drive" / "road_1.mcap") == ""  # it is there
    assert did_you_mean_file(tmp_path / "drive" / "xyz") == did_you_mean_file("\0") == ""


def changed(path: Path, **keys: object) -> Path:
    """The first subject's file with keys changed; None takes one away."""
    document = yaml.safe_load(subject_file("subject_1").read_text(encoding="utf-8")) | keys
    path.write_text(yaml.safe_dump({key: value for key, value in document.items() if value is not None}))
    return path


HARNESS = {"name": "harness", "site": "upper_torso", "parameters": {"stiffness_n_per_m": 2e4, "slack_m": 0.002}}


@pytest.mark.parametrize(
    ("keys", "wanted"),
    [
        ({"body_mas_kg": 60.0}, "unknown key 'body_mas_kg'.*; did you mean body_mass_kg[?]"),
        ({"effects": [HARNESS | {"name": "harnes"}]}, "unknown effect 'harnes'.*; did you mean harness[?]"),
        ({"effects": [HARNESS | {"site": "uper_torso"}]}, "site is 'uper_torso'.*; did you mean upper_torso[?]"),
        (
            {"effects": [HARNESS | {"parameters": HARNESS["parameters"] | {"slak_m": 1.0}}]},
            "unknown parameter 'slak_m'.*; did you mean slack_m[?]",
        ),
    ],
)
def test_a_subject_file_s_keys_effects_sites_and_parameters(
    tmp_path: Path, keys: dict[str, object], wanted: str
) -> None:
    with pytest.raises(InputError, match=wanted):
        load_subject(changed(tmp_path / "anna.yaml", **keys))


def test_a_limits_file_s_keys_and_sources(tmp_path: Path) -> None:
    one = {"source": "works council", "action_a8_mps2": 0.5, "limit_a8_mps2": 1.15}
    path = tmp_path / "mine.yaml"
    for content, wanted in (
        (one | {"action_vdw_mps175": 9.1}, "; did you mean action_vdv_mps175?"),
        ({"set": [one], "decides": "works council"}, "; did you mean sets?"),
        ({"sets": [one], "decides": "work council"}, "; did you mean works council?"),
    ):
        path.write_text(yaml.safe_dump(content))
        assert refusal(load_limits, path).endswith(wanted)


def test_a_campaign_s_keys_bags_and_cases(tmp_path: Path) -> None:
    shutil.copy(subject_file("subject_1"), tmp_path / "anna.yaml")
    (tmp_path / "road_1.mcap").touch()
    row = {"subject": "anna.yaml", "bags": ["road_1.mcap"]}
    path = tmp_path / "people.yaml"
    for content, wanted in (
        (row | {"holdout": []}, "; did you mean hold_out?"),
        (row | {"bags": ["road1.mcap"]}, f"; did you mean {tmp_path}/road_1.mcap?"),
        (row | {"cases": {"road1.mcap": "gravel"}}, "; did you mean road_1.mcap?"),
    ):
        path.write_text(yaml.safe_dump({"subjects": [content]}))
        assert refusal(load_campaign, path).endswith(wanted)


def test_sensors_and_topics_of_map(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"with a sensor of seat.*; did you mean seat\?"):
        parse_map(["sea=/imu"])
    with pytest.raises(InputError, match=r"expected sensor=topic .*head$"):
        parse_map(["seat="])  # the sensor is known
    bag = tmp_path / "drive.mcap"
    write_bag(bag, noisy_streams())
    with open_bag(bag) as reader, pytest.raises(InputError, match=r"; did you mean imu/seat/data\?"):
        check_given(reader, {"seat": "imu/seat/dat"})


def test_missing_files_have_suggestions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("road_1.mcap", "anna.yaml", "limits.yaml", "seat.csv"):
        (tmp_path / name).touch()
    (tmp_path / "exports").mkdir()
    for read, name, near in (
        (open_bag, "road1.mcap", "road_1.mcap"),
        (subject_file, "ana.yaml", "anna.yaml"),
        (load_limits, "limts.yaml", "limits.yaml"),
        (lambda name: read_seat_motion(name, None, {}), "seats.csv", "seat.csv"),
        (lambda name: find_exports(Path(name)), "export", "exports"),
    ):
        with pytest.raises(InputError) as message:
            read(name)
        assert f"; did you mean {near}?" in str(message.value) and "\n" not in str(message.value)


def test_the_columns_of_a_seat_motion(tmp_path: Path) -> None:
    path = tmp_path / "seat.csv"
    path.write_text("tme,ax,ay,az\n0,0,0,9.8\n")
    with pytest.raises(InputError, match=r"no time column among .*; did you mean time\?"):
        read_seat_motion(path, None, {})
    path.write_text("time,acel_x,acel_y,acel_z\n0,0,0,9.8\n")
    with pytest.raises(InputError, match=r"no acceleration columns among .*; did you mean accel_x\?"):
        read_seat_motion(path, None, {})


def test_cases_weightings_verticals_profiles_and_settings() -> None:
    with pytest.raises(InputError, match=r"; did you mean road\?"):
        load_case("raod", 4.0, None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"; did you mean Wb\?"):
        PipelineSettings(also_weighted="WB")
    with pytest.raises(InputError, match=r"; did you mean head\?"):
        PipelineSettings(vertical="haed=0,0,1")
    with pytest.raises(InputError, match=r"case of raod.mcap: no such bag is given; did you mean road.mcap\?"):
        check_bags(["road.mcap"], [], ["raod.mcap"])
    with pytest.raises(InputError, match=r"; did you mean stiffening_scale\?"):
        check_profiles(FitOptions(profiles=("stifening_scale",)))
    with pytest.raises(InputError, match=r"refine is 'neldermead'.*; did you mean nelder-mead\?"):
        FitSettings(refine="neldermead")
