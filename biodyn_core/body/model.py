"""Chain: the six-degree-of-freedom seated upper body; its matrices, linear response, modes and time response.

Zaman et al., Eq. 1-20; contradictions of the paper are named options (`mass_matrix`, `seat_force`).
Vertical axis only. Not validated beyond the paper's two adult men, upright, without backrest.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from biodyn_core.base.arrays import Complexes, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import N_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.constants import Constants
from biodyn_core.body.effect_assembly import EffectAssembly, Element
from biodyn_core.body.subject import MassMatrix, Subject
from biodyn_core.effects import AppliedEffect, ChainEffect, Joint, active, apply_to_seat

SeatForce = Literal["inertia", "joint", "paper"]

CASCADE_FORCES: Final = "forces under mass_matrix cascade are those of a body three times as heavy: set as_printed"

MAX_STEP_S: Final = 1e-3
"""Largest integration step, the paper's own setting (3.3)."""

LEAST_SEAT_RATE_HZ: Final = 500.0
"""At a slower seat, straight lines between samples weaken fast motion: at 250 Hz peak forces are up to 4.6 % low."""

MAX_SUBSTEPS: Final = 2000
"""A chain that needs more steps per sample is no body's, and too slow to integrate."""

MAX_EIGENVALUE_STEP: Final = 1.0
"""Largest |eigenvalue| x step. RK4 is stable to 2.78; the rest is room for strain stiffening."""

WARM_UP_S: Final = 2.0
"""A chain that starts from rest in motion predicts the motion after this time (Zaman et al., 5.3)."""

MOTION_COLUMNS: Final = 3 * N_SEGMENTS
"""Columns of a motion: displacements, velocities, and forces of the joints."""


def slow_seat(rate_hz: float) -> str:
    """The warning of a seat that is too slow for accurate predictions; empty if its rate is high enough."""
    if rate_hz > 0.95 * LEAST_SEAT_RATE_HZ:  # a sensor of 500 Hz may have a clock that is a little slow
        return ""
    return (
        f"{rate_hz:.0f} Hz is slow: predicted doses and forces of fast motion are too low; record it at"
        f" {LEAST_SEAT_RATE_HZ:.0f} Hz or faster"
    )


def parts_of_motion(motion: Floats) -> tuple[Floats, Floats, Floats]:
    """Displacements m, velocities m/s and forces of the joints N, each (n, 6), views of a motion (n, 18)."""
    return motion[:, :N_SEGMENTS], motion[:, N_SEGMENTS : 2 * N_SEGMENTS], motion[:, 2 * N_SEGMENTS :]


@dataclass(frozen=True)
class Modes:
    """Natural frequencies (6,) ascending, damping ratios (6,) by Eq. 14, mass-normalised shapes as columns (6, 6)."""

    natural_frequency_hz: Floats
    damping_ratio: Floats
    shapes: Floats


@dataclass(frozen=True)
class Response:
    """Result of `simulate`, each (n, 6): absolute accelerations, displacements and velocities relative to the seat.

    joint_force_n: dynamic force of the joint below each segment, positive in compression, without static weight.
    Rayleigh damping counts as carried by the joints, so it is the sum of mass times acceleration of the segments above,
    less the forces of effects on them. Under `cascade` it is that of a body three times as heavy.
    """

    rate_hz: float
    seat_mps2: Floats
    accel_mps2: Floats
    displacement_m: Floats
    velocity_mps: Floats
    joint_force_n: Floats

    @property
    def stretch_m(self) -> Floats:
        """The stretch of each joint, (n, 6)."""
        return np.diff(self.displacement_m, axis=1, prepend=0.0)

    @property
    def stretch_rate_mps(self) -> Floats:
        """The rate of that stretch, (n, 6)."""
        return np.diff(self.velocity_mps, axis=1, prepend=0.0)


@dataclass(frozen=True)
class Chain:
    """The chain's physical constants, all of shape (6,), joints and segments inferior to superior.

    mass_kg are the segments' masses; inertia_kg is the diagonal of M, equal to them unless mass_matrix is `cascade`.
    elements are the effects on joints and segments (others: `predict`). Matrices, modes and frequency responses are
    those of the chain without elements.
    """

    mass_matrix_form: MassMatrix
    mass_kg: Floats
    inertia_kg: Floats
    stiffness_n_per_m: Floats
    damping_n_s_per_m: Floats
    stiffening_per_m: Floats
    rayleigh_rad_per_s: float
    elements: tuple[Element, ...] = ()

    @classmethod
    def of(cls, subject: Subject) -> Chain:
        """Build the chain of a subject, with its effects."""
        chain = cls.of_theta(subject.parameters.vector(), subject.body_mass_kg, subject.mass_matrix)
        return chain.with_effects(subject.effects)

    @classmethod
    def of_theta(cls, theta: Floats, body_mass_kg: float, mass_matrix: MassMatrix) -> Chain:
        """Build the chain of theta (15,), which may lie outside Table 1, without effects."""
        c = Constants.of(theta, body_mass_kg, mass_matrix)
        return cls(
            mass_matrix_form=mass_matrix,
            mass_kg=c.mass_kg,
            inertia_kg=c.inertia_kg,
            stiffness_n_per_m=c.stiffness_n_per_m,
            damping_n_s_per_m=c.damping_n_s_per_m,
            stiffening_per_m=c.stiffening_per_m,
            rayleigh_rad_per_s=float(c.rayleigh_rad_per_s),
        )

    def with_effects(self, effects: Iterable[AppliedEffect]) -> Chain:
        """The same chain with effects; effects of zero strength are left out."""
        given = tuple(effects)
        carried_kg = self.loaded_mass_kg(given)
        more = [self._element(applied, effect, carried_kg) for applied, effect in active(given, ChainEffect)]
        return dataclasses.replace(self, elements=(*self.elements, *more)) if more else self

    def loaded_mass_kg(self, effects: Iterable[AppliedEffect]) -> Floats:
        """The masses of the segments with the masses that effects add, (6,) kg."""
        loaded_kg = self.mass_kg.copy()
        for applied, effect in active(effects, ChainEffect):
            if applied.site != SEAT:
                loaded_kg[SEGMENTS.index(applied.site)] += effect.carried_kg(applied.values)
        return loaded_kg

    def _element(self, applied: AppliedEffect, effect: ChainEffect, carried_kg: Floats) -> Element:
        """carried_kg (6,): masses of the segments with the masses that effects add."""
        everywhere = applied.site == SEAT
        index = 0 if everywhere else SEGMENTS.index(applied.site)
        joint = self._whole() if everywhere else self._joint(index, carried_kg)
        return Element(
            effect,
            index,
            constants=effect.constants(joint, applied.values),
            channels=effect.required_channels(applied.site),
            delay_s=effect.delay_s(applied.values),
            bounds=effect.step_bounds(joint, applied.values),
            # On the seat, the force is shared in proportion to the segments' inertia.
            spread=tuple((self.inertia_kg / self.inertia_kg.sum()).tolist()) if everywhere else (),
        )

    def _joint(self, index: int, carried_kg: Floats) -> Joint:
        """A joint with the segment above it, and with all masses (6,) from there up."""
        return Joint(
            stiffness_n_per_m=float(self.stiffness_n_per_m[index]),
            stiffening_n_per_m2=float(self.stiffness_n_per_m[index] * self.stiffening_per_m[index]),
            damping_n_s_per_m=float(self.damping_n_s_per_m[index]),
            mass_above_kg=float(carried_kg[index:].sum()),
            segment_mass_kg=float(self.mass_kg[index]),
        )

    def _whole(self) -> Joint:
        """The whole body, without a joint below."""
        whole_kg = float(self.inertia_kg.sum())
        return Joint(0.0, 0.0, 0.0, whole_kg, whole_kg)

    @property
    def M(self) -> Floats:  # noqa: N802 - the field's symbol
        """Mass matrix, (6, 6) kg (Eq. 7 in the subject's convention)."""
        return np.diag(self.inertia_kg)

    @property
    def K(self) -> Floats:  # noqa: N802 - the field's symbol
        """Stiffness matrix, (6, 6) N/m (Eq. 9)."""
        return _chain_matrix(self.stiffness_n_per_m)

    @property
    def C(self) -> Floats:  # noqa: N802 - the field's symbol
        """Damping matrix, (6, 6) N s/m, joints plus Rayleigh (Eq. 10-12)."""
        return _chain_matrix(self.damping_n_s_per_m) + self.rayleigh_rad_per_s * self.M

    def modes(self) -> Modes:
        """Solve the undamped eigenproblem and project C on it (Eq. 14)."""
        root = 1.0 / np.sqrt(self.inertia_kg)
        squares, vectors = np.linalg.eigh(root[:, None] * self.K * root[None, :])
        shapes = root[:, None] * vectors
        omega = np.sqrt(squares)
        damping = np.einsum("ip,ij,jp->p", shapes, self.C, shapes) / (2.0 * omega)
        return Modes(omega / (2.0 * np.pi), damping, shapes)

    def frequency_response(self, frequency_hz: ArrayLike) -> Complexes:
        """Relative displacement per seat acceleration at s_nl = 0, (n, 6) s^2 (Eq. 30)."""
        omega = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))[:, None, None]
        dynamic = -(omega**2) * self.M + 1j * omega * self.C + self.K
        load = np.broadcast_to(-self.inertia_kg[:, None], (omega.shape[0], N_SEGMENTS, 1))
        return np.asarray(np.linalg.solve(dynamic, load)[:, :, 0], dtype=np.complex128)

    def transmissibility(self, frequency_hz: ArrayLike) -> Complexes:
        """Absolute segment acceleration per seat acceleration at s_nl = 0, (n, 6): 1 - (2 pi f)^2 H."""
        omega = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))[:, None]
        return 1.0 - omega**2 * self.frequency_response(frequency_hz)

    def apparent_mass(
        self, frequency_hz: ArrayLike, form: SeatForce = "inertia", as_printed: bool = False
    ) -> Complexes:
        """Seat force per seat acceleration at s_nl = 0, (n,) kg (Eq. 19); options as in `seat_force`."""
        self._check_force(form, as_printed)
        omega = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
        if form == "inertia":
            return self.transmissibility(frequency_hz) @ self.inertia_kg.astype(np.complex128)
        stiffness, damping, sign = self._seat_joint(form)
        return sign * (stiffness + 1j * omega * damping) * self.frequency_response(frequency_hz)[:, 0]

    def seat_force(self, response: Response, form: SeatForce = "inertia", as_printed: bool = False) -> Floats:
        """Force of the seat on the body over time, (n,) N.

        `inertia`: sum m_i z_i''; `joint`: -(k1 x1 + b1 x1' + f_nl,1), without the Rayleigh part; `paper`:
        K11 x1 + C11 x1' with the printed sign and terms (below Eq. 19). Under `cascade` the forces are those of a body
        three times as heavy: InputError unless `as_printed`.
        """
        self._check_force(form, as_printed)
        if form == "inertia":
            return response.accel_mps2 @ self.inertia_kg
        x, v = response.displacement_m[:, 0], response.velocity_mps[:, 0]
        stiffness, damping, sign = self._seat_joint(form)
        stiffening = self.stiffness_n_per_m[0] * self.stiffening_per_m[0] * x * np.abs(x) if form == "joint" else 0.0
        return sign * (stiffness * x + damping * v + stiffening)

    def _seat_joint(self, form: SeatForce) -> tuple[float, float, float]:
        if form == "joint":
            return float(self.stiffness_n_per_m[0]), float(self.damping_n_s_per_m[0]), -1.0
        return float(self.K[0, 0]), float(self.C[0, 0]), 1.0

    def _check_force(self, form: str, as_printed: bool) -> None:
        if form not in ("inertia", "joint", "paper"):
            raise InputError(f"seat_force is {form!r}, allowed are inertia, joint and paper")
        if self.mass_matrix_form == "cascade" and not as_printed:
            raise InputError(CASCADE_FORCES)

    @functools.cached_property
    def largest_eigenvalue_rad_per_s(self) -> float:
        """Largest |eigenvalue| of the linear state matrix, 1/s, with the largest contribution of effects."""
        inverse, K, C = 1.0 / self.inertia_kg[:, None], self.K, self.C
        for element in self.elements:
            at = np.zeros(N_SEGMENTS)
            at[element.index] = 1.0
            where = _chain_matrix(at) if element.effect.place == "joint" else np.diag(at)
            K, C = K + element.bounds.stiffness_n_per_m * where, C + element.bounds.damping_n_s_per_m * where
        upper = np.hstack([np.zeros((N_SEGMENTS, N_SEGMENTS)), np.eye(N_SEGMENTS)])
        lower = np.hstack([-inverse * K, -inverse * C])
        largest = float(np.abs(np.linalg.eigvals(np.vstack([upper, lower]))).max())
        return max([largest, *(element.bounds.own_eigenvalue_per_s for element in self.elements)])

    def substeps(self, rate_hz: float) -> int:
        """Integration steps per sample; raises InputError for a chain that is too stiff."""
        longest_s = min(MAX_STEP_S, MAX_EIGENVALUE_STEP / self.largest_eigenvalue_rad_per_s)
        needed = 1.0 / (rate_hz * longest_s)
        if not needed <= MAX_SUBSTEPS:
            named = ", ".join(element.effect.name for element in self.elements)
            effects = f" with {named}" if named else ""
            raise InputError(
                f"the chain{effects} is too stiff: {needed:.3g} steps per sample, at most {MAX_SUBSTEPS} are allowed"
            )
        return math.ceil(needed - 1e-9)

    def simulate(self, seat_mps2: ArrayLike, rate_hz: float, channels: Mapping[str, Floats] | None = None) -> Response:
        """Response to a seat acceleration (n,) from rest, with the state over time; see `Stepper`."""
        seat = np.ascontiguousarray(seat_mps2, dtype=np.float64)
        motion = np.empty((seat.size, MOTION_COLUMNS))
        accel = Stepper(self, rate_hz).push(seat, motion, channels)
        return Response(rate_hz, seat, accel, *parts_of_motion(motion))


def predict(
    subject: Subject, seat_mps2: Floats, rate_hz: float, channels: Mapping[str, Floats] | None = None
) -> Response:
    """Response of a subject to a seat motion (n,), with all effects on the body and none on its sensors.

    channels (n,) by name: further inputs of effects. Raises InputError for a missing one.
    """
    moved_mps2 = apply_to_seat(subject.effects, seat_mps2, rate_hz, channels or {})
    return Chain.of(subject).simulate(moved_mps2, rate_hz, channels)


class Stepper:
    """The chain in time: seat samples in, absolute accelerations out, the same numbers for any cut into blocks.

    Classical Runge-Kutta, the seat linear between samples (3.3). Substeps are given, or chosen so that a step is at
    most 1 ms and at most 1 / |largest eigenvalue|. The chain is at rest at the first sample after `reset`.

    Against DOP853 the accelerations of subject 1, one step per sample, err by 3e-6 (pothole) to 3e-5 (rail); two steps
    by 2e-7 to 1.3e-6. The seat's linear interpolation errs by far more.
    """

    def __init__(self, chain: Chain, rate_hz: float, substeps: int | None = None) -> None:
        if not (math.isfinite(rate_hz) and rate_hz > 0.0):
            raise InputError(f"rate_hz is {rate_hz}, expected a positive number")
        self.substeps = substeps or chain.substeps(rate_hz)
        self._step_s = 1.0 / (rate_hz * self.substeps)
        self._k = np.ascontiguousarray(chain.stiffness_n_per_m)
        self._b = np.ascontiguousarray(chain.damping_n_s_per_m)
        self._k_alpha = self._k * chain.stiffening_per_m
        self._inverse_mass = 1.0 / chain.inertia_kg
        self._alpha_r = float(chain.rayleigh_rad_per_s)
        self._assembly = EffectAssembly(chain.elements, self._step_s)
        self._state = np.zeros(2 * N_SEGMENTS + 1 + self._assembly.states)
        self._fresh = True

    def reset(self) -> None:
        """Put the chain back to rest."""
        self._fresh = True

    def push(
        self, seat_mps2: Floats, motion: Floats | None = None, channels: Mapping[str, Floats] | None = None
    ) -> Floats:
        """Advance over seat samples (n,) m/s^2 and return absolute accelerations (n, 6) m/s^2.

        `motion` (n, MOTION_COLUMNS), if given, receives relative displacements, velocities, and forces of the joints;
        `channels` (n,) by name: further inputs of effects. Raises InputError for a missing one.
        """
        accel = np.empty((seat_mps2.shape[0], N_SEGMENTS))
        drive = self._assembly.drive(channels)
        if seat_mps2.shape[0] == 0:
            return accel
        start = 0
        if self._fresh:
            # No joint is deformed yet, so z'' = 0.
            self._state[:] = 0.0
            self._state[2 * N_SEGMENTS] = seat_mps2[0]
            self._assembly.begin(self._state[2 * N_SEGMENTS + 1 :], drive)
            accel[0] = 0.0
            if motion is not None:
                motion[0] = 0.0
            self._fresh, start = False, 1
        self._assembly.integrate(
            seat_mps2[start:],
            drive[start:],
            self._state,
            self._k,
            self._b,
            self._k_alpha,
            self._inverse_mass,
            self._alpha_r,
            self._assembly.p,
            self._step_s,
            self.substeps,
            accel[start:],
            _NO_MOTION if motion is None else motion[start:],
        )
        return accel


_NO_MOTION: Final = np.empty((0, MOTION_COLUMNS))


def _chain_matrix(joint: Floats) -> Floats:
    """Assemble joint constants (6,) into the tridiagonal chain matrix (Eq. 9)."""
    above = np.append(joint[1:], 0.0)
    return np.diag(joint + above) - np.diag(joint[1:], 1) - np.diag(joint[1:], -1)
