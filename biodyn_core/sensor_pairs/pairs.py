"""Check of a sensor by another one on the same structure, against an earlier stretch without a fault.

The background is a short transfer between both sensors, estimated from the earlier stretch. A fault is a deviation from
it. Without an earlier stretch, a gain, a tilt, an offset or a skin is part of the transfer.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_core.sensor_pairs.faults import (
    PARAMETRIZATIONS,
    FaultFit,
    background_fits,
    by_chance,
    fit_fault,
    fit_faults,
    size_error,
    weights,
)
from biodyn_core.sensor_pairs.settings import PairSettings
from biodyn_core.sensor_pairs.transfers import RIDGES, Shape, Stretch, best_shape, filled, in_band, percent
from biodyn_core.tracing.findings import NAMING, Verdict

RECONSTRUCTIONS: Final = 20
"""Iterations of the replacement of clipped samples."""

LEAST_KEPT: Final = 0.25
"""Least share of unclipped samples of a stretch."""

INTERVAL_ERRORS: Final = 1.96
"""Half the length of a 95 % interval, in standard errors."""

SIMILAR_SHARE: Final = 0.8
"""A candidate with this share of the best gain is ambiguous with it."""


@dataclass(frozen=True, eq=False)
class Clipping:
    """Clipped samples of a channel: a mask (n,), their number in the raw samples, and their largest |value|."""

    flags: Flags
    count: int
    limit_mps2: float


@dataclass(frozen=True, eq=False)
class Pair:
    """A stretch of synchronous raw channels: reference (n, k), under test (n,) and its sensor's other axes (n, 2).

    clipping: of the channel under test where it is resampled, because clipping is visible in raw samples alone; None:
    found in its samples.
    """

    rate_hz: float
    reference: Floats
    under_test: Floats
    own: Floats | None = None
    clipping: Clipping | None = None

    def __post_init__(self) -> None:
        n = self.under_test.size
        if self.reference.shape[:1] != (n,) or (self.own is not None and self.own.shape != (n, 2)):
            raise InputError("pair: the channels differ in length; they have to be sampled together")
        if not (np.isfinite(self.reference).all() and np.isfinite(self.under_test).all()):
            raise InputError("pair: samples are not finite; fill them or cut them out")

    def clipped(self) -> Clipping:
        """The given clipped samples, or those that the samples show."""
        return clipping_of(self.under_test) if self.clipping is None else self.clipping


@dataclass(frozen=True, eq=False)
class PairCheck:
    """The result of a check.

    name, size: of the fault, in its unit; lower, upper: its 95 % interval, NaN without one, an outer end infinite where
    the size is at the end of the searched range. gains: cross-validated mean log ratios of squared errors by candidate;
    threshold: the required gain. Percent of the channel's rms: background in the earlier stretch; before: with its
    transfer in the checked stretch; after: with the fault as well.
    """

    verdict: Verdict
    reason: str
    name: str = ""
    size: float = 0.0
    unit: str = ""
    lower: float = math.nan
    upper: float = math.nan
    ambiguous_with: tuple[str, ...] = ()
    background_percent: float = math.nan
    before_percent: float = math.nan
    after_percent: float = math.nan
    gains: Mapping[str, float] | None = None
    threshold: float = math.nan


REASONS: Final[Mapping[Verdict, str]] = {
    "effect": "its gain exceeds chance and changes of the background",
    "ambiguous": "its gain exceeds chance and changes of the background, and so do the gains of others",
    "none": "no candidate gains enough, and the error equals the background's",
    "unexplained": "the error exceeds the background's, and no candidate explains it",
}


def clipped_samples(values: Floats) -> Flags:
    """The raw samples (n,) at a limit: the highest or lowest value, three times or more, often twice in a row.

    Coarse steps repeat everywhere, and a dead sensor once for long: neither is a limit.
    """
    flags = np.zeros(values.size, dtype=np.bool_)
    slack = 1e-6 * float(np.ptp(values))
    sides = [side >= side.max() - slack for side in (values, -values)]
    between = ~(sides[0] | sides[1])
    steps = np.abs(np.diff(values))[between[1:] & between[:-1]]
    repeats = float(np.mean(steps <= slack)) if steps.size else 0.0
    for at in sides:
        again = int((at[1:] & at[:-1]).sum())
        visits = at.sum() - again
        if at.sum() >= 3 and visits >= 2 and again > min(3.0 * repeats, 0.5 + 0.5 * repeats) * at.sum():
            flags |= at
    return flags


def clipping_of(values: Floats) -> Clipping:
    """The clipped samples of raw samples (n,)."""
    flags = clipped_samples(values)
    return Clipping(flags, int(flags.sum()), float(np.abs(values[flags]).max()) if flags.any() else math.nan)


def _stretch(pair: Pair, s: PairSettings, clipped: Flags) -> Stretch:
    """A pair in band, without clipped samples and their neighbours."""
    band = (pair.rate_hz, s.lowest_hz, s.highest_share * pair.rate_hz)
    own = None if pair.own is None else in_band(pair.own, *band)
    keep = ~scipy.ndimage.binary_dilation(clipped, iterations=3)
    edge = round(s.transfer_s * pair.rate_hz) + 1
    keep[:edge] = keep[keep.size - edge :] = False
    output = in_band(pair.under_test, *band)
    return Stretch(pair.rate_hz, in_band(pair.reference, *band), output, own, keep, round(s.window_s * pair.rate_hz))


def _good(pair: Pair, s: PairSettings) -> Stretch:
    """A pair in band, clipped samples interpolated."""
    clipped = pair.clipped().flags
    return _stretch(dataclasses.replace(pair, under_test=filled(pair.under_test, clipped)), s, clipped)


def _reconstructed(pair: Pair, baseline: Pair | None, clipped: Flags, s: PairSettings) -> Pair:
    """A pair with clipped samples replaced by the background's prediction.

    They are not compared, but missing peaks would spread through the band filters.
    """
    reconstructed = dataclasses.replace(pair, under_test=filled(pair.under_test, clipped))
    if baseline is None or not clipped.any():
        return reconstructed
    good, stretch = _good(baseline, s), _stretch(reconstructed, s, clipped)
    expected = best_shape(good, s.transfer_s)[0].predict(good, stretch)
    for _ in range(RECONSTRUCTIONS):
        slow = reconstructed.under_test - _stretch(reconstructed, s, clipped).output
        reconstructed = dataclasses.replace(pair, under_test=np.where(clipped, slow + expected, pair.under_test))
    return reconstructed


def residual(pair: Pair, baseline: Pair, settings: PairSettings | None = None) -> Floats:
    """The residual (n,) m/s^2 of a channel by the background of an earlier stretch, in band, 0 where not compared."""
    s = settings or PairSettings()
    stretch, good = (_good(each, s) for each in (pair, baseline))
    return np.where(stretch.keep, stretch.output - best_shape(good, s.transfer_s)[0].predict(good, stretch), 0.0)


def check(pair: Pair, baseline: Pair | None = None, seed: int = 0, settings: PairSettings | None = None) -> PairCheck:
    """Check a channel against its reference, with an earlier stretch of both without a fault.

    Without that stretch only clipping and a drift are found. Raises InputError if both stretches differ in rate or
    channels.
    """
    s = settings or PairSettings()
    if baseline is not None and (
        baseline.rate_hz != pair.rate_hz or baseline.reference.shape[1:] != pair.reference.shape[1:]
    ):
        raise InputError("pair: the earlier stretch has another rate or other channels")
    clipping = pair.clipped()
    clipped = clipping.flags
    if not clipped.any():
        return _unclipped(pair, baseline, clipped, seed, s)
    found = _unclipped(pair, baseline, clipped, seed, s)
    whole = _unclipped(pair, baseline, np.zeros_like(clipped), seed, s)
    besides = f", {found.name} besides" if found.verdict in NAMING else ""
    return dataclasses.replace(
        found,
        verdict="effect",
        reason=f"{counted(clipping.count, 'raw sample lies', 'raw samples lie')} at the limit, masked{besides}",
        name="saturation",
        size=clipping.limit_mps2,
        unit="m/s^2",
        lower=math.nan,
        upper=math.nan,
        ambiguous_with=(),
        before_percent=whole.before_percent,
        after_percent=found.before_percent,
    )


def _unclipped(pair: Pair, baseline: Pair | None, clipped: Flags, seed: int, s: PairSettings) -> PairCheck:
    """The check with clipped samples masked."""
    shortest = min(p.under_test.size / p.rate_hz for p in (pair, baseline) if p is not None)
    if shortest < s.least_s:
        return PairCheck("not_decidable", f"{shortest:.1f} s, at least {s.least_s:g} s of each stretch are needed")
    stretch = _stretch(_reconstructed(pair, baseline, clipped, s), s, clipped)
    if stretch.keep.mean() < LEAST_KEPT:
        return PairCheck("not_decidable", f"{100.0 * stretch.keep.mean():.0f} % of the stretch is left to compare")
    if baseline is None:
        return _without_baseline(stretch, seed, s)
    return _with_baseline(stretch, _good(baseline, s), seed, s)


def _without_baseline(stretch: Stretch, seed: int, s: PairSettings) -> PairCheck:
    """The check by a transfer from the stretch itself, which contains every constant fault: only a drift is found."""
    expected = Shape(round(0.5 * s.transfer_s * stretch.rate_hz), RIDGES[1]).predict(stretch, stretch)
    # The transfer contains the mean delay as well.
    mean_s, (drift,) = 0.5 * stretch.output.size / stretch.rate_hz, PARAMETRIZATIONS["drift"]
    about_mean = dataclasses.replace(drift, values=lambda x: {"drift": 1e-4 * x[0], "delay_s": -1e-4 * x[0] * mean_s})
    weight = weights(stretch.output - expected, stretch.keep, stretch.length)
    one = fit_fault((about_mean,), stretch, expected, weight)
    threshold = max(
        by_chance(stretch, expected, {"drift": one}, s.replicates, s.chance, seed), math.log1p(s.least_ratio**2)
    )
    before = percent(stretch.output - expected, stretch.output, stretch.keep)
    seen = one.gain > threshold and before <= 100.0 * (1.0 - s.least_explained)
    return PairCheck(
        "ambiguous" if seen else "not_decidable",
        "a drift, or a structure that changes" if seen else "clock, gain, tilt and skin are part of the transfer",
        "drift" if seen else "",
        one.size if seen else 0.0,
        one.unit if seen else "",
        before_percent=before,
        after_percent=percent(one.residual, stretch.output, stretch.keep) if seen else before,
        gains={"drift": one.gain},
        threshold=threshold,
    )


def _with_baseline(stretch: Stretch, good: Stretch, seed: int, s: PairSettings) -> PairCheck:
    """The check by the background of the earlier stretch."""
    names = tuple(name for name in PARAMETRIZATIONS if name != "tilt" or stretch.own is not None)
    shape, background = best_shape(good, s.transfer_s)
    expected = shape.predict(good, stretch)
    before = percent(stretch.output - expected, stretch.output, stretch.keep)
    if background > 100.0 * (1.0 - s.least_explained):
        reason = f"the reference does not predict {background:.0f} % of the channel in the earlier stretch"
        return PairCheck("not_decidable", reason, background_percent=background, before_percent=before)
    fits = fit_faults(stretch, expected, names)
    background_faults = background_fits(good, shape, names)
    chance = by_chance(stretch, expected, fits, s.replicates, s.chance, seed)
    change = s.change_ratio * max(0.0, *(fit.gain for half in background_faults for fit in half.values()))
    threshold = max(chance, change, math.log1p(s.least_ratio**2))
    best = max(names, key=lambda name: fits[name].gain)
    one = fits[best]
    after = percent(one.residual, stretch.output, stretch.keep)
    seen = one.gain > threshold and after <= s.most_residual * background
    like = tuple(n for n in names if n != best and fits[n].gain > threshold and _as_good(fits[n], one)) if seen else ()
    far = before > s.floor * background
    half_length = INTERVAL_ERRORS * size_error(one, [half[best] for half in background_faults]) if seen else math.nan
    verdict: Verdict = ("ambiguous" if like else "effect") if seen else ("unexplained" if far else "none")
    return PairCheck(
        verdict,
        REASONS[verdict],
        best if seen else "",
        one.size if seen else 0.0,
        one.unit if seen else "",
        *_interval(one, half_length),
        like,
        background_percent=background,
        before_percent=before,
        after_percent=after if seen else before,
        gains={name: fits[name].gain for name in names},
        threshold=threshold,
    )


def _interval(one: FaultFit, half_length: float) -> tuple[float, float]:
    """The ends of the interval of a size; without an outer end where the size is at the end of the searched range."""
    lower, upper = one.size - half_length, one.size + half_length
    if one.is_at_end and math.isfinite(half_length):
        return (lower, math.inf) if one.size > 0.0 else (-math.inf, upper)
    return lower, upper


def _as_good(other: FaultFit, best: FaultFit) -> bool:
    """Whether a candidate is worse by less than two standard errors over the windows, or has a similar gain."""
    worse = best.ratios - other.ratios
    error = float(worse.std()) / math.sqrt(max(worse.size - 1, 1))
    return other.gain > SIMILAR_SHARE * best.gain or float(worse.mean()) < 2.0 * error
