"""Probabilities of causes: a softmax over scores that are linear in bounded features, from a plain text file."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biodyn_core.base.errors import InputError
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing import probability, results
from biodyn_core.tracing.evidence import BodyEvidence, CandidateEvidence, Evidence, FitEvidence
from biodyn_core.tracing.features import BODY_NAMES, CANDIDATE_NAMES, LEAST_GAIN, SAMPLES, Features, features
from biodyn_core.tracing.findings import FurtherRecordings, NamedBodies
from biodyn_core.tracing.probability import (
    EFFECT_NAMES,
    SHARED_BODY_NAMES,
    VERSION,
    LearnedModel,
    Probabilities,
    Weights,
    learned_from,
    learned_text,
    likely,
    probabilities,
)
from biodyn_core.tracing.settings import TraceSettings

EFFECTS = tuple(sorted(CATALOGUE))


def fit(*gains: float, **values: float | None) -> FitEvidence:
    """The evidence of a fit with these gains."""
    plain = {
        "evidence_gain": 0.01, "decrease": 0.2, "residual": 0.5, "nuisance_square": 3.0, "prior_scale": 0.32,
        "typical_multiple": 2.0, "on_bound": 0, "theta_on_bound": 0, "theta_shift": 0.1,
    }  # fmt: skip
    return FitEvidence(gains=gains, **plain | values)


BODY = BodyEvidence(
    residuals=(0.8, 1.2, 1.0), residual_at_unit_scale=0.9, nuisance_square=10.0, prior_scale=0.56, chance=(0.01, 0.03),
    conditions=("road", "road", "rail"), peaks_mps2=(3.0, 4.0, 9.0), samples=90.0, tilts={"head": 0.05},
    known_effects=0, level_slope=0.2, jump=0.4, drift=0.3, transfer=1.4, bracket=("neck",),
    coherent={"seat.x": ("head", 0.2)},
)  # fmt: skip
EVIDENCE = Evidence(
    BODY,
    (
        CandidateEvidence("friction", "neck", 0.3, 0.4, 0.2, (0.35, 0.5), fit(0.3, 0.5, 0.4)),
        CandidateEvidence("cubic", "neck", 0.1, 0.2, 0.5, (0.1, 0.1)),
        CandidateEvidence("stop", "head", 0.05, 0.1, 0.9),
        CandidateEvidence("clock", "head", 0.02, 0.1, 0.1, (0.02, 0.1), fit(0.02, -0.01, 0.0), ((0.1, 0.2), True)),
    ),
)


def random_model(seed: int = 3) -> LearnedModel:
    rng = np.random.default_rng(seed)
    b, e = len(BODY_NAMES), len(EFFECT_NAMES)
    weights = Weights(
        EFFECTS,
        rng.normal(0.0, 0.3, len(CANDIDATE_NAMES)),
        rng.normal(0.0, 0.3, (len(EFFECTS), e)),
        rng.normal(0.0, 0.3, 1 + b),
        rng.normal(0.0, 0.3, 1 + b),
    )
    return LearnedModel(weights, 1.3, 0.07, 0.8, (NamedBodies(0.5, 20, 1), NamedBodies(1.0, 30, 9)), 1.0, {"bodies": 3})


def test_probabilities_are_a_softmax_of_linear_scores() -> None:
    """The same by loops over names, with Python's own numbers."""
    model = random_model()
    stored = json.loads(learned_text(model))["weights"]
    found, rows = probabilities(EVIDENCE, model), features(EVIDENCE)
    body = dict(zip(BODY_NAMES, rows.of_body.tolist(), strict=True))
    scores = []
    for (effect, _), row in zip(rows.keys, rows.of_candidates.tolist(), strict=True):
        own = dict(zip(CANDIDATE_NAMES, row, strict=True))
        score = sum(stored["candidates"][name] * value for name, value in own.items())
        beside = {"constant": 1.0, "gain": own["gain"], "margin": own["margin"]}
        beside |= {name: body[name] for name in SHARED_BODY_NAMES}
        scores.append(score + sum(stored["effects"][effect][name] * value for name, value in beside.items()))
    for answer in ("none", "outside"):
        weights = stored[answer]
        scores.append(weights["constant"] + sum(weights[name] * value for name, value in body.items()))
    powers = np.exp(np.array(scores) / 1.3)
    expected = powers / powers.sum()
    np.testing.assert_allclose([*found.of_candidates, found.none, found.outside], expected, rtol=2e-3)
    assert sum(found.of_answers.values()) == pytest.approx(1.0)


def test_answers_add_the_candidates_of_a_mechanism_and_are_sorted() -> None:
    found = Probabilities(
        (("cubic", "neck"), ("stop", "neck"), ("stop", "head"), ("friction", "head")),
        np.array([0.2, 0.1, 0.15, 0.05]), 0.4, 0.1, 0.1,
    )  # fmt: skip
    expected = {"nonlinear_stiffness": 0.45, "none": 0.4, "outside": 0.1, "dry_friction": 0.05}
    assert list(found.of_answers) == list(expected) and found.of_answers == pytest.approx(expected)
    assert found.likely == ("nonlinear_stiffness", "none", "outside")
    assert found.of(("stop", "head")) == 0.15


def test_the_set_always_has_the_most_probable_answer() -> None:
    answers = {"skin": 0.4, "none": 0.3, "clock": 0.3}
    assert likely(answers, 0.5) == ("skin",)
    assert likely(answers, 0.3) == ("skin", "none", "clock")


@given(
    gain=st.floats(-1e6, 1e6), residual=st.floats(0.0, 1e9), multiple=st.none() | st.floats(0.0, 1e9),
    slope=st.none() | st.floats(-1e6, 1e6), decrease=st.floats(-1e3, 1.0), samples=st.floats(0.0, 1e9),
)  # fmt: skip
def test_features_are_bounded(
    gain: float, residual: float, multiple: float | None, slope: float | None, decrease: float, samples: float
) -> None:
    """No evidence, however extreme, can outweigh the rest without a limit."""
    body = dataclasses.replace(BODY, residuals=(residual,) * 3, level_slope=slope, samples=samples)
    one = dataclasses.replace(
        EVIDENCE.candidates[0],
        fit=fit(gain, 0.1, gain, residual=residual, typical_multiple=multiple, decrease=decrease),
    )
    rows = features(Evidence(body, (one, *EVIDENCE.candidates[1:])))
    assert np.abs(rows.of_candidates).max() < 12.0 and np.abs(rows.of_body).max() < 12.0


def test_features_rank_gains_and_know_the_best() -> None:
    rows = features(EVIDENCE).of_candidates
    gain, margin, best, not_fitted, bracket = (
        rows[:, CANDIDATE_NAMES.index(name)] for name in ("gain", "margin", "best", "not fitted", "in bracket")
    )
    np.testing.assert_allclose(gain[:2], np.log10([0.4, 0.1]))  # of the furthest stage
    assert margin[0] == pytest.approx(np.log10(0.4 / 0.1)) and margin[1] == pytest.approx(np.log10(0.1 / 0.4))
    assert best.tolist() == [1.0, 0.0, 0.0, 0.0] and not_fitted.tolist() == [0.0, 1.0, 1.0, 0.0]
    assert bracket.tolist() == [1.0, 1.0, 0.0, 0.0]


def column(rows: Features, name: str) -> list[float]:
    return rows.of_candidates[:, CANDIDATE_NAMES.index(name)].tolist()


def test_the_form_with_the_larger_gain_counts() -> None:
    friction, *others = EVIDENCE.candidates
    bent = dataclasses.replace(friction, general=fit(0.8, 0.9, 0.7, residual=0.3))
    rows = features(Evidence(BODY, (bent, *others)))
    assert column(rows, "gain")[0] == pytest.approx(np.log10(0.8))
    assert column(rows, "residual")[0] == pytest.approx(np.log10(0.3))
    assert column(rows, "generalised") == [1.0, 0.0, 0.0, 0.0]
    assert column(rows, "general over textbook") == [pytest.approx(np.log10(0.8 / 0.4)), 0.0, 0.0, 0.0]
    worse = dataclasses.replace(friction, general=fit(0.1, 0.1, 0.1))
    rows = features(Evidence(BODY, (worse, *others)))
    assert column(rows, "gain")[0] == pytest.approx(np.log10(0.4))
    assert column(rows, "general over textbook")[0] == pytest.approx(np.log10(0.1 / 0.4))


def test_gains_beside_other_candidates_count() -> None:
    friction, cubic, stop, clock = EVIDENCE.candidates
    friction = dataclasses.replace(friction, beside=(("clock", "head", 0.002),))
    clock = dataclasses.replace(clock, beside=(("friction", "neck", 0.3),))
    rows = features(Evidence(BODY, (friction, cubic, stop, clock)))
    gain = column(rows, "gain")
    assert column(rows, "beside rival") == pytest.approx([np.log10(0.3), 0.0, 0.0, np.log10(0.002)])
    shares = [np.log10(0.3) - gain[0], 0.0, 0.0, np.log10(0.002) - gain[3]]
    assert column(rows, "share beside rival") == pytest.approx(shares)
    assert column(rows, "rest") == pytest.approx([np.log10(0.002), 0.0, 0.0, np.log10(0.3)])
    assert column(rows, "rest over gain") == pytest.approx([np.log10(0.002 / 0.4), 0.0, 0.0, np.log10(0.3) - gain[3]])
    body = dict(zip(BODY_NAMES, rows.of_body.tolist(), strict=True))
    assert (body["rest"], body["rest over best"]) == pytest.approx((np.log10(0.002), np.log10(0.002 / 0.4)))
    without = features(Evidence(BODY, (cubic, stop, clock)))  # nothing is beside a candidate that is not there
    assert column(without, "beside rival")[2] == gain[3] and column(without, "rest")[2] == np.log10(LEAST_GAIN)


def test_the_gain_of_a_cause_that_varies_counts_unless_there_is_an_objection() -> None:
    *others, clock = EVIDENCE.candidates
    assert column(features(EVIDENCE), "gain")[3] == pytest.approx(np.log10(0.01 / 3.0))
    varying = dataclasses.replace(clock, varying=((0.1, 0.3), False))
    assert column(features(Evidence(BODY, (*others, varying))), "gain")[3] == pytest.approx(np.log10(0.2))
    alone = dataclasses.replace(varying, tried=None, fit=None)
    rows = features(Evidence(BODY, (*others, alone)))
    assert (column(rows, "not tried")[3], column(rows, "not fitted")[3]) == (0.0, 0.0)


def test_what_a_cause_gains_over_time_counts_by_its_variation() -> None:
    clock = dataclasses.replace(EVIDENCE.candidates[-1], varying=((0.1, 0.3), False))
    line = dataclasses.replace(clock, effect="periodic", site="neck", varying=((0.2, 2.0), True))
    rows = features(Evidence(BODY, (*EVIDENCE.candidates[:-1], clock, line)))
    assert column(rows, "delay varying") == pytest.approx([0.0, 0.0, 0.0, np.log10(0.2) + 3.0, 0.0])
    assert column(rows, "line varying") == pytest.approx([0.0, 0.0, 0.0, 0.0, np.log10(1.1) + 3.0])
    assert column(rows, "line least varying") == pytest.approx([0.0, 0.0, 0.0, 0.0, np.log10(0.2) + 3.0])
    assert column(rows, "line objected") == [0.0, 0.0, 0.0, 0.0, 1.0]
    assert column(rows, "delay objected") == column(rows, "step varying") == [0.0] * 5
    body = dict(zip(BODY_NAMES, rows.of_body.tolist(), strict=True))
    assert body["best varying"] == pytest.approx(np.log10(0.2) + 3.0)
    assert body["best objected"] == pytest.approx(np.log10(1.1) + 3.0)  # something is there, whatever it is


def test_another_site_of_its_mechanism_is_no_rest() -> None:
    friction, *others = EVIDENCE.candidates
    here = dataclasses.replace(friction, beside=(("hysteresis", "head", 0.2), ("clock", "head", 0.01)))
    there = dataclasses.replace(friction, effect="hysteresis", site="head")
    assert CATALOGUE["hysteresis"].mechanism == CATALOGUE["friction"].mechanism
    assert column(features(Evidence(BODY, (here, there, *others))), "rest")[0] == np.log10(0.01)


def test_evidence_is_stored_with_four_digits() -> None:
    whole = dataclasses.replace(EVIDENCE.candidates[0], general=fit(0.5, 0.5), beside=(("clock", "head", 0.01),))
    evidence = Evidence(BODY, (whole, *EVIDENCE.candidates[1:]))
    assert Evidence.from_dict(json.loads(json.dumps(evidence.to_dict()))) == evidence
    third = dataclasses.replace(EVIDENCE, body=dataclasses.replace(BODY, drift=1.0 / 3.0))
    assert Evidence.from_dict(third.to_dict()).body.drift == 0.3333


def test_a_learned_model_is_read_as_it_was_written() -> None:
    further = (FurtherRecordings("the least data", 3, 1, 2), FurtherRecordings("more", 3, 2, 2))
    model = dataclasses.replace(random_model(), further=further)
    text = learned_text(model)
    again = learned_from(text, "learned.json")
    assert learned_text(again) == text
    assert (again.temperature, again.set_threshold, again.named_from, again.named, again.ridge, again.provenance) == (
        1.3, 0.07, 0.8, model.named, 1.0, {"bodies": 3},
    )  # fmt: skip
    np.testing.assert_allclose(again.weights.of_effects, model.weights.of_effects, rtol=1e-4)
    assert again.further == further


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            lambda text: text.replace(f'"version": {VERSION}', '"version": 99'),
            f"version 99 of the learned model, allowed is {VERSION}",
        ),
        (lambda text: text[:-200], "the learned model is damaged"),
        (lambda text: text.replace('"behind best"', '"in front"'), "the learned model is damaged"),
        (lambda text: text.replace('"further"', '"later"'), "the learned model is damaged"),
        (lambda text: "[]", "the learned model is damaged"),
    ],
)
def test_a_learned_file_of_another_version_or_damaged_is_refused(change, why: str) -> None:
    with pytest.raises(InputError, match=why) as found:
        learned_from(change(learned_text(random_model())), "learned.json")
    assert "\n" not in str(found.value) and str(found.value).count("make train") == 1


def test_further_recordings_are_stated_for_the_probability_that_they_were_counted_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    further = (FurtherRecordings("the least data", 3, 1, 2),)
    monkeypatch.setattr(results, "packaged", lambda: dataclasses.replace(random_model(), further=further))
    assert results._further(TraceSettings(named_from=0.8)) == further
    assert results._further(TraceSettings(named_from=0.7)) == ()


def test_bodies_are_counted_for_the_probability_that_names_a_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "packaged", random_model)
    assert results._named_bodies(TraceSettings(named_from=0.8)) == random_model().named
    assert results._named_bodies(TraceSettings(named_from=0.7)) == ()


def test_more_data_than_any_training_body_count_as_its_limit() -> None:
    """... and fewer too: no weight of the samples acts beyond the bodies that it was learned from."""
    most, more, fewer, least = (
        features(dataclasses.replace(EVIDENCE, body=dataclasses.replace(BODY, samples=count))).of_body
        for count in (SAMPLES[1], 10.0 * SAMPLES[1], 1.0, SAMPLES[0])
    )
    np.testing.assert_array_equal(most, more)
    np.testing.assert_array_equal(least, fewer)
    assert (most != least).any()


def test_an_effect_without_weights_counts_as_the_mean_of_all() -> None:
    whole = random_model()
    lost = EFFECTS.index("cubic")
    weights = whole.weights
    without = dataclasses.replace(
        weights, effects=(*EFFECTS[:lost], *EFFECTS[lost + 1 :]), of_effects=np.delete(weights.of_effects, lost, axis=0)
    )
    mean = np.where(np.arange(len(EFFECTS))[:, None] == lost, without.of_effects.mean(axis=0), weights.of_effects)
    averaged = dataclasses.replace(weights, of_effects=mean)
    expected = probabilities(EVIDENCE, dataclasses.replace(whole, weights=averaged))
    found = probabilities(EVIDENCE, dataclasses.replace(whole, weights=without))
    np.testing.assert_allclose(found.of_candidates, expected.of_candidates)


def test_the_packaged_model_is_of_this_catalogue() -> None:
    model = probability.packaged()
    assert set(model.weights.effects) <= set(CATALOGUE) and len(model.weights.effects) > 0.9 * len(CATALOGUE)
    assert 0.3 < model.temperature < 5.0 and 0.0 < model.set_threshold < 0.5
    assert model.provenance["bodies"] > 0 and model.provenance["seed"] is not None
    shares = [one.named / one.bodies for one in model.named]
    assert [one.ratio for one in model.named[:2]] == [0.5, 1.0] and min(one.bodies for one in model.named) >= 30
    assert shares[0] < shares[1] < shares[2]  # a stronger effect is named more often
