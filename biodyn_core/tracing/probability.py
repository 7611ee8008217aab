"""Probability of each cause from the evidence of a round, by a model that was learned from simulated bodies.

A conditional logit: every candidate has a score that is linear in its features, `none` and `outside` (a cause that the
catalogue lacks) have scores that are linear in the features of the body, and probabilities are their softmax. The
learned file is text: weights by name, with its provenance.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.evidence import Evidence
from biodyn_core.tracing.features import BODY_NAMES, CANDIDATE_NAMES, Features, features
from biodyn_core.tracing.findings import FurtherRecordings, NamedBodies

VERSION: Final = 5
"""Of the learned file: it changes with the features and with its keys."""

NONE: Final = "none"
OUTSIDE: Final = "outside"
"""Answers beside the mechanisms: nothing visible is missing, or an effect that the catalogue lacks."""

SHARED_BODY_NAMES: Final = ("level slope", "drift", "transfer", "residual", "prior scale", "samples")
"""Features of the body that shift the scores of an effect."""

EFFECT_NAMES: Final = ("constant", "gain", "margin", *SHARED_BODY_NAMES)
"""Features whose weights differ between effects."""

FILE: Final = "learned.json"

_SHARED: Final = [BODY_NAMES.index(name) for name in SHARED_BODY_NAMES]
_GAIN: Final = CANDIDATE_NAMES.index("gain")
_MARGIN: Final = CANDIDATE_NAMES.index("margin")


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of the scores.

    of_candidates (f,); of_effects (k, 3 + s): constant, gain, margin and some features of the body, by effect; none,
    outside (1 + b,): constant and features of the body.
    """

    effects: tuple[str, ...]
    of_candidates: Floats
    of_effects: Floats
    none: Floats
    outside: Floats


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """Weights with their calibration.

    temperature divides all scores. set_threshold: an answer belongs to the 90 % set if its probability is at least
    this (split conformal prediction). named: bodies of the training whose effect is named from the probability
    `named_from`, by ratio. ridge: the precision of the weights' prior. provenance: seed, bodies, commit and scores of
    the training. further: the same bodies from the least data, the first, and from more of several kinds.
    """

    weights: Weights
    temperature: float
    set_threshold: float
    named_from: float
    named: tuple[NamedBodies, ...]
    ridge: float
    provenance: Mapping[str, Any]
    further: tuple[FurtherRecordings, ...] = ()


@dataclass(frozen=True, eq=False)
class Probabilities:
    """Probabilities (c,) of the candidates by their keys, of `none` and of `outside`; they add up to 1.

    set_threshold: the least probability of an answer in the 90 % set.
    """

    keys: tuple[tuple[str, str], ...]
    of_candidates: Floats
    none: float
    outside: float
    set_threshold: float = 1.0

    def of(self, key: tuple[str, str]) -> float:
        """The probability of an effect at a site."""
        return float(self.of_candidates[self.keys.index(key)])

    @property
    def of_answers(self) -> dict[str, float]:
        """The probability of each mechanism, of `none` and of `outside`, the largest first."""
        found = {NONE: self.none, OUTSIDE: self.outside}
        for (effect, _), p in zip(self.keys, self.of_candidates.tolist(), strict=True):
            mechanism = CATALOGUE[effect].mechanism
            found[mechanism] = found.get(mechanism, 0.0) + p
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @property
    def likely(self) -> tuple[str, ...]:
        """The 90 % set."""
        return likely(self.of_answers, self.set_threshold)


def likely(answers: Mapping[str, float], threshold: float) -> tuple[str, ...]:
    """The answers with at least the threshold's probability, and always the first, which is the most probable one."""
    return tuple(name for i, (name, p) in enumerate(answers.items()) if i == 0 or p >= threshold)


@cache
def packaged() -> LearnedModel:
    """The learned model of the package."""
    return learned_from(resources.files("biodyn_core.tracing").joinpath(FILE).read_text(encoding="utf-8"), FILE)


def learned_from(text: str, name: str) -> LearnedModel:
    """A learned model from its text; raises InputError if it is damaged or of another version."""
    try:
        stored = json.loads(text)
        version = stored["version"]
        if version != VERSION:
            raise InputError(f"{name}: version {version} of the learned model, allowed is {VERSION}; run make train")
        of = stored["weights"]
        weights = Weights(
            tuple(of["effects"]),
            _by_name(of["candidates"], CANDIDATE_NAMES),
            np.array([_by_name(values, EFFECT_NAMES) for values in of["effects"].values()]),
            *(_by_name(of[answer], ("constant", *BODY_NAMES)) for answer in (NONE, OUTSIDE)),
        )
        return LearnedModel(
            weights,
            float(stored["temperature"]),
            float(stored["set_threshold"]),
            float(stored["named_from"]),
            tuple(NamedBodies(**each) for each in stored["named"]),
            float(stored["ridge"]),
            stored["provenance"],
            tuple(FurtherRecordings(**each) for each in stored["further"]),
        )
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{name}: the learned model is damaged ({error!r}); install again or run make train") from None


def learned_text(model: LearnedModel) -> str:
    """The text of a learned model."""
    of = model.weights
    stored = {
        "version": VERSION,
        "provenance": model.provenance,
        "temperature": model.temperature,
        "set_threshold": model.set_threshold,
        "named_from": model.named_from,
        "named": [dataclasses.asdict(each) for each in model.named],
        "ridge": model.ridge,
        "further": [dataclasses.asdict(each) for each in model.further],
        "weights": {
            "candidates": _named(CANDIDATE_NAMES, of.of_candidates),
            "effects": {name: _named(EFFECT_NAMES, row) for name, row in zip(of.effects, of.of_effects, strict=True)},
            NONE: _named(("constant", *BODY_NAMES), of.none),
            OUTSIDE: _named(("constant", *BODY_NAMES), of.outside),
        },
    }
    return json.dumps(stored, indent=1) + "\n"


def _by_name(values: Mapping[str, float], names: Sequence[str]) -> Floats:
    """Values in the order of their names, which have to be exactly these."""
    if set(values) != set(names):
        raise KeyError(*sorted(set(values) ^ set(names))[:1])
    return np.array([float(values[name]) for name in names])


def _named(names: Sequence[str], values: Floats) -> dict[str, float]:
    return {name: float(f"{value:.5g}") for name, value in zip(names, values.tolist(), strict=True)}


def probabilities(evidence: Evidence, learned: LearnedModel | None = None) -> Probabilities:
    """The probabilities of all answers; learned: the model of the package unless given."""
    model = learned or packaged()
    found = features(evidence)
    scores = scores_of(found, model.weights) / model.temperature
    p = np.exp(scores - scores.max())
    p /= p.sum()
    return Probabilities(found.keys, p[:-2], float(p[-2]), float(p[-1]), model.set_threshold)


def scores_of(found: Features, weights: Weights) -> Floats:
    """The scores (c + 2,) of the candidates, of none and of outside.

    An effect that was added after the training has no weights of its own: it counts as the mean of all effects.
    """
    mean = weights.of_effects.mean(axis=0)
    by_name = dict(zip(weights.effects, weights.of_effects, strict=True))
    own = np.array([by_name.get(effect, mean) for effect, _ in found.keys]).reshape(-1, mean.size)
    of_candidates = found.of_candidates @ weights.of_candidates + np.einsum("ck,ck->c", effect_features(found), own)
    with_constant = np.append(1.0, found.of_body)
    return np.append(of_candidates, [with_constant @ weights.none, with_constant @ weights.outside])


def effect_features(found: Features) -> Floats:
    """The features (c, 3 + s) whose weights differ between effects."""
    count = len(found.keys)
    shared = np.broadcast_to(found.of_body[_SHARED], (count, len(_SHARED)))
    return np.column_stack([np.ones(count), found.of_candidates[:, [_GAIN, _MARGIN]], shared])
