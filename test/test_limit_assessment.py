"""The seat against its limits: formulas, zones with their reasons, and conditions for times."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from biodyn_core.exposure.data_quality import DataQuality
from biodyn_core.exposure.limit_assessment import SeatExposure, seat_exposure
from biodyn_core.exposure.limits import EU_LIMITS, Limits, LimitSet
from biodyn_core.exposure.losses import NO_LOSSES, Losses
from biodyn_core.exposure.meters import Dose, DoseMeter, HorizontalMeter

EU, ISO = EU_LIMITS.deciding, EU_LIMITS.additional[0]
HOUR = 3600.0
COMPLETE = DataQuality(NO_LOSSES, silent=False, gravity_mps2=9.81, fault=None)


class Plane:
    """A horizontal meter with an answer known beforehand: an ellipse with its long axis at `at_rad`."""

    def __init__(self, long: tuple[float, float] = (1e-3, 1e-3), short: tuple[float, float] = (1e-3, 1e-3), at_rad=0.0):
        self.long, self.short, self.at_rad = long, short, at_rad

    def along(self, angles_rad, rolling: bool = False, suspect: bool = False):
        """Return aw and VDV in these directions, with suspect samples as without."""
        c, s = np.cos(np.asarray(angles_rad) - self.at_rad), np.sin(np.asarray(angles_rad) - self.at_rad)
        aw, vdv = (np.hypot(long * c, short * s) for long, short in zip(self.long, self.short, strict=True))
        return aw, vdv


def upward(aw: float, vdv: float, seconds: float, mtvv: float = 1.1, peak: float = 3.0) -> Dose:
    """A vertical dose; MTVV and peak as multiples of aw."""
    return Dose(aw, mtvv * aw, 0.9 * mtvv * aw, vdv, peak * aw, seconds)


def judge(
    vertical: Dose,
    plane: object = None,
    yaw_rad: float | None = 0.0,
    limits: Limits = EU_LIMITS,
    project=False,
    **grounds,
) -> SeatExposure:
    """The seat against the limits, by a complete record where no other grounds, or losses, are given."""
    losses = NO_LOSSES._replace(**{name: grounds.pop(name) for name in Losses._fields if name in grounds})
    given_grounds = dataclasses.replace(COMPLETE, losses=losses, **grounds)
    return seat_exposure(vertical, plane or Plane(), yaw_rad, limits, given_grounds, project)


# --- formulae --------------------------------------------------------------------------------------------------------


def test_two_hours_at_one_metre_per_second_squared():
    seat = judge(upward(1.0, 0.0, 2.0 * HOUR))
    assert seat.a8_so_far_mps2 == pytest.approx(0.5)  # 1.0 sqrt(2 / 8)
    assert seat.time_to_action_value_s == pytest.approx(0.0, abs=1e-9)  # reached just now
    assert seat.time_to_limit_value_s == pytest.approx((8.0 * 1.15**2 - 2.0) * HOUR)  # 8 h 35 min more
    assert (seat.axis, seat.governing, seat.seconds, seat.zone) == ("z", "a8", 2.0 * HOUR, "above_action_value")


@pytest.mark.parametrize(("kind", "zone"), [("action", "above_action_value"), ("limit", "above_limit_value")])
@pytest.mark.parametrize("measure", ["a8", "vdv"])
def test_an_exposure_equal_to_a_value_reaches_it(kind: str, zone: str, measure: str) -> None:
    dose = upward(0.7, 10.0, HOUR)
    seat = judge(dose)
    exact = {"a8": seat.a8_so_far_mps2, "vdv": seat.vdv_so_far_mps175}[measure]
    action, limit = (exact, 2.0 * exact) if kind == "action" else (0.5 * exact, exact)
    values = (action, None, limit, None) if measure == "a8" else (None, action, None, limit)
    found = judge(dose, limits=Limits(LimitSet("test", *values)))
    left = {"action": found.time_to_action_value_s, "limit": found.time_to_limit_value_s}
    assert found.zone == zone and left[kind] == 0.0


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


def test_the_governing_measure_is_reached_first():
    # A(8) at half of its action value has used a quarter of its time, VDV at six tenths of its own only an eighth.
    seat = judge(upward(0.25 * math.sqrt(8.0), 0.6 * 9.1, HOUR))
    assert seat.governing == "a8"
    assert seat.time_to_action_value_s == pytest.approx(3.0 * HOUR)


def test_above_the_limit_the_governing_measure_reached_it():
    # Beyond the action value A(8) came first (1.5^2 > 1.2^4), but only VDV has reached the limit value (21 > 9.1 1.2).
    by_action = judge(upward(0.75, 1.2 * 9.1, 8.0 * HOUR))
    assert (by_action.zone, by_action.governing) == ("above_action_value", "a8")
    by_limit = judge(upward(1.14, 21.5, 8.0 * HOUR))
    assert (by_limit.zone, by_limit.governing) == ("above_limit_value", "vdv")
    assert "VDV so far is 21.5 m/s^1.75 (axis z): the limit value of 21 (2002/44/EC) is reached" in by_limit.zone_reason


def test_time_left_is_zero_once_reached():
    seat = judge(upward(3.0, 30.0, 8.0 * HOUR))
    assert seat.time_to_action_value_s == 0.0 and seat.time_to_limit_value_s == 0.0


def test_horizontal_axes_count_one_point_four_times():
    plane = Plane((0.8, 4.0), (0.5, 2.0))
    seat = judge(upward(1.0, 5.0, HOUR), plane)
    assert seat.a8_axis == "x"  # 1.4 0.8 = 1.12 > 1.0
    assert seat.a8_so_far_mps2 == pytest.approx(1.12 * math.sqrt(1.0 / 8.0))
    assert seat.vdv_so_far_mps175 == pytest.approx(5.6)
    assert seat.aw_weighted_mps2 == pytest.approx({"x": 0.8, "y": 0.5, "z": 1.0})  # k not applied
    assert seat.vdv_weighted_mps175 == pytest.approx({"x": 4.0, "y": 2.0, "z": 5.0})


def test_each_measure_has_its_axis_and_the_governing_ones_is_named():
    seat = judge(upward(1.0, 3.0, HOUR), Plane((0.5, 6.4)))
    assert (seat.a8_axis, seat.vdv_axis) == ("z", "x")
    assert seat.vdv_so_far_mps175 == pytest.approx(1.4 * 6.4)
    assert (seat.governing, seat.axis) == ("vdv", "x")  # (8.96 / 9.1)^4 > (0.354 / 0.5)^2


def test_the_missing_seconds_have_passed_as_well():
    # 0.5 m/s^2 lasts eight hours. Of one hour 18 s were not measured: seven hours are left, not seven and 18 s.
    seat = judge(upward(0.5, 1.0, HOUR - 18.0), absent_s=18.0)
    assert seat.time_to_action_value_s == pytest.approx(7.0 * HOUR)


def test_interpolated_seconds_are_counted_once():
    # Two hours' worth of the action value in an hour: of one hour counted, an hour is left, whatever was interpolated.
    seat = judge(upward(1.0, 1.0, HOUR), filled_s=18.0)
    assert seat.time_to_action_value_s == pytest.approx(HOUR, rel=1e-12)
    assert seat.lower_bound and seat.withheld is None
    # One percent of the time that passed, which is what was counted.
    assert judge(upward(0.1, 1.0, 3600.0), filled_s=36.0).zone == "below_action_value"
    assert judge(upward(0.1, 1.0, 3600.0), filled_s=36.01).zone == "undecided"


# --- yaw and horizontal data -----------------------------------------------------------------------------------------


def test_a_yaw_rotates_the_axes():
    plane = Plane((1.0, 8.0), (0.2, 1.0), at_rad=math.radians(30.0))
    along = judge(upward(0.1, 1.0, HOUR), plane, yaw_rad=math.radians(30.0))
    assert along.horizontal == "yaw_given" and along.axis == "x"
    assert along.aw_weighted_mps2 == pytest.approx({"x": 1.0, "y": 0.2, "z": 0.1})
    across = judge(upward(0.1, 1.0, HOUR), plane, yaw_rad=math.radians(-60.0))
    assert across.axis == "y" and across.aw_weighted_mps2["y"] == pytest.approx(1.0)


@given(st.floats(-10.0, 10.0))
def test_without_a_yaw_the_worst_direction_is_found(at_rad):
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


@pytest.mark.parametrize("yaw_rad", [None, 0.0, 0.7])
def test_a_single_axis_sensor_is_vertical_only_and_never_green(yaw_rad):
    seat = judge(upward(0.1, 1.0, HOUR), Plane((0.0, 0.0), (0.0, 0.0)), yaw_rad)
    assert seat.horizontal == "missing"
    assert seat.aw_weighted_mps2 == {"z": 0.1} and seat.vdv_weighted_mps175 == {"z": 1.0}
    assert seat.zone == "undecided" and "vertical only" in seat.zone_reason
    assert seat.lower_bound  # the axes that are not known may be the worse ones
    assert seat.time_to_action_value_s > 0.0
    above = judge(upward(1.0, 1.0, 3.0 * HOUR), Plane((0.0, 0.0), (0.0, 0.0)), yaw_rad)
    assert above.zone == "above_action_value" and "at least 0.612" in above.zone_reason


@pytest.mark.parametrize("yaw_rad", [None, 0.0, 0.7])
def test_a_sensor_with_one_dead_horizontal_axis_is_never_green(yaw_rad):
    seat = judge(upward(0.1, 1.0, HOUR), Plane((0.1, 1.0), (0.0, 0.0)), yaw_rad)
    assert seat.horizontal == ("worst_direction" if yaw_rad is None else "yaw_given")
    assert seat.zone == "undecided" and "one of its horizontal axes" in seat.zone_reason
    assert seat.lower_bound and seat.projected_lower_bound  # the axis that is not known may be the worse one


# --- the zone --------------------------------------------------------------------------------------------------------


def test_below_the_action_values_needs_a_complete_record():
    seat = judge(upward(0.1, 1.0, HOUR))
    assert seat.zone == "below_action_value" and not seat.lower_bound and seat.withheld is None
    assert seat.zone_reason == (
        "A(8) so far is 0.0354 m/s^2 (axis z) and VDV so far is 1.00 m/s^1.75 (axis z):"
        " below the action values of 0.5 and 9.1 (2002/44/EC)"
    )


@pytest.mark.parametrize(
    ("grounds", "because"),
    [
        ({"clipped": 1}, "1 sample is clipped"),
        ({"absent_s": 40.0}, "40 s are missing at the seat, more than 1 %"),
        ({"flat_s": 2.0}, "2 s of the seat's readings do not change"),
        ({"dead_s": 2.0}, "one axis of the seat does not change for 2 s while another one moves"),
        ({"silent": True}, "fallen silent"),
        ({"unusable_s": 0.6}, "the last 0.6 s of the seat's samples are unusable"),
        ({"fault": "no power"}, "no power"),
        ({"gravity_mps2": 7.8}, "reads 7.80 m/s^2 for gravity"),
        ({"gravity_mps2": None}, "reads nothing for gravity"),
    ],
)
@pytest.mark.parametrize("limits", [EU_LIMITS, Limits(ISO, (EU,))])
def test_poor_data_quality_is_never_below(grounds, because, limits):
    seat = judge(upward(0.1, 1.0, HOUR), limits=limits, **grounds)
    assert seat.zone == "undecided" and because in seat.zone_reason
    assert [each.zone for each in seat.additional] == ["undecided"]
    if "gravity_mps2" in grounds:  # a gain too low by a fifth would promise twice the time
        assert because in (seat.withheld or "") and seat.time_to_action_value_s is None
        assert judge(upward(0.1, 1.0, HOUR), limits=limits, project=True, **grounds).a8_projected_8h_mps2 is None
    # A value that is reached stays reached; the excess is unknown.
    action = judge(upward(0.1, 10.0, HOUR), limits=limits, **grounds)
    assert action.zone == "above_action_value" and because in action.zone_reason
    limit = judge(upward(0.1, 22.0, HOUR), limits=limits, **grounds)
    assert limit.zone == "above_limit_value" and because not in limit.zone_reason


@given(
    st.floats(0.0, 5.0), st.floats(0.0, 40.0), st.floats(0.0, 12.0 * HOUR), st.floats(0.0, 1000.0), st.integers(0, 3),
    st.booleans(), st.sampled_from([0.0, 1e-3]),
)  # fmt: skip
@example(0.1, 1.0, 3600.0, 0.0, 0, False, 1e-3)
def test_a_bound_never_gives_green(aw, vdv, seconds, missing, clipped, silent, plane):
    seat = judge(
        upward(aw, vdv, seconds), Plane((plane, plane), (plane, plane)), absent_s=missing, clipped=clipped,
        silent=silent,
    )  # fmt: skip
    assert len(seat.zone_reason) > 20
    if seat.zone == "below_action_value":
        assert seat.a8_so_far_mps2 < 0.5 and seat.vdv_so_far_mps175 < 9.1
        assert clipped == 0 and not silent and plane > 0.0 and seconds > 0.0
        assert missing <= 0.01 * (seconds + missing)
        assert "at least" not in seat.zone_reason
    assert (seat.zone == "above_limit_value") == (seat.a8_so_far_mps2 >= 1.15 or seat.vdv_so_far_mps175 >= 21.0)


def test_exactly_one_percent_missing_is_allowed_and_a_little_more_is_not():
    assert judge(upward(0.1, 1.0, 3564.0), absent_s=36.0).zone == "below_action_value"
    assert "36 s are missing, within the 1 % allowed" in judge(upward(0.1, 1.0, 3564.0), absent_s=36.0).zone_reason
    assert judge(upward(0.1, 1.0, 3564.0), absent_s=36.01).zone == "undecided"


def test_a_value_within_the_missing_seconds_is_undecided():
    # 0.5 m/s^2 for eight hours less 36 s that are missing: 0.4997 so far, 0.5 if they were like the rest.
    seat = judge(upward(0.5, 1.0, 8.0 * HOUR - 36.0), absent_s=36.0)
    assert seat.a8_so_far_mps2 < 0.5
    assert seat.zone == "undecided" and "if the 36 s missing were like the rest" in seat.zone_reason
    assert seat.time_to_action_value_s == pytest.approx(0.0, abs=1e-6)


def test_nothing_counted_is_undecided_without_times():
    seat = judge(upward(0.0, 0.0, 0.0), Plane((0.0, 0.0), (0.0, 0.0)), project=True)
    assert seat.zone == "undecided" and "nothing was counted" in seat.zone_reason
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None
    assert (seat.a8_so_far_mps2, seat.vdv_so_far_mps175, seat.seconds) == (0.0, 0.0, 0.0)
    assert seat.a8_projected_8h_mps2 is None and seat.projected_from_s is None
    assert [ratio.exceeded for ratio in seat.shock_ratios] == [None, None, None]


def test_additional_sets_are_assessed_by_their_own_values():
    seat = judge(upward(0.1, 8.8, HOUR))
    (iso,) = seat.additional
    assert (seat.source, seat.zone) == ("2002/44/EC", "below_action_value")
    assert (iso.source, iso.zone, iso.governing) == ("ISO 2631-1 caution zone", "above_action_value", "vdv")
    assert iso.time_to_action_value_s == 0.0
    assert iso.time_to_limit_value_s == pytest.approx(HOUR * ((17.0 / 8.8) ** 4 - 1.0))
    # 2.0 m/s^2 for three hours is above the directive's limit value of A(8), of which the other set knows nothing.
    loud = judge(upward(2.0, 1.0, 3.0 * HOUR))
    assert (loud.zone, loud.additional[0].zone) == ("above_limit_value", "below_action_value")
    assert "A(8)" not in loud.additional[0].zone_reason


# --- times -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("grounds", [{"clipped": 1}, {"absent_s": 40.0}])
@pytest.mark.parametrize("vdv", [5.0, 30.0])
def test_times_and_projections_are_withheld_where_samples_are_missing_or_clipped(grounds, vdv):
    seat = judge(upward(1.0, vdv, HOUR), project=True, **grounds)
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None
    assert seat.additional[0].time_to_limit_value_s is None
    assert seat.a8_projected_8h_mps2 is None and seat.vdv_projected_8h_mps175 is None
    assert seat.withheld is not None and seat.lower_bound
    assert seat.a8_so_far_mps2 == pytest.approx(math.sqrt(1.0 / 8.0)) and seat.governing in ("a8", "vdv")


def test_a_seat_at_rest_never_reaches_a_value():
    seat = judge(upward(0.0, 0.0, HOUR), Plane((0.0, 0.0), (0.0, 0.0)))
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None
    assert seat.withheld is None and seat.axis == "z"


@given(st.floats(0.01, 5.0), st.floats(0.01, 40.0), st.floats(60.0, 12.0 * HOUR))
def test_after_the_time_left_the_value_is_just_reached(aw, vdv, seconds):
    seat = judge(upward(aw, vdv, seconds))
    left = seat.time_to_action_value_s
    later = seconds + left
    a8, dose = aw * math.sqrt(later / (8.0 * HOUR)), vdv * (later / seconds) ** 0.25
    share = max(a8 / 0.5, dose / 9.1)
    assert share == pytest.approx(1.0) if left > 0.0 else share >= 1.0 - 1e-9
    assert seat.time_to_limit_value_s >= left


@given(
    st.floats(0.01, 5.0), st.floats(0.01, 40.0), st.floats(60.0, 12.0 * HOUR), st.floats(1.0, 2.0), st.floats(1.0, 2.0),
    st.floats(0.0, 2.0), st.floats(0.0, 0.009),
)  # fmt: skip
def test_more_exposure_never_leaves_more_time(aw, vdv, seconds, louder, harsher, sideways, missing):
    less = judge(upward(aw, vdv, seconds))
    more = judge(
        upward(louder * aw, harsher * vdv, seconds), Plane((sideways * aw + 1e-3, 1e-3), (1e-3, 1e-3)),
        absent_s=missing * seconds,
    )  # fmt: skip
    order = ["below_action_value", "undecided", "above_action_value", "above_limit_value"]
    for of_more, of_less in zip((more, *more.additional), (less, *less.additional), strict=True):
        assert of_more.time_to_action_value_s <= of_less.time_to_action_value_s * (1.0 + 1e-12)
        assert of_more.time_to_limit_value_s <= of_less.time_to_limit_value_s * (1.0 + 1e-12)
        assert order.index(of_more.zone) >= order.index(of_less.zone)


# --- projection ------------------------------------------------------------------------------------------------------


def test_half_an_hour_is_projected_to_eight_by_its_powers():
    seat = judge(upward(0.4, 3.0, 0.5 * HOUR))
    assert seat.a8_projected_8h_mps2 == pytest.approx(0.4)  # the mean continues
    assert seat.vdv_projected_8h_mps175 == pytest.approx(6.0)  # sixteen times as long, twice the dose
    assert seat.projected_from_s == 0.5 * HOUR


@pytest.mark.parametrize(
    ("seconds", "asked", "given_"),
    [(1199.0, False, False), (1199.0, True, True), (1200.0, False, True), (8 * HOUR, False, True),
     (8.1 * HOUR, True, False)],
)  # fmt: skip
def test_a_projection_needs_20_min_to_8_h(seconds, asked, given_):
    seat = judge(upward(0.4, 3.0, seconds), project=asked)
    projected = (seat.a8_projected_8h_mps2, seat.vdv_projected_8h_mps175, seat.projected_from_s)
    assert [value is not None for value in projected] == 3 * [given_]


@given(st.floats(0.01, 5.0), st.floats(0.01, 40.0), st.floats(1200.0, 8.0 * HOUR))
def test_a_projection_below_the_values_means_that_eight_hours_fit(aw, vdv, seconds):
    seat = judge(upward(aw, vdv, seconds))
    projected = max(seat.a8_projected_8h_mps2 / 0.5, seat.vdv_projected_8h_mps175 / 9.1)
    assume(abs(projected - 1.0) > 1e-9)
    assert (projected < 1.0) == (seconds + seat.time_to_action_value_s > 8.0 * HOUR)


# --- shocks ----------------------------------------------------------------------------------------------------------


def ratios(seat: SeatExposure) -> dict[str, tuple[float | None, bool | None]]:
    """Value and whether it fires, by name."""
    return {ratio.name: (ratio.value, ratio.exceeded) for ratio in seat.shock_ratios}


def test_the_shock_ratios_of_the_vertical():
    seat = judge(upward(0.5, 0.5 * 1.8 * 10.0, 10_000.0, mtvv=1.4, peak=9.5))
    assert ratios(seat) == {
        "crest_factor": (pytest.approx(9.5), True),
        "mtvv_over_aw": (pytest.approx(1.4), False),
        "vdv_over_aw_t": (pytest.approx(1.8), True),
    }
    assert [(ratio.threshold, ratio.clause) for ratio in seat.shock_ratios] == [
        (9.0, "6.2.2"), (1.5, "6.3.3"), (1.75, "6.3.3"),
    ]  # fmt: skip


def test_a_horizontal_axis_has_no_measured_peak():
    seat = judge(upward(0.1, 0.1, 10_000.0, mtvv=3.0, peak=20.0), Plane((0.5, 0.5 * 1.2 * 10.0), (0.1, 0.1)))
    assert seat.axis == "x"
    assert ratios(seat) == {
        "crest_factor": (None, None), "mtvv_over_aw": (None, None), "vdv_over_aw_t": (pytest.approx(1.2), False),
    }  # fmt: skip


# --- through the meters ----------------------------------------------------------------------------------------------


def weighted_sine(seconds: float, rate_hz: float = 500.0) -> tuple[Dose, HorizontalMeter, float]:
    """A vertical sine of weighted rms 1.0 (Wk(8 Hz) = 1.036, ISO 2631-1, Table 3) and a little of it sideways."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    wave = math.sqrt(2.0) / 1.036 * np.sin(2.0 * np.pi * 8.0 * time)
    up, plane = DoseMeter("Wk", rate_hz, 1, 10.0), HorizontalMeter(rate_hz, 10.0)
    up.push(wave[:, None])
    plane.push(np.column_stack([0.1 * wave, 0.05 * wave]))
    return up.since_reset()[0], plane, 1.0


def test_a_sine_of_known_weighted_rms():
    dose, plane, aw = weighted_sine(100.0)
    seat = seat_exposure(dose, plane, 0.0, EU_LIMITS, COMPLETE, project=True)
    assert seat.zone == "below_action_value" and seat.horizontal == "yaw_given"
    assert seat.a8_so_far_mps2 == pytest.approx(aw * math.sqrt(100.0 / 28_800.0), rel=5e-3)
    # The fourth power of a sine is 3/8 of its peak's, 3/2 of its rms's.
    assert seat.vdv_so_far_mps175 == pytest.approx(aw * 1.5**0.25 * 100.0**0.25, rel=5e-3)
    # VDV comes first: 9.1^4 / 1.5 = 4572 s in all, where A(8) would allow two hours.
    assert seat.governing == "vdv"
    assert seat.time_to_action_value_s == pytest.approx(9.1**4 / 1.5 - 100.0, rel=1e-2)
    assert seat.a8_projected_8h_mps2 == pytest.approx(1.0, rel=5e-3)
    found = ratios(seat)
    assert found["vdv_over_aw_t"] == (pytest.approx(1.5**0.25, rel=2e-3), False)
    assert found["mtvv_over_aw"] == (pytest.approx(1.0, abs=0.05), False)
    assert found["crest_factor"][1] is False


def test_a_single_axis_sensor_through_the_meters():
    rate_hz = 500.0
    wave = np.sin(2.0 * np.pi * 8.0 * np.arange(5000) / rate_hz)
    up, plane = DoseMeter("Wk", rate_hz, 1, 10.0), HorizontalMeter(rate_hz, 10.0)
    up.push(wave[:, None])
    plane.push(np.zeros((5000, 2)))
    seat = seat_exposure(up.since_reset()[0], plane, None, EU_LIMITS, COMPLETE)
    assert (seat.horizontal, seat.zone, set(seat.aw_weighted_mps2)) == ("missing", "undecided", {"z"})


def test_a_burst_of_a_second_exceeds_the_ratio_of_mtvv_by_the_linear_average_alone():
    """A second in three: MTVV/aw is sqrt(3) = 1.73, and sqrt(3 (1 - 1/e)) = 1.38 by the exponential average."""
    wave = np.sin(2.0 * np.pi * 16.0 * np.arange(1500) / 500.0) * (np.arange(1500) < 500)
    up, plane = DoseMeter("Wk", 500.0, 1, 10.0), HorizontalMeter(500.0, 10.0)
    up.push(wave[:, None])
    plane.push(np.zeros((1500, 2)))
    dose = up.since_reset()[0]
    assert dose.mtvv_exponential_mps2 / dose.aw_mps2 == pytest.approx(1.38, abs=0.02)
    value, exceeded = ratios(seat_exposure(dose, plane, None, EU_LIMITS, COMPLETE))["mtvv_over_aw"]
    assert value == pytest.approx(math.sqrt(3.0), rel=5e-3) and exceeded


# --- suspect samples -------------------------------------------------------------------------------------------------


class SuspectPlane(Plane):
    """A horizontal meter whose suspect samples add to each figure."""

    def __init__(self, more: float) -> None:
        super().__init__()
        self.more = more

    def along(self, angles_rad, rolling: bool = False, suspect: bool = False):
        """Return aw and VDV in these directions."""
        return tuple(figures + suspect * self.more for figures in super().along(angles_rad, rolling, suspect))


def doubted(sure: Dose, whole: Dose, limits: Limits = EU_LIMITS, plane: object = None, suspect_s: float = 2.0):
    """The seat whose exposure with suspect samples is another one than without."""
    quality = dataclasses.replace(COMPLETE, losses=NO_LOSSES._replace(suspect_s=suspect_s, filled_s=0.04))
    return seat_exposure(sure, plane or Plane(), 0.0, limits, quality, project=True, with_suspect=whole)


def test_a_value_that_only_suspect_samples_reach_is_undecided_and_has_no_time_left():
    seat = doubted(upward(0.2, 7.0, HOUR), upward(0.2, 9.8, HOUR))
    assert (seat.zone, seat.may_be_reached, seat.governing, seat.axis) == ("undecided", "action", "vdv", "z")
    assert seat.zone_reason == (
        "the counted exposure reaches no value of 2002/44/EC, but VDV is 9.80 m/s^1.75 (action value 9.1) with the 2 s"
        " after losses within strong motion"
    )
    assert seat.vdv_so_far_mps175 == 7.0 and seat.lower_bound and seat.suspect_s == 2.0
    assert seat.withheld and seat.withheld in seat.zone_reason
    assert seat.time_to_action_value_s is None and seat.time_to_limit_value_s is None
    assert seat.a8_projected_8h_mps2 is None


def test_the_highest_value_that_may_be_reached_is_named():
    seat = doubted(upward(0.2, 7.0, HOUR), upward(0.2, 21.4, HOUR))
    assert (seat.zone, seat.may_be_reached) == ("undecided", "limit") and "(limit value 21)" in seat.zone_reason


def test_a_limit_value_that_only_suspect_samples_reach_leaves_the_action_value_reached():
    seat = doubted(upward(0.2, 10.0, HOUR), upward(0.2, 22.0, HOUR))
    assert (seat.zone, seat.may_be_reached) == ("above_action_value", "limit") and seat.vdv_so_far_mps175 == 10.0
    assert "VDV so far is at least 10.0 m/s^1.75 (axis z): the action value of 9.1" in seat.zone_reason
    assert "whether the limit value is reached too is undecided, because VDV is 22.0" in seat.zone_reason
    assert seat.time_to_action_value_s == 0.0 and seat.time_to_limit_value_s is None


def test_below_a_value_the_suspect_samples_count():
    seat = doubted(upward(0.2, 3.0, HOUR), upward(0.2, 4.55, HOUR))
    assert (seat.zone, seat.may_be_reached) == ("below_action_value", None)
    assert "VDV so far is 4.55" in seat.zone_reason
    assert seat.zone_reason.endswith("; the figures are with the 2 s after losses within strong motion")
    assert seat.vdv_so_far_mps175 == 3.0 and seat.seconds == HOUR
    assert seat.time_to_action_value_s == pytest.approx(15.0 * HOUR)
    assert seat.vdv_projected_8h_mps175 == pytest.approx(4.55 * 8.0**0.25)


def test_an_additional_set_has_its_own_doubt():
    seat = doubted(upward(0.2, 7.0, HOUR), upward(0.2, 8.8, HOUR))
    assert seat.zone == "below_action_value" and seat.withheld is None
    (iso,) = seat.additional
    assert iso.zone == "undecided" and "VDV is 8.80 m/s^1.75 (action value 8.5)" in iso.zone_reason
    assert iso.time_to_action_value_s is None


def test_the_doubt_of_the_deciding_set_takes_no_time_from_an_additional_one():
    sets = Limits(LimitSet("low", None, 8.0, None, 17.0), (LimitSet("high", None, 12.0, None, 30.0),))
    seat = doubted(upward(0.2, 7.0, HOUR), upward(0.2, 9.0, HOUR), sets)
    (high,) = seat.additional
    assert seat.zone == "undecided" and seat.time_to_action_value_s is None
    assert high.zone == "below_action_value" and high.time_to_action_value_s > 0.0


@given(
    sure=st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 30.0)),
    more=st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 30.0)),
    seconds=st.floats(10.0, 2e4),
)
def test_a_zone_holds_with_and_without_suspect_samples_or_is_undecided(sure, more, seconds):
    whole = upward(sure[0] + more[0], sure[1] + more[1], seconds)
    seat, alone, with_them = doubted(upward(*sure, seconds), whole), judge(upward(*sure, seconds)), judge(whole)
    if seat.zone == "below_action_value":
        assert with_them.zone == "below_action_value"
    if seat.zone in ("above_action_value", "above_limit_value"):
        assert alone.zone == seat.zone
    if with_them.zone == alone.zone:
        assert seat.zone == alone.zone or (seat.zone == "undecided" and 0.01 * seconds < 0.04)
    order = ("below_action_value", "above_action_value", "above_limit_value")
    higher = order.index(with_them.zone) > order.index(alone.zone)
    assert (seat.may_be_reached is not None) == higher


def test_an_axis_whose_samples_are_all_suspect_is_not_missing():
    for vdv, zone in ((1.0, "below_action_value"), (10.0, "undecided")):
        seat = doubted(upward(0.0, 0.0, HOUR), upward(0.3, 1.0, HOUR), plane=SuspectPlane(vdv / 1.4))
        assert seat.horizontal == "yaw_given" and seat.projected_lower_bound is False
        assert seat.zone == zone


def test_a_shock_ratio_is_known_where_both_exposures_agree():
    def exceeded(sure: Dose, whole: Dose) -> list[bool | None]:
        return [ratio.exceeded for ratio in doubted(sure, whole).shock_ratios]

    calm, jolting = upward(0.2, 0.3, HOUR), upward(0.2, 6.0, HOUR, mtvv=3.0, peak=12.0)
    assert exceeded(calm, calm) == [False] * 3 and exceeded(jolting, jolting) == [True] * 3
    assert exceeded(calm, jolting) == [None] * 3 == exceeded(jolting, calm)


def test_every_doubt_is_named():
    lost = NO_LOSSES._replace(suspect_s=2.0, filled_s=0.04, clipped=3)
    quality = dataclasses.replace(COMPLETE, losses=lost)
    for sure, zone in ((7.0, "undecided"), (10.0, "above_action_value")):
        seat = seat_exposure(
            upward(0.2, sure, HOUR), Plane(), 0.0, EU_LIMITS, quality, with_suspect=upward(0.2, 22.0, HOUR)
        )
        assert seat.zone == zone
        assert "within strong motion; and 3 samples are clipped at the seat" in seat.zone_reason
