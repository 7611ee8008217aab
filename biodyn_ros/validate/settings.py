"""From where on a validation disagrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from biodyn_core.base.settings import check_settings, setting

LEAST_COHERENCE: Final = 0.5
"""From which on a frequency can tell, unless said otherwise."""


@dataclass(frozen=True)
class ValidationSettings:
    """From where on prediction and measurement disagree, and what is too uncertain to tell."""

    stht_ratio: float = setting(
        1.25, "largest ratio between predicted and measured peaks of seat-to-head transmissibility", "", 1.01, 10.0
    )
    frequency_ratio: float = setting(1.25, "largest ratio between the frequencies of both peaks", "", 1.01, 10.0)
    dose_ratio: float = setting(1.25, "largest ratio between predicted and measured VDV of a segment", "", 1.01, 10.0)
    nrmse_percent: float = setting(20.0, "largest error of a segment, rms over measured rms", "%", 0.1, 1000.0)
    least_coherence: float = setting(
        LEAST_COHERENCE, "measured coherence from which on a frequency can tell", "", 0.0, 1.0
    )

    def __post_init__(self) -> None:
        check_settings(self)
