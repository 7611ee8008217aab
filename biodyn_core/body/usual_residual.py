"""The usual residual of a fitted subject: how far its predictions miss measurements that they were not fitted to.

In windows of one second the mean square of the residual is n^2 + s^2 P: n is the noise, P the mean square of the
prediction, s the share of the motion that the model misses. The logarithm of the ratio of a window to it scatters by
`log_spread`. All of it is by segment, from held-out events, and stands in the provenance of the subject's file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import optimize

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS

LEAST_WINDOWS: Final = 20
"""Fewer windows say too little about their scatter."""

MOST_SHARE: Final = 10.0
"""No model misses more of the motion; windows at rest alone leave the share undetermined."""

LEAST_SHARE: Final = 0.02
"""A model that misses less is good enough, and clocks that drift apart by a millisecond look like more."""

LEAST_SPREAD: Final = 0.35
"""Held-out windows of few events scatter less than those of other drives."""

PROVENANCE: Final = "usual_residual"
_KEYS: Final = ("noise_mps2", "share", "log_spread", "windows")


@dataclass(frozen=True)
class UsualResidual:
    """The law of one segment: noise m/s^2, share of the predicted motion, scatter of ln, and number of windows."""

    noise_mps2: float
    share: float
    log_spread: float
    windows: int

    def square(self, predicted_square: float) -> float:
        """The usual mean square of the residual, (m/s^2)^2, for a mean square of the prediction."""
        return self.noise_mps2**2 + self.share**2 * predicted_square

    def score(self, residual_square: float, predicted_square: float) -> float:
        """The logarithm of a window's mean square over the usual one, in standard deviations."""
        return math.log(max(residual_square, 1e-12) / self.square(predicted_square)) / self.log_spread

    def to_dict(self) -> dict[str, float | int]:
        """The mapping in the provenance."""
        return {key: getattr(self, key) for key in _KEYS}

    @classmethod
    def of_windows(cls, residual_square: Floats, predicted_square: Floats) -> UsualResidual | None:
        """Estimate from windows (w,), (m/s^2)^2; None for fewer than LEAST_WINDOWS."""
        if residual_square.size < LEAST_WINDOWS:
            return None
        target, motion = np.log(np.maximum(residual_square, 1e-12)), np.maximum(predicted_square, 1e-12)

        def away(logs: Floats) -> Floats:
            return np.asarray(target - np.logaddexp(logs[0], logs[1] + np.log(motion)))

        start = np.array([np.quantile(target, 0.1), min(np.median(target - np.log(motion)), -1.0)])
        found = optimize.least_squares(
            away, start, bounds=(-np.inf, [np.inf, 2.0 * math.log(MOST_SHARE)]), loss="soft_l1"
        )
        spread = math.sqrt(float(np.mean(away(found.x) ** 2)) * (1.0 + 2.0 / target.size))
        noise, share = (math.exp(0.5 * max(log, -60.0)) for log in found.x)
        return cls(noise, max(share, LEAST_SHARE), max(spread, LEAST_SPREAD), int(target.size))


def usual_residuals(provenance: Mapping[str, Any]) -> tuple[dict[str, UsualResidual], str]:
    """The laws by segment of a subject's provenance, and why there are none, empty if there are."""
    given = provenance.get(PROVENANCE)
    if given is None:
        return {}, "its file has no residual of held-out events: fit it with biodyn fit --hold-out"
    if not isinstance(given, Mapping) or not set(given) <= set(MEASURED_SEGMENTS):
        return {}, f"{PROVENANCE} in its file is not by segment"
    found = {}
    for name, values in given.items():
        law = _law(values)
        if law is None:
            return {}, f"{PROVENANCE}.{name} in its file needs {', '.join(_KEYS)}, all above zero"
        found[name] = law
    return found, "" if found else "its file has no residual of held-out events"


def _law(values: object) -> UsualResidual | None:
    if not isinstance(values, Mapping) or set(values) != set(_KEYS):
        return None
    numbers: Sequence[object] = [values[key] for key in _KEYS]
    for value in numbers:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < math.inf:
            return None
    noise_mps2, share, log_spread = (float(values[key]) for key in _KEYS[:3])
    return UsualResidual(noise_mps2, share, log_spread, int(values["windows"]))
