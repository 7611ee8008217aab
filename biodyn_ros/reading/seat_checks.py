"""Checks of a measured seat motion: order and gaps of its stamps, size, unit and mean of its readings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_core.conditioning.tilt import is_gravity
from biodyn_core.kernels.sensor import IMPLAUSIBLE

OnWarning = Callable[[str], None]

MIN_RATE_HZ: Final = 20.0

MAX_STEP_S: Final = 0.2
"""Longest gap that a straight line bridges: a cycle at 5 Hz, near the main resonance of a seated body.

Stamps may go back by as much: samples that arrive late. More is a clock that was set, or a stray stamp.
"""

GAP_PERIODS: Final = 3.5
"""A gap is longer than this number of sampling periods: three lost samples or more.

A spline through a longer one may swing far beyond the samples beside it.
"""

NEAR_PERIODS: Final = 0.25
"""A sample that follows another one by less than this number of mean sampling periods is left out.

It was stamped late or early. A spline through both would swing far beyond them: 17-fold for 0.01 of a period.
"""

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
    if mean > IN_G[1] and not is_gravity(mean):
        warn(f"{where}: the mean acceleration is {mean:.2f} m/s^2, neither gravity nor zero: gain or unit may be wrong")


def order_of(where: str, time_s: Floats, remedy: str, warn: OnWarning) -> Integers:
    """Indices that put samples at time_s (n,) in order of time, without stamps that are equal or nearly so.

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
    kept = order[_apart(time_s[order])]
    if late := int((behind_s > 0.0).sum()):
        warn(f"{where}: {counted(late, 'sample is', 'samples are')} out of order and sorted by time")
    different = int(np.unique(time_s).size)
    if repeated := time_s.size - different:
        warn(f"{where}: {counted(repeated, 'sample has', 'samples have')} the time of another one and left out")
    if near := different - kept.size:
        words = f"a sample by less than {NEAR_PERIODS:g} of a sampling period and left out"
        warn(f"{where}: {counted(near, 'sample follows', 'samples follow')} {words}")
    _check_gaps(where, time_s[kept], remedy, warn)
    return kept


def _apart(time_s: Floats) -> Integers:
    """Indices of the samples at sorted time_s (n,) that follow the last kept one by NEAR_PERIODS or more."""
    different = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > 0.0)
    steps_s = np.diff(time_s[different])
    usual_s = steps_s[steps_s <= MAX_STEP_S]  # longer ones are refused later
    period_s = float(usual_s.mean()) if usual_s.size else 0.0
    least_s = NEAR_PERIODS * period_s
    if period_s > 1.0 / MIN_RATE_HZ or not (steps_s < least_s).any():
        return different  # a low rate is refused later, and stated as it is
    kept = [0]
    for index in different[1:]:
        if time_s[index] - time_s[kept[-1]] >= least_s:
            kept.append(int(index))
    return np.array(kept)


def gaps_of(time_s: Floats) -> Flags:
    """Which steps between samples at increasing time_s (n,) are gaps, (n - 1,) bool."""
    steps_s = np.diff(time_s)
    gaps: Flags = steps_s > GAP_PERIODS * float(np.median(steps_s))
    return gaps


def _check_gaps(where: str, time_s: Floats, remedy: str, warn: OnWarning) -> None:
    steps_s = np.diff(time_s)
    if not steps_s.size or min(float(np.median(steps_s)), float(steps_s.mean())) > 1.0 / MIN_RATE_HZ:
        return  # refused later: too short, or a low rate and not a record full of gaps
    gaps = gaps_of(time_s)
    if not gaps.any():
        return
    at = int(np.argmax(steps_s))
    if steps_s[at] > MAX_STEP_S:
        raise InputError(
            f"{where}: a gap of {steps_s[at]:.4g} s begins {time_s[at] - time_s[0]:.3f} s after the first sample, at"
            f" most {MAX_STEP_S:g} s is allowed: give the motion before or after it as a file of its own, or {remedy}"
        )
    count = counted(int(gaps.sum()), "gap", "gaps")
    warn(f"{where}: {count} of up to {1e3 * steps_s[at]:.3g} ms, bridged by straight lines")
