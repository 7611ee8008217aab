"""Preliminary fits: every effect at every site, screened and fitted on the first event of each loading condition.

It is the long part of a trace and says only who is in the running, so it is what can be kept and taken up again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.local_fit import relief, settle
from biodyn_core.tracing.nuisance_model import Background
from biodyn_core.tracing.screen import Screened, Screening, Tried, mean_log_ratio, screen

Tell = Callable[[str, float], None]
"""Told of the stage that a trace is in and the share of it that is done."""

STEPS: Final = 5
"""Steps of settling on few events: enough to tell who is in the running."""

ROUGHLY: Final = 0.01
"""... each worth more than this share."""

LEAST_FIT: Final = 0.01
"""What takes off less than this share of what the best takes off to first order is not tried further."""

LEAST_FIT_OF_ALL: Final = 0.05
"""... nor what takes off less than this of the objective: of what was hidden in 13 bodies the least took off 0.1."""

ALWAYS: Final = ("lift_off",)
"""... but for what acts only where it has not been looked."""

SIZES: Final = (1.0, 3.0)
"""Screening's linear step may start a strength so far from its own; from nothing a descent finds no way."""


@dataclass(frozen=True)
class PreliminaryFit:
    """One effect at one site: what it gains in the few events that choose, and takes off those that are fitted."""

    gain: float
    share: float
    applied: AppliedEffect
    screened: Screened


@dataclass(frozen=True, eq=False)
class PreliminaryFits:
    """Screening, and every effect at every site settled on few events."""

    screening: Screening
    found: tuple[PreliminaryFit, ...]

    def running(self, count: int) -> list[PreliminaryFit]:
        """Those that predict best, half as many of those that fit best, and lift-off always."""
        by_gain = sorted(self.found, key=lambda one: -one.gain)[:count]
        by_fit = sorted(self.found, key=lambda one: -one.share)[: count // 2]
        always = [one for one in self.found if one.applied.effect.name in ALWAYS]
        return _distinct([*by_gain, *by_fit, *always])


def glance(few: Background, tried: Sequence[Tried], replicates: int, seed: int, tell: Tell) -> PreliminaryFits:
    """Screen all candidates on few events, and settle each effect at each site from its best shape."""
    screening = screen(few, tried, replicates, seed, lambda share: tell("screening", share))
    without, p = settle(few, None, STEPS), few.choose.products
    best: dict[tuple[str, str], Screened] = {}
    for screened in sorted(screening.ladder, key=lambda one: -one.fits):  # a stop that nothing reaches loses nothing
        best.setdefault((screened.tried.applied.effect.name, screened.tried.applied.site), screened)
    found = []
    most = max((one.fits for one in best.values()), default=0.0)
    least = max(LEAST_FIT * most, LEAST_FIT_OF_ALL)
    worth = [one for one in best.values() if one.fits >= least or one.tried.applied.effect.name in ALWAYS]
    for number, screened in enumerate(worth):
        settled = settle(few, _sized(screened), STEPS, enough=ROUGHLY)
        if settled.applied is not None and np.isfinite(settled.objective):
            gain = float(mean_log_ratio(without.left, settled.left[:, None], p.event, p.samples)[0])
            share = 1.0 - settled.objective / without.objective
            found.append(PreliminaryFit(gain + relief(few, without, settled), share, settled.applied, screened))
        tell("trying", (number + 1) / len(worth))
    return PreliminaryFits(screening, tuple(found))


def plain(found: PreliminaryFits) -> dict[str, Any]:
    """A glance as plain lists, candidates by their place in the order they were tried in."""
    tried = found.screening.tried
    places = {id(one): i for i, one in enumerate(tried)}

    def row(one: Screened) -> list[float]:
        return [places[id(one.tried)], one.gain, one.fits, one.size, one.absorbed, one.p_value]

    return {
        "chance": found.screening.chance.tolist(),
        "along": np.round(found.screening.along, 4).tolist(),
        "ladder": [row(one) for one in found.screening.ladder],
        "found": [[places[id(g.screened.tried)], g.gain, g.share, dict(g.applied.values)] for g in found.found],
    }


def taken_up(kept: Mapping[str, Any], tried: Sequence[Tried]) -> PreliminaryFits:
    """A glance from its plain lists and the candidates that it tried; raises InputError for what is none of these."""
    try:
        ladder = tuple(Screened(tried[int(row[0])], *(float(x) for x in row[1:])) for row in kept["ladder"])
        chance, along = (np.array(kept[name], dtype=np.float64) for name in ("chance", "along"))
        screening = Screening(ladder, chance, tuple(tried), along)
        by_tried = {id(one.tried): one for one in ladder}
        found = tuple(
            PreliminaryFit(
                float(gain), float(share),
                dataclasses.replace(tried[int(place)].applied, values={k: float(v) for k, v in values.items()}),
                by_tried[id(tried[int(place)])],
            )
            for place, gain, share, values in kept["found"]
        )  # fmt: skip
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"what was kept of a trace is damaged ({error}); remove it to start anew") from None
    if along.shape != (len(tried),) * 2 or chance.ndim != 1 or not chance.size or not np.isfinite(chance).all():
        raise InputError("what was kept of a trace is damaged; remove it to start anew")
    return PreliminaryFits(screening, found)


def _distinct(given: Sequence[PreliminaryFit]) -> list[PreliminaryFit]:
    """Each once, in the order given."""
    return list({id(one): one for one in given}.values())


def _sized(screened: Screened) -> AppliedEffect:
    """The candidate with its strength as large as screening has it, within reason and within its range."""
    applied, strength = screened.tried.applied, screened.tried.strength
    turned = any(p.name == strength and p.lower < 0.0 for p in applied.effect.parameters) and screened.size < 0.0
    size = min(max(-screened.size if turned else screened.size, SIZES[0]), SIZES[1])
    return larger(applied, strength, -size if turned else size)


def larger(applied: AppliedEffect, strength: str, size: float) -> AppliedEffect:
    """The effect with a strength so many times as large, within its range."""
    values = dict(applied.values)
    for parameter in applied.effect.parameters:
        if parameter.name == strength:
            values[strength] = min(max(values[strength] * size, parameter.lower), parameter.upper)
    return dataclasses.replace(applied, values=values)
