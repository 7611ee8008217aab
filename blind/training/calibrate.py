"""Calibrate a learned model on examples that it was not learned from: temperature, 90 % sets and reliability."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.findings import NamedBodies
from biodyn_core.tracing.probability import NONE, OUTSIDE, LearnedModel, Probabilities, Weights, likely
from blind.training.learn import Design, Labelled, chances, learned_weights

Floats = NDArray[np.float64]

FOLDS: Final = 6
COVERAGE: Final = 0.9
RIDGES: Final = (10.0, 30.0, 100.0, 300.0, 1000.0)
RATIOS: Final = (0.5, 1.0, 2.0, 4.0)
"""Ratios of effects at which named bodies are counted."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """The answers of an example by a model that saw no body with one of its forms; right: those that are."""

    labelled: Labelled
    answers: Mapping[str, float]
    right: tuple[str, ...]

    @property
    def best(self) -> str:
        """The most probable answer."""
        return next(iter(self.answers))

    @property
    def p(self) -> float:
        """Its probability."""
        return self.answers[self.best]

    def names(self, named_from: float) -> bool:
        """Whether a cause is named."""
        return self.best not in (NONE, OUTSIDE) and self.p >= named_from

    def names_right(self, named_from: float) -> bool:
        """Whether a right cause is named."""
        return self.names(named_from) and self.best in self.right

    def likely(self, threshold: float) -> tuple[str, ...]:
        """The 90 % set."""
        return likely(self.answers, threshold)

    @property
    def p_of_right(self) -> float:
        """The probability of all right answers."""
        return sum(self.answers.get(name, 0.0) for name in self.right)

    @property
    def p_right(self) -> float:
        """The largest probability of a right answer."""
        return max((self.answers.get(name, 0.0) for name in self.right), default=0.0)


Folds = frozenset[int]

SINGLE: Final = tuple(frozenset([fold]) for fold in range(FOLDS))


def folds_of(one: Labelled) -> Folds:
    """The folds of an example: those of its forms, else one by its number."""
    return frozenset(map(_fold, one.forms)) or frozenset([one.number % FOLDS])


def _fold(form: str) -> int:
    return zlib.crc32(form.encode()) % FOLDS


def cross_weights(examples: Sequence[Labelled], ridge: float, left_out: Iterable[Folds]) -> dict[Folds, Weights]:
    """For each set of folds the weights that are learned from the bodies without any of them."""
    return {
        folds: learned_weights(Design.of([one for one in examples if not folds & folds_of(one)]), ridge)
        for folds in left_out
    }


def every_fold(examples: Sequence[Labelled]) -> list[Folds]:
    """The sets of folds of these examples: two forms may lie in two folds."""
    return sorted({folds_of(one) for one in examples}, key=sorted)


def cross_chances(
    examples: Sequence[Labelled], weights: Mapping[Folds, Weights], temperature: float
) -> list[Floats]:  # fmt: skip
    """Probabilities (c + 2,) of each example by weights that were learned without any of its folds."""
    found: list[Floats] = [np.empty(0)] * len(examples)
    for folds in every_fold(examples):
        at = [i for i, one in enumerate(examples) if folds_of(one) == folds]
        design = Design.of([examples[i] for i in at])
        for i, p, there in zip(at, chances(design, weights[folds], temperature), design.present, strict=True):
            found[i] = p[there]
    return found


def temperature_of(examples: Sequence[Labelled], weights: Mapping[Folds, Weights]) -> float:
    """The temperature with the least loss of examples that the weights were not learned from."""
    found = optimize.minimize_scalar(
        lambda log_t: _loss(examples, weights, log_t), bounds=(-1.0, 1.5), method="bounded"
    )
    return float(np.exp(found.x))


def _loss(examples: Sequence[Labelled], weights: Mapping[Folds, Weights], log_t: float) -> float:
    """The negative log probability of the right mechanisms by `cross_chances`, at the logarithm of T."""
    every = cross_chances(examples, weights, float(np.exp(log_t)))
    return -sum(
        one.weight * float(np.log(max(p[one.by_mechanism].sum(), 1e-300)))
        for one, p in zip(examples, every, strict=True)
    )


def beyond(examples: Sequence[Labelled], kind: str, model: LearnedModel) -> list[Prediction]:
    """The answers to bodies with a kind of background and nothing hidden, by weights from bodies without that kind.

    With an effect the weights would have to lack its form too, in each combination of kind and fold.
    """
    weights = learned_weights(Design.of([one for one in examples if kind not in one.background]), model.ridge)
    return answers([one for one in examples if kind in one.background and not one.forms], weights, model.temperature)


def answers(examples: Sequence[Labelled], weights: Weights, temperature: float) -> list[Prediction]:
    """The answers of examples by one set of weights."""
    if not examples:
        return []
    design = Design.of(examples)
    every = zip(examples, chances(design, weights, temperature), design.present, strict=True)
    return [_prediction(one, p[there]) for one, p, there in every]


def predictions(
    examples: Sequence[Labelled], weights: Mapping[Folds, Weights], temperature: float
) -> list[Prediction]:  # fmt: skip
    """The answers of each example by weights that were learned without any of its folds."""
    every = cross_chances(examples, weights, temperature)
    return [_prediction(one, p) for one, p in zip(examples, every, strict=True)]


def _prediction(one: Labelled, p: Floats) -> Prediction:
    keys = one.features.keys
    answers = Probabilities(keys, p[:-2], float(p[-2]), float(p[-1])).of_answers
    names = [*(CATALOGUE[effect].mechanism for effect, _ in keys), NONE, OUTSIDE]
    right = dict.fromkeys(name for name, good in zip(names, one.by_mechanism, strict=True) if good)
    return Prediction(one, answers, tuple(right))


def set_threshold(found: Sequence[Prediction]) -> float:
    """The probability that the right answer reaches in 90 % of the examples (split conformal prediction)."""
    p = np.sort([one.p_right for one in found])
    rank = int(np.floor((1.0 - COVERAGE) * (p.size + 1)))
    return float(p[max(rank - 1, 0)]) if rank else 0.0


def named_bodies(found: Sequence[Prediction], named_from: float) -> tuple[NamedBodies, ...]:
    """How many bodies have their effect named, within half an octave of each ratio of `RATIOS`.

    Counted are bodies with one effect of the catalogue and a background, because no person is without one.
    """
    mine = [one for one in found if is_single(one.labelled) and one.labelled.background]
    near = {ratio: [one for one in mine if abs(np.log2(one.labelled.ratio / ratio)) <= 0.5] for ratio in RATIOS}
    return tuple(
        NamedBodies(ratio, len(each), sum(one.names_right(named_from) for one in each)) for ratio, each in near.items()
    )


def is_single(one: Labelled) -> bool:
    """Whether a body has one effect of the catalogue, with a known ratio above 0."""
    return len(one.forms) == 1 and bool(one.mechanism) and one.ratio > 0.0


def chosen_ridge(examples: Sequence[Labelled]) -> float:
    """The ridge of `RIDGES` with the least loss of bodies that the weights were not learned from.

    Bodies with forms of two folds do not take part: each ridge would need the weights of every pair of folds.
    """
    mine = [one for one in examples if len(folds_of(one)) == 1]
    return min(RIDGES, key=lambda ridge: _loss(mine, cross_weights(examples, ridge, SINGLE), 0.0))


@dataclass(frozen=True, eq=False)
class Learned:
    """A calibrated model, and the predictions by cross-validation that it was calibrated on.

    ceiling: those for bodies with one effect of the catalogue, as if the catalogue had its true law.
    """

    model: LearnedModel
    found: Sequence[Prediction]
    ceiling: Sequence[Prediction]


def learned(
    examples: Sequence[Labelled], with_true_law: Sequence[Labelled], provenance: Mapping[str, Any], named_from: float
) -> Learned:
    """The model of all examples, calibrated on predictions by cross-validation."""
    ridge = chosen_ridge(examples)
    weights = cross_weights(examples, ridge, every_fold(examples))
    temperature = temperature_of(examples, weights)
    found = [one for one in predictions(examples, weights, temperature) if one.labelled.weight == 1.0]
    own = learned_weights(Design.of(examples), ridge)
    named = named_bodies(found, named_from)
    model = LearnedModel(own, temperature, set_threshold(found), named_from, named, ridge, dict(provenance))
    return Learned(model, found, predictions(with_true_law, weights, temperature))
