"""The forms of development and the earlier ones, each against its own law."""

import dataclasses

import numpy as np
import pytest
from hidden_forms import EVERY, PERSON, Fixed, followed, k_b, made, moment, of_kind, shaken, tension
from scipy import integrate
from world import seats, sensors
from world.effects import development_forms, earlier_forms, wearing
from world.effects.background import NOTHING
from world.effects.effect import Effect
from world.effects.event import HELD_HZ, Event


def test_elastic_forms_have_their_limits() -> None:
    for form in of_kind("asymmetry", "cubic", "stop"):
        one = made(form)
        assert tension(one, 0.0) == pytest.approx(0.0, abs=1e-9)
        k, d = k_b(one)[0], PERSON.reach_m[one.site]
        e, tiny = one.strength, 1e-3 * d
        if form is development_forms.FungTissue:
            assert tension(one, -tiny) == pytest.approx(-0.5 * e * k * tiny**2 / (one.toe * d), rel=2e-3)
            assert tension(one, 5 * d) > 0.0 or tension(one, -d) < -abs(tension(one, d))
        if form is development_forms.PowerLaw:
            assert [tension(one, s) for s in (d, -d)] == pytest.approx([e * k * d, -e * k * d])
        if form is development_forms.ExponentialStop:
            at_gap = tension(one, -one.gap * d)
            assert (
                at_gap == pytest.approx(-e * k * one.softness * d, rel=1e-2) and abs(tension(one, d)) < -0.01 * at_gap
            )
        if form is earlier_forms.TwoSlopes:
            assert (tension(one, 51 * d) - tension(one, 50 * d)) / d == pytest.approx(e * k, rel=1e-3)
            assert abs(tension(one, -51 * d) - tension(one, -50 * d)) < 1e-3 * e * k * d
        if form is earlier_forms.Hyperbolic:
            assert tension(one, tiny) == pytest.approx(e * k * tiny**3 / (6 * (one.toe * d) ** 2), rel=1e-3)
        if form is earlier_forms.HertzStop:
            assert tension(one, -0.99 * one.gap * d) == 0.0 and tension(one, -d) == pytest.approx(-e * k * d)
            assert tension(one, -d, 1e3) == 0.0


def test_dampers_and_friction_have_their_limits() -> None:
    orifice, valve = made(development_forms.Orifice), made(earlier_forms.Valve)
    rate = orifice.knee * PERSON.rate_mps[orifice.site]
    assert tension(orifice, 0.0, rate) == pytest.approx(orifice.strength * k_b(orifice)[1] * rate)
    twice = 2 * PERSON.rate_mps[valve.site]
    assert tension(valve, 0.0, -twice) == pytest.approx(-valve.strength * k_b(valve)[1] * twice)
    assert tension(valve, 0.0, twice) == pytest.approx(valve.rebound * valve.strength * k_b(valve)[1] * twice)
    for one in (made(earlier_forms.Stribeck), made(development_forms.LuGre)):
        rate = PERSON.rate_mps[one.site]
        coulomb = one.strength * k_b(one)[1] * rate
        t = np.linspace(0.0, 0.2, 5)
        fast = 5.0 * rate
        slid = (
            followed(one, lambda at, v=fast: v * at, lambda at, v=fast: v, t)
            if one.states
            else [tension(one, 0.0, fast)]
        )
        assert slid[-1] == pytest.approx(coulomb, rel=0.01)
    slow = made(development_forms.LuGre)
    creep = 1e-3 * PERSON.rate_mps[slow.site]
    stuck = followed(slow, lambda at: creep * at, lambda at: creep, np.linspace(0.0, 40.0, 3))
    coulomb = slow.strength * k_b(slow)[1] * PERSON.rate_mps[slow.site]
    assert stuck[-1] == pytest.approx(slow.stiction * coulomb, rel=0.01)


def test_hysteresis_follows_dahl_and_iwan() -> None:
    dahl = made(development_forms.Dahl)
    d = PERSON.reach_m[dahl.site]
    t = np.linspace(0.0, 1.0, 30)
    expected = dahl.strength * k_b(dahl)[0] * d * -np.expm1(-t / dahl.slip)
    np.testing.assert_allclose(followed(dahl, lambda at: d * at, lambda at: d, t), expected, atol=1e-5 * expected[-1])
    iwan = made(earlier_forms.Iwan)
    most, slips = 2.0 * PERSON.reach_m[iwan.site], iwan.last * PERSON.reach_m[iwan.site] * np.array([0.05, 0.2, 0.5, 1])
    t = np.linspace(0.0, 2.0, 4001)
    pull = followed(
        iwan, lambda at: most * np.sin(2 * np.pi * at), lambda at: 2 * np.pi * most * np.cos(2 * np.pi * at), t
    )
    lost = integrate.trapezoid((pull * 2 * np.pi * most * np.cos(2 * np.pi * t))[t >= 1.0], t[t >= 1.0])
    assert lost == pytest.approx(4 * iwan.strength * k_b(iwan)[0] * (slips * (most - slips)).mean(), rel=0.03)


def test_relaxation_has_its_complex_stiffness() -> None:
    high, residues, poles = earlier_forms.oustaloup(0.4)
    for w in (3.0, 20.0, 200.0):
        assert abs((high - (residues / (1j * w + poles)).sum()) / (1j * w) ** 0.4 - 1.0) < 0.08
    one, w = made(development_forms.TwoBranches), 2 * np.pi * 4.0
    t = np.linspace(0.0, 5.0, 2001)
    pull = followed(one, lambda at: 1e-3 * np.sin(w * at), lambda at: 1e-3 * w * np.cos(w * at), t)
    modulus = sum(
        share * 1j * w * tau / (1 + 1j * w * tau)
        for share, tau in ((one.share, one.fast_s), (1 - one.share, one.slow_s))
    )
    expected = one.strength * k_b(one)[0] * 1e-3 * (modulus * np.exp(1j * w * t)).imag
    np.testing.assert_allclose(pull[t > 4.0], expected[t > 4.0], atol=1e-3 * np.abs(expected).max())


def test_structures_break_and_recover_to_equilibrium() -> None:
    one = made(development_forms.Structure)
    rate = PERSON.rate_mps[one.site]
    gone = one.broken / (1.0 + one.broken)
    assert one.act(moment(0.0, rate), np.array([[gone]]))[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert tension(one, 1e-3, rate, np.array([[gone]])) == pytest.approx(-one.strength * gone * k_b(one)[0] * 1e-3)
    gel = made(earlier_forms.Brittle)
    assert gel.act(moment(0.5 * PERSON.reach_m[gel.site]), np.array([[0.0]]))[0, 0] == pytest.approx(1.0 / gel.break_s)
    assert gel.act(moment(), np.array([[1.0]]))[0, 0] == pytest.approx(-1.0 / gel.set_s)


def test_postures_change_when_they_should() -> None:
    for form in of_kind("posture"):
        one = made(form)
        k = k_b(one)[0]
        before, after = moment(1e-3), moment(1e-3)
        before.share, before.moving_s, after.share, after.moving_s = np.zeros(1), -1.0, np.ones(1), 100.0
        for now in (before, after):
            one.act(now, np.zeros((1, 0)))
        assert abs(before.up_n[0, one.site]) < 0.02 * one.strength * k * 1e-3
        assert abs(after.up_n[0, one.site]) == pytest.approx(one.strength * k * 1e-3, rel=0.01)


def test_reflexes_settle_to_their_gain() -> None:
    late = made(development_forms.LatePull)
    now = moment(1e-3)
    now.late = np.array([[1e-3]])
    assert late.act(now, np.array([[1e-3]]))[0, 0] == pytest.approx(0.0, abs=1e-15)
    assert -now.up_n[0, late.site] == pytest.approx(late.strength * k_b(late)[0] * 1e-3)
    tiring = made(earlier_forms.TiringReflex)
    now.up_n[:], now.late = 0.0, np.array([[1e3, 0.0]])
    tiring.act(now, np.zeros((1, 2)))
    most = tiring.strength * k_b(tiring)[0] * tiring.most * PERSON.reach_m[tiring.site]
    assert -now.up_n[0, tiring.site] == pytest.approx(most)


@pytest.mark.parametrize("form", of_kind("lift_off", among=EVERY))
def test_a_seat_pushes_and_never_pulls(form: type[Effect]) -> None:
    weight, k = PERSON.weight_n, PERSON.stiffness_n_per_m[0]
    for stretch, rate in ((-2e-3, 0.01), (-0.02, 0.3), (0.0, 0.0)):
        now = moment(stretch, rate)
        assert tension(made(form), stretch, rate) == pytest.approx(0.0, abs=0.003 * max(weight, abs(now.joint_n[0, 0])))
    for rate in (-1.0, 0.0, 1.0):
        far = moment(2.0 * weight / k + 0.05, rate)
        left = far.joint_n[0, 0] + tension(made(form), 2.0 * weight / k + 0.05, rate)
        assert left == pytest.approx(weight, rel=0.01) or left < weight


@pytest.mark.parametrize("form", of_kind("cushion", "viscera", "added_mass"))
def test_added_masses_obey_newton(form: type[Effect]) -> None:
    one, now = made(form), moment(1e-3, 0.02)
    now.base_mps2[:] = 3.0
    own = np.random.default_rng(1).uniform(-2e-3, 2e-3, (1, one.states))
    rates = one.act(now, own)[0]
    if form.kind == "cushion":
        still = moment()
        still.signal[:] = 0.0
        np.testing.assert_allclose(one.act(still, np.zeros((1, 4))), 0.0)
        # One that is let down by its whole load stays there: springs in a row.
        load = -400.0
        still.joint_n[:, 0] = load
        found = integrate.solve_ivp(
            lambda t, y: one.act(still, y[None])[0], (0.0, 3.0), np.zeros(4), "LSODA", rtol=1e-8, atol=1e-10
        ).y[:, -1]
        assert abs(one.act(still, found[None])[0]).max() < 1e-2 and found[0] < 0.0
        return
    if form is development_forms.TwoOrgans:
        carried = one.share * (rates[1] + 3.0) + (1.0 - one.share) * (rates[3] + 3.0)
    else:
        carried = rates[1] + 3.0
    assert now.up_n.sum() == pytest.approx(-one.strength * carried)


def test_a_backrest_acts_in_one_direction() -> None:
    webbing, belt = made(development_forms.Webbing), made(earlier_forms.CatchingBelt)
    for one in (webbing, belt):
        now = moment()
        now.x[:] = 0.99 * one.slack * PERSON.rise_m[one.site]
        one.act(now, np.zeros((1, 0)))
        assert not now.up_n.any()
        now.x[:], now.v[:] = PERSON.rise_m[one.site], -100.0
        one.act(now, np.zeros((1, 0)))
        assert now.up_n[0, one.site] <= 0.0
    slipping = made(earlier_forms.SlippingBackrest)
    now = moment()
    now.v[:] = 0.2
    held = slipping.slip * PERSON.rise_m[slipping.site]
    assert slipping.act(now, np.array([[held]]))[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert now.up_n[0, slipping.site] == pytest.approx(-slipping.strength * (held + slipping.loss_s * 0.2))
    rubbing, now = made(development_forms.RubbingBackrest), moment()
    now.x[:] = 1e-3
    rubbing.act(now, np.zeros((1, 0)))
    assert now.up_n[0, rubbing.site] == pytest.approx(-rubbing.strength * 1e-3)


def test_pitching_seats_accelerate_by_their_lever_arm() -> None:
    t = np.arange(round(2.0 * seats.RATE_HZ)) / seats.RATE_HZ
    w = 2 * np.pi * 1.0
    turning = Event(
        "road", "synthetic", 0.0, np.zeros((t.size, 3)), np.column_stack([0 * t, 1e-3 * np.sin(w * t)]), 2.0
    )
    expected = -1e-3 * w**2 * np.sin(w * t)
    for form in of_kind("pitch"):
        one = made(form)
        found = one.base_mps2(turning)
        assert found[t > 1.0] == pytest.approx(one.strength * expected[t > 1.0], abs=0.06 * one.strength * 1e-3 * w**2)


def test_necks_shorten_by_their_chord_and_spines_press_by_the_horizontal_acceleration() -> None:
    now = moment()
    now.signal = np.array([[0.2, 0.5]])
    nod = made(development_forms.NoddingNeck)
    assert nod.offset(now, np.empty((1, 0)))[1:] == pytest.approx(
        (nod.strength * (1 - np.cos(0.2)), nod.strength * 0.5 * np.sin(0.2))
    )
    curved = made(earlier_forms.CurvedNeck)
    signals = curved.signals(shaken(), PERSON)
    phi = curved.bent_rad + np.diff([shaken().leaning_rad(curved.site + i)[:, 1] for i in (0, 1)], axis=0)[0]
    chord = 2.0 * np.sin(0.5 * phi) / phi
    np.testing.assert_allclose(signals[:, 0], chord[0] - chord, atol=1e-12)
    steady = dataclasses.replace(shaken(), accel_mps2=np.ones((9000, 3)), angle_rad=np.zeros((9000, 2)))
    for form in of_kind("cross_axis"):
        one, now = made(form), moment()
        now.signal = one.signals(steady, PERSON)[-1:]
        one.act(now, np.empty((1, 0)))
        both = 1.0 + getattr(one, "left", 0.0)
        assert now.up_n[0, 0] == pytest.approx(one.strength * both * PERSON.inertia_kg[0], rel=1e-3)


def test_engines_have_their_line() -> None:
    long = dataclasses.replace(shaken(), accel_mps2=np.zeros((round(8 * seats.RATE_HZ), 3)))
    for form in of_kind("periodic"):
        one = made(form)
        line = np.abs(np.fft.rfft(one.signals(long, PERSON)[:, 0]))
        assert np.argmax(line) / 8.0 == pytest.approx(one.frequency_hz, abs=1.6)


def test_effects_outside_the_classes_follow_their_definition() -> None:
    tremor = made(earlier_forms.Tremor)
    w = 2 * np.pi * tremor.frequency_hz
    cycle = integrate.solve_ivp(lambda t, y: tremor.act(moment(), y[None])[0], (0, 60 / w), [0.1, 0.0], rtol=1e-7)
    assert np.abs(cycle.y[0]).max() == pytest.approx(2.0, abs=0.03)
    breath, now = made(development_forms.Breathing), moment(1e-3)
    now.time_s[:] = 0.25 / breath.rate_hz
    breath.act(now, np.empty((1, 0)))
    assert -now.up_n[0, breath.site] == pytest.approx(breath.strength * k_b(breath)[0] * 1e-3)
    past, now = made(development_forms.Bypass), moment(1e-3)
    past.act(now, np.empty((1, 0)))
    k = PERSON.stiffness_n_per_m[past.site + 1 : past.site + 3]
    assert now.up_n[0, past.site] == pytest.approx(past.strength * k.prod() / k.sum() * 2e-3)
    for form, at in ((earlier_forms.LongBypass, 3), (earlier_forms.SharedHead, 5)):
        now = moment(1e-3)
        made(form).act(now, np.empty((1, 0)))
        assert now.up_n[0, at] < 0.0


# --- sensors ---------------------------------------------------------------------------------------------------------


def test_skins_carry_slow_motion_and_ring() -> None:
    happens, t = shaken(), np.arange(round(4.0 * HELD_HZ)) / HELD_HZ
    for form in of_kind("skin"):
        one = made(form)

        def gain(hz: float, one: Effect = one) -> float:
            wave = np.tile(np.sin(2 * np.pi * hz * t)[:, None], 3)
            return float(one.sensor_acceleration(one.site, happens, wave)[t > 2.0].std() / wave[t > 2.0].std())

        assert gain(0.5) == pytest.approx(1.0, abs=0.01) and gain(200.0) < 1.0
        assert max(gain(hz) for hz in np.arange(12.0, 45.0, 3.0)) > 1.05


def test_tilts_gains_clocks_and_ranges(no_rest: None) -> None:
    before = dataclasses.replace(shaken(), accel_mps2=np.zeros((20000, 3)), angle_rad=np.zeros((20000, 2)))
    pushed = dataclasses.replace(before, accel_mps2=np.full((20000, 3), [2.0, 0.0, 1.0]))
    for form in of_kind("tilt"):
        one = dataclasses.replace(made(form), side=0.0)
        lean = np.full((20000, 2), [0.0, one.strength])
        still = Fixed(one.site, 1.0, lean)
        force, _ = wearing.sensed(one.site, pushed, np.ones(10000), (still,), NOTHING)
        s, forward = one.strength, pushed.aside_mps2(one.site)[-1, 0]
        assert force[-1, 2] == pytest.approx(10.80665 * np.cos(s) + forward * np.sin(s), abs=0.02)
        assert form.kind == "tilt" and np.abs(one.lean_rad(one.site, shaken())).max() <= s + 1e-12
    for form in of_kind("gain"):
        one = made(form)
        found = one.sensor_acceleration(one.site, shaken(), np.ones((len(shaken().time_s[::2]), 3)))
        assert np.abs(found - 1.0).max() <= one.strength + 1e-12
        np.testing.assert_array_equal(one.sensor_acceleration(one.site % 6 + 1, shaken(), np.ones((5, 3))), 1.0)
    for form in of_kind("clock"):
        one = made(form)
        late = one.clock_late_s(one.site, before, np.linspace(0.0, 60.0, 6001))
        assert 0.0 < late.min() < late.max() <= 1.7 * one.strength and np.ptp(late) > 0.15 * one.strength
    for form in of_kind("saturation"):
        one = made(form)
        full = sensors.GRAVITY_MPS2 + 20.0 / one.strength
        x, y, z = one.reading(one.site, np.array([[0.3 * full, 3.0 * full, -9.0 * full]]))[0]
        assert x == 0.3 * full and max(abs(x), abs(y), abs(z)) <= full and z == pytest.approx(-full, rel=1e-3)
