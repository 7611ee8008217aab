"""The usual residual of a fitted subject: how far its predictions miss measurements that they were not fitted to.

In windows of one second the mean square of the residual in an octave band is n^2 + s^2 P: n is the noise, P the mean
square of the prediction in the band, s the share of the motion that the model misses. Both are by segment, from
held-out events, and stand in the provenance of the subject's file.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import EDITED, ERRORS_OF_ANOTHER
from biodyn_core.signals.octaves import BAND_NAMES, N_BANDS

LEAST_WINDOWS: Final = 20
"""Fewer windows say too little."""

MOST_SHARE: Final = 10.0
"""No model misses more of the motion; windows at rest alone leave the share undetermined."""

ROUNDED: Final = 1.0 + 1e-9

BAND_SCATTER: Final = 1.4
"""Prior standard deviation of ln s^2 of a band about that of all bands: a band without motion shows none."""

LEAST_SQUARE: Final = 1e-12
"""Mean squares below it, (m/s^2)^2, are zero but for rounding."""

PROVENANCE: Final = "usual_residual"
_KEYS: Final = ("noise_mps2", "share", "windows")


@dataclass(frozen=True)
class UsualResidual:
    """The law of one segment: noise m/s^2 and share of the predicted motion by octave band, each (6,).

    windows: the number of those that it was estimated from.
    """

    noise_mps2: tuple[float, ...]
    share: tuple[float, ...]
    windows: int

    def square(self, predicted_squares: Floats, least_share: float = 0.0) -> float:
        """The usual mean square of the residual, (m/s^2)^2, for mean squares (6,) of the prediction.

        least_share: the share of a band counts as at least this.
        """
        bands = zip(self.noise_mps2, self.share, predicted_squares.tolist(), strict=True)
        return sum(noise**2 + max(share, least_share) ** 2 * square for noise, share, square in bands)

    @property
    def rest_square(self) -> float:
        """The usual mean square of the residual at rest, (m/s^2)^2."""
        return sum(noise**2 for noise in self.noise_mps2)

    def to_dict(self) -> dict[str, Any]:
        """The mapping in the provenance."""
        bands = {key: dict(zip(BAND_NAMES, getattr(self, key), strict=True)) for key in _KEYS[:2]}
        return bands | {"windows": self.windows}

    @classmethod
    def of_windows(cls, residual_squares: Floats, predicted_squares: Floats) -> UsualResidual | None:
        """Estimate from windows (w, 6), (m/s^2)^2; None for fewer than LEAST_WINDOWS."""
        if len(residual_squares) < LEAST_WINDOWS:
            return None
        whole = _noise_and_share(residual_squares.sum(axis=1), predicted_squares.sum(axis=1))
        bands = [
            _noise_and_share(residual_squares[:, band], predicted_squares[:, band], whole[1]) for band in range(N_BANDS)
        ]
        noise, share = (tuple(math.exp(0.5 * max(one[k], -60.0)) for one in bands) for k in (0, 1))
        return cls(noise, share, len(residual_squares))


def _noise_and_share(residual: Floats, predicted: Floats, center: float | None = None) -> tuple[float, float]:
    """Ln n^2 and ln s^2 from mean squares (w,), robustly; center: prior mean of ln s^2."""
    target, motion = np.log(np.maximum(residual, LEAST_SQUARE)), np.log(np.maximum(predicted, LEAST_SQUARE))

    def away(logs: Floats) -> Floats:
        rows = target - np.logaddexp(logs[0], logs[1] + motion)
        return rows if center is None else np.append(rows, (logs[1] - center) / BAND_SCATTER)

    most = 2.0 * math.log(MOST_SHARE)
    start = np.array([np.quantile(target, 0.1), min(float(np.median(target - motion)), -1.0)])
    found = scipy.optimize.least_squares(away, start, bounds=(-np.inf, [np.inf, most]), loss="soft_l1")
    return float(found.x[0]), float(found.x[1])


def to_provenance(laws: Mapping[str, UsualResidual]) -> dict[str, Any]:
    """The entry of a subject's provenance, empty without a law."""
    return {PROVENANCE: {name: law.to_dict() for name, law in laws.items()}} if laws else {}


def usual_residuals(provenance: Mapping[str, Any]) -> tuple[dict[str, UsualResidual], str]:
    """The laws by segment of a subject's provenance, and why there are none, empty if there are."""
    given = provenance.get(PROVENANCE)
    if given is not None and provenance.get(EDITED):
        return {}, ERRORS_OF_ANOTHER
    if given is None:
        return {}, "its file has no residual of held-out events: fit it with biodyn fit --hold-out"
    if not isinstance(given, Mapping) or not set(given) <= set(MEASURED_SEGMENTS):
        return {}, f"{PROVENANCE} in its file is not by segment"
    found = {}
    for name, values in given.items():
        law = _law(values)
        if law is None:
            numbers = f"all above zero, shares up to {MOST_SHARE:g}"
            return {}, f"{PROVENANCE}.{name} in its file needs {', '.join(_KEYS)}, by octave band, {numbers}"
        found[name] = law
    return found, "" if found else "its file has no residual of held-out events"


def _law(values: object) -> UsualResidual | None:
    if not isinstance(values, Mapping) or set(values) != set(_KEYS):
        return None
    noise_mps2, share = (_bands(values[key]) for key in _KEYS[:2])
    if not (noise_mps2 and share and _is_positive(values["windows"])) or max(share) > ROUNDED * MOST_SHARE:
        return None
    return UsualResidual(noise_mps2, share, int(values["windows"]))


def _bands(values: object) -> tuple[float, ...]:
    """Numbers by band; empty if they are not."""
    if not isinstance(values, Mapping) or set(values) != set(BAND_NAMES) or not all(map(_is_positive, values.values())):
        return ()
    return tuple(float(values[name]) for name in BAND_NAMES)


def _is_positive(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, (int, float)) and 0.0 < value <= sys.float_info.max
