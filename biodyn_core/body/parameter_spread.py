"""Spread of the parameters of a fitted subject: their covariance, and neighbouring subjects one standard deviation off.

The covariance of ln theta stands in the provenance of the subject's file (`identification.uncertainty`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS
from biodyn_core.body.subject import EDITED, ERRORS_OF_ANOTHER, Subject
from biodyn_core.body.synthesis import load_case
from biodyn_core.body.synthesis_settings import CASES, NATIVE_RATE_HZ

PROVENANCE: Final = "covariance"
_KEYS: Final = ("names", "ln_theta")
NAMES: Final = tuple(parameter.name for parameter in PARAMETERS)

ROUNDING: Final = 1e-9
"""An eigenvalue so far below zero, relative to the largest, is zero but for rounding."""

LARGEST_STEP: Final = 1.5
"""A parameter is moved by at most a factor of e^1.5: further off it is unknown in any case."""


@dataclass(frozen=True, eq=False)
class ParameterSpread:
    """Covariance (p, p) of ln theta of the parameters with these names; the others are taken as known."""

    names: tuple[str, ...]
    covariance: Floats

    def to_dict(self) -> dict[str, Any]:
        """The mapping in the provenance."""
        return {"names": list(self.names), "ln_theta": self.covariance.tolist()}

    def steps(self) -> Floats:
        """Steps of ln theta (p, 15), each one standard deviation along a principal axis, the largest first."""
        squares, axes = np.linalg.eigh(self.covariance)
        steps = np.zeros((len(self.names), len(NAMES)))
        steps[:, [NAMES.index(name) for name in self.names]] = (axes * np.sqrt(np.maximum(squares, 0.0))).T
        return steps[::-1]


REFERENCE_S: Final = 3.0


def parameter_spread(provenance: Mapping[str, Any]) -> tuple[ParameterSpread | None, str]:
    """The spread in a subject's provenance, and why there is none, empty if there is."""
    given = provenance.get(PROVENANCE)
    if given is not None and provenance.get(EDITED):
        return None, ERRORS_OF_ANOTHER
    if given is None:
        return None, "its file has no covariance of its parameters: fit it with biodyn fit"
    wrong = f"{PROVENANCE} in its file needs names of parameters and ln_theta, a symmetric matrix of their number"
    if not isinstance(given, Mapping) or set(given) != set(_KEYS):
        return None, wrong
    names, matrix = given["names"], _matrix(given["ln_theta"])
    if not isinstance(names, list) or not all(name in NAMES for name in names) or len(set(names)) < len(names):
        return None, wrong
    if matrix.shape != (len(names), len(names)) or not np.allclose(matrix, matrix.T):
        return None, wrong
    squares = np.linalg.eigvalsh(matrix) if names else np.zeros(1)
    if squares[0] < -ROUNDING * max(squares[-1], 0.0) or squares[-1] < 0.0:
        return None, f"{PROVENANCE} in its file is not positive"
    return ParameterSpread(tuple(names), matrix), ""


def _matrix(values: object) -> Floats:
    """A matrix of finite numbers, empty where the values are none."""
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # a list that is no matrix, or a whole number too large
        return np.empty(0)
    return matrix if np.isfinite(matrix).all() else np.empty(0)


def neighbours(subject: Subject, steps: Floats) -> list[Chain]:
    """Chains of the subject with ln theta moved by each of the steps (k, 15), with its effects.

    Their theta may lie outside Table 1: an interval there would be cut off on one side only.
    """
    theta = subject.parameters.vector()
    moved = theta * np.exp(np.clip(steps, -LARGEST_STEP, LARGEST_STEP))
    return [
        Chain.of_theta(one, subject.body_mass_kg, subject.mass_matrix).with_effects(subject.effects) for one in moved
    ]


def reference_motion() -> Floats:
    """A seat motion (n,) at the native rate with a road, potholes and rails: every level and band that people meet."""
    rng = np.random.default_rng(0)
    cases = [load_case(name, REFERENCE_S, rng, NATIVE_RATE_HZ).accel_mps2[:, 2] for name in CASES]
    return np.ascontiguousarray(np.concatenate(cases))


def largest_steps(subject: Subject, spread: ParameterSpread, most: int) -> Floats:
    """The steps (k, 15) that move the predictions of `reference_motion` the most, at most so many.

    Steps of the same covariance, rotated so that few of them have nearly the whole effect on the accelerations, each
    segment relative to its rms. What the others would add is spread over those kept.
    """
    steps = spread.steps()
    seat_mps2, rate_hz = reference_motion(), NATIVE_RATE_HZ
    nominal = Chain.of(subject).simulate(seat_mps2, rate_hz).accel_mps2
    scale = np.sqrt(np.mean(nominal**2, axis=0))
    changes = [
        (chain.simulate(seat_mps2, rate_hz).accel_mps2 - nominal) / scale for chain in neighbours(subject, steps)
    ]
    effects = np.array([np.nan_to_num(change, nan=0.0, posinf=0.0, neginf=0.0).ravel() for change in changes])
    squares, axes = np.linalg.eigh(effects @ effects.T)
    kept = axes[:, ::-1][:, :most].T @ steps
    explained = float(squares[::-1][:most].sum())
    return np.asarray(kept * math.sqrt(float(squares.sum()) / explained)) if explained > 0.0 else kept
