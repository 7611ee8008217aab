"""The kinds of background of the independent simulation: each law, its size, and that none makes a body unstable."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from shaking import KNOWN, after, made, moment, person, shaken
from world import seats, sensors
from world.effects import background, mixture, sitting
from world.effects.event import HELD_HZ
from world.effects.mechanism import Mechanism
from world.effects.mixture import CHANGES, LEVELS, PAPER
from world.effects.moving import Party, moved
from world.effects.sensor_mechanisms import MOST_LEAN_RAD, SensorNoise
from world.effects.sitting import Plan

BODIES = 3
IN_BODY = tuple(kind for kind, mechanism in KNOWN.items() if mechanism.in_body)
IN_SENSORS = tuple(kind for kind in KNOWN if kind not in IN_BODY)
PASSIVE = ("hysteresis", "relaxation", "sprung_masses", "two_joints", "power_law", "fluid_flow")
GROUPS = {"all": mixture.KINDS, "all unseen": mixture.UNSEEN}
SHORT = Plan(counts=(1, 0, 0), seconds=(0.3, 0.3, 0.3), uses=("fit",), recorded=False)


# --- laws of the body ------------------------------------------------------------------------------------------------


def test_hysteresis_ends_at_its_yield_force() -> None:
    one = made("hysteresis")
    force, rates = after(one, 0.0, 0.2, np.ones(6))
    np.testing.assert_allclose(force, one.yield_n)
    np.testing.assert_allclose(rates, 0.0, atol=1e-12)


def test_relaxation_is_stiff_at_once_and_absent_in_the_long_run() -> None:
    one = made("relaxation")
    force, rates = after(one, 0.01, 0.0, np.zeros(12))
    np.testing.assert_allclose(force, 0.01 * (one.fast_n_per_m + one.slow_n_per_m))
    np.testing.assert_allclose(rates, 0.01 / np.append(one.fast_s, one.slow_s))
    force, rates = after(one, 0.01, 0.0, np.full(12, 0.01))
    assert not force.any() and not rates.any()


def test_softening_and_drift_leave_every_joint_stiff() -> None:
    for number in range(20):
        most, k = LEVELS[1], person(number).stiffness_n_per_m
        soft, drift = made("softening", most, number), made("drift", most, number)
        force, rates = after(soft, 0.01, 0.0, np.ones(6))
        assert (force < 0.0).all() and (k * 0.01 + force > 0.39 * k * 0.01).all()
        assert (rates < 0.0).all()  # rest builds the structure up again
        force, _ = after(drift, 0.01, 0.0, np.zeros(0))
        assert (np.abs(force) <= 0.5 * k * 0.01).all()


def test_sprung_masses_follow_slow_motion_and_are_on_some_segments() -> None:
    one = made("sprung_masses")
    assert 1 < np.count_nonzero(one.mass_kg) < 5
    now = moment(np.full((1, 6), 1e-3), np.zeros((1, 6)))
    carried = np.append(now.x[0], np.zeros(6))[None]
    rates = one.act(now, carried)
    assert not now.up_n.any() and not rates.any()


def test_horizontal_motion_presses_with_its_share_of_inertia() -> None:
    one, happens = made("horizontal"), shaken()
    steady = dataclasses.replace(happens, accel_mps2=np.tile([1.0, 0.0, 0.0], (3 * round(seats.RATE_HZ), 1)))
    np.testing.assert_allclose(one.signals(steady)[-1], one.across_kg[:, 0], rtol=1e-3)


@pytest.mark.parametrize("kind", PASSIVE)
def test_passive_mechanisms_never_give_energy(kind: str) -> None:
    """From rest the work done on them is never negative, along a path of three tones."""
    one, step_s = made(kind, LEVELS[1]), 2e-4
    tones = 2.0 * np.pi * np.random.default_rng(1).uniform(2.0, 20.0, (3, 6))
    own, done, work = np.zeros((1, one.states)), 0.0, []
    for t in np.arange(0.0, 0.4, step_s):
        now = moment(1e-3 * np.sin(tones * t).sum(axis=0)[None], 1e-3 * (tones * np.cos(tones * t)).sum(axis=0)[None])
        rates = one.act(now, own)
        own = own if rates is None else own + step_s * rates
        done += step_s * ((now.joint_n * now.rate).sum() - (now.up_n * now.v).sum())
        work.append(done)
    assert max(work) > 0.0 and min(work) > -0.02 * max(work)


# --- bodies ----------------------------------------------------------------------------------------------------------


@cache
def accelerations() -> dict[tuple[str, float], list[np.ndarray]]:
    """Accelerations (n, 6) of some bodies: plain, with each kind at scale 1 and at most, and with groups at most."""
    single = ((kind, scale) for kind in (PAPER, *IN_BODY) for scale in (1.0, LEVELS[1]))
    choices = [("", 0.0), *single, *((group, LEVELS[1]) for group in GROUPS)]
    parties = []
    for kind, scale in choices:
        kinds = GROUPS.get(kind, (kind,))
        for number in range(BODIES):
            who, rng = person(number), np.random.default_rng(number)
            behind = background.drawn(who, scale, rng) if PAPER in kinds else background.NOTHING
            mechanisms = mixture.mechanisms(who, dict.fromkeys(set(kinds) & set(KNOWN), scale), [number])
            parties.append(Party(who, [shaken()], (), behind, mechanisms))
    found = [one.accel_mps2[0] for one in moved(parties)]
    return {choice: found[i * BODIES : (i + 1) * BODIES] for i, choice in enumerate(choices)}


def heard(kind: str, scale: float, number: int) -> np.ndarray:
    """Vertical accelerations (n, 6) of faultless sensors on a body with one kind, gravity left out."""
    plain, happens = accelerations()[("", 0.0)][number], shaken()
    if kind in IN_SENSORS:
        one = made(kind, scale, number)
        up = [np.column_stack([happens.accel_mps2[::2, :2], plain[:, i]]) for i in range(6)]
        felt = [one.sensor_acceleration(i + 1, happens, a) for i, a in enumerate(up)]
        return np.column_stack([read(one, i + 1, a) for i, a in enumerate(felt)])
    return accelerations()[(kind, scale)][number]


def read(one: Mechanism, sensor: int, accel_mps2: np.ndarray) -> np.ndarray:
    """The vertical (n,) by the clock and the digits of a sensor."""
    time_s = np.arange(len(accel_mps2)) / HELD_HZ
    late_s = one.clock_late_s(sensor, shaken(), time_s)
    gravity = np.array([0.0, 0.0, sensors.GRAVITY_MPS2])
    force = np.column_stack([np.interp(time_s - late_s, time_s, axis) for axis in accel_mps2.T]) + gravity
    return (one.reading(sensor, force) - gravity)[:, 2]


@pytest.mark.parametrize("kind", [*mixture.KINDS, *mixture.UNSEEN])
def test_each_kind_changes_the_stated_share_of_the_answer(kind: str, no_rest: None) -> None:
    shares = {}
    for scale in (1.0, LEVELS[1]):
        plain = [accelerations()[("", 0.0)][number] for number in range(BODIES)]
        changes = [heard(kind, scale, number) - one for number, one in enumerate(plain)]
        shares[scale] = [np.linalg.norm(a) / np.linalg.norm(b) for a, b in zip(changes, plain, strict=True)]
    low, high = CHANGES[kind]
    assert low < np.median(shares[1.0]) < high, shares
    assert max(shares[LEVELS[1]]) < 3.0 * high
    assert np.median(shares[LEVELS[1]]) > 1.2 * np.median(shares[1.0])


@pytest.mark.parametrize("kind", [PAPER, *IN_BODY, *GROUPS])
def test_no_kind_makes_a_body_run_away(kind: str, no_rest: None) -> None:
    """At the largest scale a strong shock is not amplified beyond all measure, and dies away after it."""
    for plain, one in zip(accelerations()[("", 0.0)], accelerations()[(kind, LEVELS[1])], strict=True):
        assert np.abs(one).max() < 3.0 * np.abs(plain).max()
        assert np.abs(one[-400:]).max() < 0.5 * np.abs(one).max()


def test_bodies_moved_together_keep_their_own_mechanisms(no_rest: None) -> None:
    kinds = {"hysteresis": 1.0, "horizontal": 1.0, "sprung_masses": 1.0, "drift": 1.0}
    few = {"drift": 2.0, "hysteresis": 0.5}
    happens, other = shaken(0.2, 0.0), shaken(0.15, 0.0)
    parties = [
        Party(person(number), events, mechanisms=mixture.mechanisms(person(number), scales, [number]))
        for number, (events, scales) in enumerate([([happens, other], kinds), ([other], {}), ([other, happens], few)])
    ]
    for one, alone in zip(moved(parties), (moved([party])[0] for party in parties), strict=True):
        for found, expected in zip(one.accel_mps2, alone.accel_mps2, strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_drifted_stiffness_is_that_of_a_stiffer_person(no_rest: None) -> None:
    who, drift = person(), made("drift", LEVELS[1])
    happens = dataclasses.replace(
        shaken(0.2, 0.0), begin_s=8e5, whole_s=1e6
    )  # of a sitting so long that it stands still
    free = drift.slope * 0.6 + drift.wave * np.sin(1.6 * np.pi + drift.phase_rad)
    factor = 1.0 + 0.5 * np.tanh(free / 0.5)
    twin = dataclasses.replace(
        who, stiffness_n_per_m=factor * who.stiffness_n_per_m, stiffening_per_m=who.stiffening_per_m / factor
    )
    found, expected = moved([Party(who, [happens], mechanisms=(drift,)), Party(twin, [happens])])
    scale = np.abs(expected.accel_mps2[0]).max()
    np.testing.assert_allclose(found.accel_mps2[0], expected.accel_mps2[0], atol=1e-5 * scale)


# --- sensors ---------------------------------------------------------------------------------------------------------


def test_the_coherent_filter_is_linear_causal_and_spares_the_seat() -> None:
    one, happens = made("coherent_filter"), shaken()
    nothing = np.zeros((len(happens.accel_mps2[::2]), 3))
    twice = dataclasses.replace(happens, accel_mps2=2.0 * happens.accel_mps2)
    added = one.sensor_acceleration(6, happens, nothing)
    np.testing.assert_allclose(one.sensor_acceleration(6, twice, nothing), 2.0 * added, atol=1e-12)
    assert not one.sensor_acceleration(0, happens, nothing).any()
    struck = dataclasses.replace(happens, accel_mps2=np.where(np.arange(len(nothing) * 2 - 1) == 200, 1.0, 0.0)[:, None]
                                 * np.array([0.0, 0.0, 1.0]))  # fmt: skip
    response = one.sensor_acceleration(6, struck, nothing)[:, 2]
    np.testing.assert_allclose(response[:100], 0.0, atol=1e-12)
    np.testing.assert_allclose(response[100 : 100 + one.taps.shape[1]], one.taps[6], atol=1e-12)


def test_noise_repeats_within_an_event_and_differs_between_events_and_sensors(no_rest: None) -> None:
    happens = shaken(4.0)
    later = dataclasses.replace(happens, begin_s=9.0)
    nothing = np.zeros((len(happens.accel_mps2[::2]), 3))
    for one in (made("coloured_noise"), SensorNoise.of(person(), 2.0, np.random.default_rng(0))):
        first = one.sensor_acceleration(4, happens, nothing)
        np.testing.assert_array_equal(first, one.sensor_acceleration(4, happens, nothing))
        for other in (one.sensor_acceleration(4, later, nothing), one.sensor_acceleration(5, happens, nothing)):
            assert abs(np.corrcoef(first[:, 2], other[:, 2])[0, 1]) < 0.6
    assert first.std() == pytest.approx(np.sqrt(3.0) * sensors.NOISE_MPS2, rel=0.05)
    assert SensorNoise.of(person(), 1.0, np.random.default_rng(0)).added_mps2 == 0.0


def test_a_mounting_leans_in_vibration_alone_and_passes_slow_motion() -> None:
    happens = shaken()
    most = [np.abs(made("mounting", 5.0, number).lean_rad(4, happens)).max() for number in range(8)]
    assert 0.02 < max(most) <= MOST_LEAN_RAD
    one = made("mounting")
    assert not one.lean_rad(4, dataclasses.replace(happens, accel_mps2=0.0 * happens.accel_mps2)).any()
    assert one.lean_rad(0, happens) is None
    slow = np.tile([0.0, 0.0, 1.0], (2000, 1))
    np.testing.assert_allclose(one.sensor_acceleration(4, happens, slow)[-1], [*one.cross[4, :2, 2], 1.0], atol=1e-6)


# --- scales ----------------------------------------------------------------------------------------------------------


def no_share_exceeds(most: float, count: int) -> float:
    """The probability that no one of so many even Dirichlet shares exceeds a value, by inclusion and exclusion."""
    terms = [(-1) ** j * math.comb(count, j) * max(0.0, 1.0 - j * most) ** (count - 1) for j in range(count + 1)]
    return sum(terms) if count > 1 else float(most >= 1.0)


def test_the_squares_of_scales_are_shares_of_a_log_uniform_level_and_none_dominates() -> None:
    assert mixture.scales((PAPER,), np.random.default_rng(0)) == {PAPER: 1.0}
    found = np.array([[*mixture.scales(mixture.KINDS, np.random.default_rng(n)).values()] for n in range(1000)])
    level, count = np.linalg.norm(found, axis=1), (found > 0.0).sum(axis=1)
    logs = np.log(level / LEVELS[0]) / np.log(LEVELS[1] / LEVELS[0])
    assert logs.min() >= 0.0 and logs.max() <= 1.0
    np.testing.assert_allclose(np.quantile(logs, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.05)
    kinds = len(mixture.KINDS)
    shares = (found / level[:, None]) ** 2
    assert 0.39 < shares.max() <= mixture.MOST_SHARE + 1e-12
    expected = np.array([no_share_exceeds(mixture.MOST_SHARE, n) for n in range(1, kinds + 1)])
    np.testing.assert_allclose(np.bincount(count, minlength=kinds + 1)[1:] / 1000, expected / expected.sum(), atol=0.04)
    np.testing.assert_allclose((found > 0.0).mean(axis=0), count.mean() / kinds, atol=0.06)
    few = [mixture.scales(mixture.KINDS[:2], np.random.default_rng(n)) for n in range(50)]
    assert min(sum(scale > 0.0 for scale in one.values()) for one in few) == 1  # of two kinds one may be alone
    assert not any(mixture.scales(mixture.KINDS, np.random.default_rng(0), bare=1.0).values())
    with pytest.raises(ValueError, match="'rust' is unknown, known are paper"):
        mixture.scales(("rust",), np.random.default_rng(0))


@pytest.mark.parametrize("kinds", GROUPS.values(), ids=GROUPS)
def test_without_scale_nothing_changes_to_the_bit(kinds: tuple[str, ...], no_rest: None) -> None:
    plain, none = (
        sitting.drawn(1, 3, level=0.0, effects=0, plan=SHORT, kinds_behind=each)[0] for each in ((PAPER,), kinds)
    )
    assert none.mechanisms == () and none.truth()["background"] == dict.fromkeys(kinds, 0.0)
    np.testing.assert_array_equal(plain.plain[0], none.plain[0])
    for name, stream in plain.streams(0).items():
        for ours, theirs in zip(stream, none.streams(0)[name], strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_kind_draws_the_same_whatever_the_others_are() -> None:
    alone, among = (
        mixture.mechanisms(person(), scales, [5])
        for scales in ({"relaxation": 0.7}, {"hysteresis": 1.0, "relaxation": 0.7, "drift": 0.0})
    )
    assert [type(one).__name__ for one in among] == ["Hysteresis", "Relaxation"]
    np.testing.assert_array_equal(alone[0].slow_s, among[1].slow_s)
