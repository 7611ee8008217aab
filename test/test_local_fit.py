"""Local fit: theta and an effect are recovered together from data of another integrator."""

import dataclasses
from functools import cache
from types import SimpleNamespace

import hiding
import numpy as np
import pytest
from hiding import applied

from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.tracing import local_fit
from biodyn_core.tracing.local_fit import LocalFit, evidence_gain, fit_locally, simulated_products
from biodyn_core.tracing.nuisance_model import FREE, N_THETA, EventSet, NuisanceModel
from biodyn_core.tracing.rows import Rows
from biodyn_core.tracing.settings import LocalFitSettings

PRIOR_SCALES = LocalFitSettings().prior_scales
SKIN = {"softness_s": 1.0 / (2.0 * np.pi * 30.0), "damping_ratio": 0.3}


def at_most(steps: int) -> LocalFitSettings:
    return LocalFitSettings(steps=steps)


def as_given(steps: int) -> LocalFitSettings:
    """Settings that keep a start that fits worse than no effect."""
    return LocalFitSettings(steps=steps, weaker_starts=(), weaker_ends=())


@cache
def without(change, law=hiding.plain) -> LocalFit:
    return fit_locally(hiding.nuisance(change, law), None)


def assert_theta_is_true(found: LocalFit, rel: float) -> None:
    ours, true = (subject.parameters.natural_frequency_hz for subject in (found.subject, hiding.TRUTH))
    np.testing.assert_allclose(ours, true, rtol=rel)


@pytest.mark.parametrize(
    ("change", "law", "name", "site", "truth", "less"),
    [
        (hiding.louder, hiding.plain, "gain", "neck", {"gain": 0.1}, 0.8),
        (hiding.later, hiding.plain, "clock", "head", {"delay_s": 0.004}, 0.8),
        (hiding.on_skin, hiding.plain, "skin", "head", SKIN, 0.8),
        # Typical friction explains a share of it.
        (hiding.nothing, hiding.orifice, "quadratic_damping", "pelvis", {"growth_s_per_m": 4.0}, 0.85),
        (hiding.nothing, hiding.thrown, "lift_off", "pelvis", {}, 0.8),
    ],
)
def test_theta_and_a_hidden_effect_are_recovered_together(
    change, law, name: str, site: str, truth: dict, less: float
) -> None:
    nuisance = hiding.nuisance(change, law)
    found = fit_locally(nuisance, applied(name, site), with_intervals=True)
    assert found.applied is not None and set(truth) <= set(found.applied.values)
    for parameter, value in truth.items():
        # A share of it may stay with the nuisance parameter of the same law.
        assert found.applied.values[parameter] == pytest.approx(value, rel=0.08)
    assert found.subject.effects == (found.applied,)
    assert_theta_is_true(found, 0.02)
    assert found.at_bound == () and len(found.intervals) == len(found.applied.effect.textbook_parameters)
    assert found.objective < 0.7 * without(change, law).objective
    assert found.residual_square.sum() < less * without(change, law).residual_square.sum()


def test_the_interval_contains_the_size_and_narrows_with_more_data() -> None:
    nuisance = hiding.nuisance(hiding.louder)
    found = fit_locally(nuisance, applied("gain", "neck"), with_intervals=True)
    ((low, high),) = found.intervals
    assert low < 0.1 < high and high - low < 0.15
    fewer = dataclasses.replace(nuisance, weight=0.25 * nuisance.weight)
    ((wide_low, wide_high),) = fit_locally(fewer, applied("gain", "neck"), with_intervals=True).intervals
    assert wide_high - wide_low > 1.1 * (high - low)


def test_a_start_of_theta_counts_only_if_it_fits_better() -> None:
    """Without a step, that of an earlier fit is as good as its end, and one far away changes nothing."""
    nuisance, start = hiding.nuisance(hiding.louder), applied("gain", "neck")
    ended, plain = fit_locally(nuisance, start), fit_locally(nuisance, start, as_given(0))
    again = fit_locally(nuisance, ended.applied, as_given(0), theta=ended.subject.parameters)
    assert again.objective == pytest.approx(ended.objective, rel=1e-6) and again.objective < plain.objective
    vector = nuisance.subject.parameters.vector()
    vector[0] *= 1.4
    far = fit_locally(nuisance, start, as_given(0), theta=type(nuisance.subject.parameters).from_vector(vector))
    assert far.objective == plain.objective and far.subject.parameters == plain.subject.parameters


def test_a_fit_without_an_effect_reduces_the_residual_and_adds_no_effect() -> None:
    nuisance, found = hiding.nuisance(hiding.louder), without(hiding.louder)
    p = nuisance.train.products
    before = float(nuisance.weight @ p.square)
    assert found.applied is None and found.subject.effects == () and found.intervals == ()
    assert 0.0 < found.objective < 0.9 * before
    usual = dict(zip(nuisance.names, found.coefficients[N_THETA:], strict=True))
    assert max(usual, key=lambda name: abs(usual[name])) == "gain of neck" and usual["gain of neck"] > 1.0


def test_the_residual_is_that_of_the_fitted_subject() -> None:
    """The squares are those of a simulation of the fitted subject with its nuisance parameters."""
    nuisance, found = hiding.nuisance(hiding.louder), fit_locally(hiding.nuisance(hiding.louder), None)
    slow = []
    for rows, known, missed in zip(
        nuisance.choose.rows, nuisance.choose.known, nuisance.choose.residuals(found.subject), strict=True
    ):
        slow += [((missed[w] - known[w] @ found.coefficients) ** 2).sum() for w in range(rows.windows)]
    np.testing.assert_allclose(found.residual_square, slow, rtol=1e-6)
    np.testing.assert_allclose(
        simulated_products(nuisance.choose, found.subject).residual_square(found.coefficients), slow, rtol=1e-6
    )


def test_more_steps_do_not_increase_the_objective() -> None:
    nuisance = hiding.nuisance(hiding.on_skin)
    objectives = [fit_locally(nuisance, applied("skin", "head"), at_most(steps)).objective for steps in (0, 1, 4, 12)]
    assert objectives == sorted(objectives, reverse=True) and objectives[3] < 0.5 * objectives[0]


def test_parameters_on_a_bound_are_named() -> None:
    """A sensor with a gain of 60 %; the range of the effect is 30 %."""
    nuisance = hiding.nuisance(hiding.far_louder)
    found = fit_locally(nuisance, applied("gain", "neck"))
    assert found.applied is not None and found.applied.values["gain"] > 0.29
    assert found.at_bound == ("gain",)


def test_an_unstable_start_has_an_infinite_objective() -> None:
    parameter, *general = CATALOGUE["cubic"].parameters
    changed = dataclasses.replace(parameter, lower=-1e12, upper=-1e9, start=-1e10)
    softer = dataclasses.replace(CATALOGUE["cubic"], parameters=(changed, *general))
    start = AppliedEffect(softer, "pelvis", {parameter.name: -1e10})
    nuisance = hiding.nuisance(hiding.louder)
    found = fit_locally(nuisance, start)
    assert found.objective == np.inf and found.applied is start
    assert np.isfinite(found.residual_square).all() and np.isfinite(found.coefficients).all()
    np.testing.assert_array_equal(found.residual_square, nuisance.choose.products.square)


def test_a_start_that_fits_worse_than_no_effect_becomes_weaker() -> None:
    """A sensor on skin of 30 Hz. From 10 Hz with little damping the steps end in another minimum."""
    nuisance, far = hiding.nuisance(hiding.on_skin), applied("skin", "head", softness_s=0.015, damping_ratio=0.1)
    problem = local_fit._Problem(nuisance, far, LocalFitSettings(), textbook=True)
    at, start = problem.at(np.zeros(N_THETA), problem.unbounded(far)), problem.start(None)
    assert start.objective < without(hiding.on_skin).objective < at.objective
    weaker = problem.applied(start.psi).values
    assert weaker["softness_s"] / far.values["softness_s"] == pytest.approx(0.25)
    assert weaker["damping_ratio"] == pytest.approx(0.1), "a shape is no strength"
    found = fit_locally(nuisance, far)
    assert found.applied is not None
    assert found.applied.values["softness_s"] == pytest.approx(SKIN["softness_s"], rel=0.08)
    assert found.objective == pytest.approx(fit_locally(nuisance, applied("skin", "head")).objective, rel=1e-3)


@pytest.mark.parametrize(("most", "share"), [(1.0, 1.0), (0.8, 0.7), (0.4, 0.3), (0.2, None)])
def test_a_fit_that_is_unstable_in_an_event_for_choosing_becomes_weaker(
    monkeypatch: pytest.MonkeyPatch, most: float, share: float | None
) -> None:
    """most: the largest stable gain, as a share of the fitted one; share: of the gain that the fit ends with."""
    nuisance = hiding.nuisance(hiding.louder)
    fitted, no_effect = fit_locally(nuisance, applied("gain", "neck")), without(hiding.louder)
    gain, plain = fitted.applied.values["gain"], simulated_products  # type: ignore[union-attr]

    def products(events: EventSet, subject) -> object:
        found = plain(events, subject)
        runs_away = subject.effects[0].values["gain"] > 1.001 * most * gain
        return dataclasses.replace(found, square=np.full_like(found.square, 1e20)) if runs_away else found

    monkeypatch.setattr(local_fit, "simulated_products", products)
    found = fit_locally(nuisance, applied("gain", "neck"))
    if share is None:
        assert found.objective == np.inf
    else:
        assert found.applied is not None and found.applied.values["gain"] == pytest.approx(share * gain, rel=1e-6)
        assert fitted.objective <= found.objective < no_effect.objective
        assert found.residual_square.max() < 1e10


@pytest.mark.parametrize(("most", "share"), [(1.0, 1.0), (0.8, 0.7), (0.1, 0.0)])
def test_theta_that_is_unstable_in_an_event_for_choosing_changes_less(
    monkeypatch: pytest.MonkeyPatch, most: float, share: float
) -> None:
    """most: the largest stable change of theta, as a share of the fitted one; share: of the change that remains."""
    nuisance, plain = hiding.nuisance(hiding.louder), simulated_products
    start = np.log(nuisance.subject.parameters.vector()[FREE])

    def change(subject: Subject) -> np.ndarray:
        return np.log(subject.parameters.vector()[FREE]) - start

    whole = change(fit_locally(nuisance, None).subject)

    def products(events: EventSet, subject: Subject) -> object:
        found = plain(events, subject)
        runs_away = np.linalg.norm(change(subject)) > 1.001 * most * np.linalg.norm(whole)
        return dataclasses.replace(found, square=np.full_like(found.square, 1e20)) if runs_away else found

    monkeypatch.setattr(local_fit, "simulated_products", products)
    found = fit_locally(nuisance, None)
    assert np.isfinite(found.objective) and found.residual_square.max() < 1e10
    np.testing.assert_allclose(change(found.subject), share * whole, atol=1e-9)


def test_derivatives_near_instability_use_the_stable_side() -> None:
    """A slightly larger value is unstable; the gain is finite, and the fit returns to small values."""
    parameter, *general = CATALOGUE["asymmetry"].parameters
    changed = dataclasses.replace(parameter, lower=-20_000.0, upper=20_000.0)
    wider = dataclasses.replace(CATALOGUE["asymmetry"], parameters=(changed, *general))
    nuisance = hiding.nuisance(hiding.louder)

    def at(value: float) -> AppliedEffect:
        return AppliedEffect(wider, "pelvis", {parameter.name: value})

    holds, runs_away = 0.0, 1000.0
    while runs_away - holds > 1.0:  # a nudge of settling is 100 here
        middle = 0.5 * (holds + runs_away)
        stays = np.isfinite(fit_locally(nuisance, at(middle), as_given(0)).objective)
        holds, runs_away = (middle, runs_away) if stays else (holds, middle)
    start, found = (fit_locally(nuisance, at(holds), as_given(steps)) for steps in (0, 12))
    assert np.isfinite(start.penalty) and np.isfinite(evidence_gain(nuisance, without(hiding.louder), start))
    assert found.objective < 0.6 * start.objective and found.applied is not None
    assert abs(found.applied.values[parameter.name]) < 10.0, "nothing of the kind is hidden"


class _Shifted(Rows):
    """Rows with an additional residual."""

    def __init__(self, rows: Rows, more: np.ndarray) -> None:
        self.__dict__ |= rows.__dict__
        self._more = more

    def residual(self, answer: np.ndarray) -> np.ndarray:
        return super().residual(answer) + self._more


def deviating(nuisance: NuisanceModel, deviations: np.ndarray) -> NuisanceModel:
    """The same events of a body and sensors with these deviations, in typical spreads."""
    b = np.concatenate([np.zeros(N_THETA), deviations])

    def of(events: EventSet) -> EventSet:
        rows = tuple(_Shifted(one, known @ b) for one, known in zip(events.rows, events.known, strict=True))
        apart = dataclasses.replace(events, rows=rows)
        return dataclasses.replace(apart, products=apart.products_of(apart.residuals(nuisance.subject)))

    return dataclasses.replace(nuisance, train=of(nuisance.train), choose=of(nuisance.choose)).reweighted(2)


@pytest.mark.parametrize("seed", [0, 3])
def test_the_prior_scale_follows_the_drawn_deviations(seed: int) -> None:
    """Without deviations the scale is the least; with typical ones it is about 1."""
    nuisance = hiding.nuisance()
    drawn = np.random.default_rng(seed).standard_normal(len(nuisance.names))
    as_modelled, a_little, as_usual = (fit_locally(deviating(nuisance, size * drawn), None) for size in (0.0, 0.3, 1.0))
    assert as_modelled.prior_scale == PRIOR_SCALES[-1] and a_little.prior_scale <= 0.32 and as_usual.prior_scale >= 0.56
    assert as_modelled.nuisance_square < 0.01 and 5.0 < as_usual.nuisance_square < len(drawn)


@pytest.mark.parametrize(("size", "level"), [(0.1, 0.1), (0.7, 0.32), (2.0, 1.0)])
def test_the_prior_scale_maximises_the_evidence_of_a_linear_model(size: float, level: float) -> None:
    """In a linear model the residual is normal with the covariance of theta and nuisance parameters."""
    drawn = np.random.default_rng(0).standard_normal(len(hiding.nuisance().names))
    nuisance = deviating(hiding.nuisance(), size * drawn)
    found = fit_locally(nuisance, None, at_most(0))
    weight = np.repeat(nuisance.weight, nuisance.train.known[0].shape[1])
    rows = np.concatenate([known.reshape(-1, known.shape[2]) for known in nuisance.train.known])
    missed = np.concatenate([one.ravel() for one in nuisance.train.residuals(nuisance.subject)])
    scaled, y = rows * np.sqrt(weight)[:, None], missed * np.sqrt(weight)
    theta, own = scaled[:, :N_THETA], scaled[:, N_THETA:]

    def cost(level: float) -> float:
        """Twice the log, up to what no level changes; theta is fitted, so that its volume does not count."""
        inner = np.eye(own.shape[1]) / level**2 + own.T @ own
        volume = np.linalg.slogdet(level**2 * inner)[1]
        spread = np.concatenate([theta * 0.5, own * level], axis=1)
        small = np.eye(spread.shape[1]) + spread.T @ spread
        return float(y @ y - (y @ spread) @ np.linalg.solve(small, spread.T @ y) + volume)

    assert found.prior_scale == min(PRIOR_SCALES, key=cost) == level


def test_an_effect_that_replaces_a_large_nuisance_parameter_gains_evidence_and_another_does_not() -> None:
    """Without it the seat's joint has an atypical damping, with it the body has no deviations."""
    nuisance = hiding.nuisance(hiding.nothing, hiding.orifice)
    bent = without(hiding.nothing, hiding.orifice)
    orifice, gain = (
        fit_locally(nuisance, applied(*one)) for one in (("quadratic_damping", "pelvis"), ("gain", "head"))
    )
    assert bent.prior_scale > orifice.prior_scale == PRIOR_SCALES[-1] and gain.prior_scale == bent.prior_scale
    assert evidence_gain(nuisance, bent, orifice) > 0.25
    # At the least prior scale a deviation costs more, so that its replacement gains more.
    strict = nuisance.at_scale(PRIOR_SCALES[-1])
    damped = fit_locally(strict, applied("quadratic_damping", "pelvis"))
    assert evidence_gain(strict, fit_locally(strict, None), damped) > 1.0
    assert abs(evidence_gain(nuisance, bent, gain)) < 0.05
    assert evidence_gain(nuisance, bent, bent) == 0.0


def test_a_step_that_is_not_finite_is_no_step() -> None:
    """Beside an unstable point the derivatives are not finite; a finite step to a smaller objective is taken."""
    here, there = (SimpleNamespace(delta=np.zeros(2), psi=np.zeros(1), objective=one) for one in (2.0, 1.0))
    for delta, psi, found in (
        (np.ones(2), np.ones(1), there),
        (np.array([1.0, np.nan]), np.ones(1), None),
        (np.ones(2), np.array([np.inf]), None),
    ):
        problem = SimpleNamespace(
            by_psi=lambda at: [], step=lambda at, slopes, d=delta, p=psi: (d, p), at=lambda *_: there
        )
        assert local_fit._line_search(problem, here, (1.0,)) is found
