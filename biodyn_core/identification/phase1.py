"""Phase 1: a particle swarm on the linear surrogate finds the basin (Zaman et al., 6.2.1, Eq. 29-31).

The paper specifies 80 particles and 200 iterations, but not the parameters that decide convergence. Here the inertia
decreases, bounds reflect, velocities are clamped, and a particle follows the best of its neighbours on a ring (Shi and
Eberhart 1998; Clerc and Kennedy 2002 for the acceleration coefficients; Kennedy and Mendes 2002 for the ring). The
minimum is so flat that 200 iterations end a few percent above it; an optional local descent does the rest. Short
records cause several minima: a swarm then finds the lowest in 8 to 9 of 10 runs with 3 neighbours per side, and in 3 to
5 with 10 or more.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.parameters import from_log
from biodyn_core.identification.objectives import Surrogate
from biodyn_core.identification.settings import SwarmSettings

ACCELERATION: Final = 1.49445
"""Acceleration towards a particle's own best position, and towards its neighbours' (Clerc and Kennedy 2002)."""

DESCENT_STEP: Final = 1e-6
"""Step of the logarithms for derivatives in the descent."""

SAME_OPTIMUM: Final = 0.01
"""Starts whose costs exceed the best by at most this share reached the same optimum."""


@dataclass(frozen=True, eq=False)
class Swarm:
    """Result of one swarm: point (d,), cost, evaluations, and counts of non-finite costs by cause."""

    point: Floats
    cost: float
    evaluations: int
    penalties: Counter[str]


@dataclass(frozen=True, eq=False)
class Search:
    """Result of several swarms: theta (starts, 13) and costs (starts,), best first, and all evaluations."""

    theta: Floats
    costs: Floats
    evaluations: int
    penalties: Counter[str]

    @property
    def reached(self) -> int:
        """The number of starts that reached the best optimum."""
        return reached(self.costs)


def reached(costs: Floats) -> int:
    """The number of costs equal to the best within `SAME_OPTIMUM`."""
    return int(np.count_nonzero(costs <= costs.min() * (1.0 + SAME_OPTIMUM)))


def search(
    surrogate: Surrogate, seed: int, settings: SwarmSettings | None = None, parallel: ParallelMap = serial_map
) -> Search:
    """Run the swarms; the random generator of each depends on the seed and its number alone."""
    s = settings or SwarmSettings()
    swarms = list(parallel("search", _swarm, (surrogate, s), np.random.SeedSequence(seed).spawn(s.starts)))
    swarms.sort(key=lambda swarm: swarm.cost)
    return Search(
        from_log([swarm.point for swarm in swarms]),
        np.array([swarm.cost for swarm in swarms]),
        sum(swarm.evaluations for swarm in swarms),
        sum((swarm.penalties for swarm in swarms), Counter()),
    )


def _swarm(problem: tuple[Surrogate, SwarmSettings], sequence: np.random.SeedSequence) -> Swarm:
    """One swarm, with its descent if wanted."""
    surrogate, s = problem
    swarm = minimise(surrogate.costs, surrogate.lower, surrogate.upper, np.random.default_rng(sequence), s)
    return _descend(surrogate, swarm) if s.polish else swarm


def minimise(
    costs: Callable[[Floats], Floats],
    lower: Floats,
    upper: Floats,
    rng: np.random.Generator,
    s: SwarmSettings,
) -> Swarm:
    """Minimise a function of many points (p, d) to costs (p,) within lower and upper (d,).

    Non-finite costs are never a particle's best. Raises InputError if every cost is non-finite.
    """
    width, penalties = upper - lower, Counter[str]()
    fastest = s.velocity_clamp * width
    position = lower + width * rng.random((s.particles, lower.size))
    velocity = fastest * rng.uniform(-1.0, 1.0, position.shape)
    best, best_costs = position.copy(), _finite(costs(position), penalties)
    ring = (np.arange(s.particles)[:, None] + np.arange(-s.neighbours, s.neighbours + 1)) % s.particles
    for inertia in np.linspace(s.first_inertia, s.last_inertia, s.iterations):
        leaders = best[ring[np.arange(s.particles), np.argmin(best_costs[ring], axis=1)]]
        own, shared = rng.random(position.shape), rng.random(position.shape)
        velocity = inertia * velocity + ACCELERATION * (own * (best - position) + shared * (leaders - position))
        velocity = np.clip(velocity, -fastest, fastest)
        position, velocity = _reflect(position + velocity, velocity, lower, upper)
        found = _finite(costs(position), penalties)
        better = found < best_costs
        best[better], best_costs[better] = position[better], found[better]
    first = int(np.argmin(best_costs))
    if not np.isfinite(best_costs[first]):
        raise InputError(f"the objective is finite nowhere in Table 1 ({dict(penalties)}); check the recording")
    return Swarm(best[first], float(best_costs[first]), s.particles * (s.iterations + 1), penalties)


def _descend(surrogate: Surrogate, swarm: Swarm) -> Swarm:
    """Descend from the end of a swarm, with central differences in one batch."""
    steps = DESCENT_STEP * np.eye(swarm.point.size)
    moves = np.concatenate([np.zeros((1, swarm.point.size)), steps, -steps])
    batches = 0

    def cost_and_slope(point: Floats) -> tuple[float, Floats]:
        nonlocal batches
        batches += 1
        costs = surrogate.costs(point + moves)
        ahead, behind = np.split(costs[1:], 2)
        return float(costs[0]), (ahead - behind) / (2.0 * DESCENT_STEP)

    bounds = list(zip(surrogate.lower, surrogate.upper, strict=True))
    found = scipy.optimize.minimize(
        cost_and_slope, swarm.point, jac=True, method="SLSQP", bounds=bounds, options={"maxiter": 500, "ftol": 1e-10}
    )
    evaluations = swarm.evaluations + batches * len(moves)
    if not found.fun < swarm.cost:
        return dataclasses.replace(swarm, evaluations=evaluations)
    point = np.clip(found.x, surrogate.lower, surrogate.upper)  # rounding
    return Swarm(point, float(found.fun), evaluations, swarm.penalties)


def _finite(costs: Floats, penalties: Counter[str]) -> Floats:
    """Costs with inf in position of non-finite ones, which are counted by cause."""
    for cause, found in (("not a number", np.isnan(costs)), ("infinite", np.isinf(costs))):
        if found.any():
            penalties[cause] += int(found.sum())
    return np.where(np.isfinite(costs), costs, np.inf)


def _reflect(position: Floats, velocity: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Reflect positions beyond a bound; steps are shorter than the range, so one reflection is enough."""
    below, above = position < lower, position > upper
    inside = np.where(below, 2.0 * lower - position, np.where(above, 2.0 * upper - position, position))
    return np.clip(inside, lower, upper), np.where(below | above, -velocity, velocity)
