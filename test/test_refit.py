"""Theta and an effect fitted together come back as another hand put them in."""

import dataclasses

import fitting
import numpy as np
import pytest
from test_effects import applied, twin
from test_screen import cases, fitted, later, louder, on_skin

from biodyn_core.identification.problem import Case
from biodyn_core.tracing.refit import Refit, refit
from biodyn_core.tracing.screen import candidates, screen

TRUTH = fitting.true_subjects()["segment"]


def best(made: list[Case], name: str, site: str, clocks: str = "trusted") -> tuple[float, Refit]:
    """The fit's error before, and the refit with the best candidate of this name."""
    fit = fitted(made, clocks)
    tried = [
        one
        for one in candidates(made)[0]
        if (one.applied.effect.name, one.applied.site) == (name, site) and one.strength != "drift"
    ]
    return fit.error_percent, refit(fit, made, screen(fit, made, tried)[0])


def assert_theta_is_true(found: Refit, rel: float) -> None:
    ours, true = (subject.parameters.natural_frequency_hz for subject in (found.subject, TRUTH))
    np.testing.assert_allclose(ours, true, rtol=rel)


@pytest.mark.parametrize(
    ("change", "name", "site", "truth"),
    [
        (louder, "gain", "neck", {"gain": 0.1}),
        (later, "clock", "head", {"delay_s": 0.004}),
        (on_skin, "skin", "head", {"softness_s": 1.0 / (2.0 * np.pi * 30.0), "damping_ratio": 0.3}),
    ],
)
def test_a_sensors_fault_and_theta_come_back_together(change, name: str, site: str, truth: dict) -> None:
    before, found = best(cases(change), name, site)
    for parameter, value in truth.items():
        assert found.applied.values[parameter] == pytest.approx(value, rel=0.05)
    assert_theta_is_true(found, 0.01)
    after = np.mean([error.mean_percent for error in found.errors])
    assert after < 0.7 * before and found.effect_at_bound == () and found.moved_onto_bound == ()


def test_a_tissue_law_and_theta_come_back_together() -> None:
    effect = applied("quadratic_damping", "pelvis", growth_s_per_m=4.0)
    seat = fitting.seat_motion("pothole", 5.0, 3)
    made = [fitting.ready(seat, twin(effect, seat, TRUTH, fitting.RATE_HZ), "pothole")]
    before, found = best(made, "quadratic_damping", "pelvis", "estimated")
    assert found.applied.values["growth_s_per_m"] == pytest.approx(4.0, rel=0.02)
    assert_theta_is_true(found, 0.01)
    assert found.errors[0].mean_percent < 0.1 * before


def test_lift_off_has_nothing_to_fit_but_theta() -> None:
    """A rail that throws the pelvis off the seat, by another integrator."""
    seat = fitting.seat_motion("rail", 5.0, 2)
    made = [fitting.ready(seat, twin(applied("lift_off"), seat, TRUTH, fitting.RATE_HZ), "rail")]
    before, found = best(made, "lift_off", "pelvis", "estimated")
    assert dict(found.applied.values) == {} and found.errors[0].mean_percent < 0.2 * before
    assert_theta_is_true(found, 0.02)


def test_what_ends_on_a_bound_is_named() -> None:
    """Nothing is hidden: a stop that has nothing to do leaves by one side or stays without strength."""
    made = cases(lambda measured: measured)
    fit = fitted(made)
    tried = [one for one in candidates(made)[0] if (one.applied.effect.name, one.applied.site) == ("cubic", "pelvis")]
    screened = screen(fit, made, tried)[0]
    found = refit(fit, made, dataclasses.replace(screened, size=1.0))
    assert found.objective <= fit.unpulled(made).cost(fit.subject.parameters.vector()) * (1.0 + 1e-6)
    share = found.applied.values["cubic_per_m2"] / found.applied.effect.parameters[0].upper
    assert (share < 1e-3) == (found.effect_at_bound == ("cubic_per_m2",))
