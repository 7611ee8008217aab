"""Fits with published groups of people as prior: the maximum a posteriori, its weights, and what users see of it."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from functools import cache
from pathlib import Path

import fitting
import naive
import numpy as np
import pytest
from streams import simulated

from biodyn_core.base.errors import InputError
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import MEASURED_SEGMENTS, SEGMENTS
from biodyn_core.body.origin import origin_of
from biodyn_core.body.parameters import LOWER, STIFFENING, UNFITTED, UPPER, Parameters
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.fit import Fit, fit_joint
from biodyn_core.identification.identify import identify
from biodyn_core.identification.objectives import PriorTerm, RegularizationTerm, TimeDomain
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.posterior import (
    independent_samples,
    maximum_a_posteriori,
    parameters_known,
    prior_of,
)
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings, UncertaintySettings
from biodyn_core.identification.uncertainty import covariance_of, uncertainty
from biodyn_core.population.distribution import SPREAD, Distribution, places_of, theta_of
from biodyn_core.population.population import new_subject, population
from biodyn_ros.commands.cli import main

QUICK = FitSettings(swarm=SwarmSettings(particles=12, iterations=20, starts=2), refined_starts=1, evaluations=400)
SMALL = [
    "--particles", "12", "--iterations", "10", "--starts", "1", "--refined-starts", "1", "--evaluations", "60",
    "--no-report", "--executor", "none",
]  # fmt: skip
GIVEN = Subject("anna", 70.0, 1.75, "segment", UNFITTED)
PRIOR = population().without_softening
HEAD_ALONE = np.array([name == "head" for name in MEASURED_SEGMENTS])
NOISE_MPS2 = 0.02


@cache
def people() -> tuple[Subject, ...]:
    """Two people of the population."""
    drawn = PRIOR.draw(np.random.default_rng(2), 2)
    drawn[:, STIFFENING] = 0.3
    return tuple(Subject("drawn", 70.0, 1.75, "segment", Parameters.from_vector(theta)) for theta in drawn)


@cache
def recorded(case: str, seconds: float) -> tuple[Case, ...]:
    """The same motion of both, integrated by DOP853 from full matrices, with white noise in every sensor."""
    seat, rng = fitting.seat_motion(case, seconds, 5), np.random.default_rng(6)
    bodies = [(fitting.theta_of(one), one.body_mass_kg, one.mass_matrix) for one in people()]
    answers = naive.chain_responses(bodies, seat, fitting.RATE_HZ, rtol=1e-8)
    noise = NOISE_MPS2 * rng.normal(size=(len(bodies), *answers[0].shape))
    return tuple(fitting.ready(seat, accel + one, case) for accel, one in zip(answers, noise, strict=True))


def of_head(case: Case) -> Case:
    """A case of the head's sensor alone."""
    compared = case.compared & HEAD_ALONE
    return dataclasses.replace(
        case, compared=compared, measured_mps2=np.where(compared, case.measured_mps2, 0.0),
        energy=case.energy * HEAD_ALONE, transmissibility=case.transmissibility * HEAD_ALONE,
        coherence=case.coherence * HEAD_ALONE,
    )  # fmt: skip


def parameter_error(fit: Fit, truth: Subject) -> float:
    return float(np.sqrt(np.mean(np.log(fit.refined.theta / fitting.theta_of(truth))[SPREAD] ** 2)))


@cache
def fits_of_the_head(number: int) -> tuple[Fit, Fit, Case]:
    """One person, 2 s of the head alone after the warm-up: without and with prior."""
    case = of_head(recorded("road", 4.0)[number])
    alone = fit_joint([case], GIVEN, 1, QUICK)
    return alone, maximum_a_posteriori(alone, [case], PRIOR), case


def test_independent_samples_of_white_noise_and_of_a_first_order_process() -> None:
    """An autoregressive process has rho_k = a^|k|, so n (1 - a^2) / (1 + a^2) samples."""
    rng, a, count = np.random.default_rng(0), 0.9, 40_000
    white = rng.normal(size=count)
    assert independent_samples(white, 300) == pytest.approx(count, rel=0.05)
    process = np.zeros(count)
    for k in range(1, count):
        process[k] = a * process[k - 1] + white[k]
    assert independent_samples(process, 300) == pytest.approx(count * (1 - a**2) / (1 + a**2), rel=0.1)
    assert independent_samples(np.zeros(8), 4) == 8.0


def test_deviations_of_drawn_people_are_independent_and_of_unit_variance() -> None:
    deviations = PRIOR.standardized(PRIOR.draw(np.random.default_rng(1), 4000))
    wide = np.abs(PRIOR.mean) < 4.0  # the others are often so near to a bound that their place is linear
    np.testing.assert_allclose(np.cov(deviations[:, wide].T), np.eye(wide.sum()), atol=0.12)
    theta = theta_of(PRIOR.mean)
    term = PriorTerm(PRIOR, 0.5, 0.2)
    assert (term(theta) ** 2).sum() == pytest.approx(0.1 * PRIOR.distance(theta) ** 2, abs=1e-12)
    small = theta_of(PRIOR.mean + np.linalg.cholesky(PRIOR.covariance) @ np.full(13, 1e-3))
    assert (term(small)[wide] ** 2).sum() <= 0.1 * 13e-6 * 1.01
    np.testing.assert_allclose(term.variances(theta)[SPREAD], np.diag(PRIOR.spread.covariance) / 0.2, rtol=1e-9)
    assert np.isinf(term.variances(theta)[STIFFENING:]).all()


def test_a_fixed_mass_scale_on_its_bound_stays_there_with_a_prior() -> None:
    light = dataclasses.replace(GIVEN, parameters=dataclasses.replace(GIVEN.parameters, mass_scale=0.85))
    few = dataclasses.replace(QUICK, refined_starts=1, evaluations=60)
    case = of_head(recorded("road", 4.0)[0])
    alone = fit_joint([case], light, 1, few)
    fit = maximum_a_posteriori(alone, [case], PRIOR)
    assert fit.subject.parameters.mass_scale == 0.85


def test_few_data_of_people_of_the_population_give_better_parameters_with_the_prior() -> None:
    for number, truth in enumerate(people()):
        alone, found, _ = fits_of_the_head(number)
        assert parameter_error(found, truth) < 0.7 * parameter_error(alone, truth)
        assert found.prior is not None and found.settings == alone.settings
        assert found.refined.costs.size == 2 and 1 <= found.reached <= 2  # from the fit and from the mean of the prior


def test_ample_data_hardly_notice_the_prior() -> None:
    """Also of a body that is far from the population."""
    cases = fitting.true_cases("segment")
    elsewhere = fit_joint(cases, GIVEN, 1, QUICK)
    found = maximum_a_posteriori(elsewhere, cases, PRIOR)
    np.testing.assert_allclose(found.refined.theta, elsewhere.refined.theta, rtol=5e-3)
    assert found.prior is not None and found.prior.scale < 0.1
    assert found.error_percent <= 1.05 * elsewhere.error_percent


def test_the_maximum_is_that_of_the_linear_problem_near_the_fit() -> None:
    """A narrow prior near the fit: theta is the mean of both, weighted by their information."""
    case = recorded("road", 4.0)[0]
    alone = fit_joint([case], GIVEN, 1, QUICK)
    theta, free = alone.refined.theta, alone.settings.free
    away = theta * np.exp(0.004 * np.where(np.arange(15) % 2, 1.0, -1.0))
    near = Distribution(places_of(away), 1e-4 * np.eye(13))
    found = maximum_a_posteriori(alone, [case], near)
    term, data = found.prior, alone.objective([case])
    assert term is not None
    at = found.refined.theta
    slopes, penalty = data.linearised(at, free)[1], TimeDomain([case], GIVEN, term).term_slopes(at, free)
    residual = data.linearised(at, free)[0]
    gradient = slopes.T @ residual + penalty.T @ term(at)
    curvature = slopes.T @ slopes + penalty.T @ penalty
    # The step to the minimum of the whole quadratic form is nothing, and a part of the way to the prior's mean is gone.
    assert np.abs(np.linalg.solve(curvature, gradient)).max() < 1e-3
    assert 0.05 < near.distance(at) / near.distance(theta) < 0.95


@pytest.mark.slow
def test_the_covariance_is_that_of_data_and_prior_together() -> None:
    """White noise: (H / variance + precision of the prior)^-1; the scatter of the data is estimated by windows."""
    case, truth = recorded("road", 6.0)[1], people()[1]
    alone = fit_joint([case], truth, 1, QUICK)
    found = maximum_a_posteriori(alone, [case], PRIOR)
    assert found.prior is not None
    theta, free = found.refined.theta, found.settings.free
    found_covariance, _ = covariance_of(found.objective([case]), theta, free, UncertaintySettings(cross_axis=0.0))
    slopes = alone.objective([case]).linearised(theta, free)[1]
    penalty = found.objective([case]).term_slopes(theta, free)
    expected = np.linalg.inv((slopes.T @ slopes + penalty.T @ penalty) / found.prior.variance)
    ratio = np.sqrt(np.diag(found_covariance) / np.diag(expected))
    assert np.all((ratio[SPREAD] > 0.4) & (ratio[SPREAD] < 2.0))


@pytest.mark.parametrize("place", [0.5, 0.02, 0.003, 0.0])
def test_the_variance_of_the_prior_alone_is_that_of_its_residuals(place: float) -> None:
    """(S' S)^-1 of the slopes S of the residuals, by differences; also so near to a bound that places are linear."""
    term = PriorTerm(PRIOR, 0.7, 2.0)
    theta = theta_of(PRIOR.mean)
    theta[3] = LOWER[3] * (UPPER[3] / LOWER[3]) ** place
    step = 1e-6
    moved = [term(theta * np.exp(step * axis)) for axis in np.eye(15)[SPREAD]]
    slopes = (np.array(moved) - term(theta)).T / step
    expected = np.diag(np.linalg.inv(slopes.T @ slopes / term.variance))
    np.testing.assert_allclose(term.variances(theta)[SPREAD], expected, rtol=1e-4)


def test_parameters_that_the_data_leave_open_have_the_spread_of_the_prior_and_are_called_so() -> None:
    alone, found, case = fits_of_the_head(1)
    estimates = uncertainty(found, [case]).estimates
    open_ones = [one for one in estimates if one.identifiability == "from the prior"]
    assert len(open_ones) >= 4 and not any(
        one.identifiability == "from the prior" for one in uncertainty(alone, [case]).estimates
    )
    assert found.prior is not None
    spread = NORMAL_95 * np.sqrt(found.prior.variances(found.refined.theta))
    for place, one in enumerate(estimates):
        if one in open_ones:
            assert 0.6 * spread[place] < one.half_width < 1.1 * spread[place]


def test_the_number_of_known_parameters_falls_with_the_weight_of_the_prior() -> None:
    case, theta = recorded("road", 4.0)[0], fitting.theta_of(people()[0])
    free = QUICK.free
    known = [
        parameters_known(TimeDomain([case], GIVEN, PriorTerm(PRIOR, weight, 1.0)), theta, free)
        for weight in (1e-12, 1e-3, 1e6)
    ]
    assert known[0] > 13.5 > known[1] > known[2] and known[2] < 2.0
    without = TimeDomain([case], GIVEN, RegularizationTerm(theta, 0.0))
    assert parameters_known(without, theta, free) == pytest.approx(14.0)


def test_an_identification_keeps_the_fit_without_prior_for_comparisons() -> None:
    cases = [of_head(recorded("road", 4.0)[0])]
    few = dataclasses.replace(QUICK, swarm=SwarmSettings(particles=8, iterations=5, starts=1), evaluations=30)
    found = identify(cases, GIVEN, 1, dataclasses.replace(few, prior="population"))
    plain = identify(cases, GIVEN, 1, few)
    assert found.without_prior.subject == plain.joint.subject != found.joint.subject == found.subject
    assert plain.joint is plain.without_prior and plain.joint.prior is None
    assert found.better_mass_matrix(cases) == plain.better_mass_matrix(cases)


def test_a_model_with_thixotropy_has_the_parameters_at_rest_as_prior() -> None:
    settings = dataclasses.replace(QUICK, prior="population")
    assert prior_of(GIVEN, QUICK) is None
    assert prior_of(GIVEN, settings) is population().without_softening
    assert prior_of(new_subject("new", 75.0, 1.75), settings) is population().at_rest
    with pytest.raises(InputError, match=r"mass_matrix segment, anna has cascade"):
        prior_of(dataclasses.replace(GIVEN, mass_matrix="cascade"), settings)
    with pytest.raises(InputError, match="only the joint result has a prior"):
        prior_of(GIVEN, dataclasses.replace(settings, result="idealized"))


def softened(sites: tuple[str, ...], softening: float) -> Subject:
    values = {**population().softening, "softening": softening}
    effects = tuple(AppliedEffect(CATALOGUE["thixotropy"], site, values) for site in sites)
    return dataclasses.replace(GIVEN, effects=effects)


def test_a_thixotropy_without_strength_softens_nothing_and_another_one_has_no_prior() -> None:
    """The parameters at rest belong to the population's own softening: the head's frequency is 1.5 times higher."""
    settings = dataclasses.replace(QUICK, prior="population")
    own = population().softening["softening"]
    assert prior_of(softened(SEGMENTS, 0.0), settings) is population().without_softening
    assert prior_of(softened(SEGMENTS, own), settings) is population().at_rest
    for other in (softened(SEGMENTS, 0.1), softened(("pelvis",), own)):
        with pytest.raises(InputError, match="thixotropy of biodyn subject new, or none, anna has another"):
            prior_of(other, settings)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return simulated(tmp_path_factory.mktemp("bags"), 3.0, {"road": "road", "spare": "rail"})


def unfitted(directory: Path, mass_matrix: str) -> Path:
    path = directory / f"{mass_matrix}.yaml"
    path.write_text(
        f"schema: 1\nname: anna\nbody_mass_kg: 70\nstature_m: 1.75\nmass_matrix: {mass_matrix}\n", encoding="utf-8"
    )
    return path


def test_fit_with_a_prior_writes_and_says_it(
    bags: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, output = unfitted(tmp_path, "segment"), tmp_path / "anna_fitted.yaml"
    words = ["fit", str(bags["road"]), "--subject", str(given), "--hold-out", str(bags["spare"]), "-o", str(output)]
    assert main([*words, "--prior", "population", *SMALL]) == 0
    text = capsys.readouterr().out
    assert "joint without prior" in text and "prior: published groups of people; the result is" in text
    document = json.loads((tmp_path / "anna_fitted.fit.json").read_text(encoding="utf-8"))
    prior = document["prior"]
    assert prior["name"] == "population" == document["settings"]["prior"] and prior["distance"] > 0.0
    assert prior["without"]["parameters"] != document["parameters"]
    assert document["held_out"][0]["without_prior"]["mean"] > 0.0
    joint = document["joint"]
    assert min(joint["starts"]["objectives"]) == joint["objective"]  # of one objective, that with the prior
    fitted = load_subject(output)
    assert fitted.provenance["prior"] == "population" and origin_of(fitted) == "person"


@pytest.mark.parametrize(
    ("mass_matrix", "options", "words"),
    [
        ("cascade", (), "mass_matrix segment, anna has cascade"),
        ("segment", ("--result", "idealized"), "only the joint result"),
        ("segment", ("--prior", "group"), "'group' is not one of none, population"),
    ],
)
def test_a_prior_that_cannot_be_is_refused_before_the_work(
    mass_matrix: str, options: tuple[str, ...], words: str, bags: dict[str, Path], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    given = unfitted(tmp_path, mass_matrix)
    command = ["fit", str(bags["road"]), "--subject", str(given), "-o", str(tmp_path / "out.yaml")]
    with pytest.raises(SystemExit) if "--prior" in options else contextlib.nullcontext():
        assert main([*command, "--prior", "population", *options]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [given.name]
