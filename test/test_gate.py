"""What the data can carry, and what no seat can."""

import dataclasses

import fitting
import naive
import numpy as np
import pytest
from test_effects import applied

from biodyn_core.identification.problem import Case
from biodyn_core.subject import load_subject
from biodyn_core.tracing.gate import FloorSettings, contents, missing, pulled_down
from biodyn_ros.resources import subject_file

RATE_HZ = fitting.RATE_HZ
SUBJECT = load_subject(subject_file("subject_1"))


def case(peaks_g: list[float], seconds: float = 20.0, apart_s: float = 3.0) -> Case:
    """A seat at rest but for half-sines of 50 ms, the first 4 s into the record."""
    seat = np.zeros(round(seconds * RATE_HZ))
    width = round(0.05 * RATE_HZ)
    for number, peak in enumerate(peaks_g):
        begin = round((4.0 + apart_s * number) * RATE_HZ)
        seat[begin : begin + width] = 9.80665 * peak * np.sin(np.pi * np.arange(width) / (width - 1))
    measured = np.repeat(seat[:, None], 5, axis=1) + 1e-3
    return dataclasses.replace(fitting.true_cases("segment")[0], seat_mps2=seat, measured_mps2=measured)


def test_shocks_are_counted_by_their_peaks() -> None:
    found = contents([case([0.5, 1.5, 2.9, 3.2]), case([-4.0])])
    assert (found.shocks, found.hard_shocks) == (2, 2)
    assert found.road_s == pytest.approx(36.0 - 4.0, abs=0.1)  # 2 s of warm-up in each


def test_two_axles_are_one_shock() -> None:
    assert contents([case([1.5, 2.0], apart_s=0.3)]).shocks == 1
    assert contents([case([1.5, 2.0], apart_s=1.5)]).shocks == 2


def test_what_is_missing_is_said_and_enough_is_enough() -> None:
    few = missing([case([1.5])], "to fit")
    assert few == [
        "to fit: 17 s without shocks, 30 are needed",
        "to fit: 1 shocks of 1 to 3 g, 3 are needed",
        "to fit: 0 shocks of 3 g and more, 3 are needed",
    ]
    assert missing([case([1.5, 2.0, 2.0]), case([4.0, 5.0, 5.0])], "to fit", FloorSettings(road_s=20.0)) == []


def test_the_papers_windows_carry_no_verdict() -> None:
    """4 to 6 s less 2 of warm-up, three of a kind."""
    windows = [case([1.5], seconds=6.0)] * 3
    assert any("without shocks" in line for line in missing(windows, "to fit"))


def test_a_seat_that_would_have_to_hold_somebody_down_is_seen() -> None:
    """Against the force from the paper's matrices, by another integrator."""
    seat = fitting.seat_motion("rail", 4.0, 2)
    theta = SUBJECT.parameters.vector()
    M = naive.chain_matrices(theta, SUBJECT.body_mass_kg, "segment")[0]
    accel = naive.chain_response(theta, SUBJECT.body_mass_kg, "segment", seat, RATE_HZ)
    made = fitting.ready(seat, accel, "rail")
    # All that pushes the six segments comes from the seat, but for the Rayleigh part, which holds on to nothing.
    found = pulled_down(SUBJECT, made)
    rayleigh = SUBJECT.parameters.rayleigh_rad_per_s
    relative = np.cumsum(accel - seat[:, None], axis=0) / RATE_HZ
    tension = -(accel @ np.diag(M) + rayleigh * relative @ np.diag(M))
    assert found == pytest.approx(tension.max() / (9.80665 * np.trace(M)), rel=0.03)
    assert found > 1.0


def test_a_quiet_road_lifts_nobody_and_lift_off_is_no_omission_twice() -> None:
    seat = 0.1 * fitting.seat_motion("road", 6.0, 1)
    quiet = dataclasses.replace(fitting.true_cases("segment")[0], seat_mps2=seat)
    assert 0.0 < pulled_down(SUBJECT, quiet) < 0.5
    assert pulled_down(dataclasses.replace(SUBJECT, effects=(applied("lift_off"),)), quiet) == 0.0
