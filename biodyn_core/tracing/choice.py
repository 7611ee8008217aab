"""Choice: the required gain, the objections to a candidate, the chosen candidate, and its rivals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biodyn_core.base.wording import counted
from biodyn_core.tracing.candidate import Candidate, CandidateFit
from biodyn_core.tracing.evidence import theta_moved_to_bound
from biodyn_core.tracing.findings import RankedCandidate
from biodyn_core.tracing.fitted_candidates import WithoutEffect, residual_ratio
from biodyn_core.tracing.local_fit import PRIOR_SCALES, LocalFit
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.screen import Screening
from biodyn_core.tracing.settings import TraceSettings


def required_gain(without_effect: WithoutEffect, settings: TraceSettings) -> float:
    """The gain that a candidate has to exceed; it grows with the typical deviations of the body.

    A residual above a good model's shows that something is missing, so the least gain suffices. A body without
    deviations gains next to nothing by any law, unless an effect was added whose form differs from the body's.
    """
    nuisance = without_effect.nuisance
    if residual_ratio(nuisance, without_effect.at(PRIOR_SCALES[0])) >= settings.evidence.good_fit:
        return settings.least_gain
    if nuisance.prior_scale == PRIOR_SCALES[-1] and not nuisance.subject.effects:
        return settings.plain_gain
    decades = 1.0 + float(np.log10(nuisance.prior_scale))
    return settings.least_gain * (1.0 + settings.departing * decades)


def ranked(
    one: Candidate, nuisance: NuisanceModel, without: LocalFit, screening: Screening, settings: TraceSettings
) -> RankedCandidate:
    """A candidate as it is published: with its objections if it is fitted to all events, else as it is screened."""
    of = one.screened
    if one.fit is None:
        return RankedCandidate(one.start, of.gain, False, of.p_value, of.absorbed, 0)
    return RankedCandidate(
        one.fit.applied, one.fit.gain, True, screening.p_value(one.fit.gain), of.absorbed, one.fit.improved_events,
        tuple(_objections(one.fit, nuisance, without, settings)), one.fit.steady, bool(one.fit.why_typical(settings)),
    )  # fmt: skip


def _objections(fit: CandidateFit, nuisance: NuisanceModel, without: LocalFit, settings: TraceSettings) -> list[str]:
    """The reasons against a candidate, a line each."""
    found = [f"{name} ends on a bound" for name in fit.local.at_bound]
    if not fit.improves_enough(settings.evidence):
        found.append(f"improves only {fit.improved_events} of {counted(fit.gains.size, 'event')}")
    found += [why for why in (fit.objection, fit.why_typical(settings)) if why]
    moved = theta_moved_to_bound(nuisance, without, fit.local, settings.evidence.near_bound)
    return [*found, *(f"{name} moves to its bound" for name in moved)]


def chosen(
    ranking: Sequence[RankedCandidate], candidates: Sequence[Candidate], threshold: float, settings: TraceSettings
) -> int | None:
    """The index of the chosen candidate: the best without objections, but a sensor's fault before an equal tissue law.

    A known omission comes before any law. A candidate with a parameter on its bound is chosen only if its gain is
    overwhelming and no other one comes near: the form of its law then differs from the body's.
    """
    fits = [one.fitted for one in candidates]
    enough = [fit.improves_enough(settings.evidence) for fit in fits]
    for i, one in enumerate(ranking):
        if one.applied.effect.known_omission and one.gain > settings.least_lift_off and enough[i]:
            return i
    good = [i for i, one in enumerate(ranking) if one.gain > threshold and not one.objections]
    rough = [
        i
        for i, one in enumerate(ranking)
        if one.gain > settings.overwhelming * threshold and enough[i] and not (fits[i].objection or one.typical)
    ]
    if rough and (not good or ranking[good[0]].gain < settings.near_alike * ranking[rough[0]].gain):
        return rough[0]
    if not good:
        return None
    best = good[0]
    least = settings.near * ranking[best].gain
    close = [i for i in good if ranking[i].gain >= least and not _worse(fits[i], fits[best])]
    on_sensors = [i for i in close if ranking[i].applied.effect.place == "sensor"]
    return on_sensors[0] if on_sensors else best


def _worse(one: CandidateFit, than: CandidateFit) -> bool:
    """Whether its gain is smaller by more than twice the standard error over the events."""
    difference = than.gains - one.gains
    error = difference.std(ddof=1) / np.sqrt(difference.size) if difference.size > 1 else 0.0
    return bool(difference.mean() > 2.0 * error)


def rivals(
    index: int,
    ranking: Sequence[RankedCandidate],
    candidates: Sequence[Candidate],
    screening: Screening,
    settings: TraceSettings,
) -> tuple[RankedCandidate, ...]:
    """Other candidates that explain about as much as the chosen one, one for each name and site.

    A known omission has none: the next round tests all other candidates beside it.
    """
    best, found = ranking[index], []
    if best.applied.effect.known_omission:
        return ()
    seen = {candidates[index].key}
    for i, one in enumerate(ranking):
        if candidates[i].key in seen or one.gain <= 0.0:
            continue
        near = one.gain >= settings.near * best.gain and not _worse(candidates[i].fitted, candidates[index].fitted)
        alike = screening.cosine(candidates[i], candidates[index]) > settings.alike
        if near or (alike and one.gain >= settings.near_alike * best.gain):
            seen.add(candidates[i].key)
            found.append(one)
    return tuple(found)
