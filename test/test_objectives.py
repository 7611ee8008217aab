"""The two objectives, their derivatives, and the kernels below them."""

import dataclasses

import fitting
import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS
from biodyn_core.body.constants import Constants
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import LOWER, UPPER
from biodyn_core.identification import objectives
from biodyn_core.identification.objectives import (
    PENALTY,
    RegularizationTerm,
    Surrogate,
    SurrogateSettings,
    TimeDomain,
)
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import SEGMENT_WEIGHTS
from biodyn_core.kernels import compiling, cost, surrogate
from biodyn_core.kernels.cost import LANES

WEIGHTS = (0.5, 0.2, 0.8, 2.5, 3.0)
"""Of Eq. 31, as its text has them, pelvis to head."""

DATA_ONLY = RegularizationTerm(np.ones(15), 0.0)
FREE = np.arange(15) < 14


def points(count: int, seed: int = 0) -> np.ndarray:
    """Points all over Table 1, (count, 15)."""
    return LOWER + (UPPER - LOWER) * np.random.default_rng(seed).uniform(0.05, 0.95, (count, 15))


# --- Eq. 31 ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mass_matrix", fitting.MASS_MATRICES)
def test_surrogate_is_the_dense_sum(mass_matrix) -> None:
    cases = fitting.true_cases(mass_matrix)[:2]
    theta = points(3)
    theta[:, 13:] = 0.0, 1.0
    reference = fitting.drawn(9, mass_matrix).parameters
    found = Surrogate(cases, mass_matrix, SurrogateSettings(0.3, WEIGHTS, reference)).costs(np.log(theta[:, :13]))
    for row, value in zip(theta, found, strict=True):
        expected = 0.3 * (np.log(row[:13] / reference.vector()[:13]) ** 2).sum()
        for case in cases:
            h = naive.transfer_functions(row, 70.0, mass_matrix, case.frequency_hz)
            t = 1.0 - ((2.0 * np.pi * case.frequency_hz) ** 2)[:, None] * h
            misses = np.abs(t[:, MEASURED_SEGMENT_INDEX]) - case.transmissibility
            expected += (np.array(WEIGHTS) * case.coherence * misses**2).sum()
        assert value == pytest.approx(expected, rel=1e-11)


def test_surrogate_settings_are_checked() -> None:
    assert tuple(SEGMENT_WEIGHTS) == MEASURED_SEGMENTS
    assert SurrogateSettings().segment_weights == WEIGHTS
    with pytest.raises(InputError, match="segment_weights"):
        SurrogateSettings(segment_weights=(1.0, 2.0))
    with pytest.raises(InputError, match="lambda_1"):
        SurrogateSettings(lambda_1=float("nan"))


# --- Eq. 33 ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mass_matrix", fitting.MASS_MATRICES)
def test_constants_of_many_per_kg_are_those_of_each_chain(mass_matrix) -> None:
    theta, kg = points(3), 81.5
    many = Constants.of(theta, 1.0, mass_matrix)
    for row, one in enumerate(theta):
        chain = Chain.of_theta(one, kg, mass_matrix)
        for name in ("mass_kg", "inertia_kg", "stiffness_n_per_m", "damping_n_s_per_m"):
            np.testing.assert_allclose(kg * getattr(many, name)[row], getattr(chain, name), rtol=1e-14)
        np.testing.assert_array_equal(many.stiffening_per_m[row], chain.stiffening_per_m)
        assert many.rayleigh_rad_per_s[row] == chain.rayleigh_rad_per_s


@pytest.mark.parametrize("mass_matrix", fitting.MASS_MATRICES)
def test_the_cost_of_the_truth_of_another_integrator_is_zero(mass_matrix) -> None:
    cases, theta = fitting.true_cases(mass_matrix), fitting.theta_of(fitting.true_subjects()[mass_matrix])
    problem = TimeDomain(cases, fitting.drawn(0, mass_matrix), DATA_ONLY)
    assert problem.cost(theta) < 1e-8
    residuals, _ = problem.linearised(theta, FREE)
    assert residuals @ residuals < 1e-8


def test_cost_is_equation_33() -> None:
    cases = fitting.true_cases("segment")
    subject, reference = fitting.drawn(8, "segment"), fitting.theta_of(fitting.drawn(9, "segment"))
    theta = fitting.theta_of(subject)
    expected = {
        "physical": 0.01 * ((theta - reference) ** 2).sum(),
        "log": 0.01 * (np.log(theta / reference) ** 2).sum(),
    }
    misses = 0.0
    for case, recording in zip(cases, fitting.true_recordings()["segment"], strict=True):
        every = Chain.of(subject).simulate(recording.seat_mps2, recording.rate_hz).accel_mps2
        answer = every[:, MEASURED_SEGMENT_INDEX]
        behind = slice(round(2.0 * recording.rate_hz), None)
        misses += (
            ((answer - recording.measured_mps2)[behind] ** 2).sum(0) / (recording.measured_mps2[behind] ** 2).sum(0)
        ).sum()
        assert case.name == recording.name
    for regularization, pull in expected.items():
        problem = TimeDomain(cases, fitting.drawn(0, "segment"), RegularizationTerm(reference, 0.01, regularization))
        assert problem.cost(theta) == pytest.approx(misses + pull, rel=1e-5)  # the one steps twice where the other does


def test_batches_and_single_points_agree() -> None:
    problem = TimeDomain(fitting.true_cases("cascade"), fitting.drawn(0, "cascade"), RegularizationTerm(points(1)[0]))
    theta = points(LANES + 3)
    np.testing.assert_allclose(problem.costs(theta), [problem.cost(row) for row in theta], rtol=1e-12)
    assert problem.evaluations == 2 * len(theta) * len(problem.cases)  # simulations of a case
    count = len(MEASURED_SEGMENTS)
    none = np.empty((0, count))
    accel = np.empty((problem.cases[0].seat_mps2.size, count, LANES))
    problem._lanes(0, theta[:LANES], none, none, accel)
    for lane, row in enumerate(theta[:LANES]):
        # Per kg the one, with the body's mass the other: rounding is all that is between them.
        np.testing.assert_allclose(accel[:, :, lane], problem.accelerations(0, row), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("clocks", ["trusted", "estimated"])
def test_the_linearised_cost_represents_all_samples(clocks) -> None:
    cases = fitting.true_cases("segment")[:2]
    problem = TimeDomain(cases, fitting.drawn(0, "segment"), RegularizationTerm(points(1)[0], 0.01, "log"), clocks)
    theta = points(1, 4)[0]
    residuals, slopes = problem.linearised(theta, FREE)
    rows = np.concatenate([problem.rows(n, theta, FREE).reshape(-1, 15) for n in range(2)])
    pull = np.zeros((15, 14))
    pull[:14] = 0.1 * np.eye(14)
    offset = 0.1 * np.log(theta / points(1)[0])
    np.testing.assert_allclose(slopes.T @ slopes, rows[:, :-1].T @ rows[:, :-1] + pull.T @ pull, rtol=1e-5)
    np.testing.assert_allclose(slopes.T @ residuals, rows[:, :-1].T @ rows[:, -1] + pull.T @ offset, rtol=1e-5)
    assert residuals @ residuals == pytest.approx((rows[:, -1] ** 2).sum() + offset @ offset, rel=1e-10)
    if clocks == "trusted":
        assert residuals @ residuals == pytest.approx(problem.cost(theta), rel=1e-10)


def test_derivatives_are_those_of_another_integrator() -> None:
    """Central differences of DOP853, whose step and error have nothing to do with ours."""
    seat = fitting.seat_motion("pothole", 2.6, 5)
    theta, step = fitting.theta_of(fitting.drawn(3, "segment")), 1e-3
    case = fitting.ready(seat, np.ones((seat.size, 5)) + seat[:, None])
    rows = TimeDomain([case], fitting.drawn(0, "segment"), DATA_ONLY).rows(0, theta, FREE)
    moved = theta * np.exp(step * np.concatenate([np.eye(15)[:14], -np.eye(15)[:14]]))
    answers = naive.chain_responses([(row, 70.0, "segment") for row in moved], seat, fitting.RATE_HZ, rtol=1e-8)
    slopes = (answers[:14] - answers[14:])[:, case.begin :, MEASURED_SEGMENT_INDEX] / (2.0 * step)
    expected = np.moveaxis(slopes / np.sqrt(case.energy), 0, 2)
    for p in range(14):
        assert np.linalg.norm(rows[..., p] - expected[..., p]) < 1e-4 * np.linalg.norm(expected[..., p])


def test_mass_scale_cancels() -> None:
    problem = TimeDomain(fitting.true_cases("segment"), fitting.drawn(0, "segment"), DATA_ONLY)
    light, heavy = points(1)[0], points(1)[0]
    light[14], heavy[14] = 0.85, 1.15
    for number in range(3):
        assert np.abs(problem.accelerations(number, light) - problem.accelerations(number, heavy)).max() < 1e-10


@settings(max_examples=10)
@given(st.integers(1300, 2300), st.integers(1, 400), st.integers(0, 4))
def test_masked_samples_have_no_effect(begin: int, length: int, segment: int) -> None:
    recording = fitting.true_recordings()["segment"][1]
    masked = recording.measured_mps2.copy()
    masked[begin : begin + length, segment] = np.nan
    case = Case.of(dataclasses.replace(recording, measured_mps2=masked), fitting.SPECTRUM, fitting.LINES)
    theta = points(1, 2)[0]
    answer = TimeDomain([case], fitting.drawn(0, "segment"), DATA_ONLY).accelerations(0, theta)
    misses = (answer - masked)[case.begin :]
    expected = (np.nansum(misses**2, axis=0) / np.nansum(masked[case.begin :] ** 2, axis=0)).sum()
    assert TimeDomain([case], fitting.drawn(0, "segment"), DATA_ONLY).cost(theta) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("factor", [1e5, 1e160])
def test_a_divergent_response_is_a_penalty_counted_by_cause(factor: float) -> None:
    """A seat motion so strong that the chain diverges, and one whose squares overflow."""
    case = fitting.true_cases("segment")[0]
    wild = dataclasses.replace(case, seat_mps2=factor * case.seat_mps2)
    problem = TimeDomain([wild], fitting.drawn(0, "segment"), DATA_ONLY)
    assert problem.costs(points(2)).tolist() == [PENALTY, PENALTY]
    assert problem.cost(points(1)[0]) == PENALTY
    assert not np.isfinite(problem.linearised(points(1)[0], FREE)[0]).any()
    assert sum(problem.penalties.values()) == 4 and set(problem.penalties) <= {"diverged", "not a number"}


def test_clock_offset_and_drift_are_found_at_zero_cost() -> None:
    """A band-limited answer read late, by its spectrum, so that no interpolation of ours is trusted."""
    late_s, slow = np.array([2e-4, -1e-4, 0.0, 3e-4, -2e-4]), np.array([5e-5, 0.0, -5e-5, 2e-5, 0.0])
    recording = fitting.true_recordings()["segment"][0]
    time_s = np.arange(recording.seat_mps2.size) / recording.rate_hz
    middle_s = 0.5 * (round(2.0 * recording.rate_hz) / recording.rate_hz + time_s[-1])
    measured = np.empty_like(recording.measured_mps2)
    for s in range(5):
        delay = late_s[s] + slow[s] * (time_s - middle_s)
        slope = np.gradient(recording.measured_mps2[:, s], time_s)
        measured[:, s] = recording.measured_mps2[:, s] - delay * slope
    case = Case.of(dataclasses.replace(recording, measured_mps2=measured), fitting.SPECTRUM, fitting.LINES)
    theta = fitting.theta_of(fitting.true_subjects()["segment"])
    estimated = TimeDomain([case], fitting.drawn(0, "segment"), DATA_ONLY, "estimated")
    found = estimated.clock_delays_s(0, theta)
    np.testing.assert_allclose(found[:, 0], late_s, atol=2e-6)
    np.testing.assert_allclose(found[:, 1], slow, atol=5e-6)
    residuals, _ = estimated.linearised(theta, FREE)
    assert residuals @ residuals < 1e-3 * TimeDomain([case], fitting.drawn(0, "segment"), DATA_ONLY).cost(theta)


# --- kernels --------------------------------------------------------------------------------------------------------


def test_difference_quotients_are_those_of_numpy_compiled_and_plain() -> None:
    given = np.random.default_rng(4).standard_normal((7, 5, 4))
    given[0, 0] = 3.0
    expected = np.concatenate([(given[:, :, :-1] - given[:, :, -1:]) / 0.25, given[:, :, -1:]], axis=2)
    for kernel in (cost.difference_quotients, getattr(cost.difference_quotients, "py_func", None)):
        if kernel is not None:
            found = given.copy()
            kernel(found, 0.25)
            np.testing.assert_array_equal(found, expected)


@pytest.mark.skipif(not compiling.COMPILED, reason="numba is not there: everything is plain already")
def test_compiled_and_plain_kernels_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    seat = fitting.seat_motion("pothole", 2.3, 1)[1320:1360]
    count = len(MEASURED_SEGMENTS)
    recording = fitting.recording(np.tile(seat, 45), np.tile(seat, 45)[:, None] * np.ones(count))
    case = Case.of(recording, fitting.SPECTRUM, fitting.LINES)
    short = dataclasses.replace(
        case, seat_mps2=seat, measured_mps2=case.measured_mps2[:40], compared=np.ones((40, count), dtype=bool)
    )

    def answers() -> list[np.ndarray]:
        problem = TimeDomain([short], fitting.drawn(0, "segment"), DATA_ONLY)
        accel, none = np.empty((40, count, LANES)), np.empty((0, count))
        problem._lanes(0, points(3), none, none, accel)
        return [problem.costs(points(3)), accel, Surrogate([case], "segment").costs(np.log(points(2)[:, :13]))]

    compiled = answers()
    for module in (cost, surrogate):
        for name, value in vars(module).items():
            if hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, value.py_func)
    monkeypatch.setattr(objectives, "integrate_lanes", cost.integrate_lanes)
    monkeypatch.setattr(objectives, "surrogate_costs", surrogate.surrogate_costs)
    for fast, slow in zip(compiled, answers(), strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-11)
