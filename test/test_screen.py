"""Screening finds what was done to data that another integrator made, and little where nothing was."""

import dataclasses
from functools import cache

import hiding
import numpy as np
import pytest
from hiding import applied
from scipy import signal

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.nuisance_model import Background, Side
from biodyn_core.tracing.rows import Rows
from biodyn_core.tracing.screen import Screening, Tried, candidates, mean_log_ratio, screen

FEW = ("gain", "clock", "skin", "asymmetry", "quadratic_damping", "relaxation", "friction")


def of_names(names: tuple[str, ...]) -> list[Tried]:
    return [one for one in candidates(hiding.events(6))[0] if one.applied.effect.name in names]


@cache
def screening(change=hiding.nothing, law=hiding.plain) -> Screening:
    return screen(hiding.background(change, law), of_names(FEW), 200, 0)


@pytest.mark.parametrize(
    ("change", "law", "name", "site", "least", "times"),
    [
        (hiding.louder, hiding.plain, "gain", "neck", 0.3, 2.0),
        (hiding.later, hiding.plain, "clock", "head", 0.3, 2.0),
        (hiding.on_skin, hiding.plain, "skin", "head", 0.3, 2.0),
        # Theta has taken most of it, and friction behind its bristle, as usual, half of the rest.
        (hiding.nothing, hiding.orifice, "quadratic_damping", "pelvis", 0.01, 1.5),
    ],
)
def test_what_was_hidden_comes_first(change, law, name: str, site: str, least: float, times: float) -> None:
    found = screening(change, law)
    best = found.ladder[0]
    assert (best.tried.applied.effect.name, best.tried.applied.site) == (name, site)
    assert best.gain > least and best.p_value < 0.05
    assert best.gain > times * next(one.gain for one in found.ladder if one.tried.applied.site != site)


def test_the_size_is_that_of_the_truth() -> None:
    best = screening(hiding.louder).ladder[0]
    assert best.size * best.tried.applied.values["gain"] == pytest.approx(0.1, rel=0.1)
    best = screening(hiding.later).ladder[0]
    assert best.size * best.tried.applied.values["delay_s"] == pytest.approx(0.004, rel=0.1)


def test_nothing_hidden_leaves_little_to_gain() -> None:
    found = screening()
    assert found.ladder[0].gain < 0.02 and found.ladder[0].p_value > 0.05
    assert all(0.0 <= one.absorbed <= 1.0 + 1e-9 for one in found.ladder)
    assert [one.gain for one in found.ladder] == sorted((one.gain for one in found.ladder), reverse=True)


def test_the_same_seed_draws_the_same_chance_and_another_one_does_not() -> None:
    tried = of_names(("gain",))
    first, second, other = (screen(hiding.background(hiding.louder), tried, 30, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.chance, second.chance)
    assert [one.gain for one in first.ladder] == [one.gain for one in second.ladder]
    assert (first.chance != other.chance).any() and (np.diff(first.chance) >= 0.0).all()


def test_a_gain_looks_like_itself_turned_round_and_not_like_another_sensors() -> None:
    up, down, other = (
        Tried(applied("gain", site, gain=gain), "gain")
        for site, gain in (("neck", 0.05), ("neck", -0.02), ("pelvis", 0.05))
    )
    found = screen(hiding.background(hiding.louder), [up, down, other], 20, 0)
    assert found.cosine(up, down) == pytest.approx(1.0, abs=1e-4) and found.cosine(up, other) < 0.5
    by_tried = {one.tried.applied.values["gain"] * (1 + (one.tried is other)): one for one in found.ladder}
    assert by_tried[-0.02].gain == pytest.approx(by_tried[0.05].gain, rel=1e-6)
    assert by_tried[-0.02].size == pytest.approx(-2.5 * by_tried[0.05].size, rel=1e-6)


def test_what_theta_can_do_itself_it_absorbs_and_a_sensors_gain_it_does_not() -> None:
    """A mass on the head shifts the modes as frequencies and dampings do."""
    mass, gain = Tried(applied("added_mass", "head"), ""), Tried(applied("gain", "pelvis"), "gain")
    ladder = screen(hiding.background(), [mass, gain], 20, 0).ladder
    absorbed = [next(one.absorbed for one in ladder if one.tried is tried) for tried in (mass, gain)]
    assert absorbed[0] > 0.8 and absorbed[1] < 0.6


def test_a_candidate_that_runs_away_is_not_seen_and_spoils_no_other() -> None:
    (parameter,) = CATALOGUE["cubic"].parameters
    softer = dataclasses.replace(CATALOGUE["cubic"], parameters=(dataclasses.replace(parameter, lower=-1e12),))
    values = {parameter.name: -1e10}
    wild = Tried(dataclasses.replace(applied("cubic", "pelvis"), effect=softer, values=values), parameter.name)
    gain = Tried(applied("gain", "neck"), "gain")
    background = hiding.background(hiding.louder)
    (alone,), both = (screen(background, tried, 20, 0).ladder for tried in ([gain], [wild, gain]))
    assert both[0].tried is gain and both[0].gain == pytest.approx(alone.gain, rel=1e-9)
    assert (both[1].gain, both[1].p_value, both[1].absorbed) == (0.0, 1.0, 1.0)


class _Drawn(Rows):
    """Rows of which what is missed has been drawn."""

    def __init__(self, rows: Rows, drawn: np.ndarray) -> None:
        self.__dict__ |= rows.__dict__
        self._drawn = drawn

    def missed(self, answer: np.ndarray) -> np.ndarray:
        return self._drawn


def drawn(side: Side, rng: np.random.Generator) -> Side:
    """Coloured residuals that are loud where the motion is, and nothing hidden in them."""
    missed = []
    for known in side.known:
        windows, each = known.shape[:2]
        noise = signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal((windows, each // 5, 5)), axis=1)
        loud = np.exp(rng.standard_normal((windows, 1, 1)))
        missed.append((loud * noise).reshape(windows, each))
    rows = tuple(_Drawn(one, y) for one, y in zip(side.rows, missed, strict=True))
    return dataclasses.replace(side, rows=rows, products=side.of(missed))


def test_chance_is_right_about_as_often_as_it_says() -> None:
    """Every gain and clock of five sensors, nothing hidden."""
    rng, background, tried = np.random.default_rng(8), hiding.background(), of_names(("gain", "clock"))
    p_values = []
    for number in range(40):
        sides = {name: drawn(getattr(background, name), rng) for name in ("train", "choose")}
        alike: Background = dataclasses.replace(background, **sides).reweighted()
        p_values.append(screen(alike, tried, 60, number).ladder[0].p_value)
    assert np.count_nonzero(np.array(p_values) <= 0.05) <= 7  # 2 are expected
    assert 0.35 < np.mean(p_values) < 0.65


def test_the_mean_log_ratio_is_over_windows_first_and_events_then() -> None:
    before, event = np.array([8.0, 8.0, 8.0, 8.0, 8.0]), np.array([0, 0, 0, 1, 1])
    after = np.array([[8.0], [4.0], [2.0], [1.0], [8.0]])
    samples = np.array([100.0, 100.0, 100.0, 100.0, 10.0])  # the last window is too short to count
    ln2 = np.log(2.0)
    np.testing.assert_allclose(mean_log_ratio(before, after, event, samples), [0.5 * (ln2 + 3.0 * ln2)])


def test_what_cannot_be_tested_is_named_not_passed_over() -> None:
    made = hiding.events(6)
    tried, untestable = candidates(made)
    assert {name.split(" at ")[0] for name in untestable} == {"bending", "cross_axis", "pitch", "tilt"}
    assert not {one.applied.effect.name for one in tried} & {"bending", "cross_axis", "pitch", "tilt"}
    names = ["seat.x", "seat.y", "seat.rate_x", "seat.rate_y", "head.x", "head.y"]
    names += [f"{upper}.bend_rate_{axis}" for upper in ("neck", "head") for axis in "xy"]
    full = [dataclasses.replace(case, channels=dict.fromkeys(names, case.seat_mps2)) for case in made]
    tried, untestable = candidates(full)
    assert {name.split(" at ")[0] for name in untestable} == {"tilt"}
    assert "tilt at head (lean_x)" in {one.name for one in tried}
    # A channel that one event lacks is not there.
    assert {name.split(" at ")[0] for name in candidates([*full, made[0]])[1]} == {
        "bending", "cross_axis", "pitch", "tilt",
    }  # fmt: skip


def test_what_is_there_already_is_no_candidate() -> None:
    made = hiding.events(6)
    there = applied("stop", "pelvis")
    every, left = (
        [(one.applied.effect.name, one.applied.site) for one in candidates(made, has)[0]] for has in ((), [there])
    )
    assert ("stop", "pelvis") in every
    assert left == [one for one in every if one != ("stop", "pelvis")]
