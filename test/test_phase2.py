"""Phase 2 and whole fits: both refiners recover drawn truths from simulations by another integrator."""

import dataclasses

import fitting
import numpy as np
import pytest
from scipy import signal

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.fit import Fit, at_bound, fit_cases, fit_joint, search_all
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.phase2 import exchanged, interior, least_squares, nelder_mead, refine, trust_region
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import PAPER, FitSettings

QUICK = FitSettings(swarm=SwarmSettings(particles=30, iterations=60, starts=2), refined_starts=2)
SEVERAL = dataclasses.replace(QUICK, refined_starts=4)
ONE = dataclasses.replace(QUICK, clocks="trusted", refined_starts=1, swarm=SwarmSettings(particles=10, iterations=5))
FREE = FitSettings().free


@pytest.mark.parametrize("mass_matrix", fitting.MASS_MATRICES)
def test_a_drawn_subject_is_recovered_from_three_cases(mass_matrix) -> None:
    """Without noise the pull of lambda_2 = 1e-6 remains."""
    truth = fitting.true_subjects()[mass_matrix]
    stranger = dataclasses.replace(truth, parameters=fitting.drawn(40, mass_matrix).parameters)
    fit = fit_joint(fitting.true_cases(mass_matrix), stranger, seed=1, settings=SEVERAL)
    np.testing.assert_allclose(fitting.theta_of(fit.subject), fitting.theta_of(truth), rtol=5e-3)
    np.testing.assert_allclose(fit.subject.parameters.natural_frequency_hz, truth.parameters.natural_frequency_hz, 5e-4)
    assert fit.error_percent < 0.05 and fit.at_bound == () and fit.refined.penalties.total() == 0
    assert fit.reached >= 2
    assert fit.refined.costs.tolist() == sorted(fit.refined.costs) and fit.refined.costs[0] == fit.refined.objective
    assert [error.case for error in fit.errors] == ["road", "pothole", "rail"]
    assert np.abs(fit.clock_delays_s[:, :, 0]).max() < 5e-6
    assert fit.subject.name == truth.name and fit.subject.mass_matrix == mass_matrix


def test_one_case_recovers_its_observable_parameters() -> None:
    truth = fitting.true_subjects()["segment"]
    for fit in fit_cases(fitting.true_cases("segment")[1:], truth, seed=1, settings=QUICK):
        np.testing.assert_allclose(
            fit.subject.parameters.natural_frequency_hz, truth.parameters.natural_frequency_hz, rtol=0.01
        )
        assert len(fit.errors) == 1 and fit.error_percent < 0.1


def test_a_deeper_minimum_with_the_joints_of_the_central_torso_exchanged_is_found() -> None:
    """... where the chain does not fit: the lower torso's sensor sits on a pad that passes 8 Hz."""
    truth, pad = fitting.true_subjects()["segment"], signal.butter(2, 8.0, fs=fitting.RATE_HZ, output="sos")
    cases = []
    for one in fitting.true_recordings()["segment"]:
        soft = one.measured_mps2.copy()
        soft[:, 1] = signal.sosfilt(pad, soft[:, 1])
        cases.append(fitting.ready(one.seat_mps2, soft, one.case))
    theta = fitting.theta_of(truth)
    searches = [dataclasses.replace(search_all(cases[:1], truth, 1, ONE)[0], theta=theta[None, :13])]
    found = refine(cases, truth, searches, ONE)
    problem = TimeDomain(cases, truth, RegularizationTerm(theta, 0.0))
    _, nearest = least_squares(problem, theta, ONE.free, ONE.evaluations)
    assert found.objective < 0.92 * nearest
    order = [0, 1, 3, 2, 4, 5, 6, 7, 9, 8, 10, 11, 12, 13, 14]
    np.testing.assert_array_equal(exchanged(theta), np.clip(theta[order], LOWER, UPPER))


def test_equal_seeds_give_equal_fits() -> None:
    cases, subject = fitting.true_cases("segment")[:1], fitting.true_subjects()["segment"]
    first, again, other = (fit_joint(cases, subject, seed, QUICK) for seed in (3, 3, 4))
    assert first.subject == again.subject and first.refined.costs.tolist() == again.refined.costs.tolist()
    assert first.refined.costs.tolist() != other.refined.costs.tolist()


def test_pooled_search_is_one_of_all_cases() -> None:
    cases, subject = fitting.true_cases("segment"), fitting.true_subjects()["segment"]
    pooled = dataclasses.replace(QUICK, phase1="pooled", refined_starts=1)
    assert [len(search_all(cases, subject, 1, s)) for s in (QUICK, pooled)] == [3, 1]
    fits = fit_cases(cases, subject, 1, pooled)
    assert len({fit.subject.parameters for fit in fits}) == 3


def test_both_refiners_find_the_same_optimum() -> None:
    """A noisy case, so that the optimum is not at zero and not at the truth; a simplex of 8 parameters is quick."""
    free = FREE & (np.arange(FREE.size) < 8)
    case, theta = noisy("pothole"), fitting.theta_of(fitting.true_subjects()["segment"])
    problem = TimeDomain([case], fitting.drawn(0, "segment"), RegularizationTerm(theta, 1e-6, "log"))
    start = theta * np.where(free, 1.1, 1.0)
    by_squares, least = least_squares(problem, start, free, 3000)
    by_simplex, lowest = nelder_mead(problem, start, free, 6000)
    assert 1e-5 < least < problem.cost(theta)
    assert lowest == pytest.approx(least, rel=1e-3)
    np.testing.assert_allclose(by_simplex[:6], by_squares[:6], rtol=0.01)
    assert least == pytest.approx(problem.cost(by_squares), rel=1e-9)


def test_a_point_where_the_response_is_not_finite_is_left_without_a_warning() -> None:
    """The first step of arctan(x - 2) from 4 ends at 0, below 1; there slopes are infinite and the map has zeros."""
    rejected = []

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        x = point - 2.0
        if point[0] < 1.0:
            rejected.append(float(point[0]))
            return np.full(1, np.inf), np.full((1, 1), np.inf) * np.zeros(1)
        return np.arctan(x), np.atleast_2d(1.0 / (1.0 + x * x))

    end, objective = trust_region(linearised, np.array([4.0]), 100)
    assert rejected and end == pytest.approx([2.0], abs=1e-6) and objective < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_starts_on_the_bounds_are_left(side: str) -> None:
    """The start that ended 194 of 200 fits of an older SciPy where they began."""
    cases, subject = fitting.true_cases("segment")[1:2], fitting.true_subjects()["segment"]
    searches = search_all(cases, subject, 1, QUICK)
    corner = (LOWER if side == "lower" else UPPER)[:13]
    stuck = [dataclasses.replace(searches[0], theta=corner[None, :].copy(), costs=np.ones(1))]
    for settings in (QUICK, dataclasses.replace(QUICK, refine="nelder-mead", clocks="trusted")):
        fit = Fit.of(refine(cases, subject, stuck, settings), cases, subject, settings)
        problem = fit.objective(cases)
        assert problem.cost(fitting.theta_of(fit.subject)) < 0.2 * problem.cost(fit.refined.reference)


def test_the_regularisation_of_the_paper_biases_its_result() -> None:
    """Eq. 33 with lambda_2 = 0.002 in physical units: 1 Hz from the start costs as much as 2 % rms in five segments."""
    cases, truth = fitting.true_cases("segment")[1:2], fitting.true_subjects()["segment"]
    swarm = SwarmSettings(particles=30, iterations=60, starts=1, polish=False)
    fit = fit_joint([cases[0]], truth, seed=1, settings=dataclasses.replace(PAPER, swarm=swarm, evaluations=1000))
    found = fitting.theta_of(fit.subject)
    pull = 0.002 * ((found - fit.refined.reference) ** 2).sum()
    assert fit.refined.objective == pytest.approx(
        TimeDomain(cases, fitting.drawn(0, "segment"), RegularizationTerm(fit.refined.reference)).cost(found), rel=1e-12
    )
    assert pull > 0.1 * fit.refined.objective > 0.0
    assert fit.clock_delays_s.size == 0 and fit.settings.free.all()
    # Only the regularisation determines m_scale: it pulls it to 1.
    assert found[14] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("mass_scale", [LOWER[14], 1.1, UPPER[14]])
def test_mass_scale_stays_the_subjects(mass_scale: float) -> None:
    """Also on a bound of Table 1: only the start of a fitted parameter is moved off its bound."""
    truth = fitting.true_subjects()["segment"]
    heavy = np.append(fitting.theta_of(truth)[:14], mass_scale)
    subject = dataclasses.replace(truth, parameters=type(truth.parameters).from_vector(heavy))
    fit = fit_joint(fitting.true_cases("segment")[1:2], subject, 1, ONE)
    assert fit.subject.parameters.mass_scale == mass_scale


def test_only_fitted_parameters_are_moved_off_their_bounds() -> None:
    inside = LOWER + 0.02 * (UPPER - LOWER)
    np.testing.assert_array_equal(interior(LOWER, FREE), np.append(inside[:14], LOWER[14]))
    np.testing.assert_array_equal(interior(LOWER, np.ones(15, dtype=bool)), inside)


def test_parameters_on_a_bound_are_named() -> None:
    theta = 0.5 * (LOWER + UPPER)
    theta[1], theta[9], theta[14] = UPPER[1], LOWER[9], UPPER[14]
    assert at_bound(theta, FREE) == ("natural_frequency_hz[lower_torso]", "damping_ratio[upper_torso]")
    assert [p.name for p in PARAMETERS][14] in at_bound(theta, np.ones(15, dtype=bool))


def test_a_truth_beyond_table_1_ends_on_its_bound() -> None:
    seat = fitting.seat_motion("pothole", 4.0, 2)
    inside = fitting.drawn(11, "segment")
    chain = Chain.of(inside)
    stiff = chain.stiffness_n_per_m.copy()
    stiff[5] *= (14.0 / inside.parameters.natural_frequency_hz[5]) ** 2
    damping = chain.damping_n_s_per_m.copy()
    damping[5] *= np.sqrt(stiff[5] / chain.stiffness_n_per_m[5])
    beyond = dataclasses.replace(chain, stiffness_n_per_m=stiff, damping_n_s_per_m=damping)
    case = fitting.ready(seat, beyond.simulate(seat, fitting.RATE_HZ).accel_mps2, "pothole")
    fit = fit_joint([case], inside, seed=1, settings=QUICK)
    assert "natural_frequency_hz[head]" in fit.at_bound
    assert fit.subject.parameters.natural_frequency_hz[5] == pytest.approx(12.0, rel=1e-3)


def test_a_subject_with_an_effect_is_fitted_with_it() -> None:
    """An orifice damper at the pelvis; the subject's file knows of it, or does not."""
    effect = AppliedEffect(CATALOGUE["quadratic_damping"], "pelvis", {"growth_s_per_m": 3.0})
    truth = dataclasses.replace(fitting.drawn(1, "segment"), effects=(effect,))
    seat = fitting.seat_motion("pothole", 5.0, 1)
    case = fitting.ready(seat, Chain.of(truth).simulate(seat, fitting.RATE_HZ).accel_mps2, "pothole")
    knowing, ignorant = (fit_joint([case], s, 1, QUICK) for s in (truth, dataclasses.replace(truth, effects=())))
    assert knowing.subject.effects == (effect,)
    assert knowing.error_percent < 0.1 and ignorant.error_percent > 1.0
    np.testing.assert_allclose(
        knowing.subject.parameters.natural_frequency_hz, truth.parameters.natural_frequency_hz, rtol=5e-3
    )


def test_a_missing_segment_does_not_stop_a_fit() -> None:
    recording = fitting.true_recordings()["segment"][1]
    measured = recording.measured_mps2.copy()
    measured[:, 0] = np.nan
    case = Case.of(dataclasses.replace(recording, measured_mps2=measured), fitting.SPECTRUM, fitting.LINES)
    truth = fitting.true_subjects()["segment"]
    fit = fit_joint([case], truth, seed=1, settings=QUICK)
    assert np.isnan(fit.errors[0].nrmse_rms_percent[0]) and fit.error_percent < 0.2
    assert np.isnan(fit.clock_delays_s[0, 0]).all()


def test_a_chain_that_always_diverges_is_one_line() -> None:
    case = dataclasses.replace(
        fitting.true_cases("segment")[0], seat_mps2=1e160 * fitting.true_cases("segment")[0].seat_mps2
    )
    with pytest.raises(InputError, match="road: the chain diverges from every start"):
        fit_joint([case], fitting.true_subjects()["segment"], 1, QUICK)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"refine": "newton"}, "refine is 'newton', allowed are least-squares and nelder-mead"),
        ({"clocks": "none"}, "clocks is 'none'"),
        ({"lambda_2": -1.0}, "lambda_2 is -1"),
        ({"refined_starts": 0}, "refined_starts is 0"),
        ({"evaluations": 0}, "evaluations is 0"),
    ],
)
def test_settings_are_checked(wrong, expected) -> None:
    with pytest.raises(InputError, match=expected):
        FitSettings(**wrong)


def noisy(case: str) -> Case:
    """One of the true cases with 0.05 m/s^2 of noise on every segment."""
    recording = next(r for r in fitting.true_recordings()["segment"] if r.case == case)
    noise = fitting.low_passed(0.05 * np.random.default_rng(1).standard_normal(recording.measured_mps2.shape))
    assert noise.shape[1] == MEASURED_SEGMENT_INDEX.size
    return Case.of(
        dataclasses.replace(recording, measured_mps2=recording.measured_mps2 + noise), fitting.SPECTRUM, fitting.LINES
    )
