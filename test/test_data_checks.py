"""Checks before a trace: amount of data, sensors, and tension of the seat."""

import dataclasses
from functools import cache

import fitting
import naive
import numpy as np
import pytest
from hiding import applied
from streams import subject

from biodyn_core.body.model import Chain
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.data_checks import (
    FloorSettings,
    contents,
    missing,
    needs,
    same_motion,
    seat_tension,
    split_held_out,
    usable,
    without_failed_sensors,
)

RATE_HZ = fitting.RATE_HZ
SUBJECT = subject()


@cache
def ride(kind: str = "road") -> Case:
    """Some motion of a body, of which the checks ask no more than that."""
    seat = fitting.seat_motion(kind, 4.0, 0)
    return fitting.ready(seat, Chain.of(SUBJECT).simulate(seat, RATE_HZ).accel_mps2, kind)


def case(peaks_g: list[float], seconds: float = 20.0, apart_s: float = 3.0) -> Case:
    """A seat at rest but for half-sines of 50 ms, the first 4 s into the record."""
    seat = np.zeros(round(seconds * RATE_HZ))
    width = round(0.05 * RATE_HZ)
    for number, peak in enumerate(peaks_g):
        begin = round((4.0 + apart_s * number) * RATE_HZ)
        seat[begin : begin + width] = 9.80665 * peak * np.sin(np.pi * np.arange(width) / (width - 1))
    measured = np.repeat(seat[:, None], 5, axis=1) + 1e-3
    return dataclasses.replace(ride(), seat_mps2=seat, measured_mps2=measured)


def test_shocks_are_counted_by_their_peaks() -> None:
    found = contents([case([0.5, 1.5, 1.9, 3.2]), case([-4.0])])
    assert (found.shocks, found.hard_shocks) == (4, 2)  # hard ones are shocks too
    assert found.road_s == pytest.approx(36.0 - 4.0, abs=0.1)  # 2 s of warm-up in each


def test_peaks_of_shocks_are_settings() -> None:
    s = FloorSettings(shock_g=2.0, hard_shock_g=3.0)
    found = contents([case([0.5, 1.5, 2.9, 3.2])], s)
    assert (found.shocks, found.hard_shocks) == (2, 1)
    assert found.road_s == pytest.approx(18.0 - 2.0, abs=0.1)


def test_a_peak_at_the_limit_is_a_hard_shock() -> None:
    one = case([2.5])
    peak_g = float(np.abs(one.seat_mps2).max() / 9.80665)
    for limit_g, hard in ((peak_g, 1), (np.nextafter(peak_g, np.inf), 0)):
        assert contents([one], FloorSettings(hard_shock_g=limit_g)).hard_shocks == hard


def test_a_shock_in_the_warm_up_does_not_count() -> None:
    early = case([3.0])
    shifted = dataclasses.replace(early, seat_mps2=np.roll(early.seat_mps2, -round(3.0 * RATE_HZ)))
    assert contents([shifted]).shocks == 0


def test_two_axles_are_one_shock() -> None:
    assert contents([case([1.5, 2.0], apart_s=0.3)]).shocks == 1
    assert contents([case([1.5, 2.0], apart_s=1.5)]).shocks == 2


def test_held_out_records_are_dealt_whole() -> None:
    """A gap makes two recordings of one bag, and both have one use."""
    one = case([1.5])
    runs = [dataclasses.replace(one, name=f"a.mcap ({n} of 2)", record="a.mcap") for n in (1, 2)]
    other = dataclasses.replace(one, name="b.mcap", record="b.mcap")
    assert split_held_out(runs) == (runs, [])
    assert split_held_out([*runs, other]) == (runs, [other])
    unnamed = [dataclasses.replace(one, name=name) for name in ("c", "d", "e")]
    assert split_held_out(unnamed) == ([unnamed[0], unnamed[2]], [unnamed[1]])


def test_channels_that_a_held_out_event_lacks_are_left_out_of_all() -> None:
    whole = dataclasses.replace(case([1.5]), channels={"seat.x": np.zeros(3), "seat.rate_x": np.zeros(3)})
    lean = dataclasses.replace(whole, channels={"seat.x": np.zeros(3)})
    train, held_out, _ = usable([whole], [whole, lean])
    assert [set(one.channels) for one in (*train, *held_out)] == [{"seat.x"}] * 3
    train, held_out, _ = usable([lean], [whole])
    assert [set(one.channels) for one in (*train, *held_out)] == [{"seat.x"}, {"seat.x", "seat.rate_x"}]


def test_missing_amounts_are_listed() -> None:
    assert missing([case([1.5])], "to fit") == [
        "to fit: 17 s without shocks, 30 are needed",
        "to fit: 1 shock of 0.8 g and more, 6 are needed",
        "to fit: 0 shocks of 2 g and more, 1 is needed",
    ]
    enough = [case([1.0, 1.5, 1.5]), case([4.0, 5.0, 1.0])]
    assert missing(enough, "held out", FloorSettings(road_s=20.0)) == []
    assert missing(enough, "held out") == []  # 2 x 18 s less 6 s of shocks are just 30
    assert missing(enough[:1], "held out", FloorSettings(road_s=1.0, shocks=3)) == [
        "held out: 0 shocks of 2 g and more, 1 is needed"
    ]
    assert missing([], "held out")[0] == "held out: 0 s without shocks, 30 are needed"


def motion(kind: str, peaks_g: list[float], seconds: float = 20.0) -> Case:
    """A case of one loading condition, unlike any other."""
    return dataclasses.replace(case(peaks_g, seconds), name=f"{kind} {peaks_g}", case=kind)


def test_a_need_is_the_difference_to_the_floor_for_each_use() -> None:
    s = FloorSettings(road_s=30.0, shocks=4, hard_shocks=1)
    train = [motion("road", [1.0]), motion("rail", [1.0, 1.2, 1.4, 2.5])]  # 2 x 18 s less 5 s of shocks
    held = [motion("road", [1.1]), motion("road", [0.9, 1.3])]  # 36 s less 3 s; 3 shocks, none of them hard
    (need,) = needs(train, held, s)
    assert (need.use, need.road_s, need.shocks, need.hard_shocks, need.conditions) == ("held out", 0.0, 1, 1, ())
    longer = FloorSettings(road_s=40.0, shocks=5, hard_shocks=1)
    to_fit, held_out = needs(train, held, longer)
    assert (to_fit.use, to_fit.road_s, to_fit.shocks) == ("to fit", pytest.approx(9.0, abs=0.1), 0)
    assert (held_out.road_s, held_out.shocks, held_out.hard_shocks) == (pytest.approx(7.0, abs=0.1), 2, 1)


def test_a_need_lists_each_condition_once() -> None:
    s = FloorSettings(road_s=30.0, shocks=2, hard_shocks=0)
    road, again = motion("road", [1.0, 1.1]), motion("road", [1.2, 1.3])
    to_fit, held_out = needs([road, again], [road], s)
    assert to_fit.conditions == ("another loading condition than road",)
    assert (to_fit.road_s, to_fit.shocks) == (0.0, 0)
    assert (
        len(held_out.conditions) == 2
        and held_out.conditions[0] == f"another recording than {road.name}, which is also fitted to"
    )
    assert held_out.shocks == 2 and held_out.road_s == 30.0  # the event on both sides counts for nothing
    assert needs([], [], s)[0].conditions == ("two loading conditions",)
    assert needs([], [road], s)[1].conditions == ("a further recording of road",)


def test_the_papers_windows_are_too_short_for_a_verdict() -> None:
    """4 to 6 s less 2 of warm-up, three of a kind."""
    windows = [case([1.5], seconds=6.0)] * 3
    assert any("without shocks" in line for line in missing(windows, "to fit"))


def test_the_tension_of_the_seat_is_that_of_the_papers_matrices() -> None:
    """Against the force from the paper's matrices, by another integrator."""
    seat = fitting.seat_motion("rail", 4.0, 2)
    theta = SUBJECT.parameters.vector()
    M = naive.chain_matrices(theta, SUBJECT.body_mass_kg, "segment")[0]
    (accel,) = naive.chain_responses([(theta, SUBJECT.body_mass_kg, "segment")], seat, RATE_HZ, 1e-8)
    made = fitting.ready(seat, accel, "rail")
    # All that pushes the six segments comes from the seat, but for the Rayleigh part, which holds on to nothing.
    found = seat_tension(SUBJECT, made)
    rayleigh = SUBJECT.parameters.rayleigh_rad_per_s
    relative = np.cumsum(accel - seat[:, None], axis=0) / RATE_HZ
    tension = -(accel @ np.diag(M) + rayleigh * relative @ np.diag(M))
    assert found == pytest.approx(tension.max() / (9.80665 * np.trace(M)), rel=0.03)
    assert found > 1.0


def test_the_tension_is_small_on_a_quiet_road_and_zero_with_lift_off() -> None:
    seat = 0.1 * fitting.seat_motion("road", 6.0, 1)
    quiet = dataclasses.replace(ride(), seat_mps2=seat)
    assert 0.0 < seat_tension(SUBJECT, quiet) < 0.5
    assert seat_tension(dataclasses.replace(SUBJECT, effects=(applied("lift_off"),)), quiet) == 0.0


def masked(share: float, column: int, one: Case) -> Case:
    """A case with one sensor masked for a share of the time after the warm-up."""
    compared, measured = one.compared.copy(), one.measured_mps2.copy()
    end = one.begin + round(share * (len(measured) - one.begin))
    compared[one.begin : end, column] = False
    measured[one.begin : end, column] = 0.0
    return dataclasses.replace(one, compared=compared, measured_mps2=measured, energy=(measured**2).sum(axis=0))


def test_a_clipping_sensor_is_left_out_of_its_event_alone() -> None:
    one = masked(0.1, 3, ride())
    found, (line,) = without_failed_sensors(one)
    assert line.startswith("road: neck, 10 % ")
    assert found.energy[3] == 0.0 and not found.compared[:, 3].any() and "neck" not in found.fitted
    others = [0, 1, 2, 4]
    np.testing.assert_array_equal(found.compared[:, others], one.compared[:, others])
    np.testing.assert_array_equal(found.energy[others], one.energy[others])


def test_few_masked_samples_or_equal_masks_leave_no_sensor_out() -> None:
    whole = ride()
    few, alike = masked(0.01, 3, whole), whole
    for column in range(5):
        alike = masked(0.1, column, alike)
    for one in (whole, few, alike):
        found, warnings = without_failed_sensors(one)
        assert found is one and warnings == []


def test_an_absent_sensor_is_not_reported_as_clipping() -> None:
    whole = ride()
    compared, energy = whole.compared.copy(), whole.energy.copy()
    compared[:, 1], energy[1] = False, 0.0
    assert without_failed_sensors(dataclasses.replace(whole, compared=compared, energy=energy))[1] == []


def test_equal_seats_are_the_same_motion() -> None:
    road, pothole = ride(), ride("pothole")
    renamed = dataclasses.replace(road, name="other", case="rail", measured_mps2=pothole.measured_mps2)
    shorter = dataclasses.replace(road, seat_mps2=road.seat_mps2[:-1])
    assert same_motion(road, renamed) and not same_motion(road, pothole) and not same_motion(road, shorter)
