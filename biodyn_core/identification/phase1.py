"""Phase 1: a particle swarm on the linear surrogate finds the basin (Zaman et al., 6.2.1, Eq. 29-31).

The paper gives 80 particles and 200 iterations. What decides whether a swarm arrives it does not give: here the inertia
falls, walls reflect, velocities are clamped, and a particle follows the best of its neighbours on a ring (Shi and
Eberhart 1998; Clerc and Kennedy 2002 for the two pulls; Kennedy and Mendes 2002 for the ring). The valley's floor is
so flat that 200 iterations end a few percent above its lowest point; where asked a local descent goes the rest. Where
short records make several valleys, a swarm ends in the lowest 8 to 9 times in 10 with 3 neighbours to a side, and 3 to
5 times with 10 or more.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import from_log
from biodyn_core.identification.objectives import Surrogate
from biodyn_core.identification.settings import SwarmSettings

PULL: Final = 1.49445
"""How strongly a particle is drawn to its own best place, and to its neighbours' (Clerc and Kennedy 2002)."""

DESCENT_STEP: Final = 1e-6
"""Step of a logarithm for the slopes of the descent."""

SAME_OPTIMUM: Final = 0.01
"""Starts whose cost is above the best by no more than this share of it have reached the same optimum."""


@dataclass(frozen=True, eq=False)
class Swarm:
    """Where one swarm ended: point (d,), its cost, evaluations, and how often a cost was not finite, by cause."""

    point: Floats
    cost: float
    evaluations: int
    penalties: Counter[str]


@dataclass(frozen=True, eq=False)
class Search:
    """What several swarms found: starts, theta (starts, 13) and costs (starts,), the best first; all evaluations."""

    theta: Floats
    costs: Floats
    evaluations: int
    penalties: Counter[str]

    @property
    def reached(self) -> int:
        """How many starts reached the best optimum."""
        return reached(self.costs)


def reached(costs: Floats) -> int:
    """How many of the costs are the best one's, to `SAME_OPTIMUM`."""
    return int(np.count_nonzero(costs <= costs.min() * (1.0 + SAME_OPTIMUM)))


def search(surrogate: Surrogate, seed: int, settings: SwarmSettings | None = None) -> Search:
    """Run the swarms, each with a generator of its own that depends on the seed and its number alone."""
    s = settings or SwarmSettings()
    generators = [np.random.default_rng(sequence) for sequence in np.random.SeedSequence(seed).spawn(s.starts)]
    swarms = [minimise(surrogate.costs, surrogate.lower, surrogate.upper, rng, s) for rng in generators]
    if s.polish:
        swarms = [_descended(surrogate, swarm) for swarm in swarms]
    swarms.sort(key=lambda swarm: swarm.cost)
    return Search(
        from_log([swarm.point for swarm in swarms]),
        np.array([swarm.cost for swarm in swarms]),
        sum(swarm.evaluations for swarm in swarms),
        sum((swarm.penalties for swarm in swarms), Counter()),
    )


def minimise(
    costs: Callable[[Floats], Floats],
    lower: Floats,
    upper: Floats,
    rng: np.random.Generator,
    settings: SwarmSettings | None = None,
) -> Swarm:
    """Minimise a function of many points (p, d) to costs (p,) within lower and upper (d,).

    A cost that is not finite is never the best of a particle. Raises InputError where no particle ever has one.
    """
    s = settings or SwarmSettings()
    width, penalties = upper - lower, Counter[str]()
    fastest = s.velocity_clamp * width
    place = lower + width * rng.random((s.particles, lower.size))
    velocity = fastest * rng.uniform(-1.0, 1.0, place.shape)
    best, best_costs = place.copy(), _finite(costs(place), penalties)
    ring = (np.arange(s.particles)[:, None] + np.arange(-s.neighbours, s.neighbours + 1)) % s.particles
    for inertia in np.linspace(s.first_inertia, s.last_inertia, s.iterations):
        leaders = best[ring[np.arange(s.particles), np.argmin(best_costs[ring], axis=1)]]
        own, common = rng.random(place.shape), rng.random(place.shape)
        velocity = inertia * velocity + PULL * (own * (best - place) + common * (leaders - place))
        velocity = np.clip(velocity, -fastest, fastest)
        place, velocity = _reflect(place + velocity, velocity, lower, upper)
        found = _finite(costs(place), penalties)
        better = found < best_costs
        best[better], best_costs[better] = place[better], found[better]
    first = int(np.argmin(best_costs))
    if not np.isfinite(best_costs[first]):
        raise InputError(f"the objective is finite nowhere in Table 1 ({dict(penalties)}); check the recording")
    return Swarm(best[first], float(best_costs[first]), s.particles * (s.iterations + 1), penalties)


def _descended(surrogate: Surrogate, swarm: Swarm) -> Swarm:
    """Walk down from where a swarm ended, with central differences in one batch."""
    steps = DESCENT_STEP * np.eye(swarm.point.size)
    moves = np.concatenate([np.zeros((1, swarm.point.size)), steps, -steps])
    calls = 0

    def cost_and_slope(point: Floats) -> tuple[float, Floats]:
        nonlocal calls
        calls += 1
        costs = surrogate.costs(point + moves)
        ahead, behind = np.split(costs[1:], 2)
        return float(costs[0]), (ahead - behind) / (2.0 * DESCENT_STEP)

    bounds = list(zip(surrogate.lower, surrogate.upper, strict=True))
    options = {"maxiter": 500, "ftol": 1e-10}
    found = optimize.minimize(cost_and_slope, swarm.point, jac=True, method="SLSQP", bounds=bounds, options=options)
    evaluations = swarm.evaluations + calls * len(moves)
    if not found.fun < swarm.cost:
        return dataclasses.replace(swarm, evaluations=evaluations)
    point = np.clip(found.x, surrogate.lower, surrogate.upper)  # rounding
    return Swarm(point, float(found.fun), evaluations, swarm.penalties)


def _finite(costs: Floats, penalties: Counter[str]) -> Floats:
    """Costs with inf for what is not finite, counted by cause."""
    for cause, found in (("not a number", np.isnan(costs)), ("infinite", np.isinf(costs))):
        if found.any():
            penalties[cause] += int(found.sum())
    return np.where(np.isfinite(costs), costs, np.inf)


def _reflect(place: Floats, velocity: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Mirror what has passed a wall; a step is shorter than the range, so once is enough."""
    below, above = place < lower, place > upper
    inside = np.where(below, 2.0 * lower - place, np.where(above, 2.0 * upper - place, place))
    return np.clip(inside, lower, upper), np.where(below | above, -velocity, velocity)
