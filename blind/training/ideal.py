"""The decision that the bodies allow: learned and asked as if the catalogue had the true law of each body."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from biodyn_core.tracing.features import CANDIDATE_NAMES
from biodyn_core.tracing.probability import LearnedModel, Weights
from blind.training.calibrate import (
    Folds,
    Prediction,
    answers,
    chosen_ridge,
    cross_weights,
    every_fold,
    named_bodies,
    predictions,
    set_threshold,
    temperature_of,
)
from blind.training.learn import Design, Labelled, learned_weights

UNLIKE: Final = (
    "generalised", "general over textbook", "evidence gain", "nuisance over before", "prior scale",
    "prior scale over before", "nothing typical", "typical multiple", "typical multiple at scale", "on bound",
    "theta on bound", "theta shift",
)  # fmt: skip
"""Features in which a true law is unlike a fit, because it has no parameters: they would give it away."""

_HIDDEN: Final = [CANDIDATE_NAMES.index(name) for name in UNLIKE]


@dataclass(frozen=True, eq=False)
class IdealDecision:
    """A decision that is learned with true laws: from bodies as if the catalogue had the true law of each.

    Bodies without such evidence, and the examples without their mechanism, have their own. No features of `UNLIKE` take
    part. numbers: the bodies with their true law.
    """

    examples: Sequence[Labelled]
    numbers: frozenset[int]
    ridge: float
    folds: Mapping[Folds, Weights]
    temperature: float

    @classmethod
    def of(cls, examples: Sequence[Labelled], with_true_law: Sequence[Labelled]) -> IdealDecision:
        """Learned from the examples, of which those with a true law are replaced."""
        ideal = {one.number: one for one in with_true_law}
        every = [_without_unlike(ideal.get(one.number, one) if one.weight == 1.0 else one) for one in examples]
        ridge = chosen_ridge(every)
        folds = cross_weights(every, ridge, every_fold(every))
        return cls(every, frozenset(ideal), ridge, folds, temperature_of(every, folds))

    def cross_validated(self) -> list[Prediction]:
        """The answers to the bodies with their true law, each by weights that saw none of its forms."""
        return [one for one in self._predictions() if one.labelled.number in self.numbers]

    def model(self, provenance: Mapping[str, Any], named_from: float) -> LearnedModel:
        """The decision with its calibration on all bodies in cross-validation.

        The weights of `UNLIKE` are zero, so it can be asked with all features.
        """
        found = self._predictions()
        named = named_bodies(found, named_from)
        return LearnedModel(
            self._weights, self.temperature, set_threshold(found), named_from, named, self.ridge, dict(provenance)
        )

    def _predictions(self) -> list[Prediction]:
        every = predictions(self.examples, self.folds, self.temperature)
        return [one for one in every if one.labelled.weight == 1.0]

    def answers(self, others: Sequence[Labelled]) -> list[Prediction]:
        """The answers to bodies that it was not learned from."""
        return answers([_without_unlike(one) for one in others], self._weights, self.temperature)

    @cached_property
    def _weights(self) -> Weights:
        """The weights from all examples."""
        return learned_weights(Design.of(self.examples), self.ridge)


def _without_unlike(one: Labelled) -> Labelled:
    of_candidates = one.features.of_candidates.copy()
    of_candidates[:, _HIDDEN] = 0.0
    return dataclasses.replace(one, features=dataclasses.replace(one.features, of_candidates=of_candidates))
