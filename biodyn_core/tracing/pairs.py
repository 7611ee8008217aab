"""Tracing on a chain of two channels: what changed on a sensor since it was last good, told by another beside it.

What two sensors of one structure differ by is their background, a short transfer learnt while both were good. A fault
shows only as a departure from it: without such a stretch, a gain, a tilt, an offset or a skin is part of the transfer.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize, signal

from biodyn_core.effects import CATALOGUE
from biodyn_core.errors import InputError
from biodyn_core.settings import check_settings, setting

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Verdict = Literal["effect", "ambiguous", "none", "unexplained", "not_decidable"]
Map = Callable[[Floats], Floats]

CREEPING: Final = 10.0
"""The catalogue's skin with so much damping is a lag of first order, to a percent."""

RIDGES: Final = (1e-4, 1e-3, 1e-2, 1e-1)
MENDING: Final = 20
"""Turns until what is put in the place of clipped samples has settled."""

LEAST_KEPT: Final = 0.25
"""Of a stretch, the share that clipping must have left."""

NEARLY: Final = 0.8
"""What gains so much of the best cannot be told from it."""


@dataclass(frozen=True)
class PairSettings:
    """How a pair is traced."""

    lowest_hz: float = setting(0.5, "below lie gravity and biases", "Hz", 0.05, 10.0)
    highest_share: float = setting(0.36, "highest frequency compared, in shares of the rate", "", 0.05, 0.48)
    transfer_s: float = setting(0.06, "the background looks at most so far back and ahead", "s", 0.0, 1.0)
    window_s: float = setting(0.5, "length of a window of the score", "s", 0.05, 10.0)
    least_s: float = setting(5.0, "shortest stretch that is traced", "s", 0.5, 3600.0)
    least_explained: float = setting(0.4, "of a channel's rms, the least a reference must predict", "", 0.0, 1.0)
    replicates: int = setting(2000, "draws of the largest gain where nothing is hidden", "", 100, 1_000_000)
    chance: float = setting(0.05, "share of these draws that may exceed the threshold", "", 0.001, 0.5)
    wander: float = setting(2.0, "times what the background itself gains from one half to the other", "", 0.0, 100.0)
    least_ratio: float = setting(0.3, "an effect's own change over the background, the least named", "", 0.0, 10.0)
    most_left: float = setting(
        2.0, "error over the background's own at which an effect explains nothing", "", 1.0, 100.0
    )
    floor: float = setting(1.3, "error over the background's own from which it is unexplained", "", 1.0, 10.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class Pair:
    """A stretch of synchronous raw channels: reference (n, k), under test (n,) and its sensor's other axes (n, 2)."""

    rate_hz: float
    reference: Floats
    under_test: Floats
    own: Floats | None = None

    def __post_init__(self) -> None:
        n = self.under_test.size
        if self.reference.shape[:1] != (n,) or (self.own is not None and self.own.shape != (n, 2)):
            raise InputError("pair: the channels differ in length, they must be sampled together")
        if not (np.isfinite(self.reference).all() and np.isfinite(self.under_test).all()):
            raise InputError("pair: samples that are not finite, fill or cut them out first")


@dataclass(frozen=True, eq=False)
class PairTrace:
    """What a pair shows.

    name and size are of the effect, in its unit; gains are mean log ratios of squared errors in windows that each
    candidate was not fitted to, threshold what the best has to exceed. Percent are of the channel's rms: background
    where it was good, before with the same transfer in the stretch that is traced, after with the effect as well.
    """

    verdict: Verdict
    reason: str
    name: str = ""
    size: float = 0.0
    unit: str = ""
    ambiguous_with: tuple[str, ...] = ()
    background_percent: float = math.nan
    before_percent: float = math.nan
    after_percent: float = math.nan
    gains: Mapping[str, float] | None = None
    threshold: float = math.nan


@dataclass(frozen=True)
class _Way:
    """One way a candidate may act: free values in units in which 1 is usual, and the values of the effect they mean."""

    effect: str
    unit: str
    starts: tuple[tuple[float, ...], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    values: Callable[[Floats], dict[str, float]]
    size: Callable[[Floats], float]


def _ways() -> dict[str, tuple[_Way, ...]]:
    """Every candidate and its ways; ranges are those of the catalogue, but for the creeping skin, which it lacks."""
    of = {name: {p.name: p for p in CATALOGUE[name].parameters} for name in ("clock", "gain", "tilt", "skin")}
    late, drift, gain, lean = of["clock"]["delay_s"], of["clock"]["drift"], of["gain"]["gain"], of["tilt"]["lean_x"]
    soft, damping = of["skin"]["softness_s"], of["skin"]["damping_ratio"]

    def one(effect: str, name: str, unit: str, scale: float, most: float, rest: dict[str, float]) -> tuple[_Way, ...]:
        return (
            _Way(effect, unit, ((0.1,),), (-most / scale,), (most / scale,),
                 lambda x: {name: scale * x[0]} | rest, lambda x: float(scale * x[0])),
        )  # fmt: skip

    return {
        "clock": one("clock", "delay_s", "s", 1e-3, late.upper, {"drift": 0.0}),
        "drift": one("clock", "drift", "s/s", 1e-4, drift.upper, {"delay_s": 0.0}),
        "gain": one("gain", "gain", "", 0.1, gain.upper, {}),
        "tilt": (
            _Way("tilt", "rad", ((0.1, 0.1),), (lean.lower / 0.1,) * 2, (lean.upper / 0.1,) * 2,
                 lambda x: {"lean_x": 0.1 * x[0], "lean_y": 0.1 * x[1]}, lambda x: float(0.1 * np.hypot(*x))),
        ),
        "skin": (
            _Way("skin", "s", ((1.0,), (3.0,)), (0.02,), (20.0,),
                 lambda x: {"softness_s": 2e-3 * CREEPING * x[0], "damping_ratio": CREEPING},
                 lambda x: float(1e-3 * x[0])),
            _Way("skin", "s", ((4.5, damping.start), (2.65, damping.start)), (0.5, damping.lower),
                 (1e3 * soft.upper, damping.upper),
                 lambda x: {"softness_s": 1e-3 * x[0], "damping_ratio": float(x[1])}, lambda x: float(1e-3 * x[0])),
        ),
    }  # fmt: skip


WAYS: Final = _ways()

SAID: Final[Mapping[Verdict, str]] = {
    "effect": "it gains more than chance and than the background's own changes",
    "ambiguous": "it gains more than chance and than the background's own changes, and so do others",
    "none": "no candidate gains enough, and the error is the background's",
    "unexplained": "the error is above the background's, and no candidate takes it away",
}


# --- kernels ---------------------------------------------------------------------------------------------------------


def clipped_samples(values: Floats, least: int = 3) -> Flags:
    """Where raw samples (n,) lie at a limit: the highest or lowest value, again and again and often twice in a row.

    least is how often at least. Coarse steps repeat themselves everywhere, and a dead sensor once for long: neither is
    a limit.
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
        if at.sum() >= least and visits >= 2 and again > min(3.0 * repeats, 0.5 + 0.5 * repeats) * at.sum():
            flags |= at
    return flags


def filled(values: Floats, bad: Flags) -> Floats:
    """Samples (n,) with straight lines where they are bad."""
    if not bad.any() or bad.all():
        return values
    at = np.arange(values.size)
    return np.interp(at, at[~bad], values[~bad])


def in_band(values: Floats, rate_hz: float, lowest_hz: float, highest_hz: float) -> Floats:
    """Samples (n, ...) between two frequencies, no phase."""
    sos = signal.butter(2, (lowest_hz, highest_hz), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(signal.sosfiltfilt(sos, values, axis=0))


def lagged(inputs: Floats, span: int) -> Floats:
    """Inputs (n, k) up to `span` samples late and early, (n, k (2 span + 1)); the ends wrap."""
    return np.column_stack([np.roll(inputs, late, axis=0) for late in range(-span, span + 1)])


def transfer(rows: Floats, output: Floats, keep: Flags, ridge: float) -> Floats:
    """Coefficients (m,) of rows (n, m) for an output (n,), pulled to zero by a share of each row's own power."""
    kept = rows[keep]
    power = kept.T @ kept
    # By each row's own: a gyro in rad/s is small beside accelerations, and no less worth.
    size = np.sqrt(np.maximum(np.diag(power), 1e-12 * np.diag(power).max() + 1e-300))
    alike = power / np.outer(size, size)
    return np.asarray(np.linalg.solve(alike + ridge * np.eye(len(size)), kept.T @ output[keep] / size) / size)


def window_sums(squares: Floats, keep: Flags, length: int) -> Floats:
    """Sums over whole windows (w,) of what is kept."""
    whole = squares.size // length * length
    return np.asarray(np.where(keep, squares, 0.0)[:whole].reshape(-1, length).sum(axis=1))


def percent(residual: Floats, output: Floats, keep: Flags) -> float:
    """Rms of what is left, of the rms of the output."""
    return float(100.0 * np.sqrt(np.sum(residual[keep] ** 2) / max(np.sum(output[keep] ** 2), 1e-300)))


def largest_by_chance(windows: Floats, energy: Floats, residual: float, signs: Floats) -> Floats:
    """The largest share of the residual's squares that any candidate gains, in each draw, (r,).

    windows (w, k) are sums of candidate times residual, energy (k,) the candidates' own squares, residual the sum of
    squares, signs (r, w) of the windows: what is drawn keeps its colour and follows the motion as the residual does.
    """
    seen = energy > 0.0
    if not seen.any() or residual <= 0.0:
        return np.zeros(len(signs))
    return np.asarray(((signs @ windows[:, seen]) ** 2 / (energy[seen] * residual)).max(axis=1))


# --- the trace -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A stretch in band: reference (n, k), output (n,), own axes (n, 2), what is compared (n,), a window's length."""

    rate_hz: float
    reference: Floats
    output: Floats
    own: Floats | None
    keep: Flags
    length: int

    def only(self, these: Flags) -> _Stretch:
        """The same, comparing some of its samples alone."""
        return dataclasses.replace(self, keep=self.keep & these)


def _stretch(pair: Pair, s: PairSettings, clipped: Flags) -> _Stretch:
    """A pair in band, clipped samples and those beside them left out."""
    band = (pair.rate_hz, s.lowest_hz, s.highest_share * pair.rate_hz)
    own = None if pair.own is None else in_band(pair.own, *band)
    keep = ~ndimage.binary_dilation(clipped, iterations=3)
    edge = round(s.transfer_s * pair.rate_hz) + 1
    keep[:edge] = keep[keep.size - edge :] = False
    output = in_band(pair.under_test, *band)
    return _Stretch(pair.rate_hz, in_band(pair.reference, *band), output, own, keep, round(s.window_s * pair.rate_hz))


@dataclass(frozen=True)
class _Shape:
    """How a background is learnt: samples it looks back and ahead, and the pull on its coefficients."""

    span: int
    ridge: float

    def predict(self, learnt: _Stretch, other: _Stretch) -> Floats:
        """What another stretch shows, (n,), by the transfer of the one it is learnt from."""
        found = transfer(lagged(learnt.reference, self.span), learnt.output, learnt.keep, self.ridge)
        return np.asarray(lagged(other.reference, self.span) @ found)


@dataclass(frozen=True, eq=False)
class _Tried:
    """One candidate: residual (n,) where not fitted, its log ratios (w,), size and unit, and its changes (n,) at it."""

    residual: Floats
    ratios: Floats
    size: float
    unit: str
    changes: tuple[Floats, ...]

    @property
    def gain(self) -> float:
        """Mean log ratio."""
        return float(self.ratios.mean()) if self.ratios.size else 0.0


def _map(way: _Way, stretch: _Stretch, expected: Floats) -> Map:
    """What the sensor would show, (n,), from the free values."""
    measured = CATALOGUE[way.effect].measured
    assert measured is not None
    channels = {} if stretch.own is None else {"own.x": stretch.own[:, 0], "own.y": stretch.own[:, 1]}
    return lambda free: measured(expected, stretch.rate_hz, channels, way.values(free))


def _fit(
    way: _Way, shown: Map, output: Floats, weight: Floats, starts: tuple[tuple[float, ...], ...]
) -> tuple[Floats, float]:
    """Free values of least weighted squares from all starts, and their cost."""
    best, least = np.asarray(starts[0]), math.inf
    for start in starts:
        found = optimize.least_squares(
            lambda free: weight * (output - shown(free)), start, bounds=(way.lower, way.upper), diff_step=1e-4,
            xtol=1e-5, ftol=1e-6, max_nfev=25,
        )  # fmt: skip
        if found.cost < least:
            best, least = found.x, float(found.cost)
    return best, least


def _try(ways: tuple[_Way, ...], stretch: _Stretch, expected: Floats, weight: Floats) -> _Tried:
    """Fit a candidate to every other window, look at those between, and the other way round."""
    output, maps = stretch.output, [_map(way, stretch, expected) for way in ways]
    fits = [_fit(way, shown, output, weight, way.starts) for way, shown in zip(ways, maps, strict=True)]
    best = int(np.argmin([cost for _, cost in fits]))
    odd = (np.arange(output.size) // stretch.length) % 2 == 1
    residual = np.zeros(output.size)
    for held in (odd, ~odd):
        free, _ = _fit(ways[best], maps[best], output, weight * ~held, (tuple(fits[best][0]),))
        residual[held] = (output - maps[best](free))[held]
    sums = [window_sums(r**2, stretch.keep, stretch.length) for r in (output - expected, residual)]
    there = sums[0] > 0.0
    ratios = np.log(sums[0][there] / np.maximum(sums[1][there], 1e-300))
    changes = tuple(shown(free) - expected for shown, (free, _) in zip(maps, fits, strict=True))
    return _Tried(residual, ratios, ways[best].size(fits[best][0]), ways[best].unit, changes)


def _weight(residual: Floats, keep: Flags, length: int) -> Floats:
    """Weights (n,) by which every window counts alike, 0 where nothing is compared."""
    sums, counts = window_sums(residual**2, keep, length), window_sums(np.ones(residual.size), keep, length)
    rms = np.sqrt(sums / np.maximum(counts, 1.0))
    inverse = 1.0 / np.maximum(rms, 0.1 * max(float(np.median(rms)), 1e-12))
    whole = np.concatenate([np.repeat(inverse, length), np.zeros(residual.size - inverse.size * length)])
    return np.asarray(np.where(keep, whole, 0.0))


def _all(stretch: _Stretch, expected: Floats, names: tuple[str, ...]) -> dict[str, _Tried]:
    weight = _weight(stretch.output - expected, stretch.keep, stretch.length)
    return {name: _try(WAYS[name], stretch, expected, weight) for name in names}


def _by_chance(stretch: _Stretch, expected: Floats, tried: Mapping[str, _Tried], seed: int, s: PairSettings) -> float:
    """What the best of all candidates gains where nothing is hidden: windows of the residual with signs drawn anew."""
    best = max(tried.values(), key=lambda one: one.gain)
    rest = best.residual if best.gain > 0.0 else stretch.output - expected
    weight = _weight(rest, stretch.keep, stretch.length)
    changes = [weight * change for one in tried.values() for change in one.changes]
    windows = np.column_stack([window_sums(change * weight * rest, stretch.keep, stretch.length) for change in changes])
    energy = np.array([float(change @ change) for change in changes])
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), size=(s.replicates, len(windows)))
    largest = largest_by_chance(windows, energy, float(np.sum((weight * rest) ** 2)), signs)
    return -math.log1p(-min(float(np.quantile(largest, 1.0 - s.chance)), 0.99))


def _across(good: _Stretch, shape: _Shape) -> Floats:
    """What either half of a stretch shows by the transfer of the other, (n,)."""
    late = np.arange(good.output.size) >= good.output.size // 2
    return np.where(late, shape.predict(good.only(~late), good), shape.predict(good.only(late), good))


def _shape(good: _Stretch, s: PairSettings) -> tuple[_Shape, float]:
    """The shape by which one half predicts the other best, and its error in percent."""
    most = round(s.transfer_s * good.rate_hz)
    shapes = [_Shape(span, ridge) for span in sorted({0, most // 4, most // 2, most}) for ridge in RIDGES]
    errors = [percent(good.output - _across(good, shape), good.output, good.keep) for shape in shapes]
    best = int(np.argmin(errors))
    return shapes[best], errors[best]


def _wander(good: _Stretch, shape: _Shape, names: tuple[str, ...]) -> float:
    """The most that any candidate gains in one half by the transfer of the other: no bootstrap knows of that."""
    expected = _across(good, shape)
    late = np.arange(good.output.size) >= good.output.size // 2
    return max(0.0, *(one.gain for half in (late, ~late) for one in _all(good.only(half), expected, names).values()))


def _good(pair: Pair, s: PairSettings) -> _Stretch:
    """A pair in band, straight lines over what is clipped."""
    clipped = clipped_samples(pair.under_test)
    return _stretch(dataclasses.replace(pair, under_test=filled(pair.under_test, clipped)), s, clipped)


def _mended(pair: Pair, baseline: Pair | None, clipped: Flags, s: PairSettings) -> Pair:
    """A pair with what the background expects in the place of clipped samples.

    They are compared with nothing, but the band's filters would carry peaks that are missing far beyond them.
    """
    mended = dataclasses.replace(pair, under_test=filled(pair.under_test, clipped))
    if baseline is None or not clipped.any():
        return mended
    good, stretch = _good(baseline, s), _stretch(mended, s, clipped)
    expected = _shape(good, s)[0].predict(good, stretch)
    for _ in range(MENDING):
        slow = mended.under_test - _stretch(mended, s, clipped).output
        mended = dataclasses.replace(pair, under_test=np.where(clipped, slow + expected, pair.under_test))
    return mended


def residual(pair: Pair, baseline: Pair, settings: PairSettings | None = None) -> Floats:
    """What the background of an earlier stretch leaves of a channel, (n,) m/s^2 in band, 0 where not compared."""
    s = settings or PairSettings()
    stretch, good = (_good(each, s) for each in (pair, baseline))
    return np.where(stretch.keep, stretch.output - _shape(good, s)[0].predict(good, stretch), 0.0)


def trace(pair: Pair, baseline: Pair | None = None, seed: int = 0, settings: PairSettings | None = None) -> PairTrace:
    """Trace what a channel shows beyond its reference, given an earlier stretch of both without fault.

    Without that stretch only clipping and a drift can be told. Raises InputError where the two stretches differ in
    rate or channels.
    """
    s = settings or PairSettings()
    if baseline is not None and (
        baseline.rate_hz != pair.rate_hz or baseline.reference.shape[1:] != pair.reference.shape[1:]
    ):
        raise InputError("pair: the earlier stretch has another rate or other channels")
    clipped = clipped_samples(pair.under_test)
    if not clipped.any():
        return _unclipped(pair, baseline, clipped, seed, s)
    found = _unclipped(pair, baseline, clipped, seed, s)
    whole = _unclipped(pair, baseline, np.zeros_like(clipped), seed, s)
    besides = f", {found.name} besides" if found.verdict in ("effect", "ambiguous") else ""
    return dataclasses.replace(
        found,
        verdict="effect",
        reason=f"{clipped.sum()} raw samples lie at the limit and are masked{besides}",
        name="saturation",
        size=float(np.abs(pair.under_test[clipped]).max()),
        unit="m/s^2",
        ambiguous_with=(),
        before_percent=whole.before_percent,
        after_percent=found.before_percent,
    )


def _unclipped(pair: Pair, baseline: Pair | None, clipped: Flags, seed: int, s: PairSettings) -> PairTrace:
    """The trace of what is left once clipped samples are masked."""
    shortest = min(p.under_test.size / p.rate_hz for p in (pair, baseline) if p is not None)
    if shortest < s.least_s:
        return PairTrace("not_decidable", f"{shortest:.1f} s, at least {s.least_s:g} s of each stretch are needed")
    stretch = _stretch(_mended(pair, baseline, clipped, s), s, clipped)
    if stretch.keep.mean() < LEAST_KEPT:
        return PairTrace("not_decidable", f"{100.0 * stretch.keep.mean():.0f} % of the stretch is left to compare")
    if baseline is None:
        return _without(stretch, seed, s)
    return _with(stretch, _good(baseline, s), seed, s)


def _without(stretch: _Stretch, seed: int, s: PairSettings) -> PairTrace:
    """A transfer from the stretch itself takes every fault on that does not change with time: only drift is left."""
    expected = _Shape(round(0.5 * s.transfer_s * stretch.rate_hz), RIDGES[1]).predict(stretch, stretch)
    # The transfer has taken the mean delay on itself as well.
    mean_s, (drift,) = 0.5 * stretch.output.size / stretch.rate_hz, WAYS["drift"]
    about_mean = dataclasses.replace(drift, values=lambda x: {"drift": 1e-4 * x[0], "delay_s": -1e-4 * x[0] * mean_s})
    weight = _weight(stretch.output - expected, stretch.keep, stretch.length)
    one = _try((about_mean,), stretch, expected, weight)
    threshold = max(_by_chance(stretch, expected, {"drift": one}, seed, s), math.log1p(s.least_ratio**2))
    before = percent(stretch.output - expected, stretch.output, stretch.keep)
    seen = one.gain > threshold and before <= 100.0 * (1.0 - s.least_explained)
    return PairTrace(
        "ambiguous" if seen else "not_decidable",
        "a drift, or a structure that changes" if seen else "clock, gain, tilt and skin are part of what was learnt",
        "drift" if seen else "",
        one.size if seen else 0.0,
        one.unit if seen else "",
        before_percent=before,
        after_percent=percent(one.residual, stretch.output, stretch.keep) if seen else before,
        gains={"drift": one.gain},
        threshold=threshold,
    )


def _with(stretch: _Stretch, good: _Stretch, seed: int, s: PairSettings) -> PairTrace:
    """The ladder of all candidates against the background of the stretch that was good."""
    names = tuple(name for name in WAYS if name != "tilt" or stretch.own is not None)
    shape, background = _shape(good, s)
    expected = shape.predict(good, stretch)
    before = percent(stretch.output - expected, stretch.output, stretch.keep)
    if background > 100.0 * (1.0 - s.least_explained):
        reason = f"the reference leaves {background:.0f} % of the channel where it was good"
        return PairTrace("not_decidable", reason, background_percent=background, before_percent=before)
    tried = _all(stretch, expected, names)
    chance, wander = _by_chance(stretch, expected, tried, seed, s), s.wander * _wander(good, shape, names)
    threshold = max(chance, wander, math.log1p(s.least_ratio**2))
    best = max(names, key=lambda name: tried[name].gain)
    one = tried[best]
    after = percent(one.residual, stretch.output, stretch.keep)
    seen = one.gain > threshold and after <= s.most_left * background
    like = (
        tuple(n for n in names if n != best and tried[n].gain > threshold and _as_good(tried[n], one)) if seen else ()
    )
    far = before > s.floor * background
    verdict: Verdict = ("ambiguous" if like else "effect") if seen else ("unexplained" if far else "none")
    return PairTrace(
        verdict,
        SAID[verdict],
        best if seen else "",
        one.size if seen else 0.0,
        one.unit if seen else "",
        like,
        background_percent=background,
        before_percent=before,
        after_percent=after if seen else before,
        gains={name: tried[name].gain for name in names},
        threshold=threshold,
    )


def _as_good(other: _Tried, best: _Tried) -> bool:
    """Whether a candidate is worse by less than two standard errors over the windows, or gains nearly as much."""
    worse = best.ratios - other.ratios
    error = float(worse.std()) / math.sqrt(max(worse.size - 1, 1))
    return other.gain > NEARLY * best.gain or float(worse.mean()) < 2.0 * error
