"""General fits: the best candidates fitted to all events again, with the general forms of their laws.

A textbook law at the true site leaves a part of the residual, because the real law bends in another way. What a
candidate gains by its general form tells a cause from an effect that only resembles it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from biodyn_core.base.parallel import ParallelMap
from biodyn_core.tracing.candidate import Candidate
from biodyn_core.tracing.fitted_candidates import WithoutEffect, candidate_fit
from biodyn_core.tracing.joint_refit import general_starts
from biodyn_core.tracing.local_fit import LocalFit, fit_locally
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.settings import TraceSettings


def with_general_fits(
    few: NuisanceModel, without_effect: WithoutEffect, fitted: Sequence[Candidate], settings: TraceSettings,
    parallel: ParallelMap,
) -> list[Candidate]:  # fmt: skip
    """The candidates; those of `selected` that have a general form have its fit, unless it is unstable."""
    able = [i for i in selected(fitted, settings.generalised) if fitted[i].start.effect.general_form]
    items = [(fitted[i], settings) for i in able]
    found = list(fitted)
    fits = parallel("fitting candidates", general_fit, (few, without_effect.nuisance), items)
    for i, local in zip(able, fits, strict=True):
        if np.isfinite(local.objective):
            general = candidate_fit(without_effect, [(fitted[i].fitted.fitted_at, local)])
            found[i] = dataclasses.replace(fitted[i], general=general)
    return found


def selected(fitted: Sequence[Candidate], count: int) -> list[int]:
    """The places of so many candidates with the largest gains, and of the best one of so many mechanisms.

    The gain of the general form in the events of the preliminary fits counts as well.
    """
    gains = [max(one.fitted.gain, one.preliminary_general.gain if one.preliminary_general else 0.0) for one in fitted]
    by_gain = sorted(range(len(fitted)), key=lambda i: -gains[i])
    first: dict[str, int] = {}
    for i in by_gain:
        first.setdefault(fitted[i].start.effect.mechanism, i)
    return sorted({*by_gain[:count], *list(first.values())[:count]})


def general_fit(models: tuple[NuisanceModel, NuisanceModel], item: tuple[Candidate, TraceSettings]) -> LocalFit:
    """The general form of a fitted effect, from its best start by few events, the preliminary fit among them.

    models: of few events and of all; item: the candidate, and the settings. The prior scale is that of its fit.
    """
    one, s = item
    few, nuisance = (model.at_scale(one.fitted.fitted_at) for model in models)
    textbook = one.fitted.local
    theta = textbook.subject.parameters
    starts = [(each.effects[-1], theta) for each in general_starts(textbook.subject, few.train.cases, s.joint_refit)]
    if one.preliminary_general is not None:
        starts.append((one.preliminary_general.applied, one.preliminary_general.theta))
    ends = [fit_locally(few, start, s.few_steps, textbook=False, theta=theta) for start, theta in starts]
    best = min(ends, key=lambda end: end.objective)
    if not np.isfinite(best.objective):
        best = textbook
    return fit_locally(nuisance, best.applied, s.local_fit, textbook=False, theta=best.subject.parameters)
