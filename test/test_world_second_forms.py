"""The second forms, each against its own law."""

import dataclasses

import numpy as np
import pytest
from hidden_forms import PERSON, followed, k_b, made, moment, of_kind, shaken, tension
from world import seats
from world.effects import second_forms
from world.effects.effect import Effect
from world.effects.event import HELD_HZ, Event


def test_second_elastic_forms_have_their_limits() -> None:
    for form in of_kind("asymmetry", "cubic", "stop", among=second_forms.FORMS):
        one = made(form)
        assert tension(one, 0.0) == pytest.approx(0.0, abs=1e-9)
        k, d = k_b(one)[0], PERSON.reach_m[one.site]
        e, tiny = one.strength, 1e-4 * d
        if form is second_forms.PolytropicBelly:
            assert tension(one, -d) == pytest.approx(-e * k * d) and -0.7 * e * k * d < tension(one, d) < 0.0
        if form is second_forms.GentFibres:
            assert [tension(one, s) for s in (d, -d)] == pytest.approx([e * k * d, -e * k * d])
        if form is second_forms.MindlinTangent:
            half = (one.gap + 0.5 * one.depth) * d
            assert tension(one, -one.gap * d) == pytest.approx(0.0, abs=1e-9 * k * d) and tension(one, d) == 0.0
            slope = (tension(one, -half + tiny) - tension(one, -half - tiny)) / (2 * tiny)
            assert slope == pytest.approx(e * k, rel=1e-3)
        for s in np.linspace(-3 * d, 3 * d, 61):  # no jump where a law continues linearly
            assert abs(tension(one, s + 1e-9 * d) - tension(one, s)) < 1e-6 * k * d


def test_second_dampers_friction_and_hysteresis_have_their_limits() -> None:
    fluid, rubs, fades = (made(getattr(second_forms, n)) for n in ("OstwaldDilatancy", "AmontonsLoad", "ValanisPaths"))
    twice = 2.0 * PERSON.rate_mps[fluid.site]
    assert tension(fluid, 0.0, -twice) == pytest.approx(-fluid.strength * k_b(fluid)[1] * twice)
    rate, d = PERSON.rate_mps[rubs.site], PERSON.reach_m[rubs.site]
    coulomb = rubs.strength * k_b(rubs)[1] * rate
    assert tension(rubs, 0.0, 100.0 * rate) == pytest.approx(coulomb, rel=1e-3)
    pressed, eased = (tension(rubs, s, 100.0 * rate) / coulomb for s in (-9.0 * d, 9.0 * d))
    assert (pressed, eased) == pytest.approx((1.0 + rubs.pressed, 1.0 - rubs.pressed), rel=1e-3)
    d = PERSON.reach_m[fades.site]
    pull = followed(fades, lambda at: d * at, lambda at: d, np.linspace(0.0, 10.0, 5))
    assert pull[0] == 0.0 and pull[-1] == pytest.approx(fades.strength * k_b(fades)[0] * d, rel=1e-3)


def test_second_forms_with_states_settle() -> None:
    tissue, network, reflex = (made(getattr(second_forms, n)) for n in ("FungSpectrum", "KrausPayne", "RateSpindle"))
    d = PERSON.reach_m[tissue.site]
    held = followed(tissue, lambda at: d, lambda at: 0.0, np.array([0.0, 0.1, 30.0]))
    whole = tissue.strength * k_b(tissue)[0] * d * np.hypot(1.0, 1.0 / tissue.straight)
    assert held[0] == pytest.approx(whole) and 0.1 * whole < held[1] < 0.9 * whole and abs(held[2]) < 1e-6 * whole
    d = PERSON.reach_m[network.site]
    lost = followed(network, lambda at: d, lambda at: 0.0, np.array([0.0, 200.0])) / (k_b(network)[0] * d)
    broken = network.broken**network.power
    assert lost == pytest.approx([0.0, -network.strength * broken / (1.0 + broken)], rel=1e-6)
    now, settled = moment(0.0, 0.2), np.array([[reflex.lead_s * 0.2, 0.0]])
    now.late = settled
    assert not reflex.act(now, settled).any()
    assert -now.up_n[0, reflex.site] == pytest.approx(reflex.strength * k_b(reflex)[0] * reflex.lead_s * 0.2)


def test_second_postures_brace_two_joints() -> None:
    for site, beside in ((1, 2), (5, 4)):
        one = dataclasses.replace(made(second_forms.BracesTwoJoints), site=site)
        now = moment(1e-3)
        for moving_s, done in ((0.5 * one.at_s, 0.0), (one.at_s + 9.0 * one.width_s, 1.0)):
            now.moving_s, now.up_n = moving_s, np.zeros((1, 6))
            one.act(now, np.empty((1, 0)))
            pulls = -np.cumsum(now.up_n[0, ::-1])[::-1]
            k = 1e-3 * one.strength * done * PERSON.stiffness_n_per_m
            expected = np.zeros(6)
            expected[[site, beside]] = k[site], one.beside * k[beside]
            np.testing.assert_allclose(pulls, expected, atol=1e-9)


@pytest.mark.parametrize("form", of_kind("viscera", "added_mass", among=second_forms.FORMS))
def test_second_masses_obey_newton(form: type[Effect]) -> None:
    one, now = made(form), moment(1e-3, 0.02)
    now.base_mps2[:] = 3.0
    risen = one.act(now, np.zeros((1, 2)))[0]  # at rest in the seat, where a wheel does not pull
    assert risen[0] == 0.0 and one.strength * (risen[1] + 3.0) == pytest.approx(-now.up_n.sum())


def test_second_seats_rests_and_belts() -> None:
    foam, rest, belt = (
        made(getattr(second_forms, n)) for n in ("GibsonAshbySlab", "PressedKelvinVoigt", "LoadLimiter")
    )
    tiny = 1e-3 * foam.yield_m
    now, own = moment(), np.array([[-tiny, 0.0, 0.0]])
    up = foam.act(now, own)[0, 1]
    assert up == pytest.approx(
        foam.stiffness_n_per_m * (1.0 + foam.creep) * tiny / foam.strength / foam.mass_kg, rel=1e-3
    )
    assert foam.offset(now, own)[1] == tiny
    contact = rest.signals(shaken(), PERSON)
    assert 1.0 - rest.press < contact.min() < 1.0 < contact.max() < 1.0 + rest.press
    d = PERSON.rise_m[belt.site]
    for rise, rate in ((0.9 * belt.slack * d, 1.0), (3.0 * d, 10.0), (3.0 * d, -10.0)):
        now = moment(rise / (belt.site + 1), rate)
        belt.act(now, np.empty((1, 0)))
        most = belt.strength * belt.limit * d * (1.0 + np.sign(rate) * belt.loss)
        assert -now.up_n[0, belt.site] == pytest.approx(most if rise > d else 0.0, rel=0.02)


def test_second_seats_and_necks_turn() -> None:
    frame, neck, happens = made(second_forms.FrameOnSlides), made(second_forms.NodsAndRolls), shaken()
    rate = frame.signals(happens, PERSON)[:, 1]
    turning = frame.strength * np.gradient(rate, 1.0 / seats.RATE_HZ)
    np.testing.assert_allclose(turning[:-3], frame.base_mps2(happens)[:-3], atol=1e-5)
    lost = neck.signals(happens, PERSON)[:, 0]
    roll, pitch = (happens.leaning_rad(neck.site + 1) - happens.leaning_rad(neck.site)).T
    assert lost.min() >= 0.0
    np.testing.assert_allclose(lost, 0.5 * ((neck.rolls * roll) ** 2 + pitch**2), rtol=0.05, atol=1e-9)


def test_second_engines_have_two_alternating_lines() -> None:
    one, t = made(second_forms.TwoOrdersInTurn), np.arange(round(40.0 * seats.RATE_HZ)) / seats.RATE_HZ
    rest = Event("rail", "synthetic", 0.0, np.zeros((t.size, 3)), np.zeros((t.size, 2)), 40.0)
    shake = one.signals(rest, PERSON)[:, 0]
    for order, size in ((1, 1.0), (2, one.second)):
        line = 2.0 * np.abs((np.exp(-2j * np.pi * order * one.frequency_hz * t) * shake).mean())
        assert line == pytest.approx(size, rel=0.15)


def test_second_sensors_follow_their_definition(no_rest: None) -> None:
    skin, strap, clock, gain, clip = (
        made(getattr(second_forms, n))
        for n in ("ScottBlairTissue", "PhillipsCreep", "TwoPeriodClock", "ShelvingGain", "RappKnee")
    )
    t, happens = np.arange(round(4.0 * HELD_HZ)) / HELD_HZ, shaken()
    window, middle = np.sin(np.pi * t / t[-1])[:, None] ** 2, slice(t.size // 2 - 500, t.size // 2 + 500)

    def gained(effect: Effect, hz: float) -> float:
        wave = window * np.sin(2 * np.pi * hz * t)[:, None]
        return np.abs(effect.sensor_acceleration(effect.site, happens, wave)[middle]).max() / np.abs(wave[middle]).max()

    c = 2.0 * skin.damping * 1j**skin.order
    rings = np.abs(1.0 + skin.strength / c)
    assert gained(skin, 1.0) == pytest.approx(1.0, abs=0.02)
    assert gained(skin, skin.frequency_hz) == pytest.approx(rings, rel=0.03)
    assert gained(gain, 50.0) == pytest.approx(1.0 + gain.strength, rel=2e-3)
    lean = strap.lean_rad(strap.site, happens)[:, 1]
    assert abs(lean[0]) < 1e-6 and lean[-1] == pytest.approx(strap.strength) and (np.diff(lean) >= 0.0).all()
    late = clock.clock_late_s(clock.site, happens, np.linspace(0.0, 300.0, 3001))
    assert (
        late.mean() == pytest.approx(clock.steady * clock.strength, rel=0.15) and np.abs(late).max() <= clock.strength
    )
    full = seats.GRAVITY_MPS2 + 20.0 / clip.strength
    reading = clip.reading(clip.site, np.array([[0.5 * full, -10.0 * full, 0.0]]))[0]
    assert reading == pytest.approx([0.5 * full, -full, 0.0], rel=2e-3)


def test_second_forms_of_no_class() -> None:
    fluid, belly, fascia, noise = (
        made(getattr(second_forms, n))
        for n in ("SmithInerter", "PelvisGovernsJoint", "ThreeJointDamper", "EffortTremor")
    )
    assert tension(fluid, 0.0, 0.3, np.array([[0.3]])) == 0.0  # at a steady rate
    expected = fluid.strength * PERSON.carried_kg[fluid.site] * 0.3 / fluid.passage_s
    assert tension(fluid, 0.0, 0.3) == pytest.approx(expected)
    for s in (-1e-2, 1e-2):
        more = belly.strength * np.tanh(-s / PERSON.reach_m[0])
        expected = more * PERSON.stiffness_n_per_m[4] * s
        assert tension(dataclasses.replace(belly, site=4), s) == pytest.approx(expected)
    now = moment(0.0, 0.1)
    fascia.act(now, np.empty((1, 0)))
    between = PERSON.damping_ns_per_m[fascia.site + 1 : fascia.site + 4]
    assert now.up_n[0, fascia.site] == pytest.approx(fascia.strength * 0.3 / (1.0 / between).sum())
    one, other = (noise.signals(dataclasses.replace(shaken(), begin_s=s), PERSON) for s in (0.0, 7.0))
    assert one.std() == pytest.approx(1.0) and np.abs(one - other).max() > 1.0
    np.testing.assert_array_equal(one, noise.signals(shaken(), PERSON))
    assert tension(noise, 0.0, 0.1) == 0.0
