"""The program that hides faults in measured streams: faults match their notes, and verdicts do not use the truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from world import measured

from blind import measured as study

pytestmark = pytest.mark.usefixtures("shared_data")


@pytest.fixture(scope="module")
def legs() -> measured.Pair:
    return next(pair for pair in measured.pairs() if pair.name.startswith("legs 1 x"))


def hidden(pair: measured.Pair, fault: measured.Fault, seed: int = 0) -> tuple[measured.Pair, float]:
    return measured.faulty(pair, fault, len(pair.reference) // 2, np.random.default_rng(seed))


def test_the_simulation_does_not_import_the_package() -> None:
    assert "biodyn" not in Path(str(measured.__file__)).read_text(encoding="utf-8")


def test_recordings_match_their_notes(legs: measured.Pair) -> None:
    assert legs.rate_hz == 250.0
    assert legs.under_test.shape[0] / legs.rate_hz == pytest.approx(17.3, abs=0.1)
    # SOURCE.txt: running, low-g peaks of 146 m/s^2; gravity right on low-g.
    assert 100.0 < np.abs(legs.under_test).max() < 16.0 * 9.80665
    assert np.linalg.norm(legs.under_test[:100].mean(axis=0)) == pytest.approx(9.8, abs=0.2)
    for pair in measured.pairs():
        assert np.isfinite(pair.reference).all()
        assert np.isfinite(pair.under_test).all()
        assert len(pair.reference) == len(pair.under_test)


def test_without_a_fault_the_stream_is_unchanged(legs: measured.Pair) -> None:
    pair, size = hidden(legs, "none")
    assert size == 0.0
    np.testing.assert_array_equal(pair.under_test, legs.under_test)


@pytest.mark.parametrize("fault", measured.FAULTS)
def test_a_fault_of_a_drawn_size_does_not_change_the_reference(legs: measured.Pair, fault: measured.Fault) -> None:
    limits = {
        "clock": measured.OFFSET_S, "drift": measured.DRIFT, "gain": measured.GAIN,
        "tilt": tuple(np.deg2rad(measured.TILT_DEG)), "skin": measured.POLE_HZ, "saturation": (9.0, 150.0),
    }  # fmt: skip
    for seed in range(5):
        pair, size = hidden(legs, fault, seed)
        np.testing.assert_array_equal(pair.reference, legs.reference)
        assert limits[fault][0] <= abs(size) <= limits[fault][1]
        assert not np.array_equal(pair.under_test, legs.under_test)
        again, same = hidden(legs, fault, seed)
        assert same == size
        np.testing.assert_array_equal(again.under_test, pair.under_test)


def test_each_fault_matches_its_definition() -> None:
    rate_hz, time_s = 250.0, np.arange(2500) / 250.0
    tone = np.column_stack([np.sin(2.0 * np.pi * f * time_s) for f in (3.0, 5.0, 8.0)])
    inner = slice(250, -250)

    later = measured.late(tone, rate_hz, np.full(2500, 0.0033))
    np.testing.assert_allclose(later[inner, 2], np.sin(16.0 * np.pi * (time_s - 0.0033))[inner], atol=2e-3)
    drifting = measured.late(tone, rate_hz, 3e-4 * time_s)
    np.testing.assert_allclose(drifting[inner, 2], np.sin(16.0 * np.pi * time_s * (1.0 - 3e-4))[inner], atol=2e-3)

    leaning = measured.turned(tone, 0.1, 0.7)
    np.testing.assert_allclose(np.linalg.norm(leaning, axis=1), np.linalg.norm(tone, axis=1))
    upright = measured.turned(np.array([[0.0, 0.0, 1.0]]), 0.1, 0.7)
    assert np.arccos(upright[0, 2]) == pytest.approx(0.1)

    lag = 1.0 / (1.0 + 1j * 8.0 / 20.0)
    soft = measured.soft(tone, rate_hz, 20.0)[:, 2]
    expected = np.imag(lag * np.exp(16j * np.pi * time_s))
    np.testing.assert_allclose(soft[inner], expected[inner], atol=5e-3)

    np.testing.assert_array_equal(measured.clipped(tone, 0.5), np.clip(tone, -0.5, 0.5))


def test_records_repeat_with_the_seed_without_the_truth() -> None:
    records, truths = measured.records(20, 5)
    again, same = measured.records(20, 5)
    assert sum(truth.fault == "none" for truth in truths) == 6
    assert {truth.fault for truth in truths} == {"none", *measured.FAULTS}
    assert {field.name for field in dataclasses.fields(measured.Record)} == {"name", "earlier", "later"}
    for one, other, truth, its in zip(records, again, truths, same, strict=True):
        assert (one.name, truth.fault, truth.size) == (other.name, its.fault, its.size)
        np.testing.assert_array_equal(one.later.under_test, other.later.under_test)
        changed = not np.array_equal(one.later.under_test[:, 2], truth.clean_mps2)
        assert changed == (truth.fault != "none")
        assert len(one.earlier.reference) / one.earlier.rate_hz >= measured.STRETCH_S[0] - 0.01


@pytest.mark.slow
def test_most_faults_above_the_background_are_named() -> None:
    graded = study.run(24, 3)
    large = [one for one in graded if one.fault != "none" and one.ratio >= study.RATIOS[1]]
    assert len(large) >= 3
    assert np.mean([one.within for one in large]) > 0.7
    sound = [one for one in graded if one.fault == "none"]
    assert all(one.ratio == 0.0 for one in sound)
    assert sum(one.found.verdict in ("effect", "ambiguous") for one in sound) <= 1
    counted = study.counts(graded)
    assert sum(count.of for count in counted if count.fault != "any") == len(graded)
    assert all(c.of == c.among + c.wrong + c.none + c.unexplained + c.not_decidable for c in counted)
    assert len(study.table(graded)) == 1 + len(counted)
