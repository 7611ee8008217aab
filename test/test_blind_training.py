"""Bodies for training the evidence of tracing: the laws of their draw, and their simulation."""

import dataclasses
import itertools
from collections import Counter
from functools import cache
from types import SimpleNamespace

import hiding
import numpy as np
import pytest
from blind_answers import SUBJECT
from world import ride
from world.effects import mixture
from world.effects.draw import forms

from biodyn_core.tracing import trace
from biodyn_core.tracing.settings import TraceSettings
from blind.tracing.records import Record
from blind.tracing.rows import KINDS
from blind.training import traced
from blind.training.draw import OUTSIDE, TrainingBody, TrainingSettings, drawn, sittings

COUNT = 1500
SEED = 7
SENSOR_KINDS = ("skin", "tilt", "clock", "gain", "saturation")
TINY = TrainingSettings(
    counts=((1, 1), (0, 0), (0, 0)), seconds=((0.2, 0.3),) * 3, uses=("fit",), recorded=False,
    background=("paper", "hysteresis"), bare=0.3, two=0.0, outside=0.0, kinds=("added_mass", "backrest"),
)  # fmt: skip


@cache
def bodies() -> list[TrainingBody]:
    return [drawn(number, SEED) for number in range(COUNT)]


def near(share: float, count: int = COUNT) -> object:
    """A share of a count of draws, within four standard errors."""
    return pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / count))


def same(one: TrainingBody, other: TrainingBody) -> bool:
    return repr(one) == repr(other)


def test_a_body_depends_on_seed_and_number_alone() -> None:
    assert all(same(drawn(number, SEED), bodies()[number]) for number in (1499, 3, 700))
    assert not same(drawn(3, SEED + 1), bodies()[3])
    assert len({one.ratio for one in bodies()}) > 0.7 * COUNT


def test_shares_are_as_stated() -> None:
    s = TrainingSettings()
    counts = Counter(len(one.effects) for one in bodies())
    assert [counts[n] / COUNT for n in (0, 2)] == [near(s.nothing), near(s.two)]
    outside = [one for one in bodies() if any(effect.kind == OUTSIDE for effect in one.effects)]
    assert len(outside) / COUNT == near(s.outside) and all(len(one.effects) == 1 for one in outside)
    assert sum(bool(one.missing) for one in bodies()) / COUNT == near(s.missing)
    assert np.mean([not any(one.scales.values()) for one in bodies()]) == near(s.bare)


def test_classes_are_even_and_forms_even_among_both_splits() -> None:
    single = [one.effects[0] for one in bodies() if len(one.effects) == 1 and one.effects[0].kind != OUTSIDE]
    counts = Counter(effect.kind for effect in single)
    assert set(counts) == set(KINDS)
    assert all(counts[kind] / len(single) == near(1.0 / len(KINDS), len(single)) for kind in KINDS)
    every = [effect for one in bodies() for effect in one.effects]
    assert {type(effect) for effect in every} >= {
        form for split in TrainingSettings().splits for form in forms(split) if form.kind in (*KINDS, OUTSIDE)
    }
    assert {type(effect).__module__.split(".")[-1] for effect in every} == {
        "development_forms", "second_forms", "earlier_forms",
    }  # fmt: skip
    clocks = [type(effect).__name__ for effect in every if effect.kind == "clock"]
    assert Counter(clocks)["JumpingClock"] / len(clocks) == near(1.0 / 3.0, len(clocks))
    for one in bodies():
        assert len({effect.kind for effect in one.effects}) == len(one.effects)


def test_ratios_and_noise_are_log_uniform_and_plans_vary() -> None:
    s = TrainingSettings()
    ratios, noise = [one.ratio for one in bodies() if one.ratio is not None], [one.noise for one in bodies()]
    assert all((one.ratio is None) == (not one.effects) for one in bodies())
    for values, (low, high) in ((ratios, s.ratio), (noise, s.noise)):
        places = np.log(np.array(values) / low) / np.log(high / low)
        assert places.min() >= 0.0 and places.max() <= 1.0
        np.testing.assert_allclose(np.quantile(places, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.06)
    every = itertools.product(*(range(least, most + 1) for least, most in s.counts))
    assert {one.plan.counts for one in bodies()} == set(every)
    for case, (low, high) in enumerate(s.seconds):
        found = [one.plan.seconds[case] for one in bodies()]
        assert low <= min(found) < max(found) <= high and np.std(found) == pytest.approx(
            (high - low) / 12**0.5, rel=0.1
        )


def test_a_missing_sensor_is_on_the_body_and_not_that_of_an_effect() -> None:
    settings = TrainingSettings(missing=1.0, two=0.5, nothing=0.1)
    found = [drawn(number, SEED, settings) for number in range(300)]
    assert {one.missing for one in found} == set(ride.WORN) - {"seat"}
    for one in found:
        changed = {effect.site for effect in one.effects if effect.kind in SENSOR_KINDS}
        assert ride.SENSORS.index(one.missing) not in changed


def test_simulated_bodies_have_their_facts_and_do_not_depend_on_the_others(no_rest: None) -> None:
    numbers = [next(n for n in range(50) if bool(drawn(n, SEED, TINY).effects) == hides) for hides in (True, False)]
    busy, idle = sittings(numbers, SEED, TINY)
    (alone,) = sittings(numbers[1:], SEED, TINY)
    (without,) = sittings(numbers[:1], SEED, dataclasses.replace(TINY, nothing=1.0))
    for one, number in ((busy, numbers[0]), (idle, numbers[1])):
        body = drawn(number, SEED, TINY)
        assert one.truth()["background"] == body.scales and one.level == body.scales[mixture.PAPER]
        assert [type(e) for e in one.effects] == [type(e) for e in body.effects]
        assert (one.ratio is None) == (body.ratio is None)
        assert set(one.streams(0)) == set(ride.WORN) - {body.missing}
        assert one.mechanisms[-1].added_mps2 > 0.0
    np.testing.assert_array_equal(busy.theta, without.theta)
    assert np.abs(busy.hidden[0] - without.hidden[0]).max() > 0.0
    np.testing.assert_array_equal(idle.theta, alone.theta)
    np.testing.assert_allclose(idle.hidden[0], alone.hidden[0], atol=1e-9 * np.abs(alone.hidden[0]).max())
    np.testing.assert_allclose(idle.streams(0)["head"][1], alone.streams(0)["head"][1], atol=2e-2)


def test_a_body_without_a_sensor_has_no_stream_of_it(no_rest: None) -> None:
    settings = TrainingSettings(
        counts=((1, 1), (0, 0), (0, 0)), seconds=((0.2, 0.2),) * 3, uses=("fit",), recorded=False, nothing=1.0, two=0.0,
        outside=0.0, missing=1.0, bare=1.0,
    )  # fmt: skip
    (one,) = sittings([4], SEED, settings)
    missing = drawn(4, SEED, settings).missing
    assert missing and set(one.streams(0)) == set(ride.WORN) - {missing}


def test_a_body_is_searched_like_a_record_of_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """... with its own theta, and without stored results."""
    monkeypatch.setattr(trace, "fit_joint", lambda train, subject, *rest: SimpleNamespace(subject=SUBJECT))
    monkeypatch.setattr(traced, "search", lambda before, *rest: before)
    train, held_out = hiding.events(2), hiding.events(2)
    record = Record(dataclasses.replace(SUBJECT, name="middle"), train, held_out)
    monkeypatch.setattr(traced.data_checks, "usable", lambda *cases: (train, held_out, ()))
    assert traced.searched(record, TraceSettings()) is SUBJECT
    monkeypatch.setattr(traced.data_checks, "usable", lambda *cases: (train, (), ()))
    assert traced.searched(record, TraceSettings()) is None
