"""The swarm, and its results on surrogates of our size."""

import dataclasses
import functools

import fitting
import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.identification.objectives import Surrogate, SurrogateSettings
from biodyn_core.identification.phase1 import SwarmSettings, minimise, reached, search
from biodyn_core.identification.problem import Case

BOX = -np.ones(4), 2.0 * np.ones(4)


def bowl(at: np.ndarray):
    """Squares of the distance to a point."""
    return lambda points: ((points - at) ** 2).sum(axis=1)


@settings(max_examples=40)
@given(st.lists(st.floats(-1.0, 2.0), min_size=4, max_size=4), st.integers(0, 2**32))
def test_the_minimum_of_a_quadratic_is_found_also_on_a_bound(bottom: list[float], seed: int) -> None:
    found = minimise(bowl(np.array(bottom)), *BOX, np.random.default_rng(seed), SwarmSettings(30, 150))
    assert found.cost < 1e-4
    np.testing.assert_allclose(found.point, bottom, atol=1e-2)


@given(st.integers(0, 2**32), st.floats(1e-3, 1.0), st.integers(2, 30))
def test_no_particle_ever_leaves_the_box(seed: int, clamp: float, particles: int) -> None:
    seen = []

    def costs(points: np.ndarray) -> np.ndarray:
        seen.append(points.copy())
        return points.sum(axis=1)

    minimise(costs, *BOX, np.random.default_rng(seed), SwarmSettings(particles, 20, velocity_clamp=clamp))
    places = np.array(seen)
    assert ((places >= BOX[0]) & (places <= BOX[1])).all()
    # A reflection can only shorten a step.
    assert np.abs(np.diff(places, axis=0)).max() <= clamp * 3.0 * (1.0 + 1e-12)


def test_equal_seeds_give_equal_results_and_others_do_not() -> None:
    surrogate = Surrogate(fitting.true_cases("segment")[:1], "segment")
    few = SwarmSettings(20, 10, starts=3, polish=False)
    first, again, other = (search(surrogate, seed, few) for seed in (1, 1, 2))
    assert first.theta.tolist() == again.theta.tolist() and first.costs.tolist() == again.costs.tolist()
    assert first.costs.tolist() != other.costs.tolist()
    assert first.costs.tolist() == sorted(first.costs) and len(set(first.costs.tolist())) == 3
    assert first.evaluations == 3 * 20 * 11


def test_costs_that_are_not_finite_are_counted_and_ignored() -> None:
    def holed(points: np.ndarray) -> np.ndarray:
        costs = bowl(np.full(4, 0.5))(points)
        costs[points[:, 0] > 1.0] = np.nan
        costs[points[:, 1] > 1.0] = -np.inf
        return costs

    found = minimise(holed, *BOX, np.random.default_rng(0), SwarmSettings(40, 100))
    assert found.cost < 1e-4 and set(found.penalties) == {"not a number", "infinite"}
    assert min(found.penalties.values()) >= 5

    with pytest.raises(InputError, match=r"finite nowhere .*'not a number': 220"):
        minimise(lambda points: np.full(len(points), np.nan), *BOX, np.random.default_rng(0), SwarmSettings(20, 10))


def test_starts_that_reached_the_best_are_counted() -> None:
    assert reached(np.array([1.0, 1.009, 1.011, 7.0])) == 2
    assert reached(np.array([3.0])) == 1


@functools.cache
def surrogate_of(mass_matrix: str, error: float) -> tuple[Surrogate, np.ndarray]:
    """A surrogate at 99 frequencies with a relative error, without regularization, and the truth (13,)."""
    theta = fitting.theta_of(fitting.drawn(7, mass_matrix))[:13]
    grid = np.linspace(1.0, 50.0, 99)
    h = naive.transfer_functions(np.append(theta, [0.0, 1.0]), 70.0, mass_matrix, grid)
    magnitude = np.abs(1.0 - ((2.0 * np.pi * grid) ** 2)[:, None] * h)[:, MEASURED_SEGMENT_INDEX]
    magnitude *= 1.0 + error * np.random.default_rng(3).standard_normal(magnitude.shape)
    none = np.zeros((4, 5))
    case = Case(
        "drawn", "road", 600.0, none[:, 0], none, none > 0.0, np.ones(5), grid, magnitude, np.ones_like(magnitude), ()
    )
    return Surrogate([case], mass_matrix, SurrogateSettings(lambda_1=0.0)), theta


@pytest.mark.parametrize("mass_matrix", fitting.MASS_MATRICES)
def test_every_seed_reaches_the_optimum_of_a_typical_problem(mass_matrix: str) -> None:
    surrogate, theta = surrogate_of(mass_matrix, error=0.0)
    assert surrogate.costs(np.log(theta)[None, :])[0] < 1e-20
    surrogate, theta = surrogate_of(mass_matrix, error=0.05)
    found = search(surrogate, 5, SwarmSettings(starts=4))
    assert found.reached == 4
    assert found.costs[0] <= surrogate.costs(np.log(theta)[None, :])[0]
    np.testing.assert_allclose(found.theta[:, :6], np.tile(theta[:6], (4, 1)), rtol=0.15)


def test_the_descent_only_goes_down() -> None:
    surrogate, _ = surrogate_of("segment", error=0.05)
    few = SwarmSettings(20, 20, starts=3)
    up, down = (search(surrogate, 1, dataclasses.replace(few, polish=polish)) for polish in (False, True))
    assert (down.costs <= up.costs).all() and down.costs[0] < 0.9 * up.costs[0]
    assert up.evaluations == 3 * 20 * 21 < down.evaluations


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 2])
def test_most_swarms_end_in_the_lowest_of_several_minima(number: int) -> None:
    """Spectra of a few windows of a second; not all 16 do, so a fit must not rest on one."""
    surrogate = Surrogate(fitting.true_cases("cascade")[number : number + 1], "cascade")
    found = search(surrogate, 3, SwarmSettings(starts=16))
    assert 9 <= found.reached < 16
    assert found.costs[-1] > 1.2 * found.costs[0]


@pytest.mark.slow
def test_another_global_optimiser_finds_nothing_better() -> None:
    surrogate = Surrogate(fitting.true_cases("cascade")[:1], "cascade")
    ours = search(surrogate, 1)
    others = [
        optimize.differential_evolution(
            lambda points: surrogate.costs(np.ascontiguousarray(points.T)),
            np.column_stack([surrogate.lower, surrogate.upper]),
            vectorized=True, updating="deferred", popsize=15, maxiter=1500, tol=1e-8, seed=seed, polish=True,
        ).fun
        for seed in range(4)
    ]  # fmt: skip
    assert ours.costs[0] == pytest.approx(min(others), rel=0.01)
    assert ours.penalties.total() == 0
