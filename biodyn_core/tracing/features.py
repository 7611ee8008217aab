"""Features of the evidence: bounded numbers of each candidate and of the body, which a learned model weighs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.evidence import BodyEvidence, CandidateEvidence, Evidence, FitEvidence
from biodyn_core.tracing.settings import TypicalSettings

LEAST_GAIN: Final = 1e-3
"""Smaller gains count as this one.

No number here is a setting: they all define the features that the model was learned with.
"""

SAMPLES: Final = (60.0, 115.0)
"""Independent samples of nine tenths of the training bodies. Other numbers count as the nearer of these.

A weight shows nothing beyond them: with three times the data it lowered the probability of true causes.
"""

_TYPICAL_TILT: Final = TypicalSettings().usual_lean
"""The default, with which the model was learned, whatever the settings of a trace are."""


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one round: of candidates (c, f) by `CANDIDATE_NAMES`, of the body (b,) by `BODY_NAMES`."""

    keys: tuple[tuple[str, str], ...]
    of_candidates: Floats
    of_body: Floats

    @property
    def mechanisms(self) -> tuple[str, ...]:
        """The mechanism of each candidate."""
        return tuple(CATALOGUE[effect].mechanism for effect, _ in self.keys)


@dataclass(frozen=True)
class _Context:
    """What a candidate is compared with.

    best: the largest gain; of_mechanisms: that of each mechanism; mechanisms: of all candidates by effect and site;
    fitted: those that are fitted to all events, the largest gain first.
    """

    body: BodyEvidence
    best: float
    of_mechanisms: dict[str, float]
    mechanisms: dict[tuple[str, str], str]
    fitted: tuple[CandidateEvidence, ...]

    def best_other(self, mechanism: str) -> float:
        """The best gain of another mechanism."""
        return max((gain for name, gain in self.of_mechanisms.items() if name != mechanism), default=LEAST_GAIN)

    def rest(self, one: CandidateEvidence) -> float:
        """The largest gain of another mechanism beside a candidate."""
        own = self.mechanisms[one.key]
        others = [(self.mechanisms.get((effect, site), own), gain) for effect, site, gain in one.beside]
        return max((gain for mechanism, gain in others if mechanism != own), default=0.0)

    def beside_rival(self, one: CandidateEvidence) -> float:
        """The gain of a candidate beside the best candidate of another mechanism; its own gain without one."""
        own = self.mechanisms[one.key]
        rival = next((other for other in self.fitted if self.mechanisms[other.key] != own), None)
        if rival is None:
            return _best_gain(one)
        return next((gain for effect, site, gain in rival.beside if (effect, site) == one.key), 0.0)


def features(evidence: Evidence) -> Features:
    """The features of a round's evidence."""
    context = _context(evidence)
    rows = [_of_candidate(one, context) for one in evidence.candidates]
    keys = tuple(one.key for one in evidence.candidates)
    of_candidates = np.array(rows, dtype=np.float64).reshape(len(rows), len(CANDIDATE_NAMES))
    return Features(keys, of_candidates, np.array(_of_body(evidence, context)))


def _context(evidence: Evidence) -> _Context:
    found: dict[str, float] = {}
    for one in evidence.candidates:
        mechanism = CATALOGUE[one.effect].mechanism
        found[mechanism] = max(found.get(mechanism, LEAST_GAIN), _best_gain(one))
    fitted = sorted((one for one in evidence.candidates if one.fit is not None), key=_best_gain, reverse=True)
    return _Context(
        body=evidence.body,
        best=max(found.values(), default=LEAST_GAIN),
        of_mechanisms=found,
        mechanisms={one.key: CATALOGUE[one.effect].mechanism for one in evidence.candidates},
        fitted=tuple(fitted),
    )


def _best_fit(one: CandidateEvidence) -> FitEvidence | None:
    """The fit of the general form if its gain is larger, else that of the textbook form."""
    return max((each for each in (one.fit, one.general) if each is not None), key=lambda each: each.gain, default=None)


def _best_gain(one: CandidateEvidence) -> float:
    """The larger gain of the furthest stage and of the cause fitted again with time; `LEAST_GAIN` at least."""
    fit = _best_fit(one)
    steady = fit.gain if fit is not None else min(one.tried[0] if one.tried else one.screened, one.screened)
    return max(steady, _varying_gain(one), LEAST_GAIN)


def _varying_gain(one: CandidateEvidence) -> float:
    """The mean gain of a cause that varies with time, 0 without one or with an objection."""
    return 0.0 if one.varying is None or one.varying[1] else float(np.mean(one.varying[0]))


def _log(value: float, least: float, most: float) -> float:
    """The decimal logarithm within limits."""
    return float(np.log10(min(max(value, least), most)))


def _above(value: float, knots: Sequence[float]) -> list[float]:
    """Piecewise linear basis: by how much a value exceeds each knot."""
    return [max(0.0, value - knot) for knot in knots]


GAIN_KNOTS: Final = (-2.5, -2.0, -1.5, -1.0, -0.5, 0.0)
MARGIN_KNOTS: Final = (-0.5, -0.2, 0.0, 0.2, 0.5)
RESIDUAL_KNOTS: Final = (-0.3, 0.0, 0.3, 0.6)
REST_KNOTS: Final = (-1.0, -0.5)
VARYING_KNOTS: Final = (-2.0, -0.6)
LEAST_VARYING_KNOTS: Final = (-1.5,)
"""Knots of the piecewise linear bases, in decimal logarithms."""

VARIATIONS: Final = ("delay", "line", "step")
"""Ways in which a cause varies with time; what one of them gains means something else than with another."""


def _of_candidate(one: CandidateEvidence, context: _Context) -> list[float]:
    gain = _log(_best_gain(one), LEAST_GAIN, 10.0)
    margin = gain - _log(context.best_other(CATALOGUE[one.effect].mechanism), LEAST_GAIN, 10.0)
    behind = gain - _log(context.best, LEAST_GAIN, 10.0)
    body, effect = context.body, CATALOGUE[one.effect]
    return [
        gain, *_above(gain, GAIN_KNOTS),
        np.clip(margin, -1.5, 1.0), *_above(min(margin, 1.0), MARGIN_KNOTS),
        max(behind, -1.5), float(behind == 0.0),
        float(one.tried is None and one.varying is None), float(one.fit is None and one.varying is None),
        _log(one.screened, LEAST_GAIN, 10.0), one.absorbed,
        *_of_fit(_best_fit(one), body),
        *_of_general(one),
        *_of_beside(one, context, gain),
        *_of_varying(one),
        *_of_mechanism(effect.mechanism, context, gain),
        *_products(one, context, gain, float(np.clip(margin, -1.5, 1.0))),
        float(one.site in body.bracket and effect.place == "joint"),
        _own_coherence(one, body),
        _log(body.tilts.get(one.site, 0.0) / _TYPICAL_TILT, 0.1, 30.0) if effect.seen_by_gyro else 0.0,
        _log(body.jump or 1.0, 0.005, 1.0) if effect.varies_as == "step" else 0.0,
    ]  # fmt: skip


def _of_fit(fit: FitEvidence | None, body: BodyEvidence) -> list[float]:
    """The features of a fit to all events; all 0 without."""
    if fit is None:
        return [0.0] * len(_FIT_NAMES)
    gains = np.array(fit.gains)
    error = float(gains.std(ddof=1) / np.sqrt(gains.size)) if gains.size > 1 else abs(fit.gain)
    conditions = sorted(set(body.conditions))
    by_condition = [float(gains[np.array(body.conditions) == name].mean()) for name in conditions]
    multiple, fitted = fit.typical_multiple, -float(np.log1p(-min(fit.decrease, 0.9999)))
    before = float(np.median(body.residuals))
    return [
        float(np.mean(gains > 0.0)), float(np.clip(fit.gain / max(error, 1e-4), -3.0, 8.0)),
        min(by_condition) / max(*map(abs, by_condition), 1e-3) if len(by_condition) > 1 else 0.0,
        _log(max(fit.evidence_gain, 0.0), LEAST_GAIN, 10.0),
        _log(fit.decrease, 1e-3, 1.0), _log(fitted / max(fit.gain, LEAST_GAIN), 0.1, 10.0),
        _log(fit.residual, 0.1, 10.0), _log(fit.residual / max(before, 1e-3), 0.03, 1.5),
        _log(fit.nuisance_square / max(body.nuisance_square, 1e-3), 1e-2, 1e2),
        _log(fit.prior_scale, 0.1, 1.0), _log(fit.prior_scale / body.prior_scale, 0.1, 10.0),
        float(multiple is None), _log(multiple, 0.1, 30.0) if multiple is not None else 0.0,
        _log(multiple * body.prior_scale, 0.1, 30.0) if multiple is not None else 0.0,
        float(fit.on_bound > 0), float(fit.theta_on_bound > 0), _log(fit.theta_shift, 1e-3, 1.0),
    ]  # fmt: skip


def _of_general(one: CandidateEvidence) -> list[float]:
    """Whether there is a fit of the general form, and its gain over that of the textbook form."""
    if one.fit is None or one.general is None:
        return [0.0, 0.0]
    textbook, general = (_log(each.gain, LEAST_GAIN, 10.0) for each in (one.fit, one.general))
    return [1.0, float(np.clip(general - textbook, -1.0, 2.0))]


def _of_beside(one: CandidateEvidence, context: _Context, gain: float) -> list[float]:
    """What remains of the gain beside the best rival, and what others gain beside this one; all 0 without a fit."""
    if one.fit is None:
        return [0.0] * len(_BESIDE_NAMES)
    remains = _log(context.beside_rival(one), LEAST_GAIN, 10.0)
    rest = _log(context.rest(one), LEAST_GAIN, 10.0)
    return [max(remains - gain, -2.0), remains, rest - gain, *_above(rest - gain, REST_KNOTS), rest]


def _of_varying(one: CandidateEvidence) -> list[float]:
    """The mean and the least gain of a cause that varies with time, and whether it is objected, by its variation."""
    found = [0.0] * len(_VARYING_NAMES)
    if one.varying is None:
        return found
    gains, objected = one.varying
    mean, least = (_log(float(value), LEAST_GAIN, 10.0) for value in (np.mean(gains), min(gains)))
    values = [
        mean + 3.0, *_above(mean, VARYING_KNOTS), least + 3.0, *_above(least, LEAST_VARYING_KNOTS), float(objected),
    ]  # fmt: skip
    at = VARIATIONS.index(CATALOGUE[one.effect].varies_as) * len(values)
    found[at : at + len(values)] = values
    return found


def _of_mechanism(mechanism: str, context: _Context, gain: float) -> list[float]:
    """How far the gain is behind the best of its mechanism, whether it is the best, and the number of candidates."""
    behind = gain - _log(context.of_mechanisms[mechanism], LEAST_GAIN, 10.0)
    return [behind, float(behind == 0.0), float(np.log(sum(name == mechanism for name in context.mechanisms.values())))]


def _products(one: CandidateEvidence, context: _Context, gain: float, margin: float) -> list[float]:
    """Products of gain, margin and share beside the best rival with what is known of the body."""
    body, fit = context.body, _best_fit(one)
    residual = _log(body.residual_at_unit_scale, 0.1, 30.0)
    left = _log(fit.residual, 0.1, 10.0) if fit is not None else 0.0
    beside = max(_log(context.beside_rival(one), LEAST_GAIN, 10.0) - gain, -2.0) if one.fit is not None else 0.0
    return [
        gain * residual, margin * residual, beside * residual, gain * left,
        gain * _log(body.prior_scale, 0.1, 1.0), margin * _log(body.chance[1], LEAST_GAIN, 10.0), margin * (gain + 1.5),
    ]  # fmt: skip


def _own_coherence(one: CandidateEvidence, body: BodyEvidence) -> float:
    """The largest coherent share of the channels that an effect needs at its site."""
    channels = CATALOGUE[one.effect].required_channels(one.site)
    return max((body.coherent[name][1] for name in channels if name in body.coherent), default=0.0)


def _of_body(evidence: Evidence, context: _Context) -> list[float]:
    body = evidence.body
    residual = _log(body.residual_at_unit_scale, 0.1, 30.0)
    best = _log(context.best, LEAST_GAIN, 10.0)
    fits = [fit for fit in map(_best_fit, evidence.candidates) if fit is not None]
    left = min((one.residual for one in fits), default=float(np.median(body.residuals)))
    rest = _log(context.rest(context.fitted[0]) if context.fitted else LEAST_GAIN, LEAST_GAIN, 10.0)
    others = sorted(context.of_mechanisms.values())
    return [
        residual, *_above(residual, RESIDUAL_KNOTS),
        _log(float(np.median(body.residuals)), 0.1, 30.0),
        _log(body.nuisance_square, 1e-2, 1e3), _log(body.prior_scale, 0.1, 1.0),
        best, *_above(best, GAIN_KNOTS),
        _log(context.best / max(body.chance[1], LEAST_GAIN), 0.1, 100.0), _log(body.chance[1], LEAST_GAIN, 10.0),
        _log(left, 0.1, 30.0), best - _log(others[-2] if len(others) > 1 else LEAST_GAIN, LEAST_GAIN, 10.0),
        rest, rest - best,
        _log(body.samples, *SAMPLES),
        float(np.clip(body.level_slope or 0.0, -2.0, 2.0)), _log(body.jump or 1.0, 0.005, 1.0),
        _log(body.drift, 1e-3, 10.0), _log(body.transfer, 1.0, 10.0), float(body.known_effects > 0),
        *_best_varying(evidence, objected=False), *_best_varying(evidence, objected=True),
    ]  # fmt: skip


def _best_varying(evidence: Evidence, objected: bool) -> list[float]:
    """The largest mean gain of the causes that vary with time, of those with or without an objection."""
    varying = (one.varying for one in evidence.candidates if one.varying is not None)
    best = _log(
        max((float(np.mean(gains)) for gains, is_objected in varying if is_objected == objected), default=0.0),
        LEAST_GAIN,
        10.0,
    )
    return [best + 3.0, *_above(best, LEAST_VARYING_KNOTS)]


def _knots(name: str, count: int) -> list[str]:
    return [name, *(f"{name} above {i}" for i in range(count))]


_BESIDE_NAMES: Final = (
    "share beside rival", "beside rival", *_knots("rest over gain", len(REST_KNOTS)), "rest",
)  # fmt: skip

_FIT_NAMES: Final = (
    "improved share", "t", "worst condition", "evidence gain", "decrease", "decrease over gain", "residual",
    "residual over before", "nuisance over before", "prior scale", "prior scale over before", "nothing typical",
    "typical multiple", "typical multiple at scale", "on bound", "theta on bound", "theta shift",
)  # fmt: skip

_VARYING_NAMES: Final = tuple(
    f"{variation} {name}"
    for variation in VARIATIONS
    for name in (
        *_knots("varying", len(VARYING_KNOTS)), *_knots("least varying", len(LEAST_VARYING_KNOTS)), "objected",
    )
)  # fmt: skip

_PRODUCT_NAMES: Final = (
    "gain by residual", "margin by residual", "share beside rival by residual", "gain by residual left",
    "gain by prior scale", "margin by chance", "margin by gain",
)  # fmt: skip

CANDIDATE_NAMES: Final = (
    *_knots("gain", len(GAIN_KNOTS)), *_knots("margin", len(MARGIN_KNOTS)), "behind best", "best", "not tried",
    "not fitted", "screened", "absorbed", *_FIT_NAMES, "generalised", "general over textbook", *_BESIDE_NAMES,
    *_VARYING_NAMES, "behind own mechanism", "best of mechanism", "candidates of mechanism", *_PRODUCT_NAMES,
    "in bracket", "coherence", "gyro tilt", "jump",
)  # fmt: skip

BODY_NAMES: Final = (
    *_knots("residual", len(RESIDUAL_KNOTS)), "residual at scale", "nuisance", "prior scale",
    *_knots("best gain", len(GAIN_KNOTS)), "best over chance", "chance", "residual left", "lead", "rest",
    "rest over best", "samples", "level slope", "jump", "drift", "transfer", "known effects",
    *_knots("best varying", len(LEAST_VARYING_KNOTS)), *_knots("best objected", len(LEAST_VARYING_KNOTS)),
)  # fmt: skip
