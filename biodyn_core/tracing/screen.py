"""Screening: what each candidate would take off the residual, once the background has taken what it can (tracing, B).

One simulation a candidate and event, at a strength at which it acts: a derivative at zero is useless for a stop or for
lift-off. Sizes come from the fitted side, gains from the events that choose.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.effects import CATALOGUE, AppliedEffect, Effect
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.nuisance_model import N_THETA, Background, Side
from biodyn_core.tracing.rows import Products

UNSEEN: Final = 1e-9
"""A candidate of which the background leaves no more than this share of its square is not seen at all."""

LEAST_SAMPLES: Final = 50
"""A window with fewer compared is not counted."""


@dataclass(frozen=True)
class Tried:
    """One effect at one site with start values, and by which of its parameters its size is changed, `` for presence."""

    applied: AppliedEffect
    strength: str

    @property
    def name(self) -> str:
        """The effect, its site, and the strength where there are several."""
        several = len(self.applied.effect.strengths) > 1
        return f"{self.applied.effect.name} at {self.applied.site}" + (f" ({self.strength})" if several else "")


@dataclass(frozen=True)
class Screened:
    """What one candidate would do to first order.

    gain: mean log ratio of what is left without and with it, in the events that choose; fits: what it takes off the
    squares that are fitted, weighted; size: of the strength, in shares of the start value; absorbed: share of its
    energy that theta takes on itself; p_value: how often the best of all candidates gains as much by chance.
    """

    tried: Tried
    gain: float
    fits: float
    size: float
    absorbed: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Screening:
    """All candidates, the largest gain first, and the largest gain (r,) of each draw of chance, ascending.

    along (c, c) are the absolute cosines between what is left of the candidates, in the order they were tried in.
    """

    ladder: tuple[Screened, ...]
    chance: Floats
    tried: tuple[Tried, ...]
    along: Floats

    def p_value(self, gain: float) -> float:
        """How often the best of all candidates gains as much by chance."""
        as_large = self.chance.size - int(np.searchsorted(self.chance, gain))
        return (1.0 + as_large) / (1.0 + self.chance.size)

    def cosine(self, one: Tried, other: Tried) -> float:
        """How alike two candidates are, once the background has taken what it can."""
        return float(self.along[self.tried.index(one), self.tried.index(other)])


def candidates(cases: Sequence[Case], there: Sequence[AppliedEffect] = ()) -> tuple[list[Tried], list[str]]:
    """Every effect at every site that these cases can show, and the names of those for which a channel is missing.

    What is there already is no candidate: a law that is added to itself is the same law beyond its range.
    """
    found, untestable = [], []
    has = {(one.effect.name, one.site) for one in there}
    for effect in CATALOGUE.values():
        for site in effect.sites:
            if (effect.name, site) in has:
                continue
            if not all(name in case.channels for case in cases for name in effect.required_channels(site)):
                untestable.append(f"{effect.name} at {site}")
                continue
            found += [
                Tried(AppliedEffect(effect, site, shape | _others(effect, strength)), strength)
                for strength in effect.strengths or ("",)
                for shape in _shapes(effect)
            ]
    return found, untestable


def _others(effect: Effect, strength: str) -> dict[str, float]:
    """The other strengths of an effect, at zero."""
    return {p.name: 0.0 for p in effect.parameters if p.kind == "strength" and p.name != strength}


def _shapes(effect: Effect) -> list[dict[str, float]]:
    """Values at which the effect shows, every combination of those that have a grid."""
    tried = [p.grid or (p.size,) for p in effect.parameters]
    return [dict(zip((p.name for p in effect.parameters), values, strict=True)) for values in itertools.product(*tried)]


def screen(
    background: Background, tried: Sequence[Tried], replicates: int = 400, seed: int = 0,
    tell: Callable[[float], None] = lambda share: None,
) -> Screening:  # fmt: skip
    """Screen candidates.

    Chance: the signs of whole windows of what the background leaves are drawn anew, on both sides, so that what is
    drawn keeps its colour and follows the seat as the residual does (wild bootstrap by blocks); everything is refitted.
    """
    sides = [_Beside.of(background, side, tried, tell) for side in (background.train, background.choose)]
    linear = _Linear.of(background, *sides)
    gains = linear.gains(background.train.products, background.choose.products, [side.with_miss for side in sides])
    chance = linear.chance(replicates, np.random.default_rng(seed))
    found = [
        Screened(one, float(gains[i]), float(linear.fits[i]), float(linear.sizes[i]), float(linear.absorbed[i]), 1.0)
        for i, one in enumerate(tried)
    ]
    ordered = Screening((), chance, tuple(tried), linear.along(sides[0]))
    ranked = sorted(
        (dataclasses.replace(one, p_value=ordered.p_value(one.gain)) for one in found), key=lambda one: -one.gain
    )
    return Screening(tuple(ranked), chance, tuple(tried), ordered.along)


@dataclass(frozen=True, eq=False)
class _Beside:
    """Products of the candidates' rows by window: with the known columns (w, c, k), own and with the miss (w, c)."""

    with_known: Floats
    own: Floats
    with_miss: Floats
    rows: tuple[NDArray[np.float32], ...]

    @classmethod
    def of(cls, background: Background, side: Side, tried: Sequence[Tried], tell: Callable[[float], None]) -> _Beside:
        parts, kept = [], []
        for number, (case, rows, known) in enumerate(zip(side.cases, side.rows, side.known, strict=True)):
            plain = answer(background.subject, case)
            missed = rows.missed(plain)
            own = np.empty((*missed.shape, len(tried)))
            for i, one in enumerate(tried):
                own[:, :, i] = rows((answer(background.subject, case, (one.applied,), plain) - plain)[:, :, None])[
                    :, :, 0
                ]
            parts.append(
                (
                    np.matmul(own.transpose(0, 2, 1), known),
                    np.einsum("wrc,wrc->wc", own, own),
                    np.einsum("wrc,wr->wc", own, missed, optimize=True),
                )
            )
            kept.append(own.reshape(-1, len(tried)).astype(np.float32))
            tell((number + 1) / len(side.cases))
        with_known, own_square, with_miss = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(with_known, own_square, with_miss, tuple(kept))


@dataclass(frozen=True, eq=False)
class _Linear:
    """The linear step of every candidate by itself.

    share (k, c) of the known columns in each candidate, energy (c,) that is left of it, sizes (c,), absorbed (c,).
    """

    background: Background
    beside: tuple[_Beside, _Beside]
    inverse: Floats
    share: Floats
    energy: Floats
    sizes: Floats
    absorbed: Floats

    @classmethod
    def of(cls, background: Background, train: _Beside, choose: _Beside) -> _Linear:
        weight, products = background.weight, background.train.products
        inverse = np.linalg.inv(background.normal())
        with_known = np.einsum("w,wck->ck", weight, train.with_known)
        share = inverse @ with_known.T
        own = weight @ train.own
        energy = own - np.einsum("ck,kc->c", with_known, share)
        seen = energy > UNSEEN * np.maximum(own, 1e-12)
        matches = weight @ train.with_miss - (weight @ products.miss) @ share
        sizes = np.where(seen, matches / np.where(seen, energy, 1.0), 0.0)
        theta = with_known[:, :N_THETA]
        inner = np.linalg.inv(background.normal()[:N_THETA, :N_THETA])
        taken = np.einsum("ck,kl,cl->c", theta, inner, theta) / np.where(own > 0.0, own, 1.0)
        absorbed = np.where(own > 0.0, taken, 1.0)
        return cls(
            background,
            (train, choose),
            np.asarray(inverse),
            np.asarray(share),
            np.where(seen, energy, np.inf),
            sizes,
            absorbed,
        )

    @property
    def fits(self) -> Floats:
        """What each takes off the squares of the fitted side, weighted (c,)."""
        return self.sizes**2 * np.where(np.isfinite(self.energy), self.energy, 0.0)

    def gains(self, train: Products, choose: Products, with_miss: Sequence[Floats]) -> Floats:
        """Mean log ratios (c,) in the events that choose, for a miss whose products are given."""
        weight, beside = self.background.weight, self.beside[1]
        b = self.inverse @ (weight @ train.miss)
        sizes = (weight @ with_miss[0] - (weight @ train.miss) @ self.share) / self.energy
        before = choose.left(b)
        known_left = choose.miss - np.einsum("wij,j->wi", choose.columns, b)
        match = with_miss[1] - beside.with_known @ b - known_left @ self.share
        after = before[:, None] - 2.0 * sizes * match + sizes**2 * self._own_choose
        return mean_log_ratio(before, after, choose.event, choose.samples)

    @property
    def _own_choose(self) -> Floats:
        """What is left of each candidate in each window that chooses, squared, (w, c)."""
        if "own" not in self.__dict__:
            beside, columns = self.beside[1], self.background.choose.products.columns
            inside = np.stack([np.einsum("jc,jc->c", self.share, one @ self.share) for one in columns])
            own = beside.own - 2.0 * np.einsum("wck,kc->wc", beside.with_known, self.share, optimize=True) + inside
            object.__setattr__(self, "own", own)
        return np.asarray(self.__dict__["own"])

    def chance(self, replicates: int, rng: np.random.Generator) -> Floats:
        """The largest gain of all candidates in each draw, (r,) ascending."""
        background, drawn = self.background, []
        b = background.solved(background.train.products)
        sides = [(background.train, self.beside[0]), (background.choose, self.beside[1])]
        left = [_without(side.products, beside, b) for side, beside in sides]
        for _ in range(replicates):
            signs = [rng.choice((-1.0, 1.0), size=p.square.size) for p, _ in left]
            flipped = [_flipped(p, m, s) for (p, m), s in zip(left, signs, strict=True)]
            drawn.append(self.gains(flipped[0][0], flipped[1][0], [m for _, m in flipped]).max())
        return np.sort(drawn)

    def along(self, train: _Beside) -> Floats:
        """Absolute cosines (c, c) between what is left of the candidates on the fitted side."""
        weight, total = self.background.weight, np.zeros((self.sizes.size,) * 2)
        begin = 0
        for rows, known in zip(train.rows, self.background.train.known, strict=True):
            windows, each = known.shape[0], known.shape[1]
            w = np.repeat(weight[begin : begin + windows], each)[:, None]
            own = (rows - known.reshape(-1, known.shape[2]) @ self.share) * np.sqrt(w)
            total += own.T @ own
            begin += windows
        size = np.sqrt(np.maximum(np.diag(total), 1e-30))
        return np.abs(total / np.outer(size, size))


def _without(products: Products, beside: _Beside, b: Floats) -> tuple[Products, Floats]:
    """Products for what the background b leaves of the miss."""
    left = dataclasses.replace(
        products, miss=products.miss - np.einsum("wij,j->wi", products.columns, b), square=products.left(b)
    )
    return left, beside.with_miss - beside.with_known @ b


def _flipped(products: Products, with_miss: Floats, signs: Floats) -> tuple[Products, Floats]:
    return dataclasses.replace(products, miss=products.miss * signs[:, None]), with_miss * signs[:, None]


def mean_log_ratio(before: Floats, after: Floats, event: Integers, samples: Floats) -> Floats:
    """Mean over events of the mean over their windows of log(before (w,) / after (w, c)), (c,)."""
    return by_event(before, after, event, samples).mean(axis=0)


def by_event(before: Floats, after: Floats, event: Integers, samples: Floats) -> Floats:
    """The same for each event, (e, c)."""
    counted = (samples >= LEAST_SAMPLES) & (before > 0.0)
    ratio = np.log(before[:, None] / np.maximum(after, 1e-9 * before[:, None] + 1e-300))
    return np.array([ratio[counted & (event == e)].mean(axis=0) for e in np.unique(event[counted])])
