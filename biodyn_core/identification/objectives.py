"""The two objectives of identification: transmissibility magnitudes (Zaman et al., Eq. 31) and samples (Eq. 33).

Body mass and m_scale cancel from every acceleration of the base chain (k, b, alpha_r M, F_nl and M are all proportional
to them), so the surrogate needs only the convention of M; effects may have masses of their own. Choices that the paper
leaves open are settings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS
from biodyn_core.body.constants import Constants
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.parameters import LOWER, N_PARAMETERS, STIFFENING, UPPER, from_log, to_log
from biodyn_core.body.subject import MassMatrix, Subject
from biodyn_core.effects import apply_to_seat, apply_to_sensors
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import Clocks, Regularization, SurrogateSettings
from biodyn_core.kernels.cost import LANES, difference_quotients, integrate_lanes
from biodyn_core.kernels.surrogate import surrogate_costs
from biodyn_core.population.distribution import SPREAD, Distribution

N_LINEAR: Final = STIFFENING
"""Number of parameters of phase 1: f_n, zeta and alpha_r; s_nl = 0 and m_scale = 1 are fixed (Eq. 29)."""

PENALTY: Final = 1e9
"""Cost of a parameter set whose response diverges; a zero response costs 5 per case."""

_SEGMENTS: Final = MEASURED_SEGMENT_INDEX.astype(np.int64)
_NO_TARGET: Final = np.empty((0, len(MEASURED_SEGMENTS)))
_NO_ACCEL: Final = np.empty((0, len(MEASURED_SEGMENTS), LANES))
_PER_KG: Final = 1.0
"""The body mass of constants where it cancels."""

_STEP: Final = 1e-6
"""Relative step of the parameters for the Jacobian; truncation and rounding errors are both below 1e-5."""


class Surrogate:
    """Eq. 31 over one case or several: sum w_i gamma_i^2 (|T_i| - |T_meas,i|)^2 + lambda_1 |theta_log - theta_ref|^2.

    T_i = 1 - (2 pi f)^2 H_i, because the measured transmissibility is of accelerations.
    """

    def __init__(
        self, cases: Sequence[Case], mass_matrix: MassMatrix, settings: SurrogateSettings | None = None
    ) -> None:
        s = settings or SurrogateSettings()
        self.mass_matrix = mass_matrix
        self.lower, self.upper = to_log(LOWER[:N_LINEAR]), to_log(UPPER[:N_LINEAR])
        self._omega = 2.0 * np.pi * np.concatenate([case.frequency_hz for case in cases])
        self._magnitude = np.concatenate([case.transmissibility for case in cases])
        self._weight = np.concatenate([case.coherence for case in cases]) * np.array(s.segment_weights)
        self._lambda_1 = s.lambda_1
        middle = 0.5 * (self.lower + self.upper)
        self._reference = middle if s.reference is None else to_log(s.reference.vector()[:N_LINEAR])

    def costs(self, theta_log: Floats) -> Floats:
        """The objective (p,) at points (p, 13) in log space."""
        theta = np.ones((theta_log.shape[0], N_PARAMETERS))
        theta[:, :N_LINEAR] = from_log(theta_log)
        c, costs = Constants.of(theta, _PER_KG, self.mass_matrix), np.empty(theta.shape[0])
        alpha_r = np.ascontiguousarray(c.rayleigh_rad_per_s)
        surrogate_costs(
            self._omega, self._magnitude, self._weight, _SEGMENTS, c.stiffness_n_per_m, c.damping_n_s_per_m,
            c.inertia_kg, alpha_r, costs,
        )  # fmt: skip
        return np.asarray(costs + self._lambda_1 * ((theta_log - self._reference) ** 2).sum(axis=1))


@dataclass(frozen=True, eq=False)
class RegularizationTerm:
    """The last term of Eq. 33: lambda_2 |theta - reference|^2 in physical units as printed, or of the logarithms."""

    reference: Floats
    lambda_2: float = 0.002
    regularization: Regularization = "physical"
    variance: ClassVar[float] = 0.0
    """It is a choice and no measurement, so it adds no scatter."""

    def __call__(self, theta: Floats) -> Floats:
        """Residuals (..., 15) whose squares add up to the term."""
        deviation = np.log(theta / self.reference) if self.regularization == "log" else theta - self.reference
        return np.asarray(np.sqrt(self.lambda_2) * deviation)


@dataclass(frozen=True, eq=False)
class PriorTerm:
    """A prior of the parameters in place of that term: the squared Mahalanobis distance, weighted.

    variance: that of an independent residual of the data, so that the whole objective is -2 ln of the posterior times
    that variance. scale: precision of the prior, relative to that of the distribution.
    """

    prior: Distribution
    variance: float
    scale: float

    @property
    def weight(self) -> float:
        """The weight of the squared distance."""
        return self.variance * self.scale

    def __call__(self, theta: Floats) -> Floats:
        """Residuals (..., 13) whose squares add up to the term."""
        return np.asarray(np.sqrt(self.weight) * self.prior.standardized(theta))

    def variances(self, theta: Floats) -> Floats:
        """Variances (15,) of ln theta at theta (15,) by the prior alone, infinite without a prior."""
        found = np.full(N_PARAMETERS, np.inf)
        found[SPREAD] = np.diag(self.prior.covariance_at(theta)) / self.scale
        return found


Term = RegularizationTerm | PriorTerm


LARGEST_DELAY_S: Final = 2e-3
"""Delays are removed to first order: with 6 ms parameters are wrong by a tenth, with 12 ms by a third."""


class TimeDomain:
    """Eq. 33 over one case or several: sum over cases and measured segments of |z'' - a|^2 / |a|^2, and regularization.

    z'' = x'' + seat, from rest; masked samples and the warm-up are left out. The model's response is not low-passed,
    because the seat is: a second low-pass would attenuate a nearly linear chain twice.

    clocks: `trusted` as in the paper, or `estimated`: least squares then uses residuals less the best constant and
    linearly growing delay of each sensor. Otherwise clocks that differ by 0.2 ms change damping by several percent.
    First order in the delay, which must stay below `LARGEST_DELAY_S`.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        subject: Subject,
        term: Term,
        clocks: Clocks = "trusted",
        substeps: Sequence[int] | None = None,
    ) -> None:
        self.cases, self.subject = tuple(cases), subject
        self.term = term
        self._weights = [case.weight for case in cases]
        self._clocks = clocks
        self._seats = [apply_to_seat(subject.effects, case.seat_mps2, case.rate_hz, case.channels) for case in cases]
        # One choice for the whole of Table 1: steps that change with theta would make the objective discontinuous.
        self.substeps = tuple(substeps or [self._chain(UPPER).substeps(case.rate_hz) for case in cases])
        self.evaluations = 0
        self.penalties: Counter[str] = Counter()

    def costs(self, theta: Floats) -> Floats:
        """Eq. 33 as printed at points (p, 15), (p,), in batches of `LANES`; a penalty where it is not finite."""
        if self.subject.effects:
            return np.array([self.cost(point) for point in theta])
        total = np.asarray((self.term(theta) ** 2).sum(axis=1))
        for begin in range(0, len(theta), LANES):
            batch = slice(begin, begin + LANES)
            for number, weight in enumerate(self._weights):
                target = self.cases[number].measured_mps2
                total[batch] += self._lanes(number, theta[batch], target, weight, _NO_ACCEL)
        self.evaluations += len(theta) * len(self.cases)
        return np.array([self._penalised(cost) for cost in total])

    def cost(self, theta: Floats) -> float:
        """The same at one point (15,)."""
        term = self.term(theta)
        total = float(term @ term)
        for number, (case, weight) in enumerate(zip(self.cases, self._weights, strict=True)):
            with np.errstate(all="ignore"):  # the total shows non-finite values
                miss = self.accelerations(number, theta)
                miss -= case.measured_mps2
                total += float((weight * miss * miss).sum())  # a dot product would use several threads
        self.evaluations += len(self.cases)
        return self._penalised(total)

    def accelerations(self, number: int, theta: Floats) -> Floats:
        """Absolute accelerations z'' (n, 5) of the measured segments in one case at one point (15,)."""
        case = self.cases[number]
        stepper = Stepper(self._chain(theta), case.rate_hz, self.substeps[number])
        accel = stepper.push(self._seats[number], channels=case.channels)
        accel = apply_to_sensors(self.subject.effects, accel, case.rate_hz, case.channels)[:, MEASURED_SEGMENT_INDEX]
        return np.ascontiguousarray(accel)  # strided arrays are slow later

    def _chain(self, theta: Floats) -> Chain:
        s = self.subject
        return Chain.of_theta(theta, s.body_mass_kg, s.mass_matrix).with_effects(s.effects)

    def linearised(self, theta: Floats, free: Flags, others: Sequence[Floats] | None = None) -> tuple[Floats, Floats]:
        """Residuals (q,) and their derivatives (q, p + k) by ln theta of the p parameters that are free.

        They are a root of the products of all samples' rows: the same sum of squares, gradient and J'J in a size that
        does not grow with the records; not finite where the response is not. others, for each case as in
        `rows`, add k columns.
        """
        points = _difference_points(theta, free)
        term = _differences(self.term(points).T)
        beside = others[0].shape[2] if others else 0
        term = np.concatenate([term[:, :-1], np.zeros((len(term), beside)), term[:, -1:]], axis=1)
        products = term.T @ term
        for number in range(len(self.cases)):
            products += self.products(number, theta, free, others[number] if others else None)
        self._penalised(products[-1, -1])  # counts it
        return linearised_of(products)

    def products(self, number: int, theta: Floats, free: Flags, others: Floats | None = None) -> Floats:
        """Products (q, q) of all samples' `rows` of one case, not finite where the response is not."""
        with np.errstate(all="ignore"):
            rows = self.rows(number, theta, free, others)
            rows = rows.reshape(-1, rows.shape[-1])
            return np.asarray(rows.T @ rows)

    def rows(self, number: int, theta: Floats, free: Flags, others: Floats | None = None) -> Floats:
        """Derivatives by ln theta of the p that are free, then the residual, of one case, (n, 5, p + 1).

        Rows start after the warm-up, divided by the root of the segment's energy, 0 where not compared. One-sided
        differences in one batch; at most `LANES` - 1 parameters are free. others (m, 5, k) are accelerations of other
        models over the whole case; their differences are columns before the residual.
        """
        case = self.cases[number]
        weight = np.sqrt(self._weights[number][case.begin :])
        rows = self._slopes(number, theta, free)[case.begin :]
        answers = rows[:, :, -1].copy()
        if others is not None:
            rows = np.concatenate([rows[:, :, :-1], others[case.begin :] - rows[:, :, -1:], rows[:, :, -1:]], axis=2)
        rows[:, :, -1] -= case.measured_mps2[case.begin :]
        rows *= weight[:, :, None]
        if self._clocks == "estimated":
            _remove_projection(rows, _delays(answers, case.rate_hz) * weight[:, :, None])
        return rows

    def term_slopes(self, theta: Floats, free: Flags) -> Floats:
        """Derivatives (m, p) of the residuals of the last term by ln theta of the p that are free."""
        return _differences(self.term(_difference_points(theta, free)).T)[:, :-1]

    def slopes(self, number: int, theta: Floats, free: Flags) -> Floats:
        """Derivatives (n, 5, p) of the accelerations in one case by ln theta of the p that are free."""
        return self._slopes(number, theta, free)[:, :, :-1]

    def _slopes(self, number: int, theta: Floats, free: Flags) -> Floats:
        """The same with the accelerations themselves as last column, (n, 5, p + 1)."""
        points = _difference_points(theta, free)
        self.evaluations += len(points)
        values = self._accelerations_at(number, points)
        difference_quotients(values, _STEP)
        return values

    def clock_delays_s(self, number: int, theta: Floats) -> Floats:
        """Delay of each segment's sensor at the middle of one case, s, and its growth per second, (5, 2)."""
        delays = self._misfit(number, theta)[2]
        return np.where(self.cases[number].energy[:, None] > 0.0, delays, np.nan)

    def residuals(self, number: int, theta: Floats) -> Floats:
        """Model minus measurement of one case (n, 5), NaN where not compared, without the part of estimated delays."""
        case = self.cases[number]
        miss, shapes, delays = self._misfit(number, theta)
        if self._clocks == "estimated":
            miss = miss - np.einsum("nsd,sd->ns", shapes, delays)
        residuals = np.full(case.measured_mps2.shape, np.nan)
        residuals[case.begin :] = np.where(case.compared[case.begin :], miss, np.nan)
        return residuals

    def _misfit(self, number: int, theta: Floats) -> tuple[Floats, Floats, Floats]:
        """Model minus measurement after the warm-up (n, 5), its derivatives by delays (n, 5, 2), the delays (5, 2)."""
        case = self.cases[number]
        accel, weight = self.accelerations(number, theta)[case.begin :], np.sqrt(self._weights[number][case.begin :])
        miss, shapes = accel - case.measured_mps2[case.begin :], _delays(accel, case.rate_hz)
        found = [
            np.linalg.lstsq(shapes[:, s] * weight[:, s, None], miss[:, s] * weight[:, s], rcond=None)[0]
            for s in range(len(MEASURED_SEGMENTS))
        ]
        return miss, shapes, np.array(found)

    def _accelerations_at(self, number: int, points: Floats) -> Floats:
        """Accelerations (n, 5, p) at points (p, 15), in one batch where there are no effects."""
        if self.subject.effects:
            return np.stack([self.accelerations(number, point) for point in points], axis=2)
        accel = np.empty((self.cases[number].seat_mps2.size, len(MEASURED_SEGMENTS), LANES))
        self._lanes(number, points, _NO_TARGET, _NO_TARGET, accel)
        return accel[:, :, : len(points)]

    def _lanes(self, number: int, theta: Floats, target: Floats, weight: Floats, accel: Floats) -> Floats:
        case, substeps, costs = self.cases[number], self.substeps[number], np.empty(LANES)
        lanes = _lanes_of(Constants.of(theta, _PER_KG, self.subject.mass_matrix))
        step_s = 1.0 / (case.rate_hz * substeps)
        integrate_lanes(case.seat_mps2, lanes, step_s, substeps, _SEGMENTS, target, weight, costs, accel)
        return costs[: len(theta)]

    def _penalised(self, cost: float) -> float:
        """The cost, or the penalty where the chain has diverged, counted by cause."""
        if cost < PENALTY:
            return float(cost)
        self.penalties["not a number" if np.isnan(cost) else "diverged"] += 1
        return PENALTY


def _lanes_of(c: Constants) -> Floats:
    """Constants for `integrate_lanes`, (25, LANES); surplus lanes repeat the last theta."""
    stiffening = c.stiffness_n_per_m * c.stiffening_per_m
    rows = np.column_stack(
        [c.stiffness_n_per_m, c.damping_n_s_per_m, stiffening, 1.0 / c.inertia_kg, c.rayleigh_rad_per_s]
    )
    return np.ascontiguousarray(rows[np.minimum(np.arange(LANES), len(rows) - 1)].T)


def _delays(accel: Floats, rate_hz: float) -> Floats:
    """Derivatives (n, 5, 2) of responses (n, 5) by a constant delay of the clock and by a linearly growing one."""
    slope = np.gradient(accel, 1.0 / rate_hz, axis=0)
    time_s = (np.arange(len(accel)) - 0.5 * (len(accel) - 1)) / rate_hz
    return np.stack([slope, slope * time_s[:, None]], axis=2)


def _remove_projection(rows: Floats, shapes: Floats) -> None:
    """Remove the projection on the shapes (n, 5, 2) from rows (n, 5, p), segment by segment, in place.

    Variable projection (Kaufman 1975): the derivatives ignore the change of the shapes with theta.
    """
    for s in range(rows.shape[1]):
        basis = shapes[:, s]
        share = np.linalg.pinv(basis.T @ basis, hermitian=True) @ (basis.T @ rows[:, s])
        rows[:, s] -= basis @ share


def _difference_points(theta: Floats, free: Flags) -> Floats:
    """Points (p + 1, 15): one step along each free parameter, and last the point itself."""
    which = np.flatnonzero(free)
    points = np.repeat(theta[None, :], which.size + 1, axis=0)
    points[np.arange(which.size), which] *= 1.0 + _STEP
    return points


def _differences(values: Floats) -> Floats:
    """Derivatives by ln theta and last the value, from values (..., p + 1) at `_difference_points`, in place."""
    values[..., :-1] -= values[..., -1:]
    values[..., :-1] /= _STEP
    return values


def linearised_of(products: Floats) -> tuple[Floats, Floats]:
    """Residuals (q,) and derivatives (q, q - 1) with these products (q, q), of which the residual's is the last.

    Infinite where the sum of squares is at least the penalty or not a number.
    """
    root = _root(products if products[-1, -1] < PENALTY else np.full_like(products, np.inf))
    return root[:, -1], root[:, :-1]


def _root(products: Floats) -> Floats:
    """A root R (q, q) with R'R = products (q, q); scaled first, because columns of parameters on bounds are tiny."""
    if not np.isfinite(products).all():
        return np.full_like(products, np.inf)
    scale = np.sqrt(np.diag(products))
    scale[scale == 0.0] = 1.0
    squares, vectors = np.linalg.eigh(products / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(squares, 0.0))[:, None] * vectors.T * scale)
