"""Phase 2: the full nonlinear chain, refined on the samples (Zaman et al., 6.2.2, Eq. 32-34), and fits as a whole.

`PAPER` is the paper's way: Nelder-Mead on 15 parameters from the best of phase 1. The default is least squares with
sensitivities from several starts, all cases' clocks estimated, m_scale held and theta left to the data.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.errors import InputError
from biodyn_core.identification.objectives import (
    N_LINEAR,
    PENALTY,
    Clocks,
    Pull,
    Regularization,
    Surrogate,
    SurrogateSettings,
    TimeDomain,
)
from biodyn_core.identification.phase1 import Search, SwarmSettings, reached, search
from biodyn_core.identification.problem import Case, Errors, errors
from biodyn_core.parameters import LOWER, N_PARAMETERS, PARAMETERS, UPPER, Parameters, from_sigmoid, to_sigmoid
from biodyn_core.segments import MEASURED_SEGMENTS
from biodyn_core.subject import Subject

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

FIRST_STIFFENING: Final = float(np.sqrt(LOWER[13] * UPPER[13]))
"""Start of s_nl, which phase 1 does not see: the middle of Table 1 in log space."""

INTERIOR: Final = 0.02
"""A start keeps this share of each range from both bounds: on a bound the sigmoid map has no slope to leave it by."""

SIMPLEX: Final = 0.5
"""Edge of the first simplex in the mapped coordinates, each towards the middle of its range."""

AT_BOUND: Final = 1e-3
"""A parameter closer to a bound than this share of its range is on it."""

_TWINS: Final = 0.01
"""Starts that differ by less than this in every logarithm are refined once."""


@dataclass(frozen=True)
class FitSettings:
    """How a fit is done; what the paper leaves open or what departs from it is an option here.

    phase1 `per_case` searches each case's surrogate, `pooled` one surrogate of all. regularization and lambda_2: see
    `Pull`. mass_scale `fixed` holds the subject's, since accelerations say nothing of it.
    """

    phase1: Literal["per_case", "pooled"] = "per_case"
    refine: Literal["least-squares", "nelder-mead"] = "least-squares"
    regularization: Regularization = "log"
    lambda_2: float = 1e-6
    clocks: Clocks = "estimated"
    mass_scale: Literal["fixed", "free"] = "fixed"
    refined_starts: int = 4
    evaluations: int = 3000
    swarm: SwarmSettings = dataclasses.field(default_factory=SwarmSettings)
    surrogate: SurrogateSettings = dataclasses.field(default_factory=SurrogateSettings)

    def __post_init__(self) -> None:
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                raise InputError(f"{name} is {getattr(self, name)!r}, allowed are {' and '.join(allowed)}")
        for name, most in (("refined_starts", 1000), ("evaluations", 10_000_000)):
            if not 1 <= getattr(self, name) <= most:
                raise InputError(f"{name} is {getattr(self, name)}, allowed are 1 to {most}")
        if not 0.0 <= self.lambda_2 <= 1e3:
            raise InputError(f"lambda_2 is {self.lambda_2:g}, allowed are 0 to 1000")

    @property
    def free(self) -> Flags:
        """Which parameters are fitted, (15,)."""
        return np.array([p.group != "mass_scale" or self.mass_scale == "free" for p in PARAMETERS])


_CHOICES: Final = {
    "phase1": ("per_case", "pooled"),
    "refine": ("least-squares", "nelder-mead"),
    "regularization": ("physical", "log"),
    "clocks": ("trusted", "estimated"),
    "mass_scale": ("fixed", "free"),
}

PAPER: Final = FitSettings(
    refine="nelder-mead",
    regularization="physical",
    lambda_2=0.002,
    clocks="trusted",
    mass_scale="free",
    refined_starts=1,
    swarm=SwarmSettings(starts=1, polish=False),
)
"""The paper's way, complete (6.2)."""


@dataclass(frozen=True, eq=False)
class Fit:
    """One theta fitted to one case or several.

    subject carries it; reference (15,) is where the pull leads to; objective is Eq. 33 there, less the sensors' delays
    where clocks are estimated, costs (starts,) that of every refined start, best first; clock_delays_s (cases, 5, 2) is
    empty where they are trusted; at_bound names the parameters that end on a bound of Table 1.
    """

    subject: Subject
    settings: FitSettings
    reference: Floats
    objective: float
    costs: Floats
    errors: tuple[Errors, ...]
    at_bound: tuple[str, ...]
    clock_delays_s: Floats
    searches: tuple[Search, ...]
    evaluations: int
    penalties: Counter[str]

    @property
    def reached(self) -> int:
        """How many of the refined starts reached the best optimum."""
        return reached(self.costs)

    @property
    def error_percent(self) -> float:
        """J of Eq. 35: normalised rms in percent, mean over the measured segments and the cases."""
        return float(np.mean([error.mean_percent for error in self.errors]))

    def unpulled(self, cases: Sequence[Case]) -> TimeDomain:
        """The objective that was minimised, of the same cases, but for the pull: what the data alone say."""
        return TimeDomain(cases, self.subject.mass_matrix, Pull(self.reference, 0.0), self.settings.clocks)


def fit_case(case: Case, subject: Subject, seed: int, settings: FitSettings | None = None) -> Fit:
    """Fit one case; the subject gives anthropometry, mass matrix and m_scale. InputError as `fit_joint`."""
    return fit_joint([case], subject, seed, settings)


def fit_cases(
    cases: Sequence[Case],
    subject: Subject,
    seed: int,
    settings: FitSettings | None = None,
    searches: Sequence[Search] | None = None,
) -> list[Fit]:
    """Fit each case by itself, as the paper does; under `phase1: pooled` from one search over all.

    searches are those of `search_all` on the same cases, where they have been made already.
    """
    s = settings or FitSettings()
    found = search_all(cases, subject, seed, s) if searches is None else searches
    own = [[one] for one in found] if s.phase1 == "per_case" else [found] * len(cases)
    return [refine([case], subject, starts, s) for case, starts in zip(cases, own, strict=True)]


def fit_joint(
    cases: Sequence[Case],
    subject: Subject,
    seed: int,
    settings: FitSettings | None = None,
    searches: Sequence[Search] | None = None,
) -> Fit:
    """Fit one theta to all cases; searches as in `fit_cases`. InputError where the chain diverges from every start."""
    s = settings or FitSettings()
    return refine(cases, subject, search_all(cases, subject, seed, s) if searches is None else searches, s)


def search_all(cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings) -> tuple[Search, ...]:
    """Phase 1 of all cases, in their order: one search for each, or one of all."""
    groups = [cases] if settings.phase1 == "pooled" else [[case] for case in cases]
    surrogates = (Surrogate(group, subject.mass_matrix, settings.surrogate) for group in groups)
    return tuple(search(surrogate, seed, settings.swarm) for surrogate in surrogates)


def refine(cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings) -> Fit:
    """Phase 2 from what phase 1 found: the best starts by Eq. 33, each refined, the best kept."""
    starts, ranked = _starts(cases, subject, searches, settings)
    problem = TimeDomain(
        cases, subject.mass_matrix, Pull(starts[0], settings.lambda_2, settings.regularization), settings.clocks
    )
    ends = sorted((_refined(problem, start, settings) for start in starts), key=lambda end: end[1])
    theta, objective = ends[0]
    if objective >= PENALTY:
        raise InputError(f"{cases[0].name}: the chain diverges from every start; look for outliers in the recording")
    return Fit(
        subject=dataclasses.replace(subject, parameters=Parameters.from_vector(theta), provenance={}),
        settings=settings,
        reference=starts[0],
        objective=objective,
        costs=np.array([cost for _, cost in ends]),
        errors=tuple(errors(case, problem.accelerations(number, theta)) for number, case in enumerate(cases)),
        at_bound=at_bound(theta, settings.free),
        clock_delays_s=_clock_delays_s(problem, theta, settings.clocks),
        searches=tuple(searches),
        evaluations=problem.evaluations + ranked,
        penalties=problem.penalties,
    )


def at_bound(theta: Floats, free: Flags) -> tuple[str, ...]:
    """The fitted parameters that lie on a bound of Table 1."""
    share = (theta - LOWER) / (UPPER - LOWER)
    pinned = free & ((share < AT_BOUND) | (share > 1.0 - AT_BOUND))
    return tuple(p.name for p, flag in zip(PARAMETERS, pinned, strict=True) if flag)


def _starts(
    cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings
) -> tuple[Floats, int]:
    """Starts (k, 15) with s_nl and m_scale added (Eq. 32), best first and no twins; how many were tried."""
    found = np.concatenate([search.theta for search in searches])
    theta = np.empty((len(found), N_PARAMETERS))
    theta[:, :N_LINEAR], theta[:, 13], theta[:, 14] = found, FIRST_STIFFENING, subject.parameters.mass_scale
    unpulled = TimeDomain(cases, subject.mass_matrix, Pull(theta[0], 0.0))
    kept: list[Floats] = []
    for point in theta[np.argsort(unpulled.costs(theta), kind="stable")]:
        if all(np.abs(np.log(point / other)).max() > _TWINS for other in kept):
            kept.append(point)
    return np.array(kept[: settings.refined_starts]), len(theta)


def _refined(problem: TimeDomain, start: Floats, settings: FitSettings) -> tuple[Floats, float]:
    """Theta (15,) and objective after one run and one restart from its end, the better of both."""
    run = least_squares if settings.refine == "least-squares" else nelder_mead
    first = run(problem, _interior(start), settings.free, settings.evaluations)
    second = run(problem, _interior(first[0]), settings.free, settings.evaluations)
    return min(first, second, key=lambda end: end[1])


def _interior(theta: Floats) -> Floats:
    """Theta at least `INTERIOR` away from both bounds."""
    margin = INTERIOR * (UPPER - LOWER)
    return np.clip(theta, LOWER + margin, UPPER - margin)


def nelder_mead(problem: TimeDomain, start: Floats, free: Flags, evaluations: int) -> tuple[Floats, float]:
    """Theta (15,) and Eq. 33 by Nelder and Mead's simplex, its coefficients those of Gao and Han (2012).

    The first simplex is ours: SciPy's collapses at a bound before 1.13, and steps of 5 % suit no sigmoid.
    """
    theta, phi = _mapped(start, free)
    corners = np.repeat(phi[None, :], phi.size + 1, axis=0)
    corners[np.arange(phi.size), np.arange(phi.size)] += np.where(phi > 0.0, -SIMPLEX, SIMPLEX)
    options = {"initial_simplex": corners, "maxfev": evaluations, "maxiter": evaluations}
    found = optimize.minimize(
        lambda point: problem.cost(theta(point)),
        phi,
        method="Nelder-Mead",
        options={**options, "adaptive": True, "xatol": 1e-4, "fatol": 1e-8},
    )
    return theta(found.x), float(found.fun)


def least_squares(problem: TimeDomain, start: Floats, free: Flags, evaluations: int) -> tuple[Floats, float]:
    """Theta (15,) and objective by SciPy's trust region, with all derivatives from one batch of simulations."""
    theta, phi = _mapped(start, free)
    memory: dict[bytes, tuple[Floats, Floats]] = {}

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        """Residuals and derivatives by phi; the solver asks for one after the other."""
        key = point.tobytes()
        if key not in memory:
            memory.clear()
            at = theta(point)
            residuals, slopes = problem.linearised(at, free)
            memory[key] = residuals, slopes * ((at - LOWER) * (UPPER - at) / ((UPPER - LOWER) * at))[free]
        return memory[key]

    if not np.isfinite(linearised(phi)[0]).all():
        return start, PENALTY
    found = optimize.least_squares(
        lambda point: linearised(point)[0],
        phi,
        jac=lambda point: linearised(point)[1],
        xtol=1e-8,
        ftol=1e-10,
        gtol=1e-12,
        max_nfev=evaluations // (phi.size + 1) + 1,
    )
    return theta(found.x), float(2.0 * found.cost)


def _mapped(start: Floats, free: Flags) -> tuple[Callable[[Floats], Floats], Floats]:
    """The map from phi of the free parameters (p,) to theta (15,), the others as at the start; and phi of the start."""

    def theta(phi: Floats) -> Floats:
        everything = np.zeros(N_PARAMETERS)
        everything[free] = phi
        # Rounding must not carry a value out of Table 1.
        return np.where(free, np.clip(from_sigmoid(everything), LOWER, UPPER), start)

    margin = 1e-6 * (UPPER - LOWER)
    return theta, to_sigmoid(np.clip(start, LOWER + margin, UPPER - margin))[free]


def _clock_delays_s(problem: TimeDomain, theta: Floats, clocks: Clocks) -> Floats:
    if clocks == "trusted":
        return np.empty((0, len(MEASURED_SEGMENTS), 2))
    return np.array([problem.clock_delays_s(number, theta) for number in range(len(problem.cases))])
