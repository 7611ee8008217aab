"""The decision that the bodies allow: learned and asked as if the catalogue had the true law of each body."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

from biodyn_core.tracing.features import CANDIDATE_NAMES
from blind.training.calibrate import Prediction, chosen_ridge, cross_weights, predictions, temperature_of
from blind.training.learn import Labelled

UNLIKE: Final = (
    "generalised", "general over textbook", "evidence gain", "nuisance over before", "prior scale",
    "prior scale over before", "nothing typical", "typical multiple", "typical multiple at scale", "on bound",
    "theta on bound", "theta shift",
)  # fmt: skip
"""Features in which a true law is unlike a fit, because it has no parameters: they would give it away."""

_HIDDEN: Final = [CANDIDATE_NAMES.index(name) for name in UNLIKE]


def answers_with_true_laws(examples: Sequence[Labelled], with_true_law: Sequence[Labelled]) -> list[Prediction]:
    """The answers to the bodies that have evidence with their true law, by cross-validation.

    All others, and the examples without their mechanism, have their own evidence. No features of `UNLIKE` take part.
    """
    ideal = {one.number: one for one in with_true_law}
    if not ideal:
        return []
    every = [_without_unlike(ideal.get(one.number, one) if one.weight == 1.0 else one) for one in examples]
    weights = cross_weights(every, chosen_ridge(every))
    found = predictions(every, weights, temperature_of(every, weights))
    return [one for one in found if one.labelled.weight == 1.0 and one.labelled.number in ideal]


def _without_unlike(one: Labelled) -> Labelled:
    of_candidates = one.features.of_candidates.copy()
    of_candidates[:, _HIDDEN] = 0.0
    return dataclasses.replace(one, features=dataclasses.replace(one.features, of_candidates=of_candidates))
