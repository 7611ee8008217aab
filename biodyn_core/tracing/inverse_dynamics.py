"""Inverse dynamics: the force that a subject's model lacks at one joint or segment, from measured accelerations.

The motion of the subject and the measurement differ by the residual. The residual, high-passed and integrated, corrects
the simulated motion, so below the high-pass the motion is the subject's, above it is the measured one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Complexes, Flags, Floats
from biodyn_core.base.segments import CENTRAL, MEASURED_SEGMENT_INDEX, N_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.effect_assembly import Element
from biodyn_core.body.model import Chain, predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, JointForce, JointLimit, SegmentForce, apply_to_sensors
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.settings import MissingForceSettings

LAW_STEP: Final = 0.3
"""Largest |eigenvalue| x step for the states of a law: over a time constant Heun's method then errs by 2 %."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Displacements m and velocities m/s relative to the seat, absolute accelerations m/s^2, all (n, 6).

    seat_mps2 (n,) and channels (n,) by name are the further inputs of effects.
    """

    rate_hz: float
    displacement_m: Floats
    velocity_mps: Floats
    accel_mps2: Floats
    seat_mps2: Floats
    channels: Mapping[str, Floats]


@dataclass(frozen=True, eq=False)
class Target:
    """A joint or a segment as linear maps: shares (6,) of the segments' unbalanced forces, and of displacements.

    The tension of a joint balances all segments above. The force on a segment balances that segment alone, on the
    central torso also both neighbours, because its motion is not measured. The site seat is the whole body. settled_s:
    samples within this time after the warm-up are not used.
    """

    site: str
    joint: bool
    force_shares: Floats
    motion_shares: Floats
    high_pass_hz: float
    settled_s: float

    @classmethod
    def of(cls, applied: AppliedEffect, chain: Chain, settings: MissingForceSettings | None = None) -> Target:
        """The target of an effect inside the chain."""
        s = settings or MissingForceSettings()
        if applied.site == SEAT:
            shares = chain.inertia_kg / chain.inertia_kg.sum()
            return cls(SEAT, False, np.ones(N_SEGMENTS), shares, high_pass_hz(chain, 0, s), s.settled_s)
        index = SEGMENTS.index(applied.site)
        return cls.of_joint(index, chain, s) if applied.effect.place == "joint" else cls.of_segment(index, chain, s)

    @classmethod
    def of_joint(cls, index: int, chain: Chain, settings: MissingForceSettings | None = None) -> Target:
        """The joint below a segment."""
        s = settings or MissingForceSettings()
        moves = np.eye(N_SEGMENTS)[index]
        if index > 0:
            moves[index - 1] = -1.0
        above = -(np.arange(N_SEGMENTS) >= index).astype(np.float64)
        return cls(SEGMENTS[index], True, above, moves, high_pass_hz(chain, index, s), s.settled_s)

    @classmethod
    def of_segment(cls, index: int, chain: Chain, s: MissingForceSettings) -> Target:
        """A segment."""
        balanced = np.eye(N_SEGMENTS)[index]
        if index == CENTRAL:
            balanced[index - 1 : index + 2] = 1.0
        joints = range(index, min(index + 2, N_SEGMENTS))
        cut_off_hz = max(high_pass_hz(chain, joint, s) for joint in joints)
        return cls(SEGMENTS[index], False, balanced, np.eye(N_SEGMENTS)[index], cut_off_hz, s.settled_s)

    @property
    def joint_shares(self) -> Floats:
        """Shares (6,) of the joints' tensions in the balance."""
        return np.diff(self.force_shares, prepend=0.0)

    def coordinates(self, motion: Motion) -> tuple[Floats, Floats]:
        """Stretch m and its rate m/s (n,); of a segment, displacement and velocity relative to the seat."""
        return motion.displacement_m @ self.motion_shares, motion.velocity_mps @ self.motion_shares

    def used(self, case: Case) -> Flags:
        """The samples (n,) at which every working sensor of the balance is compared, and that of its own segments."""
        needed = (self.force_shares != 0.0) | (self.motion_shares != 0.0)
        if needed[CENTRAL]:
            needed[CENTRAL - 1 : CENTRAL + 2] = True
        own = np.zeros(N_SEGMENTS, dtype=bool) if self.site == SEAT else self.motion_shares != 0.0
        required = needed[MEASURED_SEGMENT_INDEX] & (own[MEASURED_SEGMENT_INDEX] | (case.energy > 0.0))
        late = np.arange(len(case.seat_mps2)) >= case.begin + round(self.settled_s * case.rate_hz)
        return np.asarray(case.compared[:, required].all(axis=1) & late)


def high_pass_hz(chain: Chain, joint: int, s: MissingForceSettings) -> float:
    """Cut-off of the double integration for a joint."""
    natural_hz = math.sqrt(chain.stiffness_n_per_m[joint] / chain.mass_kg[joint:].sum()) / (2.0 * math.pi)
    return max(s.least_high_pass_hz, s.high_pass_share * natural_hz)


def simulated_motion(subject: Subject, case: Case) -> Motion:
    """The motion of a subject in a case."""
    found = predict(subject, case.seat_mps2, case.rate_hz, case.channels)
    return Motion(
        case.rate_hz, found.displacement_m, found.velocity_mps, found.accel_mps2, found.seat_mps2, case.channels
    )


def measured_motion(
    subject: Subject, case: Case, cut_off_hz: float, settings: MissingForceSettings | None = None
) -> Motion:
    """The measured motion of a case: that of a subject, corrected by the residual above the cut-off.

    The central torso follows its neighbours by the linear joints 3 and 4 of the subject.
    """
    padded_s = (settings or MissingForceSettings()).padded_s
    own = simulated_motion(subject, case)
    shown = apply_to_sensors(subject.effects, own.accel_mps2, case.rate_hz, case.channels)[:, MEASURED_SEGMENT_INDEX]
    length = scipy.fft.next_fast_len(len(shown) + round(padded_s * case.rate_hz), real=True)
    residual = np.zeros((length // 2 + 1, N_SEGMENTS), dtype=np.complex128)
    residual[:, MEASURED_SEGMENT_INDEX] = scipy.fft.rfft(_residual(case, shown), length, axis=0)
    p = np.asarray(2j * np.pi * scipy.fft.rfftfreq(length, 1.0 / case.rate_hz), dtype=np.complex128)
    residual[:, CENTRAL] = _between_neighbours(Chain.of(subject), p, residual)
    ratio = np.abs(p) / (2.0 * np.pi * cut_off_hz)
    residual *= (ratio**4 / (1.0 + ratio**4))[:, None]
    per_p = np.where(p == 0.0, 0.0, 1.0 / np.where(p == 0.0, 1.0, p))[:, None]
    accel, velocity, displacement = (
        scipy.fft.irfft(residual * per_p**order, length, axis=0)[: len(shown)] for order in (0, 1, 2)
    )
    return dataclasses.replace(
        own,
        displacement_m=own.displacement_m + displacement,
        velocity_mps=own.velocity_mps + velocity,
        accel_mps2=own.accel_mps2 + accel,
    )


def inertial_force(chain: Chain, motion: Motion, target: Target) -> Floats:
    """Force (n,), N, that the masses of a target's balance need, with the Rayleigh term."""
    inertial = chain.inertia_kg * (motion.accel_mps2 + chain.rayleigh_rad_per_s * motion.velocity_mps)
    return np.asarray(inertial @ target.force_shares)


def missing_force(chain: Chain, motion: Motion, target: Target) -> Floats:
    """Force (n,), N, that a chain lacks at a target to move like this."""
    found = inertial_force(chain, motion, target)
    for joint in np.flatnonzero(target.joint_shares):
        found += target.joint_shares[joint] * _tension(chain, motion, int(joint))
    for element in chain.elements:
        at = np.array(element.spread) if element.spread else np.eye(N_SEGMENTS)[element.index]
        share = float(at @ target.force_shares)
        if isinstance(element.effect, SegmentForce) and share != 0.0:
            found -= share * _law(element, motion, motion.displacement_m @ at, motion.velocity_mps @ at)
    return found


def _residual(case: Case, shown: Floats) -> Floats:
    """Measured less shown (n, 5), linear across masked samples, 0 outside the compared ones."""
    sample, found = np.arange(len(shown)), np.zeros_like(shown)
    for column, compared in enumerate(case.compared.T):
        if compared.any():
            difference = (case.measured_mps2 - shown)[compared, column]
            found[:, column] = np.interp(sample, sample[compared], difference, left=0.0, right=0.0)
    return found


def _between_neighbours(chain: Chain, p: Complexes, residual: Complexes) -> Complexes:
    """Spectrum (f,) of the central torso's acceleration for those of its neighbours, at s_nl = 0."""
    k, b = chain.stiffness_n_per_m[CENTRAL : CENTRAL + 2], chain.damping_n_s_per_m[CENTRAL : CENTRAL + 2]
    below, above = (k[i] + b[i] * p for i in (0, 1))
    own = chain.inertia_kg[CENTRAL] * (p**2 + chain.rayleigh_rad_per_s * p)
    return np.asarray((below * residual[:, CENTRAL - 1] + above * residual[:, CENTRAL + 1]) / (own + below + above))


def _tension(chain: Chain, motion: Motion, joint: int) -> Floats:
    """Tension (n,), N, of a joint with its effects; limits follow all forces."""
    x, v = motion.displacement_m, motion.velocity_mps
    stretch, rate = (one[:, joint] - (one[:, joint - 1] if joint else 0.0) for one in (x, v))
    found = chain.stiffness_n_per_m[joint] * stretch * (1.0 + chain.stiffening_per_m[joint] * np.abs(stretch))
    found = found + chain.damping_n_s_per_m[joint] * rate
    here = [element for element in chain.elements if element.index == joint and element.effect.place == "joint"]
    for element in here:
        if isinstance(element.effect, JointForce):
            found = found + _law(element, motion, stretch, rate)
    for element in here:
        if isinstance(element.effect, JointLimit):
            pairs = zip(found.tolist(), rate.tolist(), strict=True)
            found = np.array([element.effect.law(*pair, *element.constants) for pair in pairs])
    return np.asarray(found)


def _law(element: Element, motion: Motion, stretch: Floats, rate: Floats) -> Floats:
    """Force (n,), N, of a law along a motion from rest; its states by Heun's method, inputs linear between samples."""
    effect, constants = element.effect, element.constants
    steps = 1
    if effect.states:
        steps = max(1, math.ceil(element.bounds.own_eigenvalue_per_s / (LAW_STEP * motion.rate_hz)))
    sample = np.arange(len(stretch)) / motion.rate_hz
    inputs = [stretch, rate, motion.seat_mps2]
    if element.delay_s > 0.0:
        inputs.append(np.interp(sample - element.delay_s, sample, stretch, left=0.0))
    inputs += [np.nan_to_num(motion.channels[name]) for name in element.channels]
    if not effect.states:
        return np.array([effect.law(*row, *constants) for row in zip(*(one.tolist() for one in inputs), strict=True)])
    fine = np.arange((len(sample) - 1) * steps + 1) / (motion.rate_hz * steps)
    rows = zip(*(np.interp(fine, sample, one).tolist() for one in inputs), strict=True)
    step_s, q = 1.0 / (motion.rate_hz * steps), (0.0,) * effect.states
    force, *slope = effect.law(*next(rows), *q, *constants)
    found = [force]
    for row in rows:
        tried = [one + step_s * dq for one, dq in zip(q, slope, strict=True)]
        _, *ahead = effect.law(*row, *tried, *constants)
        q = tuple(one + 0.5 * step_s * (a + b) for one, a, b in zip(q, slope, ahead, strict=True))
        force, *slope = effect.law(*row, *q, *constants)
        found.append(force)
    return np.array(found[::steps])
