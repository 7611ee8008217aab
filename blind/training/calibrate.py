"""Calibrate a learned model on examples that it was not learned from: temperature, 90 % sets and reliability."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.features import SAMPLES
from biodyn_core.tracing.probability import NONE, OUTSIDE, LearnedModel, Power, Probabilities, Weights, likely
from blind.training.learn import Design, Labelled, chances, learned_weights

Floats = NDArray[np.float64]

FOLDS: Final = 6
COVERAGE: Final = 0.9
RIDGES: Final = (10.0, 30.0, 100.0, 300.0, 1000.0)


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
    found = optimize.minimize_scalar(
        lambda log_t: _loss(examples, weights, log_t), bounds=(-1.0, 1.5), method="bounded"
    )
    return float(np.exp(found.x))


def _loss(examples: Sequence[Labelled], weights: Sequence[Weights], log_t: float) -> float:
    """The negative log probability of the right mechanisms by the weights of the folds, at the logarithm of T."""
    every = cross_chances(examples, weights, float(np.exp(log_t)))
    return -sum(
        one.weight * float(np.log(max(p[one.by_mechanism].sum(), 1e-300)))
        for one, p in zip(examples, every, strict=True)
    )


def beyond(examples: Sequence[Labelled], kind: str, model: LearnedModel) -> list[Prediction]:
    """The answers to bodies with a kind of background by weights that were learned from bodies without it."""
    weights = learned_weights(Design.of([one for one in examples if kind not in one.background]), model.ridge)
    mine = [one for one in examples if kind in one.background and one.weight == 1.0]
    return answers(mine, weights, model.temperature)


def answers(examples: Sequence[Labelled], weights: Weights, temperature: float) -> list[Prediction]:
    """The answers of examples by one set of weights."""
    if not examples:
        return []
    design = Design.of(examples)
    every = zip(examples, chances(design, weights, temperature), design.present, strict=True)
    return [_prediction(one, p[there]) for one, p, there in every]


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


def power(found: Sequence[Prediction], named_from: float) -> Power:
    """The curve of named effects by penalised maximum likelihood, from bodies with one effect of the catalogue.

    Those without a known ratio, or whose effect changes nothing, do not count.
    """
    of_catalogue = [one for one in found if len(one.labelled.forms) == 1 and one.labelled.mechanism]
    single = [one for one in of_catalogue if one.labelled.ratio > 0.0]
    samples = np.clip([one.labelled.samples for one in single], *SAMPLES)
    rows = [(1.0, np.log10(one.labelled.ratio), np.log10(count)) for one, count in zip(single, samples, strict=True)]
    x, named = np.array(rows).reshape(-1, 3), np.array([one.names_right(named_from) for one in single])
    centre = x[:, 2].mean() if single else 0.0
    x[:, 2] -= centre

    def loss(w: Floats) -> float:
        return float(np.logaddexp(0.0, np.where(named, -(x @ w), x @ w)).sum() + 0.5 * (w[1:] @ w[1:]))

    constant, by_ratio, by_samples = optimize.minimize(loss, np.zeros(3)).x
    return Power(named_from, float(constant - by_samples * centre), float(by_ratio), float(by_samples))


def chosen_ridge(examples: Sequence[Labelled]) -> float:
    """The ridge of `RIDGES` with the least loss of bodies that the weights were not learned from."""
    return min(RIDGES, key=lambda ridge: _loss(examples, cross_weights(examples, ridge), 0.0))


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
    weights = cross_weights(examples, ridge)
    temperature = temperature_of(examples, weights)
    found = [one for one in predictions(examples, weights, temperature) if one.labelled.weight == 1.0]
    own = learned_weights(Design.of(examples), ridge)
    model = LearnedModel(own, temperature, set_threshold(found), power(found, named_from), ridge, dict(provenance))
    return Learned(model, found, predictions(with_true_law, weights, temperature))
