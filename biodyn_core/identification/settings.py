"""Settings of identification: the paper's procedure (Zaman et al., 6.2) and the departures from it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import check_settings, setting

if TYPE_CHECKING:
    from biodyn_core.base.arrays import Flags
    from biodyn_core.body.parameters import Parameters

Regularization = Literal["physical", "log"]
Clocks = Literal["trusted", "estimated"]
Refiner = Literal["least-squares", "nelder-mead"]
Prior = Literal["none", "population"]

SEGMENT_WEIGHTS: Final = {"pelvis": 0.5, "lower_torso": 0.2, "upper_torso": 0.8, "neck": 2.5, "head": 3.0}
"""Weights of the measured segments in Eq. 31, given in its text; each multiplies its segment's sum.

In the order of `MEASURED_SEGMENTS`.
"""

THRESHOLD_PERCENT: Final = 30.0
"""Parameters of two subjects with a smaller deviation are convergent (9.1.1)."""


@dataclass(frozen=True)
class CaseSettings:
    """Preparation of a case; the grid of the spectra is in `SpectrumSettings`."""

    least_compared_s: float = setting(
        0.5, "a segment with less to compare after the warm-up is left out", "s", 0.1, 3600.0
    )
    sharpen_seat: bool = setting(True, "correct the attenuation by linear interpolation of the seat")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class SurrogateSettings:
    """Open choices of Eq. 31. `reference` is theta_ref, by default the middle of Table 1 in log space."""

    lambda_1: float = setting(0.005, "regularization of Eq. 31 towards theta_ref, of the logarithms", "", 0.0, 1e3)
    segment_weights: tuple[float, ...] = tuple(SEGMENT_WEIGHTS.values())
    reference: Parameters | None = None

    def __post_init__(self) -> None:
        if len(self.segment_weights) != len(SEGMENT_WEIGHTS) or not all(0.0 <= w < 1e6 for w in self.segment_weights):
            raise InputError(f"segment_weights: {len(SEGMENT_WEIGHTS)} numbers from 0 to 1e6 are needed")
        check_settings(self)


@dataclass(frozen=True)
class SwarmSettings:
    """The particle swarm; 80 particles and 200 iterations are the paper's (6.2.1)."""

    particles: int = setting(80, "particles of a swarm", "", 2, 10_000)
    iterations: int = setting(200, "iterations of a swarm", "", 1, 100_000)
    starts: int = setting(4, "swarms, each with its own seed", "", 1, 1000)
    first_inertia: float = setting(0.9, "first inertia: share of the velocity that a particle keeps", "", 0.0, 1.0)
    last_inertia: float = setting(0.4, "last inertia", "", 0.0, 1.0)
    velocity_clamp: float = setting(0.2, "largest step, as a share of the range", "", 1e-3, 1.0)
    polish: bool = setting(True, "descend from the end of a swarm to the local minimum")
    neighbours: int = setting(3, "neighbours of a particle on each side of the ring", "", 1, 5000)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class UncertaintySettings:
    """Assumptions on residuals and sensors, and the limits of identifiability."""

    window_s: float = setting(
        1.0, "residuals farther apart count as independent; chains decay in 0.3 s", "s", 0.05, 10.0
    )
    cross_axis: float = setting(
        0.002, "cross-axis share in a sensor: a tilt of 0.3 deg, horizontal motion 0.4 of the vertical", "", 0.0, 0.1
    )
    gain_error: float = setting(0.0, "standard error of the sensors' scale factors", "", 0.0, 0.1)
    identifiable: float = setting(0.05, "identifiable: half width up to this share of Table 1, in log", "", 1e-3, 1.0)
    weakly: float = setting(0.25, "weakly identifiable: up to this share", "", 1e-3, 1.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.weakly < self.identifiable:
            raise InputError(f"weakly is {self.weakly:g}, less than identifiable, {self.identifiable:g}: exchange them")


@dataclass(frozen=True)
class FitSettings:
    """Procedure of a fit; open choices of the paper and departures from it are options."""

    phase1: Literal["per_case", "pooled"] = setting(
        "per_case", "search each case's surrogate, or one surrogate of all", choices=("per_case", "pooled")
    )
    refine: Refiner = setting("least-squares", "the refiner of phase 2", choices=("least-squares", "nelder-mead"))
    regularization: Regularization = setting(
        "log", "regularization of Eq. 33 on logarithms, or in physical units as printed", choices=("physical", "log")
    )
    lambda_2: float = setting(1e-6, "weight of that regularization", "", 0.0, 1e3)
    clocks: Clocks = setting(
        "estimated", "estimate each sensor's delay with the fit, or trust the clocks", choices=("trusted", "estimated")
    )
    mass_scale: Literal["fixed", "free"] = setting(
        "fixed", "m_scale, which accelerations do not determine", choices=("fixed", "free")
    )
    result: Literal["joint", "idealized"] = setting(
        "joint", "the resulting subject: one theta for all cases, or the fusion of the cases' fits",
        choices=("joint", "idealized"),
    )  # fmt: skip
    prior: Prior = setting(
        "none", "prior of the joint fit: published groups of people, for few or weak recordings",
        choices=("none", "population"),
    )  # fmt: skip
    refined_starts: int = setting(4, "starts of phase 2", "", 1, 1000)
    evaluations: int = setting(3000, "evaluations of the objective per descent in phase 2", "", 1, 10_000_000)
    swarm: SwarmSettings = dataclasses.field(default_factory=SwarmSettings)
    surrogate: SurrogateSettings = dataclasses.field(default_factory=SurrogateSettings)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.refine == "nelder-mead" and self.clocks == "estimated":
            raise InputError(
                "refine nelder-mead estimates no clocks: set clocks to trusted, or refine to least-squares"
            )

    @property
    def free(self) -> Flags:
        """The fitted parameters, (15,)."""
        import numpy as np

        from biodyn_core.body.parameters import PARAMETERS

        return np.array([p.group != "mass_scale" or self.mass_scale == "free" for p in PARAMETERS])

    @property
    def fitted(self) -> tuple[str, ...]:
        """Their names."""
        from biodyn_core.body.parameters import PARAMETERS

        return tuple(p.name for p, free in zip(PARAMETERS, self.free, strict=True) if free)


PAPER: Final = FitSettings(
    refine="nelder-mead",
    regularization="physical",
    lambda_2=0.002,
    clocks="trusted",
    mass_scale="free",
    result="idealized",
    refined_starts=1,
    swarm=SwarmSettings(starts=1, polish=False),
)
"""The paper's procedure (6.2): Nelder-Mead on 15 parameters from the best of phase 1, case by case, then fused."""
