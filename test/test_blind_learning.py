"""Learning and calibration of the probability model: known weights, known temperatures, labels and folds."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize
from test_probability import EVIDENCE, random_model

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.features import BODY_NAMES, CANDIDATE_NAMES, Features
from biodyn_core.tracing.findings import NamedBodies
from biodyn_core.tracing.probability import NONE, OUTSIDE, learned_from, learned_text, packaged, probabilities
from blind.tracing.ceiling import decision_with_true_laws
from blind.tracing.outcome import Cause
from blind.tracing.reliability import calibration_error
from blind.training import calibrate, collect, learn
from blind.training.calibrate import Learned, Prediction
from blind.training.collect import Example, archive_of, examples, pack
from blind.training.ideal import UNLIKE, IdealDecision
from blind.training.learn import EFFECTS, Design, Labelled, _loss, _Scales, chances, labelled, learned_weights
from blind.training.report import GROUPS, ceiling_lines, group_rows, rendered

FRICTION, CUBIC = Cause("friction", "neck", ""), Cause("cubic", "neck", "")


def example(*causes: Cause, outside: bool = False, ratio: float | None = 2.0, number: int = 0) -> Example:
    hidden = bool(causes) or outside
    forms = tuple(f"{one.name} form" for one in causes) or (("strange form",) if outside else ())
    return Example(number, causes, outside, ratio if hidden else None, forms, {"paper": 1.0}, EVIDENCE)


# --- labels ----------------------------------------------------------------------------------------------------------


def right(label: Labelled, exact: bool = False) -> set[str]:
    names = [*(f"{effect} {site}" for effect, site in label.features.keys), NONE, OUTSIDE]
    return {name for name, good in zip(names, label.exact if exact else label.by_mechanism, strict=True) if good}


def test_a_label_has_the_mechanism_and_the_exact_cause() -> None:
    own, without = labelled(example(CUBIC))
    assert right(own) == {"cubic neck", "stop head"} and right(own, exact=True) == {"cubic neck"}
    assert (own.weight, own.mechanism, own.ratio, own.background) == (1.0, "nonlinear_stiffness", 2.0, ("paper",))
    # Without its mechanism the cause is outside the catalogue.
    assert [key[0] for key in without.features.keys] == ["friction", "clock"]
    assert right(without) == right(without, exact=True) == {OUTSIDE} and without.weight == learn.LEFT_OUT


def test_nothing_and_weak_effects_may_be_none() -> None:
    (idle,) = labelled(example())
    assert right(idle) == {NONE} and (idle.mechanism, idle.ratio) == ("", 0.0)
    weak, without = labelled(example(FRICTION, ratio=0.29))
    assert right(weak) == {"friction neck", NONE} and right(without) == {NONE, OUTSIDE}
    assert right(labelled(example(FRICTION, ratio=0.31))[0]) == {"friction neck"}


def test_two_effects_are_both_right_and_an_untried_one_is_outside() -> None:
    (both,) = labelled(example(FRICTION, CUBIC))
    assert right(both, exact=True) == {"friction neck", "cubic neck"}
    (strange,) = labelled(example(outside=True))
    (untried,) = labelled(example(Cause("skin", "head", "")))
    assert right(strange) == right(untried) == {OUTSIDE} and strange.mechanism == ""


def test_an_unknown_ratio_is_no_number_and_is_not_weak() -> None:
    label, _ = labelled(example(FRICTION, ratio=None))
    (idle,) = labelled(example(ratio=None))
    assert np.isnan(label.ratio) and idle.ratio == 0.0
    assert NONE not in right(label) and right(label) == right(labelled(example(FRICTION))[0])
    assert not any(group.holds(Prediction(label, {}, ())) for group in GROUPS if "ratio" in group.name)


def test_with_the_true_law_the_label_is_the_same_for_other_evidence() -> None:
    friction, *others = EVIDENCE.candidates
    ideal = dataclasses.replace(EVIDENCE, candidates=(dataclasses.replace(friction, general=friction.fit), *others))
    assert learn.labelled_with_true_law(example(FRICTION)) == []
    (found,) = learn.labelled_with_true_law(dataclasses.replace(example(FRICTION), with_true_law=ideal))
    own = labelled(example(FRICTION))[0]
    assert right(found) == right(own) and found.weight == 1.0
    assert (found.features.of_candidates != own.features.of_candidates).any()


def test_a_body_that_cannot_be_traced_has_no_label() -> None:
    assert labelled(dataclasses.replace(example(CUBIC), evidence=None)) == []


# --- learning --------------------------------------------------------------------------------------------------------

COUNT = 6
"""Candidates of a drawn body."""


def drawn(rng: np.random.Generator, truth: np.ndarray, form: int, number: int) -> Labelled:
    """A body whose right answer is drawn by known weights of two features of candidates, and one of the body."""
    effects = rng.choice(EFFECTS, COUNT, replace=False)
    own, body = np.zeros((COUNT, len(CANDIDATE_NAMES))), np.zeros(len(BODY_NAMES))
    own[:, :2], body[0] = rng.normal(size=(COUNT, 2)), rng.normal()
    scores = np.append(own[:, :2] @ truth[:2], [truth[2] * body[0], -1.0])
    p = np.exp(scores) / np.exp(scores).sum()
    answer = np.arange(COUNT + 2) == rng.choice(COUNT + 2, p=p)
    keys = tuple((str(effect), "neck") for effect in effects)
    at = int(np.argmax(answer))
    mechanism = CATALOGUE[keys[at][0]].mechanism if at < COUNT else ""
    forms = () if at == COUNT else (f"form {form}",)
    return Labelled(
        Features(keys, own, body), answer, answer, 1.0, number, forms, (), mechanism, 1.0 if forms else 0.0, 90.0
    )


@pytest.fixture(scope="module")
def bodies() -> list[Labelled]:
    rng, truth = np.random.default_rng(5), np.array([2.0, -1.0, 1.5])
    return [drawn(rng, truth, number % 40, number) for number in range(1500)]


def test_the_gradient_is_that_of_the_loss(bodies: list[Labelled]) -> None:
    design = Design.of(bodies[:30])
    scales = _Scales.of(design)
    point = np.random.default_rng(2).normal(0.0, 0.2, scales.size)
    acting = np.flatnonzero(np.abs(_loss(point, design, scales, 0.0)[1]) > 1e-6)
    moved = np.append(acting[:40], scales.size - 1)

    def partly(values: np.ndarray) -> tuple[float, np.ndarray]:
        whole = point.copy()
        whole[moved] = values
        value, gradient = _loss(whole, design, scales, 0.7)
        return value, gradient[moved]

    numeric = optimize.approx_fprime(point[moved], lambda values: partly(values)[0], 1e-6)
    np.testing.assert_allclose(partly(point[moved])[1], numeric, rtol=1e-3, atol=1e-3)


def test_known_weights_are_recovered(bodies: list[Labelled]) -> None:
    found = learned_weights(Design.of(bodies), 0.3)
    np.testing.assert_allclose(found.of_candidates[:2], [2.0, -1.0], atol=0.25)
    assert found.none[1] == pytest.approx(1.5, abs=0.3)
    assert np.abs(found.of_candidates[2:]).max() < 1e-6  # features that never vary have no weight


def test_chances_ignore_padding(bodies: list[Labelled]) -> None:
    few = dataclasses.replace(
        bodies[0],
        features=dataclasses.replace(
            bodies[0].features, keys=bodies[0].features.keys[:2], of_candidates=bodies[0].features.of_candidates[:2]
        ),
        by_mechanism=np.array([True, False, False, False]), exact=np.array([True, False, False, False]),
    )  # fmt: skip
    weights = learned_weights(Design.of(bodies[:50]), 3.0)
    alone = chances(Design.of([few]), weights)[0]
    padded = chances(Design.of([few, bodies[1]]), weights)[0]
    np.testing.assert_allclose(padded[[0, 1, COUNT, COUNT + 1]], alone)
    assert padded[2:COUNT].max() == 0.0 and alone.sum() == pytest.approx(1.0)


# --- calibration -----------------------------------------------------------------------------------------------------


def test_no_model_answers_a_form_that_it_learned(bodies: list[Labelled], monkeypatch: pytest.MonkeyPatch) -> None:
    learned: list[set[str]] = []

    def noted(design: set[str], ridge: float) -> None:
        learned.append(design)

    monkeypatch.setattr(calibrate, "learned_weights", noted)
    monkeypatch.setattr(calibrate.Design, "of", staticmethod(lambda given: {f for one in given for f in one.forms}))
    bodies = [*bodies, *(dataclasses.replace(one, forms=(*one.forms, "form 3")) for one in bodies[:40])]
    folds = calibrate.every_fold(bodies)
    assert {len(one) for one in folds} == {1, 2}, "two forms may lie in two folds"
    calibrate.cross_weights(bodies, 1.0, folds)
    answered = [{form for one in bodies if calibrate.folds_of(one) == each for form in one.forms} for each in folds]
    assert all(answered) and not any(a & b for a, b in zip(learned, answered, strict=True))
    assert all(a or not b for a, b in itertools.combinations(answered, 2))


def test_too_sure_weights_have_a_temperature(bodies: list[Labelled]) -> None:
    weights = calibrate.cross_weights(bodies, 0.3, calibrate.every_fold(bodies))
    once = calibrate.temperature_of(bodies, weights)
    assert once == pytest.approx(1.0, abs=0.25)
    twice = {
        folds: dataclasses.replace(
            one, of_candidates=2 * one.of_candidates, of_effects=2 * one.of_effects, none=2 * one.none,
            outside=2 * one.outside,
        )
        for folds, one in weights.items()
    }  # fmt: skip
    assert calibrate.temperature_of(bodies, twice) == pytest.approx(2.0 * once, rel=0.01)


def predicted(p: float) -> Prediction:
    """An answer to a body without an effect, with this probability of `none`."""
    (label,) = labelled(example())
    answers = dict(sorted({NONE: p, OUTSIDE: 1.0 - p}.items(), key=lambda item: -item[1]))
    return Prediction(label, answers, (NONE,))


def test_nine_of_ten_right_answers_reach_the_threshold_of_the_set() -> None:
    found = [predicted(p) for p in np.linspace(0.01, 1.0, 100)]
    threshold = calibrate.set_threshold(found)
    assert np.mean([one.p_right >= threshold for one in found]) == pytest.approx(0.91)


@pytest.mark.slow
def test_drawn_bodies_are_calibrated_and_covered(bodies: list[Labelled]) -> None:
    """On bodies that were neither learned from nor calibrated on."""
    model = calibrate.learned(bodies[:1000], [], {}, 0.8).model
    found = calibrate.answers(bodies[1000:], model.weights, model.temperature)
    assert calibration_error([(one.p, one.best in one.right) for one in found]) < 0.06
    covered = np.mean([bool(set(one.likely(model.set_threshold)) & set(one.right)) for one in found])
    assert 0.86 < covered < 0.95


def test_the_decision_with_true_laws_does_not_see_what_gives_a_true_law_away() -> None:
    """A true law is marked by features in which it is unlike a fit; without them the answers are as without marks."""
    labels = [labelled(example(*causes, number=n))[0] for n, causes in enumerate([(FRICTION,), (CUBIC,), ()] * 12)]
    plain = labels[:24]
    marked = []
    for one in plain:
        of_candidates = one.features.of_candidates.copy()
        of_candidates[: one.by_mechanism.size - 2][one.by_mechanism[:-2], CANDIDATE_NAMES.index("evidence gain")] = -3.0
        marked.append(dataclasses.replace(one, features=dataclasses.replace(one.features, of_candidates=of_candidates)))
    without, with_marks = (IdealDecision.of(labels, true).cross_validated() for true in (plain, marked))
    assert [one.labelled.number for one in without] == list(range(24))
    for one, other in zip(without, with_marks, strict=True):
        assert one.answers == other.answers
    assert IdealDecision.of(labels, []).cross_validated() == []


def test_the_stored_decision_with_true_laws_answers_like_the_learned_one() -> None:
    """Though it is asked with all features."""
    labels = [labelled(example(*causes, number=n))[0] for n, causes in enumerate([(FRICTION,), (CUBIC,), ()] * 12)]
    own = IdealDecision.of(labels, labels)
    model = own.model({"bodies": 36}, 0.8)
    read = learned_from(learned_text(model), "a file")
    assert (read.provenance, read.named_from, read.ridge) == ({"bodies": 36}, 0.8, own.ridge)
    (expected,) = own.answers(labels[:1])
    assert probabilities(EVIDENCE, read).of_answers == pytest.approx(dict(expected.answers), rel=1e-3)
    assert 0.0 < model.set_threshold == calibrate.set_threshold(own.cross_validated())


def test_the_decision_of_ceilings_comes_from_the_training_of_the_package() -> None:
    stored = decision_with_true_laws()
    assert (stored.provenance, stored.named_from) == (packaged().provenance, packaged().named_from)
    unlike = [CANDIDATE_NAMES.index(name) for name in UNLIKE]
    assert not stored.weights.of_candidates[unlike].any() and packaged().weights.of_candidates[unlike].any()


def test_named_bodies_are_counted_around_their_ratio() -> None:
    """Within half an octave, one effect of the catalogue, amid a background."""
    label = labelled(example(FRICTION))[0]
    sure, unsure = {"dry_friction": 0.9, NONE: 0.1}, {"dry_friction": 0.7, NONE: 0.3}

    def body(ratio: float, answers: dict[str, float] = sure, **changed: object) -> Prediction:
        return Prediction(dataclasses.replace(label, ratio=ratio, **changed), answers, ("dry_friction",))

    found = [
        body(0.36), body(0.7), body(0.5, unsure), body(0.35), body(0.72), body(1.4), body(1.42, unsure),
        body(0.5, background=()), body(0.5, mechanism=""), body(0.5, forms=("one", "other")),
        body(float("nan")), body(0.0), body(1.0, {"skin": 0.9, NONE: 0.1}),
    ]  # fmt: skip
    assert calibrate.named_bodies(found, 0.8) == (
        NamedBodies(0.5, 3, 2), NamedBodies(1.0, 3, 2), NamedBodies(2.0, 1, 0), NamedBodies(4.0, 0, 0),
    )  # fmt: skip


# --- page and files --------------------------------------------------------------------------------------------------


def test_the_page_counts_answers_by_group() -> None:
    strong, _ = labelled(example(FRICTION))
    (idle,) = labelled(example())
    found = [
        *[Prediction(strong, {"dry_friction": 0.9, NONE: 0.1}, ("dry_friction",))] * 3,
        Prediction(strong, {"skin": 0.85, NONE: 0.15}, ("dry_friction",)),
        Prediction(idle, {"skin": 0.6, NONE: 0.4}, (NONE,)),
    ]
    nowhere = Prediction(dataclasses.replace(strong, ratio=float("nan")), {"skin": 0.9, NONE: 0.1}, ("dry_friction",))
    assert " all, those of no other row included | 6 | 50.0 %" in group_rows([*found, nowhere], 0.3, 0.8)[-1]
    rows = group_rows(found, 0.3, 0.8)
    assert len(rows) == 3 < len(GROUPS)
    assert rows[0].startswith("| nothing hidden, with a background | 1 | 0.0 %") and "2.00 |" in rows[0]
    assert rows[1].startswith("| one effect, with a background, ratio > 0.8 | 4 | 75.0 %")
    true = Prediction(strong, {"dry_friction": 0.95, NONE: 0.05}, ("dry_friction",))
    lines = ceiling_lines(found[3:4], [[true], found[3:4]], 0.8)
    (row,) = [line for line in lines if line.startswith("| 1.5 to 3 | 1 |")]
    assert [cell.split()[0] for cell in row.split("|")[3:-1]] == ["0.0", "100.0", "0.0"] * 2
    assert any(line.startswith("| 0.8 to 1.5 | 0 |") for line in lines)
    page = rendered(Learned(random_model(), found, []), 0.8, [])
    assert "| dry_friction | 4 | dry_friction 3, skin 1 |" in page and "| none | 1 | skin 1 |" in page
    assert "| 0.8 to 0.9 | 1 | 0.85 | 0.0 %" in page and "- bodies: 3" in page


def test_examples_are_packed_and_extended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "examples.jsonl"
    stored = [
        dataclasses.replace(example(CUBIC, number=3), with_true_law=EVIDENCE),
        dataclasses.replace(example(number=1), evidence=None),
    ]
    path.write_text("".join(one.line() + "\n" for one in stored))
    assert examples(path) == [stored[1], stored[0]]
    pack(path)
    assert not path.exists() and archive_of(path).exists() and examples(path) == [stored[1], stored[0]]
    asked: list[int] = []

    def made(numbers: Sequence[int], seed: int) -> list[str]:
        asked.extend(numbers)
        return [example(number=number).line() for number in numbers]

    monkeypatch.setattr(collect, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setattr(collect, "_lines", made)
    collect.collect(range(5), 1, path, 2, lambda text: None)
    assert sorted(asked) == [0, 2, 4] and [one.number for one in examples(path)] == [0, 1, 2, 3, 4]
    pack(path)
    assert [one.number for one in examples(path)] == [0, 1, 2, 3, 4]


def test_a_body_that_stays_unstable_has_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    one = SimpleNamespace(hidden=[np.array([[1.0, np.nan]])], effects=(), ratio=None)
    monkeypatch.setattr(collect, "sittings", lambda numbers, seed, settings: iter([one]))
    (found,) = collect.made([3], 1)
    assert found.evidence is None and found.number == 3
