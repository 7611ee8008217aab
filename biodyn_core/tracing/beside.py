"""Beside: the first-order gain of each fitted candidate beside the others.

A candidate that is the cause leaves little for the others, and still gains beside each of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.subject import Subject
from biodyn_core.tracing.answers import answers
from biodyn_core.tracing.nuisance_model import EventSet, NuisanceModel
from biodyn_core.tracing.rows import Products
from biodyn_core.tracing.screen import Changes, LinearStep

Beside = Mapping[tuple[str, str], tuple[tuple[str, str, float], ...]]
"""By effect and site of a candidate: effect, site and gain of each other one beside it."""

Answers = tuple[list[Floats], list[Floats]]
"""The answers (n, 5) of a fit in each event for fitting, and in each for choosing."""


def answered(nuisance: NuisanceModel, subject: Subject) -> Answers:
    """The answers of a subject in all events."""
    return answers(subject, nuisance.train.cases), answers(subject, nuisance.choose.cases)


def beside(nuisance: NuisanceModel, fits: Mapping[tuple[str, str], Answers]) -> Beside:
    """The gains of fits beside each other; a fit is given by its effect and site."""
    gains = gains_beside(nuisance, list(fits.values())).tolist()
    return {
        a: tuple((*b, gain) for b, gain in zip(fits, row, strict=True) if b != a)
        for a, row in zip(fits, gains, strict=True)
    }


def gains_beside(nuisance: NuisanceModel, fits: Sequence[Answers]) -> Floats:
    """Gains (a, b) in the events for choosing: of fit b beside fit a; 0 for a fit beside itself.

    A fit stands for the change of the answer by it. Beside another one its size is fitted again, with theta and the
    nuisance parameters.
    """
    if not fits:
        return np.zeros((0, 0))
    plain, events = answered(nuisance, nuisance.subject), (nuisance.train, nuisance.choose)
    sets = [_changes(each, plain[i], [one[i] for one in fits]) for i, each in enumerate(events)]
    linear = LinearStep.of(nuisance, *(changes for changes, _ in sets))
    found = np.zeros((len(fits), len(fits)))
    for a in range(len(fits)):
        (train, own), (choose, own_choose) = (
            _beside(each.products, changes, gram, a) for each, (changes, gram) in zip(events, sets, strict=True)
        )
        found[a] = linear.gains(train, choose, [own, own_choose])
    np.fill_diagonal(found, 0.0)
    return found


def _changes(events: EventSet, plain: Sequence[Floats], fits: Sequence[Sequence[Floats]]) -> tuple[Changes, Floats]:
    """The changes of the answers by the fits, and their products with each other (w, c, c)."""
    found, gram = [], []
    for rows, known, before, *after in zip(events.rows, events.known, plain, *fits, strict=True):
        change = np.stack([rows.decimated(one) - rows.decimated(before) for one in after], axis=2)
        own = rows.of_decimated(change)
        found.append(Changes.by_window(own, known, rows.residual(before)))
        gram.append(np.matmul(own.transpose(0, 2, 1), own))
    return Changes.of(found), np.concatenate(gram)


def _beside(products: Products, changes: Changes, gram: Floats, a: int) -> tuple[Products, Floats]:
    """Products of the residual beside fit a, and those of the changes with it (w, c)."""
    square = products.square - 2.0 * changes.with_residual[:, a] + gram[:, a, a]
    left = dataclasses.replace(products, cross=products.cross - changes.with_known[:, a], square=square)
    return left, changes.with_residual - gram[:, a]
