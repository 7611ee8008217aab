"""The kinds of background for the study alone: each law against a closed form, and that no training knows them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from shaking import KNOWN, after, made, moment, person, shaken
from world import seats, sensors
from world.effects import mixture, sitting
from world.effects.effect import Person
from world.effects.event import HELD_HZ
from world.effects.mixture import LEVELS, PAPER, UNSEEN
from world.effects.moving import Party, moved
from world.effects.sitting import Plan
from world.effects.unseen_mechanisms import (
    BRANCHES_PER_S,
    MOST_RIDING,
    MOST_TONE,
    POWER_HZ,
    STEP,
    FluidFlow,
    PowerLaw,
    TwoJointTissue,
)  # fmt: skip

from blind import training
from blind.tracing.rows import DRAWINGS
from blind.training.draw import TrainingSettings, drawn

NUMBERS = range(10)
SENSORS = ("soft_tissue", "sampling")


# --- in the body -----------------------------------------------------------------------------------------------------


def test_tissue_across_two_joints_passes_the_segment_between_them() -> None:
    """Two masses by hand: the tissue is a spring and a damper from the seat to the upper mass."""
    lower_kg, upper_kg, spring, damper = 8.0, 5.0, 9e3, 150.0
    # Four more segments, which weigh next to nothing, ride on the upper one.
    inertia = np.array([lower_kg, upper_kg, 1e-6, 1e-6, 1e-6, 1e-6])
    carried = np.cumsum(inertia[::-1])[::-1]
    k, b = 2500.0 * carried, 10.0 * carried
    who = Person(k, b, np.zeros(6), inertia, carried, 0.5)
    tissue = TwoJointTissue(np.array([spring, 0.0, 0.0, 0.0, 0.0]), np.array([damper, 0.0, 0.0, 0.0, 0.0]))
    happens = shaken(0.3, 0.1)
    mass = np.array([[lower_kg], [upper_kg]])
    stiffness = np.array([[k[0] + k[1], -k[1]], [-k[1], k[1] + spring]])
    damping = np.array([[b[0] + b[1], -b[1]], [-b[1], b[1] + damper]]) + 0.5 * np.diag(mass[:, 0])
    upward = np.hstack([-stiffness / mass, -damping / mass])
    dynamics = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), upward])
    by_hand = signal.StateSpace(dynamics, np.array([[0.0], [0.0], [-1.0], [-1.0]]), upward, np.zeros((2, 1)))
    _, expected, _ = signal.lsim(by_hand, happens.accel_mps2[:, 2], happens.time_s)
    found, without = moved([Party(who, [happens], mechanisms=(tissue,)), Party(who, [happens])])
    most = np.abs(expected).max()
    np.testing.assert_allclose(found.accel_mps2[0][:, :2], expected[::2], atol=2e-4 * most)
    assert np.abs(found.accel_mps2[0] - without.accel_mps2[0]).max() > 0.1 * most


def test_the_tissue_is_softer_than_the_joints_it_bridges() -> None:
    for number in NUMBERS:
        one, k = made("two_joints", LEVELS[1], number), person(number).stiffness_n_per_m
        assert (one.spring_n_per_m < np.minimum(k[:-1], k[1:])).all() and (one.spring_n_per_m >= 0.0).all()
        assert (one.damper_ns_per_m <= 0.03 * one.spring_n_per_m).all()


def test_branches_have_the_modulus_of_a_power_law() -> None:
    """Within 3 % at 0.5 to 30 Hz, with the spring of all slower branches, which the plain joint stands for."""
    order, modulus = np.array([0.15, 0.2, 0.25, 0.3, 0.4, 0.45]), np.arange(1.0, 7.0) * 1e3
    one, omega_0 = PowerLaw.by(modulus, order), 2.0 * np.pi * POWER_HZ
    slowest = BRANCHES_PER_S[0] / np.sqrt(STEP) / omega_0
    static = modulus * np.sin(np.pi * order) / np.pi * slowest**order / order
    for omega in 2.0 * np.pi * np.geomspace(0.5, 30.0, 25):
        own = np.tile(1.0 / (1.0 + 1j * omega / BRANCHES_PER_S), 6)
        # The law is linear: in phase with a stretch of amplitude 1, and a quarter of a period later.
        (in_phase, rates_in_phase), (behind, rates_behind) = (
            after(one, 1.0, 0.0, own.real),
            after(one, 0.0, omega, own.imag),
        )
        np.testing.assert_allclose(rates_in_phase + 1j * rates_behind, 1j * omega * own, atol=1e-9 * omega)
        expected = modulus * (1j * omega / omega_0) ** order
        np.testing.assert_array_less(np.abs(in_phase + 1j * behind + static - expected), 0.03 * np.abs(expected))


def test_a_held_joint_relaxes_for_decades() -> None:
    """The force of a step falls by a power of time: from 10 ms on by the same factor in every decade."""
    order, t = 0.3, np.array([0.01, 0.1, 1.0])
    one = PowerLaw.by(np.full(6, 1.0), np.full(6, order))
    force = []
    for since in t:
        held, _ = after(one, 1.0, 0.0, np.tile(1.0 - np.exp(-BRANCHES_PER_S * since), 6))
        force.append(held[0])
    slowest = BRANCHES_PER_S[0] / np.sqrt(STEP) / (2.0 * np.pi * POWER_HZ)
    force = np.array(force) + np.sin(np.pi * order) / np.pi * slowest**order / order
    np.testing.assert_allclose(force[1:] / force[:-1], 10.0**-order, rtol=0.04)


def test_fluid_leaves_against_another_resistance_than_it_returns() -> None:
    one = FluidFlow(*(np.full(6, value) for value in (100.0, 0.8, 0.5, 1e-3, 1e-2)))
    shares = {}
    for stretch in (-1.0, 0.0, 1.0):  # far beyond a reach of 1 mm, and faster than 10 mm/s
        for rate in (-10.0, 10.0):
            force, rates = after(one, stretch, rate, np.zeros(0))
            assert rates.size == 0
            shares[stretch, rate] = force[0] / (100.0 * rate)
    for rate, valve in ((-10.0, 1.5), (10.0, 0.5)):
        for stretch in (-1.0, 0.0, 1.0):
            assert shares[stretch, rate] == pytest.approx(np.exp(-0.8 * stretch) * valve, rel=1e-4)
    force, _ = after(one, 0.0, 1e-7, np.zeros(0))
    np.testing.assert_allclose(force, 100.0 * 1e-7, rtol=1e-4)  # a plain damper around rest


def test_flow_always_resists() -> None:
    rng = np.random.default_rng(0)
    stretch, rate = 3e-3 * rng.standard_normal((500, 6)), 0.1 * rng.standard_normal((500, 6))
    for number in NUMBERS:
        now = moment(stretch, rate)
        made("fluid_flow", LEVELS[1], number).act(now, np.zeros((500, 0)))
        assert (now.joint_n * rate >= 0.0).all()


def test_breath_has_one_rhythm_and_a_depth_that_changes() -> None:
    one, every_s = made("breathing"), 0.25
    moments = [
        dataclasses.replace(shaken(), accel_mps2=np.zeros((1, 3)), begin_s=at) for at in np.arange(0, 600, every_s)
    ]
    breath = np.vstack([one.signals(happens)[:, :6] for happens in moments])
    np.testing.assert_allclose(breath.std(axis=0), np.sqrt(1.0 + 0.5 * 0.25), rtol=0.05)
    np.testing.assert_allclose(np.abs(breath).max(axis=0), 1.5 * np.sqrt(2.0), rtol=0.05)
    frequency, power = signal.periodogram(breath, 1.0 / every_s, axis=0)
    assert 0.2 <= one.breath_hz <= 0.35
    np.testing.assert_allclose(frequency[power.argmax(axis=0)], one.breath_hz, atol=0.003)
    happens = dataclasses.replace(shaken(), begin_s=12.0)
    found = one.signals(happens)
    np.testing.assert_allclose(found[0, :6], breath[48])
    np.testing.assert_array_equal(found[:, 6:], found[:, :6] - found[0, :6])


def test_breath_leaves_every_joint_stiff_and_damped() -> None:
    for number in NUMBERS:
        one, who = made("breathing", LEVELS[1], number), person(number)
        for breath in (-3.0, 3.0):
            for stretch, rate, plain in ((0.01, 0.0, who.stiffness_n_per_m), (0.0, 0.01, who.damping_ns_per_m)):
                now = moment(np.full((1, 6), stretch), np.full((1, 6), rate))
                now.signal = np.append(np.full(6, breath), np.zeros(6))[None]
                one.act(now, np.zeros((1, 0)))
                assert (np.abs(now.joint_n) < MOST_TONE * 0.01 * plain).all() and now.joint_n.any()
        now = moment(np.zeros((1, 6)), np.zeros((1, 6)))
        now.signal = np.append(np.zeros(6), np.ones(6))[None]
        one.act(now, np.zeros((1, 0)))
        np.testing.assert_allclose(now.joint_n[0], -who.stiffness_n_per_m * one.shift_m)


def test_a_held_breath_is_that_of_a_stiffer_person() -> None:
    who = person()
    held = dataclasses.replace(made("breathing", LEVELS[1]), breath_hz=0.0, depth_s=1e12)
    happens = shaken(0.2, 0.0)
    breath = held.signals(happens)[0, :6]
    stiffer, damped = (1.0 + MOST_TONE * np.tanh(c * breath / MOST_TONE) for c in (held.stiffer, held.damped))
    twin = dataclasses.replace(
        who,
        stiffness_n_per_m=stiffer * who.stiffness_n_per_m,
        damping_ns_per_m=damped * who.damping_ns_per_m,
        stiffening_per_m=who.stiffening_per_m / stiffer,
    )
    found, expected = moved([Party(who, [happens], mechanisms=(held,)), Party(twin, [happens])])
    most = np.abs(expected.accel_mps2[0]).max()
    np.testing.assert_allclose(found.accel_mps2[0], expected.accel_mps2[0], atol=1e-9 * most)


def test_breath_strikes_no_body_at_rest() -> None:
    """The body begins each event at rest, where breath moves it by less than the noise of a sensor."""
    still = dataclasses.replace(shaken(), accel_mps2=np.zeros((2 * round(seats.RATE_HZ) + 1, 3)), begin_s=123.0)
    parties = [Party(person(n), [still], mechanisms=(made("breathing", LEVELS[1], n),)) for n in NUMBERS]
    for one in moved(parties):
        assert 0.0 < one.accel_mps2[0].std(axis=0).max() < 0.5 * sensors.NOISE_MPS2


# --- in the sensors --------------------------------------------------------------------------------------------------


def test_soft_tissue_has_two_modes_and_passes_slow_motion() -> None:
    one, t = made("soft_tissue"), np.arange(round(2.0 * HELD_HZ)) / HELD_HZ
    slow = np.tile([0.3, 0.0, 1.0], (len(t), 1))
    np.testing.assert_allclose(one.sensor_acceleration(4, shaken(), slow)[-1], [0.3, 0.0, 1.0], atol=1e-9)
    for hz in (5.0, 15.0, 40.0):
        turning = np.exp(2j * np.pi * hz * t)
        found = one.sensor_acceleration(4, shaken(), np.column_stack([turning.real, turning.imag, turning.real]))
        w, loss = 2.0 * np.pi * one.frequency_hz[4], 2j * one.damping[4] * hz / one.frequency_hz[4]
        mode = (1.0 + loss) / (1.0 + loss - (2.0 * np.pi * hz / w) ** 2)
        expected = 1.0 + (one.share[4] * (mode - 1.0)).sum()
        answer = (found[:, 0] + 1j * found[:, 1])[-200:] / turning[-200:]
        np.testing.assert_allclose(answer, expected, rtol=0.01)


def test_a_sensor_rides_on_its_tissue_at_most_whole() -> None:
    shares = np.array([made("soft_tissue", LEVELS[1], number).share for number in NUMBERS])
    assert (shares[:, 1:] > 0.0).all() and shares.max() < MOST_RIDING and 2.0 * MOST_RIDING <= 1.0


def test_a_sensor_warms_up_over_the_sitting() -> None:
    one, nothing = made("sampling"), np.ones((len(shaken().accel_mps2[::2]), 3))
    cold, warm = (one.sensor_acceleration(4, dataclasses.replace(shaken(), begin_s=at), nothing) for at in (0.0, 1e5))
    np.testing.assert_allclose(cold[0], 1.0)
    np.testing.assert_allclose(warm, 1.0 + one.gain[4])
    half = dataclasses.replace(shaken(), begin_s=float(np.log(2.0) * one.warm_s[4]))
    np.testing.assert_allclose(one.sensor_acceleration(4, half, nothing)[0], 1.0 + 0.5 * one.gain[4])


def test_a_clock_wanders_slowly_and_its_samples_are_uneven() -> None:
    time_s = np.arange(round(60.0 * sensors.RATE_HZ)) / sensors.RATE_HZ
    for number in NUMBERS:
        one = made("sampling", 1.0, number)
        late_s = one.clock_late_s(5, shaken(), time_s)
        np.testing.assert_array_equal(late_s, one.clock_late_s(5, shaken(), time_s))
        smooth = np.convolve(late_s, np.ones(201) / 201.0, "valid")
        assert (late_s[100:-100] - smooth).std() == pytest.approx(one.uneven_s, rel=0.05)
        assert np.abs(smooth).max() == pytest.approx(one.wander_s[5], abs=3e-5)
        assert np.abs(np.diff(smooth)).max() * sensors.RATE_HZ < 6e-3
        other = one.clock_late_s(5, dataclasses.replace(shaken(), begin_s=7.0), time_s)
        assert abs(np.corrcoef(np.diff(late_s), np.diff(other))[0, 1]) < 0.1
        # It is the same clock in an event that begins later.
        begin = round(7.0 * sensors.RATE_HZ)
        np.testing.assert_allclose(
            smooth[begin:], np.convolve(other, np.ones(201) / 201.0, "valid")[:-begin], atol=6e-5
        )


def test_readings_are_rounded_to_a_small_digit() -> None:
    one, force = made("sampling"), np.random.default_rng(0).standard_normal((400, 3))
    found = one.reading(4, force)
    np.testing.assert_allclose(found / one.digit_mps2[4], np.rint(found / one.digit_mps2[4]), atol=1e-9)
    assert 0.0 < np.abs(found - force).max() <= 0.5 * one.digit_mps2[4] < 0.1


@pytest.mark.parametrize("kind", SENSORS)
def test_the_sensor_of_the_seat_is_exact(kind: str) -> None:
    one, happens = made(kind, LEVELS[1]), shaken()
    accel, time_s = happens.accel_mps2[::2], happens.time_s[::2]
    np.testing.assert_array_equal(one.sensor_acceleration(0, happens, accel), accel)
    np.testing.assert_array_equal(one.reading(0, accel), accel)
    assert one.lean_rad(0, happens) is None and not np.any(one.clock_late_s(0, happens, time_s))


# --- sets ------------------------------------------------------------------------------------------------------------


def test_a_sitting_on_an_unseen_background_has_an_exact_seat(no_rest: None) -> None:
    short = Plan(counts=(1, 0, 0), seconds=(0.3, 0.3, 0.3), uses=("fit",), recorded=False)
    plain, one = (
        sitting.drawn(1, 3, effects=0, level=level, plan=short, kinds_behind=UNSEEN)[0] for level in (0.0, 1.0)
    )
    assert set(one.truth()["background"]) == set(UNSEEN)
    assert len(one.mechanisms) == sum(scale > 0.0 for scale in one.scales.values()) > 0
    found, expected = one.streams(0), plain.streams(0)
    np.testing.assert_array_equal(found["seat"][1], expected["seat"][1])
    assert not np.array_equal(found["head"][1], expected["head"][1])


@pytest.mark.parametrize("kind", UNSEEN)
def test_of_scale_zero_a_kind_changes_nothing(kind: str) -> None:
    one, happens = made(kind, 0.0), shaken()
    accel, time_s = happens.accel_mps2[::2], happens.time_s[::2]
    for sensor in range(7):
        np.testing.assert_array_equal(one.sensor_acceleration(sensor, happens, accel), accel)
        np.testing.assert_array_equal(one.reading(sensor, accel), accel)
        assert not np.any(one.clock_late_s(sensor, happens, time_s))
    now = moment(np.full((1, 6), 2e-3), np.full((1, 6), 0.1))
    now.signal = one.signals(happens)[900:901]
    one.act(now, np.zeros((1, one.states)))
    assert not now.joint_n.any() and not now.up_n.any()


def test_an_unseen_kind_draws_the_same_whatever_the_others_are() -> None:
    for kind in UNSEEN:
        (alone,) = mixture.mechanisms(person(), {kind: 0.7}, [5])
        among = mixture.mechanisms(person(), dict.fromkeys(KNOWN, 1.0) | {kind: 0.7}, [5])
        (same,) = (one for one in among if type(one) is type(alone))
        for field in dataclasses.fields(alone):
            np.testing.assert_array_equal(getattr(alone, field.name), getattr(same, field.name))


def test_the_kinds_for_training_are_the_ten_known_ones() -> None:
    assert mixture.KINDS == (
        PAPER, "hysteresis", "relaxation", "sprung_masses", "horizontal", "softening", "drift", "coherent_filter",
        "coloured_noise", "mounting",
    )  # fmt: skip
    assert len(UNSEEN) == 6 and not set(UNSEEN) & set(mixture.KINDS)
    assert set(mixture.CHANGES) == {*mixture.KINDS, *UNSEEN}


def test_no_training_has_an_unseen_kind() -> None:
    assert not set(TrainingSettings().background) & set(UNSEEN)
    assert not {kind for number in range(50) for kind in drawn(number, 7).scales} & set(UNSEEN)
    sources = sorted(Path(training.__file__).parent.rglob("*.py"))
    assert sources and not [path.name for path in sources if "unseen_mechanisms" in path.read_text(encoding="utf-8")]


def test_a_drawing_of_the_study_has_unseen_kinds_alone_or_none() -> None:
    unseen = [one for one in DRAWINGS if set(one.background) & set(UNSEEN)]
    assert unseen and all(one.background == UNSEEN for one in unseen)
