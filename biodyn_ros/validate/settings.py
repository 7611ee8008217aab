"""Settings of a validation: limits of agreement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from biodyn_core.base.settings import check_settings, setting

LEAST_COHERENCE: Final = 0.5
"""Default of the least coherence at which a frequency is used."""


@dataclass(frozen=True)
class ValidationSettings:
    """Limits beyond which prediction and measurement disagree, and the least coherence that is used."""

    stht_ratio: float = setting(
        1.25, "largest ratio between predicted and measured peaks of seat-to-head transmissibility", "", 1.01, 10.0
    )
    frequency_ratio: float = setting(1.25, "largest ratio between the frequencies of both peaks", "", 1.01, 10.0)
    dose_ratio: float = setting(1.25, "largest ratio between predicted and measured VDV of a segment", "", 1.01, 10.0)
    nrmse_percent: float = setting(20.0, "largest error of a segment, rms over measured rms", "%", 0.1, 1000.0)
    least_coherence: float = setting(
        LEAST_COHERENCE, "least measured coherence at which a frequency is used", "", 0.0, 1.0
    )

    def __post_init__(self) -> None:
        check_settings(self)
