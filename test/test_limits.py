"""The seat against its limits: formulae by hand, who governs, when times are honest, and limits files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from biodyn_core.errors import InputError
from biodyn_core.exposure import Dose
from biodyn_core.limits import EU_LIMITS, Limits, load_limits, seat_exposure

SHIPPED = Path(__file__).parents[1] / "config" / "limits.yaml"
HOUR = 3600.0


class Plane:
    """A horizontal meter with an answer known beforehand: an ellipse with its long axis at `at_rad`."""

    def __init__(self, long: tuple[float, float] = (0.0, 0.0), short: tuple[float, float] = (0.0, 0.0), at_rad=0.0):
        self.long, self.short, self.at_rad = long, short, at_rad

    def along(self, angles_rad, rolling: bool = False):
        """Return aw and VDV in these directions."""
        c, s = np.cos(np.asarray(angles_rad) - self.at_rad), np.sin(np.asarray(angles_rad) - self.at_rad)
        aw, vdv = (np.hypot(long * c, short * s) for long, short in zip(self.long, self.short, strict=True))
        return aw, vdv


def upward(aw: float, vdv: float, seconds: float) -> Dose:
    """A vertical dose."""
    return Dose(aw, 1.1 * aw, vdv, 9.0 * aw, seconds)


def judge(vertical: Dose, plane: Plane | None = None, yaw_rad: float | None = 0.0, trusted: bool = True):
    """The seat against the limits of 2002/44/EC."""
    return seat_exposure(vertical, plane or Plane(), yaw_rad, EU_LIMITS, trusted)


# --- formulae --------------------------------------------------------------------------------------------------------


def test_two_hours_at_one_metre_per_second_squared():
    seat = judge(upward(1.0, 0.0, 2.0 * HOUR))
    assert seat.a8_so_far_mps2 == pytest.approx(0.5)  # 1.0 sqrt(2 / 8)
    assert seat.time_to_action_value_s == pytest.approx(0.0)  # reached just now
    assert seat.time_to_limit_value_s == pytest.approx((8.0 * 1.15**2 - 2.0) * HOUR)  # 8 h 35 min more
    assert (seat.axis, seat.governing, seat.seconds) == ("z", "a8", 2.0 * HOUR)


def test_a_quarter_of_the_time_is_half_of_a8():
    assert judge(upward(0.8, 0.0, 8.0 * HOUR)).a8_so_far_mps2 == pytest.approx(0.8)
    assert judge(upward(0.8, 0.0, 2.0 * HOUR)).a8_so_far_mps2 == pytest.approx(0.4)


def test_time_left_by_vdv_goes_with_the_fourth_power():
    # Half of the action value in one hour: sixteen hours in all.
    seat = judge(upward(1e-3, 9.1 / 2.0, HOUR))
    assert seat.time_to_action_value_s == pytest.approx(15.0 * HOUR)
    assert seat.time_to_limit_value_s == pytest.approx(HOUR * ((21.0 / 4.55) ** 4 - 1.0))
    assert seat.governing == "vdv"
    assert seat.vdv_so_far_mps175 == 4.55


def test_the_sooner_of_both_counts():
    by_a8 = judge(upward(0.5, 1.0, HOUR))
    assert by_a8.time_to_action_value_s == pytest.approx(7.0 * HOUR)
    by_vdv = judge(upward(0.5, 9.1 / 2.0**0.25, HOUR))
    assert by_vdv.time_to_action_value_s == pytest.approx(HOUR)  # twice the fourth power fits into two hours


def test_once_reached_no_time_is_left():
    seat = judge(upward(3.0, 30.0, 8.0 * HOUR))
    assert seat.time_to_action_value_s == 0.0 and seat.time_to_limit_value_s == 0.0


def test_horizontal_axes_count_one_point_four_times():
    plane = Plane((0.8, 4.0), (0.5, 2.0))
    seat = judge(upward(1.0, 5.0, HOUR), plane)
    assert seat.axis == "x"  # 1.4 0.8 = 1.12 > 1.0
    assert seat.a8_so_far_mps2 == pytest.approx(1.12 * math.sqrt(1.0 / 8.0))
    assert seat.vdv_so_far_mps175 == pytest.approx(5.6)
    assert seat.aw_weighted_mps2 == pytest.approx({"x": 0.8, "y": 0.5, "z": 1.0})  # k not applied
    assert seat.vdv_weighted_mps175 == pytest.approx({"x": 4.0, "y": 2.0, "z": 5.0})


def test_vdv_may_govern_on_another_axis_than_aw():
    seat = judge(upward(1.0, 3.0, HOUR), Plane((0.5, 4.0)))
    assert seat.axis == "z" and seat.vdv_so_far_mps175 == pytest.approx(5.6)


# --- yaw -------------------------------------------------------------------------------------------------------------


def test_with_a_yaw_the_axes_are_turned_by_it():
    plane = Plane((1.0, 8.0), (0.2, 1.0), at_rad=math.radians(30.0))
    along = judge(upward(0.1, 1.0, HOUR), plane, yaw_rad=math.radians(30.0))
    assert along.horizontal == "yaw_given" and along.axis == "x"
    assert along.aw_weighted_mps2 == pytest.approx({"x": 1.0, "y": 0.2, "z": 0.1})
    across = judge(upward(0.1, 1.0, HOUR), plane, yaw_rad=math.radians(-60.0))
    assert across.axis == "y" and across.aw_weighted_mps2["y"] == pytest.approx(1.0)


@given(st.floats(-10.0, 10.0))
def test_without_a_yaw_the_worst_direction_is_found_wherever_it_is(at_rad):
    seat = judge(upward(0.1, 1.0, HOUR), Plane((1.0, 8.0), (0.2, 1.0), at_rad), yaw_rad=None)
    assert (seat.horizontal, seat.axis) == ("worst_direction", "worst_direction")
    assert set(seat.aw_weighted_mps2) == set(seat.vdv_weighted_mps175) == {"worst_direction", "z"}
    assert seat.aw_weighted_mps2["worst_direction"] == pytest.approx(1.0, rel=2e-5)  # within a quarter of a degree
    assert seat.a8_so_far_mps2 == pytest.approx(1.4 * math.sqrt(1.0 / 8.0), rel=2e-5)


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_the_worst_direction_is_never_milder_than_a_known_yaw(at_rad, yaw_rad):
    plane = Plane((1.0, 8.0), (0.9, 7.0), at_rad)
    known = judge(upward(0.1, 1.0, HOUR), plane, yaw_rad)
    unknown = judge(upward(0.1, 1.0, HOUR), plane, None)
    assert unknown.a8_so_far_mps2 >= known.a8_so_far_mps2 * (1.0 - 2e-5)
    assert unknown.time_to_limit_value_s <= known.time_to_limit_value_s * (1.0 + 1e-4)


# --- honesty ---------------------------------------------------------------------------------------------------------


def test_times_are_withheld_where_samples_are_missing_or_clipped():
    seat = judge(upward(1.0, 5.0, HOUR), trusted=False)
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None
    assert seat.a8_so_far_mps2 > 0.0 and seat.governing in ("a8", "vdv")


def test_nothing_counted_has_no_times():
    seat = judge(upward(0.0, 0.0, 0.0))
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None
    assert (seat.a8_so_far_mps2, seat.vdv_so_far_mps175, seat.seconds) == (0.0, 0.0, 0.0)


def test_a_seat_at_rest_reaches_nothing_ever():
    seat = judge(upward(0.0, 0.0, HOUR))
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None


@given(st.floats(0.01, 5.0), st.floats(0.01, 40.0), st.floats(60.0, 12.0 * HOUR))
def test_after_the_time_left_the_value_is_just_reached(aw, vdv, seconds):
    seat = judge(upward(aw, vdv, seconds))
    left = seat.time_to_action_value_s
    later = seconds + left
    a8, dose = aw * math.sqrt(later / (8.0 * HOUR)), vdv * (later / seconds) ** 0.25
    share = max(a8 / 0.5, dose / 9.1)
    assert share == pytest.approx(1.0) if left > 0.0 else share >= 1.0 - 1e-9
    assert seat.time_to_limit_value_s >= left


# --- the file --------------------------------------------------------------------------------------------------------


def test_the_shipped_limits_are_those_of_the_directive():
    assert load_limits(SHIPPED) == EU_LIMITS == Limits("2002/44/EC", 0.5, 9.1, 1.15, 21.0)


@pytest.fixture
def refused(tmp_path):
    """Writes a limits file and hands back the one line it is refused with, file named."""

    def refuse(content: object) -> str:
        path = tmp_path / "mine.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
        with pytest.raises(InputError) as told:
            load_limits(path)
        assert str(told.value).startswith(f"{path}: ") and "\n" not in str(told.value)
        return str(told.value)

    return refuse


def test_limits_of_ones_own_come_back(tmp_path):
    path = tmp_path / "mine.yaml"
    mine = Limits("the paper", 0.5, 8.5, 1.15, 17.0)
    path.write_text(yaml.safe_dump(mine.to_dict()), encoding="utf-8")
    assert load_limits(path) == mine


@pytest.mark.parametrize("key", sorted(EU_LIMITS.to_dict()))
def test_a_missing_key_and_one_too_many_are_refused(refused, key):
    limits = EU_LIMITS.to_dict()
    del limits[key]
    assert key in refused(limits)
    assert "exactly the keys" in refused({**EU_LIMITS.to_dict(), "action_a8": 0.5})


@pytest.mark.parametrize("key", ["action_a8_mps2", "action_vdv_mps175", "limit_a8_mps2", "limit_vdv_mps175"])
@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "0.5", True, None, [0.5], 10**400])
def test_what_is_no_positive_number_is_named(refused, key, value):
    assert f"{key} is " in refused({**EU_LIMITS.to_dict(), key: value})


@pytest.mark.parametrize("text", ["", "- 1\n", "5\n"])
def test_a_file_that_holds_something_else_is_refused(refused, text):
    assert "exactly the keys" in refused(text)


@pytest.mark.parametrize("text", ["a: [1\n", "source: 2024-13-45\n", "a: \x00\n"])
def test_a_file_that_is_no_yaml_is_refused(refused, text):
    assert "cannot be read as YAML" in refused(text)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read"):
        load_limits(tmp_path / "none.yaml")


def test_a_limit_below_its_action_value_is_refused_by_name(tmp_path):
    path = tmp_path / "limits.yaml"
    given = {**EU_LIMITS.to_dict(), "limit_vdv_mps175": 5.0}
    path.write_text("\n".join(f"{key}: {value}" for key, value in given.items()), encoding="utf-8")
    with pytest.raises(InputError, match="limit_vdv_mps175 lies below action_vdv_mps175"):
        load_limits(path)
