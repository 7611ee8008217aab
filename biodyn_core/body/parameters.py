"""The fifteen design variables of a subject: bounds, unit, meaning and source; and the maps of the search.

theta = [f_n (6), zeta (6), alpha_r, s_nl, m_scale], inferior to superior (Zaman et al., 6.1, Eq. 28).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import N_SEGMENTS, SEGMENTS


@dataclass(frozen=True)
class Parameter:
    """One design variable: its group (the key of a subject file), place in it, unit, Table 1 bounds and meaning."""

    group: str
    segment: str | None
    unit: str
    lower: float
    upper: float
    meaning: str
    zero_allowed: bool = False

    @property
    def name(self) -> str:
        """The group, with the segment for the twelve that belong to a joint."""
        return self.group if self.segment is None else f"{self.group}[{self.segment}]"

    def check(self, value: float, where: str) -> None:
        """Raise InputError unless the value is finite and within Table 1."""
        if self.lower <= value <= self.upper or (self.zero_allowed and value == 0.0):
            return
        zero = " (or 0 for the linear chain)" if self.zero_allowed else ""
        raise InputError(
            f"{where}: {self.name} is {value:g} {self.unit}, allowed are {self.lower:g} to {self.upper:g}{zero}"
        )


_FREQUENCY_ROWS = (
    ("pelvis", 5.0, 15.0, "seat to pelvis: contact stiffness, the seat included"),
    ("lower_torso", 5.0, 18.0, "pelvis to lower torso: L4-S1"),
    ("central_torso", 3.0, 15.0, "lower to central torso: T6-L3"),
    ("upper_torso", 3.0, 15.0, "central to upper torso: T1-T5"),
    ("neck", 5.0, 20.0, "upper torso to neck: C7-T1"),
    ("head", 3.0, 12.0, "neck to head: atlanto-occipital"),
)

PARAMETERS: Final[tuple[Parameter, ...]] = (
    *(Parameter("natural_frequency_hz", seg, "Hz", lo, hi, text) for seg, lo, hi, text in _FREQUENCY_ROWS),
    *(Parameter("damping_ratio", seg, "-", 0.025, 0.40, "damping ratio of the joint, Eq. 11") for seg in SEGMENTS),
    Parameter("rayleigh_rad_per_s", None, "rad/s", 0.1, 3.0, "mass-proportional damping alpha_r, Eq. 12"),
    Parameter("stiffening_scale", None, "-", 0.01, 2.0, "strain stiffening s_nl, Eq. 16", zero_allowed=True),
    Parameter("mass_scale", None, "-", 0.85, 1.15, "upper-body mass adjustment m_scale, Eq. 5"),
)
"""Table 1 in the order of theta. Not validated beyond the paper's two adult men."""

N_PARAMETERS: Final = len(PARAMETERS)
FREQUENCIES: Final = slice(0, N_SEGMENTS)
"""Place of f_n in theta; the others follow (Eq. 28)."""

DAMPINGS: Final = slice(N_SEGMENTS, 2 * N_SEGMENTS)
RAYLEIGH: Final = 2 * N_SEGMENTS
STIFFENING: Final = RAYLEIGH + 1
MASS_SCALE: Final = STIFFENING + 1

LOWER: Final[Floats] = np.array([p.lower for p in PARAMETERS])
UPPER: Final[Floats] = np.array([p.upper for p in PARAMETERS])


@dataclass(frozen=True, eq=False)
class Parameters:
    """The fifteen values of one subject, SI units; arrays of shape (6,), inferior to superior.

    Raises InputError for a wrong length, a value that is not finite, or one outside Table 1.
    """

    natural_frequency_hz: Floats
    damping_ratio: Floats
    rayleigh_rad_per_s: float
    stiffening_scale: float
    mass_scale: float

    def __post_init__(self) -> None:
        for group in ("natural_frequency_hz", "damping_ratio"):
            values = np.array(getattr(self, group), dtype=np.float64)
            if values.shape != (N_SEGMENTS,):
                raise InputError(
                    f"parameters.{group}: {N_SEGMENTS} values are needed ({', '.join(SEGMENTS)}), got {values.size}"
                )
            values.setflags(write=False)
            object.__setattr__(self, group, values)
        for parameter, value in zip(PARAMETERS, self.vector(), strict=True):
            parameter.check(float(value), "parameters")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Parameters) and np.array_equal(self.vector(), other.vector())

    def __hash__(self) -> int:
        return hash((self.vector() + 0.0).tobytes())  # -0.0 and 0.0 are equal

    def vector(self) -> Floats:
        """Return theta, shape (15,), in the order of `PARAMETERS` (Eq. 28)."""
        joints = (self.natural_frequency_hz, self.damping_ratio)
        return np.concatenate([*joints, [self.rayleigh_rad_per_s, self.stiffening_scale, self.mass_scale]])

    @classmethod
    def from_vector(cls, theta: ArrayLike) -> Parameters:
        """Read theta, shape (15,), back into named values."""
        t = np.asarray(theta, dtype=np.float64)
        if t.shape != (N_PARAMETERS,):
            raise InputError(f"theta: {N_PARAMETERS} values are needed, got shape {t.shape}")
        return cls(t[FREQUENCIES], t[DAMPINGS], float(t[RAYLEIGH]), float(t[STIFFENING]), float(t[MASS_SCALE]))


UNFITTED: Final = Parameters.from_vector([*np.sqrt(LOWER * UPPER)[:MASS_SCALE], 1.0])
"""The middle of Table 1 in log space, with m_scale 1: the parameters of a person before any fit."""


def is_fitted(parameters: Parameters) -> bool:
    """Whether parameters differ from those before any fit."""
    return not np.array_equal(parameters.vector(), UNFITTED.vector())


def to_log(theta: ArrayLike) -> Floats:
    """Map theta to the search space of phase 1, ln(theta) (Eq. 28)."""
    return np.log(np.asarray(theta, dtype=np.float64))


def from_log(theta_log: ArrayLike) -> Floats:
    """Map the search space of phase 1 back to theta."""
    return np.exp(np.asarray(theta_log, dtype=np.float64))


def to_sigmoid(theta: ArrayLike) -> Floats:
    """Map theta strictly inside Table 1 to the unbounded phi of phase 2 (Eq. 32)."""
    t = np.asarray(theta, dtype=np.float64)
    return np.log((t - LOWER) / (UPPER - t))


def from_sigmoid(phi: ArrayLike) -> Floats:
    """Map phi, any real (15,), back into Table 1 (Eq. 34)."""
    p = np.asarray(phi, dtype=np.float64)
    # Two forms of the logistic function, so that none overflows for any finite phi.
    share = np.where(p >= 0, 1.0 / (1.0 + np.exp(-np.abs(p))), np.exp(-np.abs(p)) / (1.0 + np.exp(-np.abs(p))))
    return LOWER + (UPPER - LOWER) * share
