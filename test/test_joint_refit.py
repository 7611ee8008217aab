"""Joint refit: theta and effects are recovered from events that another integrator simulated."""

import dataclasses
import pickle
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import hiding
import numpy as np
import pytest
from hiding import applied

from biodyn_core.base.parallel import serial_map
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect, Ranges
from biodyn_core.identification.problem import errors
from biodyn_core.tracing import joint_refit
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.joint_refit import covariances, general_starts, generalised, jointly_refitted, refit
from biodyn_core.tracing.nuisance_model import FREE
from biodyn_core.tracing.settings import JointRefitSettings

SKIN = {"softness_s": 1.0 / (2.0 * np.pi * 30.0), "damping_ratio": 0.3}


def cases(change=hiding.nothing, law=hiding.plain) -> list:
    return list(hiding.events(6, change, law)[:3])


def fitted(change, law, *effects: AppliedEffect) -> Subject:
    """The body fitted without an effect, with effects at their start values."""
    return dataclasses.replace(hiding.fitted(change, law), effects=effects)


def error_percent(subject: Subject, change, law) -> float:
    return float(np.mean([errors(case, answer(subject, case)).mean_percent for case in cases(change, law)]))


def assert_theta_is_true(found: Subject, rel: float) -> None:
    np.testing.assert_allclose(
        found.parameters.natural_frequency_hz, hiding.TRUTH.parameters.natural_frequency_hz, rtol=rel
    )


@pytest.mark.parametrize(
    ("change", "law", "name", "site", "truth"),
    [
        (hiding.louder, hiding.plain, "gain", "neck", {"gain": 0.1}),
        pytest.param(hiding.later, hiding.plain, "clock", "head", {"delay_s": 0.004}, marks=pytest.mark.slow),
        (
            hiding.on_skin,
            hiding.plain,
            "skin",
            "head",
            SKIN,
        ),
        (hiding.nothing, hiding.orifice, "quadratic_damping", "pelvis", {"growth_s_per_m": 4.0}),
        pytest.param(hiding.nothing, hiding.thrown, "lift_off", "pelvis", {}, marks=pytest.mark.slow),
    ],
)
def test_theta_and_a_hidden_effect_are_recovered_together(change, law, name: str, site: str, truth: dict) -> None:
    found = jointly_refitted(fitted(change, law, applied(name, site)), cases(change, law))
    (effect,) = found.effects
    assert (effect.effect.name, effect.site) == (name, site)
    for parameter, value in truth.items():
        assert effect.values[parameter] == pytest.approx(value, rel=0.05)
    assert_theta_is_true(found, 0.01)
    assert error_percent(found, change, law) < 0.6 * error_percent(hiding.fitted(change, law), change, law)


def louder_neck_and_later_head(measured: np.ndarray) -> np.ndarray:
    return hiding.later(hiding.louder(measured))


@cache
def refitted_clock_and_gain() -> Subject:
    start = fitted(louder_neck_and_later_head, hiding.plain, applied("clock", "head"), applied("gain", "neck"))
    return jointly_refitted(start, cases(louder_neck_and_later_head))


def test_two_effects_keep_their_order() -> None:
    found = refitted_clock_and_gain()
    clock, gain = found.effects
    assert (clock.effect.name, gain.effect.name) == ("clock", "gain")
    assert clock.values["delay_s"] == pytest.approx(0.004, rel=0.05)
    assert gain.values["gain"] == pytest.approx(0.1, rel=0.05)
    assert_theta_is_true(found, 0.01)


def test_without_effects_it_fits_theta_from_its_start() -> None:
    """From a start near the truth it returns to it, and the mass scale does not change."""
    theta = hiding.TRUTH.parameters.vector()
    theta[:14] *= np.where(np.arange(14) % 2, 1.05, 0.95)
    start = dataclasses.replace(hiding.TRUTH, parameters=type(hiding.TRUTH.parameters).from_vector(theta))
    found = jointly_refitted(start, cases())
    assert_theta_is_true(found, 0.005)
    assert found.effects == () and found.parameters.vector()[14] == theta[14]


def test_a_mass_scale_on_its_bound_is_not_changed() -> None:
    theta = hiding.TRUTH.parameters.vector()
    theta[:14] *= 1.02
    theta[14] = 0.85
    start = dataclasses.replace(hiding.TRUTH, parameters=type(hiding.TRUTH.parameters).from_vector(theta))
    found = jointly_refitted(start, cases()[:1], JointRefitSettings(first_evaluations=60, evaluations=60))
    assert found.parameters.vector()[14] == 0.85 and found.parameters.vector()[0] != theta[0]


def test_values_stay_in_their_ranges_for_a_truth_outside() -> None:
    found = jointly_refitted(fitted(hiding.far_louder, hiding.plain, applied("gain", "neck")), cases(hiding.far_louder))
    assert 0.29 < found.effects[0].values["gain"] <= 0.3


def test_the_covariance_is_of_each_effect_and_shrinks_with_more_data() -> None:
    found = refitted_clock_and_gain()
    few, many = (covariances(found, cases(louder_neck_and_later_head), independent) for independent in (1e-3, 1e-1))
    assert [one.shape for one in few] == [(2, 2), (1, 1)]
    for wide, narrow in zip(few, many, strict=True):
        np.testing.assert_allclose(wide, wide.T, rtol=1e-9)
        assert (np.linalg.eigvalsh(wide) > 0.0).all() and np.trace(narrow) < 0.1 * np.trace(wide)
    # The gain of 0.1 on the real line of its range, one standard deviation to either side.
    ranges = Ranges(CATALOGUE["gain"].parameters)
    at = ranges.unbounded(np.array([found.effects[1].values["gain"]]), 1e-6)
    low, high = (ranges.bounded(at + 3.0 * side * np.sqrt(many[1][0, 0]))[0] for side in (-1.0, 1.0))
    assert low < 0.1 < high and high - low < 0.05


def test_the_covariance_of_a_small_strength_is_that_at_its_own_value() -> None:
    """Quadratic damping of 0.2 s/m, a thousandth of its range, all else known: by the curvature of the objective."""
    events = cases()
    known = JointRefitSettings(theta_spread=1e-9, psi_spread=1e3)

    def at(value: float) -> Subject:
        return dataclasses.replace(
            hiding.TRUTH, effects=(applied("quadratic_damping", "pelvis", growth_s_per_m=value),)
        )

    def objective(value: float) -> float:
        problem = joint_refit._Problem(at(value), events, FREE, "trusted", textbook=False, settings=known)
        return problem.objective()

    information = np.linalg.inv(covariances(at(0.2), events, 1e-3, known)[0])[0, 0]
    noise = objective(0.2) / (1e-3 * sum(int(case.compared.sum()) for case in events))
    curvature = (objective(0.3) - 2.0 * objective(0.2) + objective(0.1)) / 0.1**2
    parameter = CATALOGUE["quadratic_damping"].parameters[0]
    share = parameter.share(0.2)
    assert share < 0.002
    slope = (parameter.upper - parameter.lower) * share * (1.0 - share)
    assert 1.0 / np.sqrt(information) == pytest.approx(np.sqrt(2.0 * noise / curvature) / slope, rel=0.1)


@cache
def one_sided_textbook() -> Subject:
    start = fitted(hiding.nothing, hiding.one_sided, applied("asymmetry", "pelvis"))
    return jointly_refitted(start, cases(law=hiding.one_sided))


@cache
def one_sided_general() -> Subject:
    return generalised(one_sided_textbook(), cases(law=hiding.one_sided))


@pytest.mark.slow
def test_a_general_form_comes_nearer_to_a_law_that_the_textbook_form_is_not() -> None:
    """A joint that is stiffer on one side alone is no quadratic law."""
    textbook, general = one_sided_textbook(), one_sided_general()
    assert textbook.effects == (textbook.effects[0].textbook,) and general.effects[0].values["exponent"] != 0.0
    alone, both = (error_percent(one, hiding.nothing, hiding.one_sided) for one in (textbook, general))
    assert both < 0.9 * alone
    gain = dataclasses.replace(textbook, effects=(applied("gain", "neck"),))
    assert generalised(gain, cases()) is gain  # it has no general form


def as_in_other_processes(stage: str, function: Any, shared: Any, items: Sequence[Any]) -> Iterator[Any]:
    """A parallel map that sends everything as bytes, and computes the last item first."""

    def sent(value: Any) -> Any:
        return pickle.loads(pickle.dumps(value))  # noqa: S301 - written here

    done = [sent(function(sent(shared), sent(one))) for one in items[::-1]]
    return iter(done[::-1])


@pytest.mark.slow
def test_a_refit_has_the_same_digits_with_cases_in_other_processes() -> None:
    law, few = hiding.one_sided, JointRefitSettings(first_evaluations=60, evaluations=60)
    here, there = (
        generalised(one_sided_textbook(), cases(law=law), few, parallel=parallel)
        for parallel in (serial_map, as_in_other_processes)
    )
    assert here.effects == there.effects != one_sided_textbook().effects
    np.testing.assert_array_equal(here.parameters.vector(), there.parameters.vector())


def test_a_general_form_starts_from_a_given_subject_too() -> None:
    """The textbook form is absent, so the starts from it are too weak for one evaluation."""
    law, one = hiding.one_sided, JointRefitSettings(first_evaluations=1, evaluations=1)
    base = fitted(hiding.nothing, law, applied("asymmetry", "pelvis", asymmetry_per_m=0.0))
    known = one_sided_general()
    alone, given = (generalised(base, cases(law=law), one, also=also) for also in ((), (known,)))
    assert error_percent(given, hiding.nothing, law) < 0.7 * error_percent(alone, hiding.nothing, law)


def test_a_start_that_is_unstable_is_weakened_and_a_refit_is_never_worse_than_the_subject() -> None:
    base = hiding.fitted(hiding.louder, hiding.plain)
    wild = dataclasses.replace(base, effects=(applied("asymmetry", "head", asymmetry_per_m=200.0),))
    found = refit(base, cases(hiding.louder), [wild], textbook=True)
    assert found.objective <= refit(base, cases(hiding.louder), [base]).objective * (1.0 + 1e-6)
    assert np.isfinite(error_percent(found.subject, hiding.louder, hiding.plain))


def test_general_starts_try_each_shape_with_the_size_that_changes_the_answer_alike() -> None:
    bare = hiding.fitted()
    assert general_starts(bare, cases()) == [bare]
    bent = dataclasses.replace(bare, effects=(applied("stop", "pelvis", gap_m=0.001),))
    own, *others = general_starts(bent, cases())
    grids = [p.grid for p in CATALOGUE["stop"].parameters if p.neutral is not None and p.grid]
    assert own is bent and len(others) == np.prod([len(grid) for grid in grids]) - 1
    plain = np.concatenate([answer(bare, case).ravel() for case in cases()])
    change = np.concatenate([answer(bent, case).ravel() for case in cases()]) - plain
    assert np.abs(change).max() > 0.1
    for one in others:
        (effect,) = one.effects
        assert effect.values["gap_m"] == 0.001 and effect != bent.effects[0]
        ratio = p_size(effect) / p_size(bent.effects[0])
        again = dataclasses.replace(bent, effects=(dataclasses.replace(effect, values={
            **effect.values, "stiffness_ratio": p_size(bent.effects[0]),
        }),))  # fmt: skip
        other = np.concatenate([answer(again, case).ravel() for case in cases()]) - plain
        upper = next(p.upper for p in effect.effect.parameters if p.name == "stiffness_ratio")
        expected = min(float(change @ other / (other @ other)), upper / p_size(bent.effects[0]))
        assert ratio == pytest.approx(expected, rel=1e-9) and ratio > 0.1


def p_size(effect: AppliedEffect) -> float:
    return effect.values["stiffness_ratio"]


def test_a_general_start_without_a_finite_answer_is_left_out() -> None:
    """Before, its strength was not a number, and an error ended the whole trace."""
    wild = dataclasses.replace(hiding.fitted(), effects=(applied("asymmetry", "pelvis", asymmetry_per_m=-200.0),))
    found = general_starts(wild, cases(hiding.louder), JointRefitSettings(halvings=1))
    assert [one.effects[0].values["exponent"] for one in found] == [0.0, -1.0]  # of -1 and 1, the second is unstable


def test_an_effect_that_is_unstable_at_every_strength_is_halved_a_limited_number_of_times(monkeypatch) -> None:
    start = dataclasses.replace(hiding.fitted(), effects=(applied("gain", "neck", gain=0.2),))
    assert joint_refit._stable(start, cases(), 8) is start
    monkeypatch.setattr(joint_refit, "first_unstable", lambda subject, cases: cases[0])
    found = joint_refit._stable(start, cases(), 8)
    assert found.effects[0].values["gain"] == pytest.approx(0.2 * 0.5**8, rel=1e-12)
