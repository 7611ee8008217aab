"""How a subject is fitted: the paper's way (Zaman et al., 6.2), and ours where it departs from it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from biodyn_core.arrays import Flags
from biodyn_core.identification.objectives import Clocks, Regularization, SurrogateSettings
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.parameters import PARAMETERS
from biodyn_core.settings import check_settings, setting

Refiner = Literal["least-squares", "nelder-mead"]


@dataclass(frozen=True)
class FitSettings:
    """How a fit is done; what the paper leaves open or what departs from it is an option here."""

    phase1: Literal["per_case", "pooled"] = setting(
        "per_case", "search each case's surrogate, or one surrogate of all", choices=("per_case", "pooled")
    )
    refine: Refiner = setting("least-squares", "the refiner of phase 2", choices=("least-squares", "nelder-mead"))
    regularization: Regularization = setting(
        "log", "pull of Eq. 33 on logarithms, or in physical units as printed", choices=("physical", "log")
    )
    lambda_2: float = setting(1e-6, "strength of that pull", "", 0.0, 1e3)
    clocks: Clocks = setting(
        "estimated", "fit beside each sensor's delay, or trust the clocks", choices=("trusted", "estimated")
    )
    mass_scale: Literal["fixed", "free"] = setting(
        "fixed", "m_scale, of which accelerations say nothing", choices=("fixed", "free")
    )
    result: Literal["joint", "idealized"] = setting(
        "joint", "the subject that comes out: one theta for all cases, or the cases' fits fused",
        choices=("joint", "idealized"),
    )  # fmt: skip
    refined_starts: int = setting(4, "starts of phase 2", "", 1, 1000)
    evaluations: int = setting(3000, "evaluations of the objective in one descent of phase 2", "", 1, 10_000_000)
    swarm: SwarmSettings = dataclasses.field(default_factory=SwarmSettings)
    surrogate: SurrogateSettings = dataclasses.field(default_factory=SurrogateSettings)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def free(self) -> Flags:
        """Which parameters are fitted, (15,)."""
        return np.array([p.group != "mass_scale" or self.mass_scale == "free" for p in PARAMETERS])

    @property
    def fitted(self) -> tuple[str, ...]:
        """Their names."""
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
"""The paper's way, complete (6.2): Nelder-Mead on 15 parameters from the best of phase 1, case by case, then fused."""
