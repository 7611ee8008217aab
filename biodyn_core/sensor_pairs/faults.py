"""Sensor faults (clock, drift, gain, tilt, skin) fitted to the residual of a transfer from another sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.effects import CATALOGUE, SensorTransform
from biodyn_core.sensor_pairs.transfers import Shape, Stretch, across, window_sums

Map = Callable[[Floats], Floats]

DIFFERENCE: Final = 1e-3
"""Step of a derivative by a free value, relative."""

END_SHARE: Final = 0.01
"""A free value within this share of its range from an end is at the end."""

OVERDAMPED: Final = 10.0
"""The catalogue's skin with this damping ratio is a first-order lag, within a percent."""


@dataclass(frozen=True)
class Parametrization:
    """One parametrization of a candidate: free values of the order of 1, and the effect's values for them."""

    effect: str
    unit: str
    starts: tuple[tuple[float, ...], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    values: Callable[[Floats], dict[str, float]]
    size: Callable[[Floats], float]


def _parametrizations() -> dict[str, tuple[Parametrization, ...]]:
    """Every candidate with its parametrizations; ranges are the catalogue's, except for the overdamped skin."""
    of = {name: {p.name: p for p in CATALOGUE[name].parameters} for name in ("clock", "gain", "tilt", "skin")}
    late, drift, gain, tilt = of["clock"]["delay_s"], of["clock"]["drift"], of["gain"]["gain"], of["tilt"]["lean_x"]
    soft, damping = of["skin"]["softness_s"], of["skin"]["damping_ratio"]

    def one(
        effect: str, name: str, unit: str, scale: float, most: float, rest: dict[str, float]
    ) -> tuple[Parametrization, ...]:
        return (
            Parametrization(effect, unit, ((0.1,),), (-most / scale,), (most / scale,),
                 lambda x: {name: scale * x[0]} | rest, lambda x: float(scale * x[0])),
        )  # fmt: skip

    return {
        "clock": one("clock", "delay_s", "s", 1e-3, late.upper, {"drift": 0.0}),
        "drift": one("clock", "drift", "s/s", 1e-4, drift.upper, {"delay_s": 0.0}),
        "gain": one("gain", "gain", "", 0.1, gain.upper, {}),
        "tilt": (
            Parametrization("tilt", "rad", ((0.1, 0.1),), (tilt.lower / 0.1,) * 2, (tilt.upper / 0.1,) * 2,
                 lambda x: {"lean_x": 0.1 * x[0], "lean_y": 0.1 * x[1]}, lambda x: float(0.1 * np.hypot(*x))),
        ),
        "skin": (
            Parametrization("skin", "s", ((1.0,), (3.0,)), (0.02,), (20.0,),
                 lambda x: {"softness_s": 2e-3 * OVERDAMPED * x[0], "damping_ratio": OVERDAMPED},
                 lambda x: float(1e-3 * x[0])),
            Parametrization("skin", "s", ((4.5, damping.start), (2.65, damping.start)), (0.5, damping.lower),
                 (1e3 * soft.upper, damping.upper),
                 lambda x: {"softness_s": 1e-3 * x[0], "damping_ratio": float(x[1])}, lambda x: float(1e-3 * x[0])),
        ),
    }  # fmt: skip


PARAMETRIZATIONS: Final = _parametrizations()


@dataclass(frozen=True, eq=False)
class FaultFit:
    """One candidate: cross-validated residual (n,) and log ratios (w,), size and unit, and its changes (n,).

    error: standard error of the size by the scatter of the windows. is_at_end: the size is the largest of the searched
    range, and the true one can be larger.
    """

    residual: Floats
    ratios: Floats
    size: float
    unit: str
    changes: tuple[Floats, ...]
    error: float
    is_at_end: bool

    @property
    def gain(self) -> float:
        """Mean log ratio."""
        return float(self.ratios.mean()) if self.ratios.size else 0.0


def _map(form: Parametrization, stretch: Stretch, expected: Floats) -> Map:
    """The sensor's output (n,) as a function of the free values."""
    effect = CATALOGUE[form.effect]
    assert isinstance(effect, SensorTransform)
    channels = {} if stretch.own is None else {"own.x": stretch.own[:, 0], "own.y": stretch.own[:, 1]}
    return lambda free: effect.transform(expected, stretch.rate_hz, channels, form.values(free))


def _fit(
    form: Parametrization, shown: Map, output: Floats, weight: Floats, starts: tuple[tuple[float, ...], ...]
) -> tuple[Floats, float]:
    """Free values of least weighted squares from all starts, and their cost."""
    best, least = np.asarray(starts[0]), math.inf
    for start in starts:
        found = scipy.optimize.least_squares(
            lambda free: weight * (output - shown(free)), start, bounds=(form.lower, form.upper), diff_step=1e-4,
            xtol=1e-5, ftol=1e-6, max_nfev=25,
        )  # fmt: skip
        if found.cost < least:
            best, least = found.x, float(found.cost)
    return best, least


def fit_fault(forms: tuple[Parametrization, ...], stretch: Stretch, expected: Floats, weight: Floats) -> FaultFit:
    """Fit a candidate to every other window and test it in those between, and vice versa."""
    output, maps = stretch.output, [_map(form, stretch, expected) for form in forms]
    fits = [_fit(form, shown, output, weight, form.starts) for form, shown in zip(forms, maps, strict=True)]
    best = int(np.argmin([cost for _, cost in fits]))
    odd = (np.arange(output.size) // stretch.length) % 2 == 1
    residual = np.zeros(output.size)
    for held in (odd, ~odd):
        free, _ = _fit(forms[best], maps[best], output, weight * ~held, (tuple(fits[best][0]),))
        residual[held] = (output - maps[best](free))[held]
    sums = [window_sums(r**2, stretch.keep, stretch.length) for r in (output - expected, residual)]
    known = sums[0] > 0.0
    ratios = np.log(sums[0][known] / np.maximum(sums[1][known], 1e-300))
    changes = tuple(shown(free) - expected for shown, (free, _) in zip(maps, fits, strict=True))
    error = _standard_error(forms[best], maps[best], fits[best][0], stretch, weight)
    form, free = forms[best], fits[best][0]
    return FaultFit(residual, ratios, form.size(free), form.unit, changes, error, _is_at_end(form, free))


def _is_at_end(form: Parametrization, free: Floats) -> bool:
    """Whether a free value is at an end of its range towards which the size grows."""
    lower, upper, size = np.array(form.lower), np.array(form.upper), abs(form.size(free))
    near = END_SHARE * (upper - lower)
    inward = np.where(free > upper - near, -near, np.where(free < lower + near, near, 0.0))
    return any(abs(form.size(free + step)) < size for step in np.diag(inward))


def _standard_error(form: Parametrization, shown: Map, free: Floats, stretch: Stretch, weight: Floats) -> float:
    """Standard error of a size by the sandwich formula, with windows as clusters; infinite where it is not defined."""
    steps = DIFFERENCE * np.maximum(np.abs(free), 0.1) * np.eye(free.size)
    columns = [(shown(free + step) - shown(free - step)) / (2.0 * step.sum()) for step in steps]
    slope = np.array([(form.size(free + step) - form.size(free - step)) / (2.0 * step.sum()) for step in steps])
    square, weighted = weight**2, weight**2 * (stretch.output - shown(free))
    scores = np.column_stack([window_sums(column * weighted, stretch.keep, stretch.length) for column in columns])
    curvature = np.array([[float(np.sum(square * one * other)) for other in columns] for one in columns])
    try:
        direction = np.linalg.solve(curvature, slope)
    except np.linalg.LinAlgError:
        return math.inf
    return float(np.sqrt(np.sum((scores @ direction) ** 2)))


def size_error(fit: FaultFit, in_background: Sequence[FaultFit]) -> float:
    """Standard error of a size: by the scatter of the windows, and by the sizes that the background alone feigns."""
    return math.sqrt(fit.error**2 + sum(one.size**2 for one in in_background) / max(len(in_background), 1))


def weights(residual: Floats, keep: Flags, length: int) -> Floats:
    """Weights (n,) that give every window the same weight, 0 outside the mask."""
    sums, counts = window_sums(residual**2, keep, length), window_sums(np.ones(residual.size), keep, length)
    rms = np.sqrt(sums / np.maximum(counts, 1.0))
    inverse = 1.0 / np.maximum(rms, 0.1 * max(float(np.median(rms)), 1e-12))
    whole = np.concatenate([np.repeat(inverse, length), np.zeros(residual.size - inverse.size * length)])
    return np.asarray(np.where(keep, whole, 0.0))


def fit_faults(stretch: Stretch, expected: Floats, names: tuple[str, ...]) -> dict[str, FaultFit]:
    """Candidates by name, each fitted."""
    weight = weights(stretch.output - expected, stretch.keep, stretch.length)
    return {name: fit_fault(PARAMETRIZATIONS[name], stretch, expected, weight) for name in names}


def largest_by_chance(windows: Floats, energy: Floats, residual: float, signs: Floats) -> Floats:
    """The largest share of the residual's squares that a candidate explains in each random draw, (r,).

    windows (w, k): sums of candidate times residual; energy (k,): the candidates' squares; residual: sum of squares;
    signs (r, w) of the windows. A draw keeps the spectrum of the residual and follows the motion as the residual does.
    """
    seen = energy > 0.0
    if not seen.any() or residual <= 0.0:
        return np.zeros(len(signs))
    return np.asarray(((signs @ windows[:, seen]) ** 2 / (energy[seen] * residual)).max(axis=1))


def by_chance(
    stretch: Stretch, expected: Floats, fits: Mapping[str, FaultFit], draws: int, chance: float, seed: int
) -> float:
    """The gain that the best candidate exceeds with this probability without a fault.

    The signs of the residual's windows are random in each draw.
    """
    best = max(fits.values(), key=lambda one: one.gain)
    rest = best.residual if best.gain > 0.0 else stretch.output - expected
    weight = weights(rest, stretch.keep, stretch.length)
    changes = [weight * change for one in fits.values() for change in one.changes]
    windows = np.column_stack([window_sums(change * weight * rest, stretch.keep, stretch.length) for change in changes])
    energy = np.array([float(change @ change) for change in changes])
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), size=(draws, len(windows)))
    largest = largest_by_chance(windows, energy, float(np.sum((weight * rest) ** 2)), signs)
    return -math.log1p(-min(float(np.quantile(largest, 1.0 - chance)), 0.99))


def background_fits(good: Stretch, shape: Shape, names: tuple[str, ...]) -> tuple[dict[str, FaultFit], ...]:
    """Candidates by name, fitted to each half with the transfer of the other: changes of the background itself.

    Random draws do not contain them.
    """
    expected = across(good, shape)
    late = np.arange(good.output.size) >= good.output.size // 2
    return tuple(fit_faults(good.only(half), expected, names) for half in (late, ~late))
