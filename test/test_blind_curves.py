"""Accuracy against ratio: bins of known records, and the logistic curve against closed forms and a slow twin."""

from __future__ import annotations

import numpy as np
import pytest
from outcomes import CLOCK, SKIN, outcome
from scipy import optimize

from blind.tracing.curves import EDGES, GROUPS, LEAST, Curve, Logistic, curves, fitted
from blind.tracing.shares import wilson

Floats = np.ndarray


def share(fit: Logistic, ratio: float) -> tuple[float, float, float]:
    middle, low, high = (float(one[0]) for one in fit.at(np.array([ratio])))
    return middle, low, high


# --- the curve -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("low", "high"), [(3, 17), (0, 20), (0, 0), (20, 20), (10, 10)])
def test_at_two_ratios_the_curve_adds_half_a_record_to_each_cell(low: int, high: int) -> None:
    """Jeffreys' prior of a saturated model: share (k + 1/2) / (n + 1), with the variance 1 / (n p q) of log odds."""
    n = 20
    ratios = np.repeat([0.5, 2.0], n)
    hits = np.concatenate([np.arange(n) < low, np.arange(n) < high])
    fit = fitted(ratios, hits)
    for ratio, k in ((0.5, low), (2.0, high)):
        p = (k + 0.5) / (n + 1.0)
        half = 1.959964 / np.sqrt(n * p * (1.0 - p))
        odds = np.log(p / (1.0 - p)) + np.array([0.0, -half, half])
        assert share(fit, ratio) == pytest.approx(1.0 / (1.0 + np.exp(-odds)), rel=1e-5)


def slow_twin(ratios: Floats, hits: Floats) -> Floats:
    """The weights by direct search of the penalised likelihood."""
    x = np.column_stack([np.ones(len(ratios)), np.log2(ratios)])

    def loss(w: Floats) -> float:
        p = 1.0 / (1.0 + np.exp(-x @ w))
        information = x.T @ np.diag(p * (1.0 - p)) @ x
        return -float(np.prod(np.where(hits, p, 1.0 - p)) * np.sqrt(np.linalg.det(information)))

    options = {"xatol": 1e-9, "fatol": 0.0, "maxiter": 4000}
    return np.asarray(optimize.minimize(loss, np.zeros(2), method="Nelder-Mead", options=options).x)


@pytest.mark.parametrize("seed", range(4))
def test_the_curve_is_that_of_its_slow_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ratios = np.exp(rng.normal(-0.3, 0.8, 30))
    hits = rng.random(30) < 1.0 / (1.0 + np.exp(-1.5 * np.log2(ratios)))
    assert fitted(ratios, hits).weights == pytest.approx(slow_twin(ratios, hits), abs=1e-4)


def test_a_step_has_a_steep_finite_curve() -> None:
    ratios = np.geomspace(0.1, 6.4, 100)
    fit = fitted(ratios, ratios > 0.8)
    assert share(fit, 0.8)[0] == pytest.approx(0.5, abs=0.1)
    assert share(fit, 0.4)[0] < 0.001 and share(fit, 1.6)[0] > 0.999
    assert np.isfinite(fit.weights).all() and np.isfinite(fit.covariance).all()
    mirrored = fitted(1.0 / ratios, ratios > 0.8)
    assert mirrored.weights == pytest.approx(fit.weights * [1.0, -1.0], rel=1e-6)


def test_the_band_contains_the_true_curve_in_95_of_100_studies() -> None:
    rng = np.random.default_rng(11)
    at = np.array([0.3, 0.8, 2.0])
    true = 1.0 / (1.0 + np.exp(-(0.2 + 1.2 * np.log2(at))))
    inside = []
    for _ in range(400):
        ratios = np.exp(rng.normal(-0.2, 0.8, 100))
        hits = rng.random(100) < 1.0 / (1.0 + np.exp(-(0.2 + 1.2 * np.log2(ratios))))
        _, low, high = fitted(ratios, hits).at(at)
        inside.append((low <= true) & (true <= high))
    assert np.mean(inside, axis=0) == pytest.approx(0.955, abs=0.025)


# --- records ---------------------------------------------------------------------------------------------------------


def test_octaves_count_known_records() -> None:
    ratios = np.array([0.1, 0.4, 0.8, *[1.0] * 5, *[1.6] * 4, 5.0, 20.0])
    hits = np.array([False, True, False, *[True] * 3, *[False] * 6, True, True])
    found = Curve.of("g", "m", ratios, hits)
    assert [(one.text, one.records, one.hits) for one in found.bins] == [
        ("0 to 0.2", 1, 0), ("0.2 to 0.4", 1, 1), ("0.4 to 0.8", 1, 0), ("0.8 to 1.6", 9, 3), ("above 3.2", 2, 2),
    ]  # fmt: skip
    middle = found.bins[3]
    assert middle.middle == pytest.approx((1.0**5 * 1.6**4) ** (1.0 / 9.0)) and middle.interval == wilson(3, 9)
    assert found.bins[4].middle == pytest.approx(10.0) and middle.share == pytest.approx(1 / 3)
    binned, curve = found.rows[3]
    assert binned == "33.3 % (12.1 to 64.6)"
    p, low, high = (100.0 * one for one in share(found.fit, middle.middle))
    assert curve == f"{p:.0f} % ({low:.0f} to {high:.0f})"


def test_few_or_equal_ratios_have_no_curve() -> None:
    for ratios in (np.geomspace(0.1, 1.0, LEAST - 1), np.full(40, 0.7)):
        found = Curve.of("g", "m", ratios, ratios > 0.5)
        assert found.fit is None and all(curve == "-" for _, curve in found.rows)
    assert Curve.of("g", "m", np.geomspace(0.1, 1.0, LEAST), np.ones(LEAST, dtype=bool)).fit is not None


def test_the_curves_count_each_measure_of_each_group() -> None:
    records = [
        outcome("strong", "effect", [SKIN], [SKIN], ratio=1.0),  # named
        outcome("medium", "ambiguous", [SKIN], [SKIN], [CLOCK], ratio=1.1),  # most probable, not named
        outcome("weak", "ambiguous", [CLOCK], [SKIN], [SKIN], ratio=1.2),  # in the set alone
        outcome("weak", "not_decidable", [], [SKIN], ratio=1.3),
        outcome("strong", "effect", [SKIN], [SKIN], ratio=None),
        outcome("sensor_noise", "effect", [SKIN], [SKIN], ratio=0.1),
        outcome("outside", "effect", [SKIN], [SKIN], ratio=1.0),
    ]
    found = curves(records)
    assert list(found) == list(GROUPS)
    background, noise = found.values()
    assert [(one.bins[0].hits, one.bins[0].records) for one in background] == [(1, 4), (2, 4), (3, 4)]
    assert [(one.bins[0].hits, one.bins[0].text) for one in noise] == [(1, "0 to 0.2")] * 3
    assert curves(records[3:5]) == {} and EDGES[3] == 0.8
