"""Screening of data from another integrator, with and without a hidden effect."""

import dataclasses
from functools import cache

import hiding
import numpy as np
import pytest
from hiding import applied
from scipy import signal

from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import predict
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.candidate import Candidate
from biodyn_core.tracing.nuisance_model import EventSet, NuisanceModel
from biodyn_core.tracing.reach import Reach
from biodyn_core.tracing.rows import Rows
from biodyn_core.tracing.screen import Screening, all_candidates, mean_log_ratio, screen, starts, untestable

FEW = ("gain", "clock", "skin", "asymmetry", "quadratic_damping", "relaxation", "friction")


def of_names(names: tuple[str, ...]) -> list[Candidate]:
    return [one for one in all_candidates(hiding.TRUTH, hiding.events(6)) if one.start.effect.name in names]


@cache
def screening(change=hiding.nothing, law=hiding.plain) -> Screening:
    return screen(hiding.nuisance(change, law), of_names(FEW), 60, 0)


@pytest.mark.parametrize(
    ("change", "law", "name", "site", "least", "times"),
    [
        (hiding.louder, hiding.plain, "gain", "neck", 0.3, 2.0),
        pytest.param(hiding.later, hiding.plain, "clock", "head", 0.3, 2.0, marks=pytest.mark.slow),
        pytest.param(hiding.on_skin, hiding.plain, "skin", "head", 0.3, 2.0, marks=pytest.mark.slow),
        # Theta explains most of it, and typical friction half of the rest.
        (hiding.nothing, hiding.orifice, "quadratic_damping", "pelvis", 0.01, 1.5),
    ],
)
def test_a_hidden_effect_ranks_first(change, law, name: str, site: str, least: float, times: float) -> None:
    found = screening(change, law)
    best = found.ranking[0]
    assert best.key == (name, site)
    assert best.screened.gain > least and best.screened.p_value < 0.05
    rivals = [one for one in found.ranking if one.start.site != site]
    assert best.screened.gain > times * next(one.screened.gain for one in rivals if one.start.is_textbook)


def test_the_size_is_the_true_one() -> None:
    best = screening(hiding.louder).ranking[0]
    assert best.screened.size * best.start.values["gain"] == pytest.approx(0.1, rel=0.1)
    best = screening(hiding.later).ranking[0]
    assert best.screened.size * best.start.values["delay_s"] == pytest.approx(0.004, rel=0.1)


def test_gains_are_small_without_a_hidden_effect() -> None:
    found = screening()
    assert found.ranking[0].screened.gain < 0.02 and found.ranking[0].screened.p_value > 0.05
    assert all(0.0 <= one.screened.absorbed <= 1.0 + 1e-9 for one in found.ranking)
    assert [one.screened.gain for one in found.ranking] == sorted(
        (one.screened.gain for one in found.ranking), reverse=True
    )


def test_random_draws_repeat_with_the_seed() -> None:
    tried = of_names(("gain",))
    first, second, other = (screen(hiding.nuisance(hiding.louder), tried, 30, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.chance, second.chance)
    assert [one.screened.gain for one in first.ranking] == [one.screened.gain for one in second.ranking]
    assert (first.chance != other.chance).any() and (np.diff(first.chance) >= 0.0).all()


def test_a_gain_gains_as_much_as_its_negative() -> None:
    tried = [Candidate(applied("gain", site, gain=gain), "gain") for site, gain in (("neck", 0.05), ("neck", -0.02))]
    found = screen(hiding.nuisance(hiding.louder), tried, 20, 0)
    up, down = found.candidates
    assert down.screened.gain == pytest.approx(up.screened.gain, rel=1e-6)
    assert down.screened.size == pytest.approx(-2.5 * up.screened.size, rel=1e-6)


def test_theta_absorbs_a_mass_and_not_a_sensor_gain() -> None:
    """A mass on the head shifts the modes as frequencies and dampings do."""
    tried = [Candidate(applied("added_mass", "head"), ""), Candidate(applied("gain", "pelvis"), "gain")]
    mass, gain = screen(hiding.nuisance(), tried, 20, 0).candidates
    assert mass.screened.absorbed > 0.8 and gain.screened.absorbed < 0.6


def test_an_unstable_candidate_has_no_gain_and_does_not_change_others() -> None:
    parameter, *general = CATALOGUE["cubic"].parameters
    changed = dataclasses.replace(parameter, lower=-1e12)
    softer = dataclasses.replace(CATALOGUE["cubic"], parameters=(changed, *general))
    values = {parameter.name: -1e10}
    wild = Candidate(dataclasses.replace(applied("cubic", "pelvis"), effect=softer, values=values), parameter.name)
    gain = Candidate(applied("gain", "neck"), "gain")
    nuisance = hiding.nuisance(hiding.louder)
    (alone,), both = (screen(nuisance, tried, 20, 0).ranking for tried in ([gain], [wild, gain]))
    assert both[0].start is gain.start
    assert both[0].screened.gain == pytest.approx(alone.screened.gain, rel=1e-9)
    unseen = both[1].screened
    assert (unseen.gain, unseen.p_value, unseen.absorbed) == (0.0, 1.0, 1.0)


class _Drawn(Rows):
    """Rows with a random residual."""

    def __init__(self, rows: Rows, drawn: np.ndarray) -> None:
        self.__dict__ |= rows.__dict__
        self._drawn = drawn

    def residual(self, answer: np.ndarray) -> np.ndarray:
        return self._drawn


def drawn(events: EventSet, rng: np.random.Generator) -> EventSet:
    """Coloured residuals that follow the motion, without a hidden effect."""
    residuals = []
    for known in events.known:
        windows, each = known.shape[:2]
        noise = signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal((windows, each // 5, 5)), axis=1)
        loud = np.exp(rng.standard_normal((windows, 1, 1)))
        residuals.append((loud * noise).reshape(windows, each))
    rows = tuple(_Drawn(one, y) for one, y in zip(events.rows, residuals, strict=True))
    return dataclasses.replace(events, rows=rows, products=events.products_of(residuals))


def test_p_values_are_uniform_without_a_hidden_effect() -> None:
    """Every gain of five sensors, without a hidden effect."""
    rng, nuisance, tried = np.random.default_rng(8), hiding.nuisance(), of_names(("gain",))
    p_values = []
    for number in range(40):
        event_sets = {name: drawn(getattr(nuisance, name), rng) for name in ("train", "choose")}
        alike: NuisanceModel = dataclasses.replace(nuisance, **event_sets).reweighted(2)
        p_values.append(screen(alike, tried, 60, number).ranking[0].screened.p_value)
    assert np.count_nonzero(np.array(p_values) <= 0.05) <= 7  # 2 are expected
    assert 0.35 < np.mean(p_values) < 0.65


def test_the_mean_log_ratio_averages_windows_then_events() -> None:
    before, event = np.array([8.0, 8.0, 8.0, 8.0, 8.0]), np.array([0, 0, 0, 1, 1])
    after = np.array([[8.0], [4.0], [2.0], [1.0], [8.0]])
    counted = np.array([True, True, True, True, False])
    windows = dataclasses.replace(hiding.nuisance().choose.products, event=event, counted=counted)
    ln2 = np.log(2.0)
    np.testing.assert_allclose(mean_log_ratio(before, after, windows), [0.5 * (ln2 + 3.0 * ln2)])


def test_untestable_effects_are_listed() -> None:
    made = hiding.events(6)
    tried = all_candidates(hiding.TRUTH, made)
    assert {name.split(" at ")[0] for name in untestable(made)} == {"bending", "cross_axis", "pitch", "tilt"}
    assert not {one.start.effect.name for one in tried} & {"bending", "cross_axis", "pitch", "tilt"}
    names = ["seat.x", "seat.y", "seat.rate_x", "seat.rate_y", "head.x", "head.y"]
    names += [f"{upper}.bend_rate_{axis}" for upper in ("neck", "head") for axis in "xy"]
    full = [dataclasses.replace(case, channels=dict.fromkeys(names, case.seat_mps2)) for case in made]
    tried = all_candidates(hiding.TRUTH, full)
    assert {name.split(" at ")[0] for name in untestable(full)} == {"tilt"}
    assert ("tilt", "head", "lean_x") in {(*one.key, one.strength) for one in tried}
    # A channel has to be in every event.
    assert {name.split(" at ")[0] for name in untestable([*full, made[0]])} == {
        "bending", "cross_axis", "pitch", "tilt",
    }  # fmt: skip


def test_a_present_effect_is_no_candidate() -> None:
    made = hiding.events(6)
    there = applied("stop", "pelvis")
    subjects = [dataclasses.replace(hiding.TRUTH, effects=has) for has in ((), (there,))]
    every, left = ([one.key for one in all_candidates(subject, made)] for subject in subjects)
    assert ("stop", "pelvis") in every
    assert left == [one for one in every if one != ("stop", "pelvis")]


def test_starts_of_a_gap_lie_within_the_reach_of_the_joint() -> None:
    made = hiding.events(6)
    responses = [predict(hiding.TRUTH, case.seat_mps2, case.rate_hz, case.channels) for case in made]
    below = [np.column_stack([np.zeros(len(one.seat_mps2)), one.displacement_m[:, :-1]]) for one in responses]
    reach = Reach.of(hiding.TRUTH, made)
    for joint, site in enumerate(SEGMENTS):
        gaps = [start.values["gap_m"] for _, start in starts(CATALOGUE["stop"], site, reach)]
        stretches = [one.displacement_m[:, joint] - low[:, joint] for one, low in zip(responses, below, strict=True)]
        assert len(set(gaps)) == 3 and 0.0 < min(gaps) < max(gaps) < max(np.abs(one).max() for one in stretches)
        assert reach.at(CATALOGUE["harness"], site) >= reach.stretch_m[joint] * (joint == 0)
