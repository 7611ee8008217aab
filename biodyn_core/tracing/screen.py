"""Screening: the first-order gain of each candidate beside theta and the nuisance parameters.

One simulation for each candidate and event, at a strength at which the effect acts, because the derivative at zero is
zero for a stop or for lift-off. Sizes come from the events for fitting, gains from the events for choosing.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect, Effect, EffectParameter
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.candidate import Candidate, ScreeningResult
from biodyn_core.tracing.nuisance_model import N_THETA, NuisanceModel
from biodyn_core.tracing.reach import Reach
from biodyn_core.tracing.rows import Products

UNSEEN: Final = 1e-9
"""A candidate is not observable if the nuisance model leaves no more than this share of its square.

Rounding errors of the difference leave as much.
"""


@dataclass(frozen=True, eq=False)
class Screening:
    """All candidates, the largest gain first, and the largest gain (r,) of each random draw, ascending."""

    ranking: tuple[Candidate, ...]
    chance: Floats

    @property
    def candidates(self) -> list[Candidate]:
        """All candidates by their index."""
        return sorted(self.ranking, key=lambda one: one.index)

    def p_value(self, gain: float) -> float:
        """How often the largest random gain is as large."""
        as_large = self.chance.size - int(np.searchsorted(self.chance, gain))
        return (1.0 + as_large) / (1.0 + self.chance.size)


def all_candidates(subject: Subject, cases: Sequence[Case]) -> list[Candidate]:
    """Every effect at every site that these cases can show, from every start of its textbook and its general form.

    An effect of the subject is no candidate: added to itself it is the same law beyond its range.
    """
    reach, known = Reach.of(subject, cases), {(one.effect.name, one.site) for one in subject.effects}
    return [
        Candidate(applied, strength)
        for effect in CATALOGUE.values()
        for site in effect.sites
        if (effect.name, site) not in known and _is_testable(effect, site, cases)
        for strength, applied in starts(effect, site, reach, textbook=False)
    ]


def starts(effect: Effect, site: str, reach: Reach, textbook: bool = True) -> list[tuple[str, AppliedEffect]]:
    """Each strength of an effect in turn at a typical value, with every combination of the starts of its shape.

    textbook: general parameters keep their neutral values.
    """
    shapes = _named(effect.textbook_parameters, [_grid(p, reach.at(effect, site)) for p in effect.textbook_parameters])
    found = [shape | bend for bend in ({}, *([] if textbook else _bends(effect))) for shape in shapes]
    return [
        (strength, AppliedEffect(effect, site, shape | _others(effect, strength)))
        for strength in effect.strengths or ("",)
        for shape in found
    ]


def untestable(cases: Sequence[Case]) -> tuple[str, ...]:
    """Every effect and site that lack a channel in these cases."""
    return tuple(
        f"{effect.name} at {site}"
        for effect in CATALOGUE.values()
        for site in effect.sites
        if not _is_testable(effect, site, cases)
    )


def _is_testable(effect: Effect, site: str, cases: Sequence[Case]) -> bool:
    return all(name in case.channels for case in cases for name in effect.required_channels(site))


def _bends(effect: Effect) -> list[dict[str, float]]:
    """Every combination of the starts of the general parameters, without the textbook form."""
    general = [p for p in effect.parameters if p.neutral is not None]
    every = _named(general, [p.grid or (p.size,) for p in general])
    return [one for one in every if any(one[p.name] != p.neutral for p in general)]


def _named(parameters: Sequence[EffectParameter], starts: Sequence[Sequence[float]]) -> list[dict[str, float]]:
    """Every combination of the starts of parameters, by name."""
    names = [p.name for p in parameters]
    return [dict(zip(names, values, strict=True)) for values in itertools.product(*starts)]


def _others(effect: Effect, strength: str) -> dict[str, float]:
    """The other strengths of an effect, at zero."""
    return {p.name: 0.0 for p in effect.parameters if p.kind == "strength" and p.name != strength}


def _grid(parameter: EffectParameter, reach_m: float) -> tuple[float, ...]:
    """The starts of a parameter."""
    if parameter.reach_shares:
        return tuple(min(max(share * reach_m, parameter.lower), parameter.upper) for share in parameter.reach_shares)
    return parameter.grid or (parameter.size,)


def screen(
    nuisance: NuisanceModel, candidates: Sequence[Candidate], replicates: int = 400, seed: int = 0,
    on_progress: Callable[[float], None] = lambda share: None, parallel: ParallelMap = serial_map,
) -> Screening:  # fmt: skip
    """Screen candidates.

    Random draws: the signs of whole windows of the residual are drawn for both event sets, and all is refitted (wild
    bootstrap by blocks). A draw keeps the spectrum of the residual and follows the seat as the residual does.
    """
    items = [
        (is_train, number, candidates)
        for is_train, events in ((True, nuisance.train), (False, nuisance.choose))
        for number in range(len(events.cases))
    ]
    changes = []
    for one in parallel("screening", _changed, nuisance, items):
        changes.append(one)
        on_progress(len(changes) / len(items))
    trained = len(nuisance.train.cases)
    sets = [Changes.of(each) for each in (changes[:trained], changes[trained:])]
    linear = LinearStep.of(nuisance, *sets)
    gains = linear.gains(nuisance.train.products, nuisance.choose.products, [one.with_residual for one in sets])
    screening = Screening((), linear.chance(replicates, np.random.default_rng(seed)))
    found = [
        dataclasses.replace(
            one,
            index=i,
            screening=ScreeningResult(
                float(gains[i]), float(linear.decrease[i]), float(linear.sizes[i]), float(linear.absorbed[i]),
                screening.p_value(float(gains[i])),
            ),
        )
        for i, one in enumerate(candidates)
    ]  # fmt: skip
    return dataclasses.replace(screening, ranking=tuple(sorted(found, key=lambda one: -one.screened.gain)))


@dataclass(frozen=True, eq=False)
class Changes:
    """Products of the candidates' rows by window: with known columns (w, c, k), own (w, c), with residual (w, c)."""

    with_known: Floats
    own: Floats
    with_residual: Floats

    @classmethod
    def by_window(cls, own: Floats, known: Floats, residual: Floats) -> Changes:
        """Those of one event, from rows of candidates (w, r, c), of the known columns (w, r, k) and of the residual."""
        return cls(
            np.matmul(own.transpose(0, 2, 1), known),
            np.einsum("wrc,wrc->wc", own, own),
            np.einsum("wrc,wr->wc", own, residual, optimize=True),
        )

    @classmethod
    def of(cls, events: Sequence[Changes]) -> Changes:
        """Those of all events from those of each."""
        return cls(
            np.concatenate([one.with_known for one in events]),
            np.concatenate([one.own for one in events]),
            np.concatenate([one.with_residual for one in events]),
        )


def _changed(nuisance: NuisanceModel, item: tuple[bool, int, Sequence[Candidate]]) -> Changes:
    """The products of candidates in one event: for fitting or not, by its number."""
    is_train, number, candidates = item
    events = nuisance.train if is_train else nuisance.choose
    case, rows, known = events.cases[number], events.rows[number], events.known[number]
    plain = answer(nuisance.subject, case)
    residual = rows.residual(plain)
    own = np.empty((*residual.shape, len(candidates)))
    for i, one in enumerate(candidates):
        change = rows.decimated(answer(nuisance.subject, case, (one.start,), plain)) - rows.decimated(plain)
        own[:, :, i] = rows.of_decimated(change[:, :, None])[:, :, 0]
    return Changes.by_window(own, known, residual)


@dataclass(frozen=True, eq=False)
class LinearStep:
    """The linear step of each candidate alone.

    share (k, c): of the known columns in each candidate; energy (c,): of its remaining part; sizes (c,); absorbed (c,).
    """

    nuisance: NuisanceModel
    changes: tuple[Changes, Changes]
    inverse: Floats
    share: Floats
    energy: Floats
    sizes: Floats
    absorbed: Floats

    @classmethod
    def of(cls, nuisance: NuisanceModel, train: Changes, choose: Changes) -> LinearStep:
        """The steps for changes in the events for fitting and for choosing."""
        weight, products = nuisance.weight, nuisance.train.products
        inverse = np.linalg.inv(nuisance.normal())
        with_known = np.einsum("w,wck->ck", weight, train.with_known)
        share = inverse @ with_known.T
        own = weight @ train.own
        energy = own - np.einsum("ck,kc->c", with_known, share)
        seen = energy > UNSEEN * np.maximum(own, 1e-12)
        matches = weight @ train.with_residual - (weight @ products.cross) @ share
        sizes = np.where(seen, matches / np.where(seen, energy, 1.0), 0.0)
        theta = with_known[:, :N_THETA]
        inner = np.linalg.inv(nuisance.normal()[:N_THETA, :N_THETA])
        by_theta = np.einsum("ck,kl,cl->c", theta, inner, theta) / np.where(own > 0.0, own, 1.0)
        absorbed = np.where(own > 0.0, by_theta, 1.0)
        return cls(
            nuisance,
            (train, choose),
            np.asarray(inverse),
            np.asarray(share),
            np.where(seen, energy, np.inf),
            sizes,
            absorbed,
        )

    @property
    def decrease(self) -> Floats:
        """Decrease of the weighted squares in the events for fitting, (c,)."""
        return self.sizes**2 * np.where(np.isfinite(self.energy), self.energy, 0.0)

    def gains(self, train: Products, choose: Products, with_residual: Sequence[Floats]) -> Floats:
        """Mean log ratios (c,) in the events for choosing, for the residual of these products."""
        weight, changes = self.nuisance.weight, self.changes[1]
        b = self.inverse @ (weight @ train.cross)
        sizes = (weight @ with_residual[0] - (weight @ train.cross) @ self.share) / self.energy
        before = choose.residual_square(b)
        known = choose.cross - np.einsum("wij,j->wi", choose.columns, b)
        match = with_residual[1] - changes.with_known @ b - known @ self.share
        after = before[:, None] - 2.0 * sizes * match + sizes**2 * self._own_choose
        return mean_log_ratio(before, after, choose)

    @cached_property
    def _own_choose(self) -> Floats:
        """Square of the remaining part of each candidate in each window for choosing, (w, c)."""
        changes, columns = self.changes[1], self.nuisance.choose.products.columns
        inside = np.stack([np.einsum("jc,jc->c", self.share, one @ self.share) for one in columns])
        own = changes.own - 2.0 * np.einsum("wck,kc->wc", changes.with_known, self.share, optimize=True) + inside
        return np.asarray(own)

    def chance(self, replicates: int, rng: np.random.Generator) -> Floats:
        """The largest gain of all candidates in each random draw, (r,) ascending."""
        nuisance, drawn = self.nuisance, []
        b = nuisance.solution(nuisance.train.products)
        sets = zip((nuisance.train, nuisance.choose), self.changes, strict=True)
        remaining = [_remaining(events.products, changes, b) for events, changes in sets]
        for _ in range(replicates):
            signs = [rng.choice((-1.0, 1.0), size=p.square.size) for p, _ in remaining]
            flipped = [_flipped(p, m, s) for (p, m), s in zip(remaining, signs, strict=True)]
            drawn.append(self.gains(flipped[0][0], flipped[1][0], [m for _, m in flipped]).max())
        return np.sort(drawn)


def _remaining(products: Products, changes: Changes, b: Floats) -> tuple[Products, Floats]:
    """Products for the residual less the known columns times b (k,)."""
    cross = products.cross - np.einsum("wij,j->wi", products.columns, b)
    remaining = dataclasses.replace(products, cross=cross, square=products.residual_square(b))
    return remaining, changes.with_residual - changes.with_known @ b


def _flipped(products: Products, with_residual: Floats, signs: Floats) -> tuple[Products, Floats]:
    return dataclasses.replace(products, cross=products.cross * signs[:, None]), with_residual * signs[:, None]


def mean_log_ratio(before: Floats, after: Floats, windows: Products) -> Floats:
    """Mean over events of the mean over their counted windows of log(before (w,) / after (w, c)), (c,)."""
    return by_event(before, after, windows).mean(axis=0)


def by_event(before: Floats, after: Floats, windows: Products) -> Floats:
    """The mean over windows of that logarithm for each event, (e, c)."""
    counted, event = windows.counted & (before > 0.0), windows.event
    ratio = np.log(before[:, None] / np.maximum(after, 1e-9 * before[:, None] + 1e-300))
    return np.array([ratio[counted & (event == e)].mean(axis=0) for e in np.unique(event[counted])])
