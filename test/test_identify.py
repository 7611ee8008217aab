"""A whole identification: the same numbers however its tasks are run, and each of its statements checked by a twin."""

import dataclasses
import random
from collections.abc import Sequence
from typing import Any

import fitting
import numpy as np
import pytest

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.fit import fit_cases, fit_joint, prediction_errors, predictions
from biodyn_core.identification.held_out import _windows, usual_residual
from biodyn_core.identification.identify import Identification, Task, fingerprint, identify, run_locally
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import PAPER, FitSettings

QUICK = FitSettings(swarm=SwarmSettings(particles=12, iterations=20, starts=2), refined_starts=2, evaluations=250)
FEW = dataclasses.replace(QUICK, swarm=SwarmSettings(particles=8, iterations=5, starts=2), evaluations=30)
"""For what does not depend on how near the minimum is."""

SUBJECT = fitting.true_subjects()["segment"]


def fitted_cases() -> tuple[Case, ...]:
    """The cases for fitting, of the segment matrix; computed when a test needs them, once."""
    return fitting.true_cases("segment")[1:]


def shuffled(tasks: list[Task]) -> list:
    """Run tasks in another order, each once."""
    done = {}
    for task in random.Random(3).sample(list(tasks), len(tasks)):
        if task.name not in done:
            done[task.name] = task.function(*task.arguments)
    return [done[task.name] for task in tasks]


@pytest.fixture(scope="module")
def found() -> Identification:
    return identify(fitted_cases(), SUBJECT, 1, QUICK)


@pytest.mark.slow
def test_the_order_of_the_tasks_does_not_matter() -> None:
    found = identify(fitted_cases(), SUBJECT, 1, FEW)
    again = identify(fitted_cases(), SUBJECT, 1, FEW, shuffled)
    assert again.subject == found.subject and again.idealized.subject == found.idealized.subject
    for one, other in zip(found.fits, again.fits, strict=True):
        assert one.refined.costs.tolist() == other.refined.costs.tolist()
    assert again.evaluations == found.evaluations


def test_work_that_serves_several_fits_is_counted_once() -> None:
    """Of a single case, one refinement is the fit by itself, the joint fit, and here that of a refiner too."""
    few = dataclasses.replace(FEW, clocks="trusted", refined_starts=1)
    done: list[Any] = []

    def counted(tasks: Sequence[Task]) -> list[Any]:
        results = {task.name: task.function(*task.arguments) for task in tasks}
        done.extend(results.values())
        return [results[task.name] for task in tasks]

    found = identify(fitted_cases()[:1], SUBJECT, 1, few, counted)
    assert found.evaluations == sum(part.evaluations for part in done)
    assert {id(part) for part in found.parts} == {id(part) for part in done}


def test_the_results_by_case_are_those_of_single_fits(found: Identification) -> None:
    for fit, alone in zip(found.fits, fit_cases(fitted_cases(), SUBJECT, 1, QUICK), strict=True):
        assert fit.subject == alone.subject and fit.errors[0].mean_percent == alone.errors[0].mean_percent
    assert found.joint.subject == fit_joint(fitted_cases(), SUBJECT, 1, QUICK).subject
    assert found.subject == found.joint.subject


@pytest.mark.parametrize(
    ("mass_matrix", "declared"),
    [("segment", "segment"), pytest.param("segment", "cascade", marks=pytest.mark.slow), ("cascade", "segment")],
)
def test_the_true_mass_matrix_is_called_better_for_any_declared_one(
    mass_matrix: str, declared: str, found: Identification
) -> None:
    cases = fitting.true_cases(mass_matrix)
    subject = dataclasses.replace(fitting.true_subjects()[mass_matrix], mass_matrix=declared)
    result = found if subject == SUBJECT else identify(cases[1:], subject, 1, QUICK)
    better, percent = result.better_mass_matrix()
    assert better == mass_matrix and percent[better] < 0.5 < min(v for k, v in percent.items() if k != better)
    assert result.better_mass_matrix(cases[:1])[0] == mass_matrix
    assert result.joint.subject.mass_matrix == declared


def test_mass_matrices_of_equal_error_are_not_distinguished(found: Identification) -> None:
    """Measurements that neither has anything to do with: both miss all of them."""
    case = fitting.true_cases("segment")[0]
    noise = 1e3 * np.random.default_rng(2).standard_normal(case.measured_mps2.shape)
    measured = np.where(case.compared, noise, 0.0)
    foreign = dataclasses.replace(case, measured_mps2=measured, energy=(measured**2).sum(axis=0))
    better, percent = found.better_mass_matrix([foreign])
    assert better is None and set(percent) == {"segment", "cascade"}
    assert min(percent.values()) == pytest.approx(100.0, rel=0.01)
    assert found.better_mass_matrix()[0] == "segment"


def bent(mass_matrix: str) -> Subject:
    """The subject with a joint under the pelvis that gets much stiffer: under `cascade` 20 g make it diverge."""
    effect = AppliedEffect(CATALOGUE["asymmetry"], "pelvis", {"asymmetry_per_m": 100.0})
    return dataclasses.replace(SUBJECT, mass_matrix=mass_matrix, effects=(effect,))


def shaken(seconds: float, peak_mps2: float) -> Case:
    """A rail of this peak, in which all segments move as the seat does."""
    seat = fitting.seat_motion("rail", seconds, 1)
    seat *= peak_mps2 / np.abs(seat).max()
    return fitting.ready(seat, np.repeat(seat[:, None], 5, axis=1), "rail")


def test_a_mass_matrix_that_diverges_is_not_the_better_one(found: Identification) -> None:
    shock = [shaken(5.0, 200.0)]
    segment, cascade = (
        dataclasses.replace(fit, subject=bent(fit.subject.mass_matrix)) for fit in (found.joint, found.other)
    )
    for one, other in ((segment, cascade), (cascade, segment)):
        better, percent = dataclasses.replace(found, without_prior=one, other=other).better_mass_matrix(shock)
        assert better == "segment" and percent["segment"] < percent["cascade"] == np.inf
    both = dataclasses.replace(found, without_prior=cascade, other=cascade)
    assert both.better_mass_matrix(shock) == (None, {"cascade": np.inf})


def test_seconds_in_which_the_model_diverges_do_not_count_in_the_usual_residual() -> None:
    """After a shock at 10 s nothing is finite; the seconds before it count as those of a record that ends there."""
    calm, begin = shaken(25.0, 10.0), round(10.0 * fitting.RATE_HZ)
    first = {name: getattr(calm, name)[:begin] for name in ("seat_mps2", "measured_mps2", "compared")}
    shock = calm.seat_mps2.copy()
    shock[begin + 60 : begin + 90] = 200.0
    diverging = dataclasses.replace(calm, seat_mps2=shock)
    (accel,) = predictions(bent("cascade"), [diverging])
    assert np.isfinite(accel[:begin]).all() and not np.isfinite(accel[begin + 600 :]).any()
    assert prediction_errors(bent("cascade"), [diverging])[0].is_unstable
    found = usual_residual(bent("cascade"), [diverging, calm])
    assert found == usual_residual(bent("cascade"), [dataclasses.replace(calm, **first), calm])
    assert found["head"].windows == 31
    assert usual_residual(bent("cascade"), [diverging]) == {}


def test_the_seconds_of_the_usual_residual_begin_after_the_warm_up() -> None:
    """3.05 s are compared at the native rate, whose warm-up is no whole number of seconds in samples."""
    case = dataclasses.replace(shaken(5.05 * 1129.3 / fitting.RATE_HZ, 10.0), rate_hz=1129.3)
    compared = case.compared.copy()
    compared[: case.begin], compared[case.begin :] = False, True
    assert [
        usable.all() for usable, *_ in _windows(dataclasses.replace(case, compared=compared), case.measured_mps2)
    ] == ([True] * 3)


def test_both_refiners_are_compared_on_one_problem(found: Identification) -> None:
    assert [run.refiner for run in found.refiners] == ["least-squares", "nelder-mead"]
    squares, simplex = (run.refined for run in found.refiners)
    assert squares.reference.tolist() == simplex.reference.tolist()
    assert squares.objective <= simplex.objective * (1.0 + 1e-6)
    assert squares.evaluations < simplex.evaluations
    assert found.compared_on.case == "rail"  # the stronger of the two


def test_the_joint_fit_of_one_case_is_the_fit_of_that_case() -> None:
    found = identify(fitted_cases()[:1], SUBJECT, 1, FEW)
    assert found.joint.subject == found.fits[0].subject
    assert found.idealized.subject.parameters == found.joint.subject.parameters
    assert dict(found.idealized.weights) == {"pothole": 1.0}


def test_the_method_of_the_paper_gives_a_fused_subject() -> None:
    small = dataclasses.replace(PAPER, swarm=dataclasses.replace(QUICK.swarm, polish=False, starts=1), evaluations=40)
    found = identify(fitted_cases(), SUBJECT, 1, small)
    assert found.subject == found.idealized.subject != found.joint.subject
    expected = np.exp(
        sum(
            found.idealized.weights[case.case] * np.log(fitting.theta_of(fit.subject))
            for case, fit in zip(fitted_cases(), found.fits, strict=True)
        )
    )
    np.testing.assert_allclose(fitting.theta_of(found.subject), expected, rtol=1e-12)


def test_errors_of_a_prediction_are_rms_over_rms() -> None:
    (error,) = prediction_errors(SUBJECT, fitted_cases()[:1])
    assert error.mean_percent < 1e-3  # the truth, by another integrator
    first = fitted_cases()[0]
    quiet = dataclasses.replace(first, measured_mps2=0.5 * first.measured_mps2, energy=0.25 * first.energy)
    np.testing.assert_allclose(prediction_errors(SUBJECT, [quiet])[0].nrmse_rms_percent, 100.0, rtol=1e-4)


def test_a_fingerprint_differs_between_problems() -> None:
    same = fingerprint(fitted_cases(), SUBJECT, 1, QUICK)
    assert same == fingerprint(fitted_cases(), SUBJECT, 1, QUICK)
    measured = fitted_cases()[0].measured_mps2.copy()
    measured[-1, -1] = np.nextafter(measured[-1, -1], np.inf)
    other_case = dataclasses.replace(fitted_cases()[0], measured_mps2=measured)
    others = [
        fingerprint(fitted_cases()[::-1], SUBJECT, 1, QUICK),
        fingerprint(fitted_cases()[:1], SUBJECT, 1, QUICK),
        fingerprint([other_case, *fitted_cases()[1:]], SUBJECT, 1, QUICK),
        fingerprint(fitted_cases(), dataclasses.replace(SUBJECT, body_mass_kg=71.0), 1, QUICK),
        fingerprint(fitted_cases(), SUBJECT, 2, QUICK),
        fingerprint(fitted_cases(), SUBJECT, 1, dataclasses.replace(QUICK, lambda_2=2e-6)),
        fingerprint(fitted_cases(), SUBJECT, 1, PAPER),
    ]
    assert len({same, *others}) == len(others) + 1


def test_tasks_of_one_name_are_done_once() -> None:
    calls = []
    task = Task("once", lambda: calls.append(1) or len(calls), ())
    assert run_locally([task, task]) == [1, 1]


def test_no_case_and_a_case_twice_are_refused() -> None:
    with pytest.raises(InputError, match="there is no case"):
        identify([], SUBJECT, 1, QUICK)
    with pytest.raises(InputError, match="pothole: the case is given twice"):
        identify([fitted_cases()[0], fitted_cases()[0]], SUBJECT, 1, QUICK)
