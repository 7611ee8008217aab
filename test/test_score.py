"""Held-out scores: of events, not of samples, and signed by who predicts better."""

import dataclasses

import fitting
import numpy as np
import pytest

from biodyn_core.tracing.score import EventScore, Score, ScoreSettings, score

TRUTH = fitting.true_subjects()["segment"]
CASES = fitting.true_cases("segment")


def off(subject, share: float):
    """A subject whose natural frequencies are off."""
    p = subject.parameters
    return dataclasses.replace(
        subject, parameters=dataclasses.replace(p, natural_frequency_hz=p.natural_frequency_hz * (1.0 + share))
    )


def test_twice_the_residual_is_the_log_of_four() -> None:
    """Where the model is the truth, the residual is what is added to the measurement."""
    noise = [0.1 * np.random.default_rng(n).standard_normal(case.measured_mps2.shape) for n, case in enumerate(CASES)]
    made = [
        dataclasses.replace(case, measured_mps2=case.measured_mps2 + added)
        for case, added in zip(CASES, noise, strict=True)
    ]
    found = score(TRUTH, TRUTH, made, "trusted")
    assert found.mean == 0.0 and not found.agrees
    squares = [
        float((added[case.compared.any(axis=1)] ** 2 / case.energy).sum())
        for case, added in zip(CASES, noise, strict=True)
    ]
    for event, square in zip(found.events, squares, strict=True):
        assert event.before == event.after == pytest.approx(square, rel=0.01)


def test_who_predicts_better_has_the_positive_sign_in_every_event() -> None:
    better = score(off(TRUTH, 0.06), off(TRUTH, 0.02), CASES)
    worse = score(off(TRUTH, 0.02), off(TRUTH, 0.06), CASES)
    assert better.agrees and all(event.mean_log_ratio > 0.0 for event in better.events)
    assert worse.mean == pytest.approx(-better.mean, rel=1e-12) and not worse.agrees
    # Three times as far off, nine times the square.
    assert better.mean == pytest.approx(np.log(9.0), rel=0.15)


def test_every_event_counts_alike_whatever_its_length_and_level() -> None:
    twice = [dataclasses.replace(CASES[0], energy=0.01 * CASES[0].energy), *CASES[1:]]
    assert score(off(TRUTH, 0.06), TRUTH, twice).mean == pytest.approx(score(off(TRUTH, 0.06), TRUTH, CASES).mean)


def test_a_missing_segment_counts_nowhere() -> None:
    case = CASES[1]
    compared, energy = case.compared.copy(), case.energy.copy()
    compared[:, 0], energy[0] = False, 0.0
    partly = dataclasses.replace(case, compared=compared, energy=energy, measured_mps2=case.measured_mps2 * compared)
    found = score(off(TRUTH, 0.06), off(TRUTH, 0.02), [partly]).events[0]
    assert found.mean_log_ratio > 0.0 and np.isfinite([found.before, found.after]).all()


@pytest.mark.parametrize(
    ("events", "agrees"),
    [
        ([("road", 1.0)], False),
        ([("road", 1.0), ("road", 0.1)], False),
        ([("road", 1.0), ("rail", 0.1)], True),
        ([("road", 1.0), ("rail", -0.1)], False),
        ([("road", 0.1), ("road", 0.1), ("road", 0.2), ("rail", -3.0)], True),
    ],
)
def test_one_shock_alone_convinces_nobody(events, agrees: bool) -> None:
    found = Score(tuple(EventScore(f"{n}", case, ratio, 1.0, 1.0) for n, (case, ratio) in enumerate(events)))
    assert found.agrees is agrees


def test_settings_are_checked() -> None:
    with pytest.raises(Exception, match="window_s is 0"):
        ScoreSettings(window_s=0.0)
