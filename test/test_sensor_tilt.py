"""Sensors with a tilt in motion are named if recordings have corrected it."""

import dataclasses
from functools import cache

import fitting
import numpy as np
import pytest
from hiding import applied

from biodyn_core.identification.problem import Case
from biodyn_core.tracing.nuisance_parameters import TypicalSettings
from biodyn_core.tracing.sensor_limits import LIMITS, within_limits
from biodyn_core.tracing.sensor_tilt import sensor_tilts, tilt_deg

USUAL = TypicalSettings().usual_lean


@cache
def event() -> Case:
    seat = fitting.seat_motion("road", 4.0, 3)
    return fitting.ready(seat, np.tile(seat[:, None], (1, 5)))


def leans(**degrees: tuple[float, float]) -> Case:
    """Of each sensor, along x and y."""
    found = {name: (float(np.sin(np.deg2rad(x))), float(np.sin(np.deg2rad(y)))) for name, (x, y) in degrees.items()}
    return dataclasses.replace(event(), mean_tilts=found)


def named(*cases: Case) -> dict[str, float]:
    """The tilt of each reported sensor, degrees."""
    return {one.site: tilt_deg(one) for one in sensor_tilts(cases, USUAL)}


def test_a_tilted_sensor_is_found_with_its_tilt() -> None:
    (found,) = sensor_tilts([leans(neck=(6.0, -2.0), head=(0.5, 0.0))] * 2, USUAL)
    assert (found.effect.name, found.site) == ("tilt", "neck")
    assert found.values["lean_x"] == pytest.approx(np.sin(np.deg2rad(6.0)))
    assert found.values["lean_y"] == pytest.approx(-np.sin(np.deg2rad(2.0)))
    assert tilt_deg(found) == pytest.approx(6.32, abs=0.02)


def test_a_typical_tilt_is_not_reported() -> None:
    """Typical are up to three times 0.025 g, 4.3 deg."""
    assert named(leans(head=(4.2, 0.0), neck=(4.4, 0.0))) == {"neck": pytest.approx(4.4)}


def test_tilts_of_several_events_are_averaged() -> None:
    assert named(leans(head=(6.0, 0.0)), leans(head=(-6.0, 0.0))) == {}
    assert named(leans(head=(3.0, 0.0)), leans(head=(7.0, 0.0))) == {"head": pytest.approx(5.0, abs=0.01)}


def test_a_sensor_without_a_tilt_in_one_event_is_left_out() -> None:
    both = leans(head=(9.0, 0.0), neck=(9.0, 0.0))
    assert set(named(both, leans(neck=(9.0, 0.0)))) == {"neck"}
    assert named(both, leans()) == {} == named()


def test_the_seat_is_left_out() -> None:
    assert named(leans(seat=(20.0, 0.0))) == {}


def test_a_large_tilt_is_clipped_to_the_range_of_the_effect() -> None:
    (found,) = sensor_tilts([leans(head=(40.0, 0.0))], USUAL)
    assert found.values["lean_x"] == 0.4


@pytest.mark.parametrize(
    ("name", "values", "within"),
    [
        # ICM-20948, table 2: 0.5 % + 0.5 % + 20 K of 0.026 %/K = 1.52 %; 50 mg and 2 % lean by 4.01 deg.
        ("gain", {"gain": 0.0151}, True),
        ("gain", {"gain": -0.0153}, False),
        ("tilt", {"lean_x": float(np.sin(np.deg2rad(1.8)))}, True),
        ("tilt", {"lean_x": 0.05, "lean_y": -0.048}, True),
        ("tilt", {"lean_x": 0.05, "lean_y": -0.05}, False),
        ("clock", {"delay_s": -0.00049}, True),
        ("clock", {"delay_s": 0.0, "drift": 0.0002}, False),  # 1 ms amid an event of 10 s
        ("skin", {}, False),
        ("stop", {}, False),
    ],
)
def test_limits_are_those_of_the_data_sheet(name: str, values: dict[str, float], within: bool) -> None:
    rest = {"tilt": {"lean_y": 0.0}, "clock": {"drift": 0.0}}.get(name, {})
    assert within_limits(applied(name, **(rest | values))) is within
    assert all("ICM-20948" in LIMITS[fault].source for fault in ("gain", "tilt"))
