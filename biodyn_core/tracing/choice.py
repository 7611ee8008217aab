"""Choice: what is asked of a gain, what speaks against a rung, which rung is taken, and what explains as much."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.wording import counted
from biodyn_core.identification.fit import at_bound
from biodyn_core.tracing.findings import Candidate
from biodyn_core.tracing.fitted_candidates import LIFT_OFF, FittedCandidate, WithoutEffect, residual_ratio
from biodyn_core.tracing.local_fit import LEVELS, LocalFit
from biodyn_core.tracing.nuisance_model import FREE, Background
from biodyn_core.tracing.screen import Screening
from biodyn_core.tracing.settings import TraceSettings

TELLING: Final = 0.9
"""With less left than so many times what a good model misses, it is told how far a body departs."""

NEXT_TO: Final = 0.1
"""A parameter of theta so near its bound without an effect, in shares of its range, is not moved there by it."""


def asked(without_effect: WithoutEffect, settings: TraceSettings) -> float:
    """What a gain must exceed: more of a body that departs as far as usual than of one that is as the model has it.

    Where more is left than of a good model, something is missing, and the least will do. A body that is as the model
    has it gains next to nothing by any law, unless one was added: then the gap between that law and its own is left.
    """
    background = without_effect.background
    if residual_ratio(background, without_effect.at(LEVELS[0])) >= TELLING:
        return settings.least_gain
    if background.level == LEVELS[-1] and not background.subject.effects:
        return settings.plain_gain
    decades = 1.0 + float(np.log10(background.level))
    return settings.least_gain * (1.0 + settings.departing * decades)


def candidate(
    rung: FittedCandidate, background: Background, without: LocalFit, screening: Screening, settings: TraceSettings
) -> Candidate:
    """A rung as it is told, with all that speaks against it."""
    against = [f"{name} ends on a bound" for name in rung.settled.at_bound]
    if not rung.helps:
        against.append(f"helps in {np.count_nonzero(rung.gains > 0.0)} of {counted(rung.gains.size, 'event')}")
    usual = rung.usual(settings)
    against += [why for why in (rung.against, usual) if why]
    before = {
        name
        for subject in (background.subject, without.subject)
        for name in at_bound(subject.parameters.vector(), FREE, NEXT_TO)
    }
    after = at_bound(rung.settled.subject.parameters.vector(), FREE)
    against += [f"{name} moves onto its bound" for name in after if name not in before]
    return Candidate(
        rung.applied, rung.gain, True, screening.p_value(rung.gain), rung.screened.absorbed,
        int(np.count_nonzero(rung.gains > 0.0)), tuple(against), rung.steady, bool(usual),
    )  # fmt: skip


def taken(
    told: Sequence[Candidate], rungs: Sequence[FittedCandidate], threshold: float, settings: TraceSettings
) -> int | None:
    """Which rung is taken: the best with nothing against it, but a sensor's fault before a tissue's law as good.

    One that ends on a bound is taken only where it gains overwhelmingly and nothing that does not comes near: the form
    of its law is then not quite the body's.
    """
    for i, one in enumerate(told):  # a seat that holds nobody down is a known omission, before any law of a joint
        if one.applied.effect.name == LIFT_OFF and one.gain > settings.least_lift_off and rungs[i].helps:
            return i
    good = [i for i, one in enumerate(told) if one.gain > threshold and not one.against]
    rough = [
        i
        for i, one in enumerate(told)
        if one.gain > settings.overwhelming * threshold
        and rungs[i].helps
        and not (rungs[i].against or rungs[i].usual(settings))
    ]
    if rough and (not good or told[good[0]].gain < settings.near_alike * told[rough[0]].gain):
        return rough[0]
    if not good:
        return None
    best = good[0]
    close = [i for i in good if told[i].gain >= settings.near * told[best].gain and not _worse(rungs[i], rungs[best])]
    on_sensors = [i for i in close if told[i].applied.effect.place == "sensor"]
    return on_sensors[0] if on_sensors else best


def _worse(one: FittedCandidate, than: FittedCandidate) -> bool:
    """Whether it predicts the events worse by more than their scatter."""
    apart = than.gains - one.gains
    error = apart.std(ddof=1) / np.sqrt(apart.size) if apart.size > 1 else 0.0
    return bool(apart.mean() > 2.0 * error)


def rivals(
    index: int,
    told: Sequence[Candidate],
    rungs: Sequence[FittedCandidate],
    screening: Screening,
    settings: TraceSettings,
) -> tuple[Candidate, ...]:
    """Others that explain about as much as what was taken, the best of each name and site; none beside lift-off.

    That is a known omission: what explains more, or as much, is for the next round.
    """
    taken, found = told[index], []
    if taken.applied.effect.name == LIFT_OFF:
        return ()
    seen = {(taken.applied.effect.name, taken.applied.site)}
    for i, one in enumerate(told):
        key = (one.applied.effect.name, one.applied.site)
        if key in seen or one.gain <= 0.0:
            continue
        close = one.gain >= settings.near * taken.gain and not _worse(rungs[i], rungs[index])
        alike = screening.cosine(rungs[i].screened.tried, rungs[index].screened.tried) > settings.alike
        if close or (alike and one.gain >= settings.near_alike * taken.gain):
            seen.add(key)
            found.append(one)
    return tuple(found)
