"""Checks of a measured seat motion: order and gaps of its stamps, size, unit and mean of its readings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.base.wording import counted
from biodyn_core.conditioning.conditioner import GRAVITY_TOLERANCE
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.kernels.sensor import IMPLAUSIBLE

OnWarning = Callable[[str], None]

MIN_RATE_HZ: Final = 20.0

MAX_STEP_S: Final = 0.2
"""Longest gap that a straight line bridges: a cycle at 5 Hz, near the main resonance of a seated body.

Stamps may go back by as much: samples that arrive late. More is a clock that was set, or a stray stamp.
"""

GAP_PERIODS: Final = 3.0
"""A gap is longer than this number of sampling periods; even stamps with jitter have none."""

IN_G: Final = (0.9, 1.1)
"""A mean acceleration between these, as a number, is gravity in units of g: no motion has such a mean."""

_UNITS: Final = (("g", 1.0), ("mg", 1000.0))


def ignore_warning(_line: str) -> None:
    """Ignore a warning."""


def check_size(where: str, time_s: Floats, accel: Floats, saturation_mps2: float) -> None:
    """Raise InputError for readings (n, k) m/s^2 that no sensor with this limit can give; the limit is of `replay`."""
    limit = IMPLAUSIBLE * saturation_mps2
    bad = np.flatnonzero(~(np.abs(accel) < limit).all(axis=1))
    if bad.size:
        raise InputError(
            f"{where}: {counted(bad.size, 'sample is', 'samples are')} beyond {limit:.0f} m/s^2, the first"
            f" {time_s[bad[0]]:.3f} s after the begin: no measurement; remove them"
        )


def check_mean(where: str, accel: Floats, warn: OnWarning) -> None:
    """Raise InputError for readings (n, k) in units of g by their mean; warn of a mean that is not gravity, nor zero.

    One column must be the vertical one. A column without gravity has a mean of about zero and passes.
    """
    mean = float(np.linalg.norm(accel.mean(axis=0)))
    for unit, gravity in _UNITS:
        if IN_G[0] < mean / gravity < IN_G[1]:
            raise InputError(
                f"{where}: the mean acceleration is {mean:.2f}, so the values are in {unit}: m/s^2 are needed, with"
                " gravity or with a mean of zero"
            )
    if mean > IN_G[1] and abs(mean / STANDARD_GRAVITY_MPS2 - 1.0) > GRAVITY_TOLERANCE:
        warn(f"{where}: the mean acceleration is {mean:.2f} m/s^2, neither gravity nor zero: gain or unit may be wrong")


def order_of(where: str, time_s: Floats, remedy: str, warn: OnWarning) -> Integers:
    """Indices that put samples at time_s (n,) in order of time, without repeated stamps.

    Raises InputError for stamps that leap and for gaps beyond MAX_STEP_S; `remedy` states what to do about stamps.
    """
    behind_s = np.maximum.accumulate(time_s) - time_s
    leapt = np.flatnonzero(behind_s > MAX_STEP_S)
    if leapt.size:
        raise InputError(
            f"{where}: time goes back by {behind_s[leapt[0]]:.4g} s at sample {leapt[0] + 1} of {time_s.size}, at most"
            f" {MAX_STEP_S:g} s is allowed: {remedy}"
        )
    order = np.argsort(time_s, kind="stable")
    kept = order[np.concatenate([[True], np.diff(time_s[order]) > 0.0])]
    if late := int((behind_s > 0.0).sum()):
        warn(f"{where}: {counted(late, 'sample is', 'samples are')} out of order and sorted by time")
    if repeated := time_s.size - kept.size:
        warn(f"{where}: {counted(repeated, 'sample has', 'samples have')} the time of another one and left out")
    _check_gaps(where, time_s[kept], remedy, warn)
    return kept


def _check_gaps(where: str, time_s: Floats, remedy: str, warn: OnWarning) -> None:
    steps_s = np.diff(time_s)
    if not steps_s.size or min(float(np.median(steps_s)), float(steps_s.mean())) > 1.0 / MIN_RATE_HZ:
        return  # refused later: too short, or a low rate and not a record full of gaps
    gaps = steps_s > max(GAP_PERIODS * float(np.median(steps_s)), ConditioningSettings.max_gap_s)
    if not gaps.any():
        return
    at = int(np.argmax(steps_s))
    if steps_s[at] > MAX_STEP_S:
        raise InputError(
            f"{where}: a gap of {steps_s[at]:.4g} s begins {time_s[at] - time_s[0]:.3f} s after the first sample, at"
            f" most {MAX_STEP_S:g} s is allowed: give the part before or after it, or {remedy}"
        )
    count = counted(int(gaps.sum()), "gap", "gaps")
    warn(f"{where}: {count} of up to {1e3 * steps_s[at]:.0f} ms, bridged by straight lines")
