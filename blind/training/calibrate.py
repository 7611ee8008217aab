"""Calibrate a learned model on examples that it was not learned from: temperature, 90 % sets and reliability."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.probability import NONE, OUTSIDE, LearnedModel, Probabilities, Weights
from blind.training.learn import Design, Labelled, chances, learned_weights

Floats = NDArray[np.float64]

FOLDS: Final = 6
COVERAGE: Final = 0.9
BINS: Final = 10


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

    @property
    def p_right(self) -> float:
        """The largest probability of a right answer."""
        return max((self.answers.get(name, 0.0) for name in self.right), default=0.0)


def fold_of(one: Labelled) -> int:
    """The fold of an example: that of its first form, else by its number."""
    return _fold(one.forms[0]) if one.forms else one.number % FOLDS


def _fold(form: str) -> int:
    return zlib.crc32(form.encode()) % FOLDS


def cross_weights(examples: Sequence[Labelled], ridge: float) -> list[Weights]:
    """The weights of each fold: learned from the other bodies, without any form of the fold."""
    found = []
    for fold in range(FOLDS):
        others = [one for one in examples if fold_of(one) != fold and fold not in map(_fold, one.forms)]
        found.append(learned_weights(Design.of(others), ridge))
    return found


def cross_chances(examples: Sequence[Labelled], weights: Sequence[Weights], temperature: float) -> list[Floats]:
    """Probabilities (c + 2,) of each example by the weights of its fold."""
    found: list[Floats] = [np.empty(0)] * len(examples)
    for fold in range(FOLDS):
        at = [i for i, one in enumerate(examples) if fold_of(one) == fold]
        if at:
            design = Design.of([examples[i] for i in at])
            for i, p, there in zip(at, chances(design, weights[fold], temperature), design.present, strict=True):
                found[i] = p[there]
    return found


def temperature_of(examples: Sequence[Labelled], weights: Sequence[Weights]) -> float:
    """The temperature with the least loss of examples that the weights were not learned from."""

    def loss(log_t: float) -> float:
        every = cross_chances(examples, weights, float(np.exp(log_t)))
        return -sum(
            one.weight * float(np.log(max(p[one.by_mechanism].sum(), 1e-300)))
            for one, p in zip(examples, every, strict=True)
        )

    return float(np.exp(optimize.minimize_scalar(loss, bounds=(-1.0, 1.5), method="bounded").x))


def predictions(examples: Sequence[Labelled], weights: Sequence[Weights], temperature: float) -> list[Prediction]:
    """The answers of each example by the weights of its fold."""
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


def expected_calibration_error(found: Sequence[Prediction]) -> float:
    """Mean distance of confidence and share of right answers over bins of confidence, weighted by their counts."""
    p = np.array([one.p for one in found])
    right = np.array([one.best in one.right for one in found], dtype=np.float64)
    bins = np.minimum((p * BINS).astype(int), BINS - 1)
    return float(sum(abs(right[bins == b].mean() - p[bins == b].mean()) * np.mean(bins == b) for b in np.unique(bins)))


def learned(examples: Sequence[Labelled], ridge: float, provenance: Mapping[str, object]) -> LearnedModel:
    """The model of all examples, calibrated on predictions by cross-validation."""
    weights = cross_weights(examples, ridge)
    temperature = temperature_of(examples, weights)
    found = [one for one in predictions(examples, weights, temperature) if one.labelled.weight == 1.0]
    return LearnedModel(
        learned_weights(Design.of(examples), ridge), temperature, set_threshold(found), dict(provenance)
    )
