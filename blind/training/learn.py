"""Learn the probability model from examples: a conditional logit with partial labels and a ridge, fitted by L-BFGS.

A label is the set of answers that count as right. Half of the loss asks for the mechanism, half for effect and site.
Every example with an effect is used again without the candidates of its mechanism: the answer is then `outside`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.evidence import Evidence
from biodyn_core.tracing.features import BODY_NAMES, CANDIDATE_NAMES, Features, features
from biodyn_core.tracing.probability import EFFECT_NAMES, Weights, effect_features
from blind.training.collect import Example

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

WEAK: Final = 0.3
"""Up to this ratio `none` is right too: no mark asks for such an effect."""

EXACT: Final = 0.5
"""Share of the loss that asks for effect and site, beside the mechanism."""

LEFT_OUT: Final = 0.1
"""Weight of an example whose mechanism is left out: with it about a fifth of all bodies are outside.

A larger weight lowers every other probability.
"""

FIRST: Final = ("gain", "margin", "behind best", "best", "not tried", "not fitted")
FIRST_OF_BODY: Final = ("constant", "best gain", "residual", "best over chance")
"""Beginnings of the names of the features whose weights are least restrained."""

FIRST_RIDGE: Final = 0.3
OWN_RIDGE: Final = 8.0
"""Precision of weights in multiples of the ridge, of those tried the best in cross-validation."""

EFFECTS: Final = tuple(sorted(CATALOGUE))


@dataclass(frozen=True, eq=False)
class Labelled:
    """The features of one body and the right answers: by mechanism and exactly, (c + 2,) each; its weight in the loss.

    forms: the hidden ones, of which the first decides the fold. background: its kinds. mechanism: of the first hidden
    effect, empty if it has no class. ratio: 0 if nothing is hidden, nan if it is unknown. samples: independent ones for
    fitting.
    """

    features: Features
    by_mechanism: Flags
    exact: Flags
    weight: float
    number: int
    forms: tuple[str, ...]
    background: tuple[str, ...]
    mechanism: str
    ratio: float
    samples: float


def labelled(example: Example) -> list[Labelled]:
    """An example with its label; with one effect of the catalogue also without the candidates of its mechanism.

    Empty for a body that cannot be traced.
    """
    if example.evidence is None:
        return []
    found = features(example.evidence)
    weak = example.ratio is not None and example.ratio < WEAK
    causes = [(one.name, one.site) for one in example.causes]
    mechanisms = [CATALOGUE[effect].mechanism for effect, _ in causes]
    by_mechanism = np.array([name in mechanisms for name in found.mechanisms], dtype=bool)
    exact = np.array([any(_same(key, cause) for cause in causes) for key in found.keys], dtype=bool)
    exact = exact if exact.any() else by_mechanism
    tail = [not example.forms or weak, example.outside or (bool(causes) and not by_mechanism.any())]
    label = Labelled(
        found, np.append(by_mechanism, tail), np.append(exact, tail), 1.0, example.number, example.forms,
        tuple(sorted(example.background)), mechanisms[0] if mechanisms and not example.outside else "",
        _ratio(example), example.evidence.body.samples,
    )  # fmt: skip
    if len(causes) != 1 or example.outside or not by_mechanism.any():
        return [label]
    return [label, _left_out(example.evidence, label, weak)]


def labelled_with_true_law(example: Example) -> list[Labelled]:
    """An example with its label as if the catalogue had the true law; empty without such evidence."""
    if example.with_true_law is None:
        return []
    return labelled(dataclasses.replace(example, evidence=example.with_true_law))[:1]


def _ratio(example: Example) -> float:
    """A body that ran away at its first strength has no ratio: its strength was changed until it was stable."""
    if not example.forms:
        return 0.0
    return float("nan") if example.ratio is None else example.ratio


def _same(key: tuple[str, str], cause: tuple[str, str]) -> bool:
    return key[0] == cause[0] and (not cause[1] or key[1] == cause[1])


def _left_out(evidence: Evidence, label: Labelled, weak: bool) -> Labelled:
    """The example as if the catalogue lacked its mechanism."""
    rest = tuple(one for one in evidence.candidates if CATALOGUE[one.effect].mechanism != label.mechanism)
    found = features(dataclasses.replace(evidence, candidates=rest))
    right = np.append(np.zeros(len(rest), dtype=bool), [weak, True])
    return dataclasses.replace(label, features=found, by_mechanism=right, exact=right, weight=LEFT_OUT)


@dataclass(frozen=True, eq=False)
class Design:
    """All examples as arrays: candidates (n, c, f), padded; their effects (n, c) and effect features (n, c, e).

    body (n, 1 + b); present (n, c + 2); by_mechanism, exact (n, c + 2); weight (n,).
    """

    of_candidates: Floats
    effects: NDArray[np.int64]
    of_effects: Floats
    body: Floats
    present: Flags
    by_mechanism: Flags
    exact: Flags
    weight: Floats

    @classmethod
    def of(cls, examples: Sequence[Labelled]) -> Design:
        """The arrays of examples."""
        n, c = len(examples), max(len(one.features.keys) for one in examples)
        own, effects = np.zeros((n, c, len(CANDIDATE_NAMES))), np.zeros((n, c), dtype=np.int64)
        shared, body = np.zeros((n, c, len(EFFECT_NAMES))), np.ones((n, 1 + len(BODY_NAMES)))
        present, by_mechanism, exact = (np.zeros((n, c + 2), dtype=bool) for _ in range(3))
        for i, one in enumerate(examples):
            count = len(one.features.keys)
            own[i, :count], shared[i, :count] = one.features.of_candidates, effect_features(one.features)
            effects[i, :count] = [EFFECTS.index(effect) for effect, _ in one.features.keys]
            body[i, 1:] = one.features.of_body
            places = np.append(np.arange(count), [c, c + 1])
            present[i, places], by_mechanism[i, places], exact[i, places] = True, one.by_mechanism, one.exact
        weight = np.array([one.weight for one in examples])
        return cls(own, effects, shared, body, present, by_mechanism, exact, weight)


def learned_weights(design: Design, ridge: float) -> Weights:
    """The weights with the smallest penalised loss.

    ridge is the precision of a weight of a scaled feature, times `FIRST_RIDGE` for gains and residuals, which are known
    to matter, and `OWN_RIDGE` for an effect's own weights.
    """
    scales = _Scales.of(design)
    found = optimize.minimize(
        _loss, np.zeros(scales.size), args=(design, scales, ridge), jac=True, method="L-BFGS-B",
        options={"maxiter": 500, "maxfun": 700},
    )  # fmt: skip
    return scales.weights(found.x)


@dataclass(frozen=True, eq=False)
class _Scales:
    """Standard deviations of the features: of candidates (f,), of effects (e,), of the body (1 + b,)."""

    of_candidates: Floats
    of_effects: Floats
    body: Floats

    @classmethod
    def of(cls, design: Design) -> _Scales:
        there = design.present[:, :-2]

        def spread(values: Floats) -> Floats:
            found = values.std(axis=0)
            return np.where(found > 1e-9, found, 1.0)

        return cls(spread(design.of_candidates[there]), spread(design.of_effects[there]), spread(design.body))

    @property
    def size(self) -> int:
        """The number of weights."""
        return self.of_candidates.size + len(EFFECTS) * self.of_effects.size + 2 * self.body.size

    @property
    def precision(self) -> Floats:
        """The precision of each weight, in multiples of the ridge."""
        first = [FIRST_RIDGE if name.startswith(FIRST) else 1.0 for name in CANDIDATE_NAMES]
        body = [FIRST_RIDGE if name.startswith(FIRST_OF_BODY) else 1.0 for name in ("constant", *BODY_NAMES)]
        own = np.full(len(EFFECTS) * self.of_effects.size, OWN_RIDGE)
        return np.concatenate([first, own, body, body])

    def weights(self, packed: Floats) -> Weights:
        """The weights of unscaled features."""
        f, e, b = self.of_candidates.size, self.of_effects.size, self.body.size
        own, effects, tail = np.split(packed, [f, f + len(EFFECTS) * e])
        none, outside = tail[:b] / self.body, tail[b:] / self.body
        return Weights(EFFECTS, own / self.of_candidates, effects.reshape(-1, e) / self.of_effects, none, outside)

    def gradient(self, weights: Weights) -> Floats:
        """The derivatives by scaled weights, from those by unscaled ones."""
        return np.concatenate([
            weights.of_candidates / self.of_candidates, (weights.of_effects / self.of_effects).ravel(),
            weights.none / self.body, weights.outside / self.body,
        ])  # fmt: skip


def _loss(packed: Floats, design: Design, scales: _Scales, ridge: float) -> tuple[float, Floats]:
    p = chances(design, scales.weights(packed))
    pull = -p * design.weight[:, None]
    total = 0.0
    for share, right in ((1.0 - EXACT, design.by_mechanism), (EXACT, design.exact)):
        inside = np.where(right, p, 0.0)
        sums = inside.sum(axis=1)
        total -= share * float(design.weight @ np.log(np.maximum(sums, 1e-300)))
        pull += share * (design.weight / np.maximum(sums, 1e-300))[:, None] * inside
    slope = -pull
    pulls = (slope[:, :-2, None] * design.of_effects).reshape(-1, design.of_effects.shape[2])
    index = design.effects.ravel()
    of_effects = np.column_stack([np.bincount(index, column, len(EFFECTS)) for column in pulls.T])
    gradient = Weights(
        EFFECTS, np.einsum("nc,ncf->f", slope[:, :-2], design.of_candidates, optimize=True), of_effects,
        slope[:, -2] @ design.body, slope[:, -1] @ design.body,
    )  # fmt: skip
    pulled = ridge * scales.precision * packed
    return total + 0.5 * float(packed @ pulled), scales.gradient(gradient) + pulled


def chances(design: Design, weights: Weights, temperature: float = 1.0) -> Floats:
    """Probabilities (n, c + 2) of all answers, 0 where there is no candidate."""
    own = np.einsum("nce,nce->nc", design.of_effects, weights.of_effects[design.effects])
    scores = np.column_stack(
        [design.of_candidates @ weights.of_candidates + own, design.body @ weights.none, design.body @ weights.outside]
    )
    scores = np.where(design.present, scores / temperature, -np.inf)
    p = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray(p / p.sum(axis=1, keepdims=True))
