"""The third forms, each against its own law."""

import dataclasses

import numpy as np
import pytest
from hidden_forms import PERSON, followed, k_b, made, moment, shaken, tension
from scipy import integrate, special
from world import seats, sensors
from world.effects import third_forms
from world.effects.effect import Effect
from world.effects.event import HELD_HZ, Event


def third(name: str, **shapes: float) -> Effect:
    return dataclasses.replace(made(getattr(third_forms, name)), **shapes)


def test_third_elastic_forms_have_their_limits() -> None:
    pad, wires, layer = third("NeoHookeanPad"), third("GuyWires"), third("CartilageFilm")
    for one in (pad, wires, layer):
        d, k = PERSON.reach_m[one.site], one.strength * k_b(one)[0]
        tiny = 1e-3 * d
        assert tension(one, 0.0) == 0.0
        for s in np.linspace(-5 * d, 5 * d, 101):  # no jump where a law continues linearly
            assert abs(tension(one, s + 1e-9 * d) - tension(one, s)) < 1e-6 * k * d
        if one is pad:
            for s in (-tiny, tiny):
                assert tension(one, s) == pytest.approx(-k * s * s / (one.thick * d), rel=2e-3)
            y = 1.0 - 1.0 / one.thick
            assert tension(one, -d) == pytest.approx(k * one.thick * d * ((y - y**-2) / 3.0 - (y - 1.0)))
        if one is wires:
            assert tension(one, tiny) == pytest.approx(k * tiny**3 / (2.0 * (one.span * d) ** 2), rel=1e-3)
            assert tension(one, 1e3 * d) == pytest.approx(1e3 * k * d, rel=2e-3) == -tension(one, -1e3 * d)
        if one is layer:
            assert tension(one, -one.gap * d) == 0.0 and tension(one, -one.gap * d, 1.0) == 0.0
            half = one.gap * d + 0.5 * one.layer * d
            assert tension(one, -half) == pytest.approx(-k * one.layer * d * np.log(2.0))
            squeezed = -one.strength * one.film * k_b(one)[1] * 0.1
            assert tension(one, -one.gap * d, -0.1) == pytest.approx(squeezed)
            assert tension(one, -0.4 * one.gap * d, -0.1) == pytest.approx(squeezed / 27.0)


def test_third_dampers_and_friction_have_their_limits() -> None:
    flow, row = third("TurbulenceBuildsUp"), third("JenkinRow")
    b, twice = k_b(flow)[1], 2.0 * PERSON.rate_mps[flow.site]
    steady = followed(flow, lambda at: 0.0, lambda at: -twice, np.array([0.0, 1.0]))
    assert steady == pytest.approx([0.0, -flow.strength * b * twice * 2.0 / 1.25])
    d, coulomb = PERSON.reach_m[row.site], row.strength * k_b(row)[1] * PERSON.rate_mps[row.site]
    yields = row.slip * d * np.array([0.5, 0.8, 1.25, 2.0])
    slid = followed(row, lambda at: d * at, lambda at: d, np.array([0.0, 1e-3 * row.slip, 3.0]))
    assert slid[1] == pytest.approx(coulomb * (1e-3 * row.slip * d / yields).mean(), rel=1e-3)
    assert slid[2] == pytest.approx(coulomb, rel=1e-3)
    back = row.act(moment(0.0, -1.0), yields[None])
    np.testing.assert_array_equal(back, -1.0)  # it unloads elastically


def test_third_hysteresis_follows_the_path_integral() -> None:
    one = third("ColemanHodgdon")
    d, force = PERSON.reach_m[one.site], one.strength * k_b(one)[0] * PERSON.reach_m[one.site]
    pull = followed(one, lambda at: d * (at - 5.0), lambda at: d, np.linspace(0.0, 10.0, 11))

    def exact(end: float) -> float:  # by the path in units of d, from -5
        weighted = integrate.quad(lambda u: np.tanh(u / one.width) * np.exp((u - end) / one.memory), -5.0, end)[0]
        return weighted / one.memory

    np.testing.assert_allclose(pull, [force * exact(u) for u in np.arange(-5.0, 6.0)], atol=1e-5 * force)
    assert pull[5] < -0.1 * force  # it lags behind its curve, which is 0 here


def test_third_relaxation_is_a_stretched_exponential_and_yields_as_eyring() -> None:
    arms, arm = third("StretchedExponential"), third("EyringDashpot")
    d, k = PERSON.reach_m[arms.site], arms.strength * k_b(arms)[0]
    t = np.linspace(0.0, 3.0, 13)
    held = followed(arms, lambda at: d, lambda at: 0.0, t * arms.tau_s)
    np.testing.assert_allclose(held / (k * d), np.exp(-np.sqrt(t)), atol=0.04)
    scale = arm.stress * PERSON.reach_m[arm.site]
    start, t = 3.0, np.linspace(0.0, 2.0, 9)
    held = followed(arm, lambda at: start * scale, lambda at: 0.0, t * arm.tau_s)
    expected = 2.0 * np.arctanh(np.tanh(0.5 * start) * np.exp(-t))  # u' = -sinh(u) / tau
    np.testing.assert_allclose(held, arm.strength * k_b(arm)[0] * scale * expected, rtol=1e-4)


def test_third_bonds_postures_and_reflexes_settle() -> None:
    bonds = third("WorkBreaksBonds")
    ratio = bonds.heal_s / bonds.break_s
    n = 0.5 * (np.sqrt(ratio**2 + 4.0 * ratio) - ratio)
    rate = PERSON.rate_mps[bonds.site]
    assert bonds.act(moment(0.0, rate), np.array([[n]]))[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert bonds.act(moment(), np.array([[n]]))[0, 0] == pytest.approx(-n * n / bonds.heal_s)
    expected = -bonds.strength * n * (k_b(bonds)[0] * 1e-3 + bonds.damped * k_b(bonds)[1] * rate)
    assert tension(bonds, 1e-3, rate, np.array([[n]])) == pytest.approx(expected)
    tired, now = third("SlumpsSlowly"), moment(1e-3)
    lost = []
    for now.share in (np.zeros(1), np.full(1, 0.5), np.ones(1)):
        now.up_n = np.zeros((1, 6))
        tired.act(now, np.empty((1, 0)))
        lost.append(now.up_n[0, tired.site] / (tired.strength * k_b(tired)[0] * 1e-3))
    assert lost[0] == 0.0 and 0.6 < lost[1] < 0.8 and lost[2] == pytest.approx(1.0)
    startle, now = third("StartleLetsGo"), moment(1e-3)
    braced = []
    for now.moving_s in (-1.0, 5.0 * startle.rise_s, 20.0 * startle.lasts_s):
        now.up_n = np.zeros((1, 6))
        startle.act(now, np.empty((1, 0)))
        braced.append(-now.up_n[0, startle.site] / (startle.strength * k_b(startle)[0] * 1e-3))
    calm = np.exp(-5.0 * startle.rise_s / startle.lasts_s)
    assert braced == pytest.approx([0.0, calm * -np.expm1(-5.0), 0.0], abs=1e-7)
    loops, now, settled = third("TwoLoops"), moment(1e-3), np.full((1, 4), 1e-3)
    now.late = settled
    assert not loops.act(now, settled).any()
    assert -now.up_n[0, loops.site] == pytest.approx(loops.strength * k_b(loops)[0] * 1e-3)
    now.late, now.up_n = np.zeros((1, 4)), np.zeros((1, 6))
    assert loops.act(now, np.zeros((1, 4)))[0] == pytest.approx([1e-3 / 0.006, 0.0, 0.0, 0.0])
    assert not now.up_n.any()  # nothing yet


def test_third_contact_opens_part_by_part() -> None:
    one, weight = third("PeelsOffTheSeat"), PERSON.weight_n
    shares = np.linspace(1.0 - one.spread, 1.0 + one.spread, 20001)
    for load in (-1.0, 0.5 * (1.0 - one.spread), 1.0, 1.0 + 0.5 * one.spread, 3.0):
        stretch = load * weight / PERSON.stiffness_n_per_m[0]
        held = load * weight + tension(one, stretch)
        assert held == pytest.approx(np.minimum(load, shares).mean() * weight, rel=1e-4)


@pytest.mark.parametrize("name", ["OrganOnOrgan", "HoppingLoad", "ArmsOnTheWheel"])
def test_third_masses_obey_newton(name: str) -> None:
    one, now = third(name), moment(1e-3, 0.02)
    now.base_mps2[:] = 3.0
    rates = one.act(now, np.zeros((1, one.states)))[0]  # at rest in the seat, where a wheel does not pull
    shares = (one.lower, 1.0 - one.lower) if name == "OrganOnOrgan" else (1.0,)
    carried = sum(share * (up + 3.0) for share, up in zip(shares, rates[1::2], strict=True))
    assert now.up_n.sum() == now.up_n[0, one.site] == pytest.approx(-one.strength * carried)
    assert not rates[::2].any()


def test_third_loads_hop_and_organs_have_two_modes() -> None:
    pack, now = third("HoppingLoad"), moment()
    rates = pack.act(now, np.array([[0.5, 0.0]]))[0]  # half a metre above the shoulder it falls freely
    assert rates[1] == pytest.approx(-seats.GRAVITY_MPS2)
    assert now.up_n[0, pack.site] == pytest.approx(pack.strength * seats.GRAVITY_MPS2)
    organs = third("OrganOnOrgan")
    matrix = np.array([organs.act(moment(), row[None])[0] for row in np.eye(4)]).T
    w = 2.0 * np.pi * organs.frequency_hz
    found = np.linalg.eigvals(matrix)
    assert np.prod(np.abs(found)) == pytest.approx(w**4 * organs.upper_ratio**2 / organs.lower)
    assert found.real.max() < 0.0


def test_third_cushion_is_in_series_and_its_air_leaks() -> None:
    foam = third("FoamWithAir")
    now, k = moment(), PERSON.stiffness_n_per_m[0] / foam.strength
    now.joint_n[:] = load = -0.2 * k * foam.thick_m
    own = integrate.solve_ivp(
        lambda t, y: foam.act(now, y[None])[0], (0.0, 5.0), np.zeros(3), "LSODA", rtol=1e-8, atol=1e-10
    ).y[:, -1]
    u = -own[0] / foam.thick_m  # without its air: u + 9 u^3 = 0.2
    assert u + 9.0 * u**3 == pytest.approx(-load / k / foam.thick_m, rel=1e-3) and own[2] == pytest.approx(own[0])
    joint, stretch, rate = foam.offset(now, own[None])
    assert joint == 0 and stretch == -own[0] and rate == -own[1]
    tiny = 1e-6
    now.joint_n[:] = 0.0
    pressed = foam.act(now, np.array([[-tiny, 0.0, 0.0]]))[0, 1] * foam.mass_kg
    assert pressed == pytest.approx(k * tiny * (1.0 + foam.air), rel=1e-4)


def test_third_rests_and_belts() -> None:
    rest, belt, strap = third("ReclinedBackOpens"), third("WebbingWithBuckle"), third("TetheredHead")
    rise, now = PERSON.rise_m[rest.site], moment()
    now.v[:] = 0.2
    assert rest.act(now, np.array([[0.9 * rest.slip * rise]]))[0, 0] == 0.2  # it sticks
    assert now.up_n[0, rest.site] == pytest.approx(-rest.strength * 0.9 * rest.slip * rise)
    now.x[:], now.v[:] = 2.0 * rest.opens * rise, 0.0
    assert rest.act(now, np.array([[1e-3]]))[0, 0] == pytest.approx(-1e-3 / 0.004)  # it is open
    now, rise = moment(), PERSON.rise_m[belt.site]
    for x, taut in ((0.99 * belt.slack * rise, 0.0), (-rise, 0.0), (rise, 2.0 * (1.0 - belt.slack) * rise)):
        now.x[:], now.up_n = x, np.zeros((1, 6))
        up = belt.act(now, np.zeros((1, 2)))[0, 1]
        assert now.up_n[0, belt.site] == pytest.approx(-belt.strength * taut, abs=1e-9)
        assert up * belt.mass_kg == pytest.approx(belt.strength * taut, abs=1e-9)
    now.x[:], now.up_n = 0.05, np.zeros((1, 6))
    y = integrate.solve_ivp(
        lambda t, y: belt.act(now, y[None])[0], (0.0, 2.0), np.zeros(2), "LSODA", rtol=1e-8, atol=1e-10
    ).y[0, -1]
    now.up_n[:] = 0.0
    belt.act(now, np.array([[y, 0.0]]))
    series = 1.0 / (1.0 / 2.0 + 1.0 / (2.0 + belt.held)) * (0.05 - belt.slack * rise)
    assert -now.up_n[0, belt.site] == pytest.approx(belt.strength * series, rel=1e-4)
    d = PERSON.rise_m[5]
    for x, rate, loss in ((0.9 * strap.slack * d, 1.0, 0.0), (2.0 * d, 10.0, 1.0), (2.0 * d, -10.0, -1.0)):
        now = moment()
        now.x[:], now.v[:] = x, rate
        strap.act(now, np.empty((1, 0)))
        over = max(x - strap.slack * d, 0.0)
        force = strap.strength * (over + over**2 / (strap.toe * d)) * (1.0 + loss * strap.loss)
        assert now.up_n.sum() == now.up_n[0, 5] == pytest.approx(-force)


def test_third_seats_necks_and_trunks_turn() -> None:
    t = np.arange(round(4.0 * seats.RATE_HZ)) / seats.RATE_HZ
    late, none = t > 3.0, np.zeros((t.size, 3))
    frame = third("TwistingFrame", up_m=0.0)
    w = 2.0 * np.pi * frame.frequency_hz
    pitch = 1e-4 * np.sin(w * t)
    found = frame.base_mps2(Event("road", "synthetic", 0.0, none, np.column_stack([0 * t, pitch]), 4.0))[late]
    rings = np.abs(1.0 + 1.0 / (2j * frame.damping_ratio))
    assert found.std() == pytest.approx(frame.strength * rings * w**2 * pitch[late].std(), rel=0.02)
    up = third("TwistingFrame", up_m=0.3)
    steady = np.column_stack([0 * t, 0.5 * t])  # half a radian per second
    base = up.base_mps2(Event("road", "synthetic", 0.0, none, steady, 4.0))[late]
    np.testing.assert_allclose(base[:-3], -up.strength * 0.25, rtol=1e-6)
    trunk, now = third("RocksAtTheHip"), moment()
    pushed = dataclasses.replace(shaken(), accel_mps2=np.full((t.size, 3), [2.0, 1.0, 0.0]))
    now.signal = trunk.signals(pushed, PERSON)[-1:]
    trunk.act(now, np.empty((1, 0)))
    expected = trunk.strength * (2.0 + trunk.left) * PERSON.inertia_kg * np.arange(1, 7) / 6.0
    np.testing.assert_allclose(now.up_n[0], expected, rtol=1e-3)


def test_third_necks_shorten_at_both_hinges(monkeypatch: pytest.MonkeyPatch) -> None:
    neck, angle = third("TwoHingedNeck"), 0.1
    monkeypatch.setattr(Event, "leaning_rad", lambda self, at: np.full((4000, 2), [0.0, angle * (at > neck.site)]))
    lost = neck.signals(shaken(), PERSON)[:, 0]
    assert lost[0] == pytest.approx(1.0 - np.cos(angle), rel=0.05)  # at once, at the upper hinge
    assert lost[-1] == pytest.approx(np.cos(neck.bent_rad) - np.cos(neck.bent_rad + angle), rel=1e-3)  # at the lower
    now = moment()
    now.signal = np.array([[0.2, 0.5]])
    at, stretch, rate = neck.offset(now, np.empty((1, 0)))
    assert (at, stretch[0], rate[0]) == (neck.site, 0.2 * neck.strength, 0.5 * neck.strength)


def test_a_third_engine_has_its_firing_order_and_quarters_of_it_at_standstill_too() -> None:
    one = third("MisfiringEngine", firing_hz=20.0, sharpness=2.0, weak=0.4)
    t = np.arange(round(40.0 * seats.RATE_HZ)) / seats.RATE_HZ
    rest = Event("rail", "synthetic", 7.0, np.zeros((t.size, 3)), np.zeros((t.size, 2)), 36.0)
    shake = one.signals(rest, PERSON)[:, 0]
    assert shake[t < 2.0].std() == pytest.approx(shake[(t >= 10.0) & (t < 12.0)].std(), rel=1e-3)
    assert abs(shake.mean()) < 1e-3
    lines = {hz: 2.0 * np.abs((np.exp(-2j * np.pi * hz * t) * shake).mean()) for hz in (5.0, 10.0, 20.0, 40.0, 23.0)}
    # Three whole pulses and one of 0.6: I1(k) / I1(k) times their mean, and the second order by I2 / I1.
    assert lines[20.0] == pytest.approx(0.9, rel=2e-3)
    assert lines[40.0] == pytest.approx(0.9 * special.iv(2, 2.0) / special.iv(1, 2.0), rel=2e-3)
    assert min(lines[5.0], lines[10.0]) > 0.02 and lines[23.0] < 1e-3  # every fourth pulse is weak


def test_third_skins_follow_their_transfer() -> None:
    skin, happens, t = third("ZenerSkin"), shaken(), np.arange(round(4.0 * HELD_HZ)) / HELD_HZ
    w = 1.0 / skin.strength
    for hz in (0.5, 10.0, 0.5 * w / np.pi, 150.0):
        s = 2j * np.pi * hz
        k = w**2 * (1.0 + skin.firm * skin.tau_s * s / (1.0 + skin.tau_s * s)) + 2.0 * skin.damping_ratio * w * s
        wave = np.tile(np.sin(2.0 * np.pi * hz * t)[:, None], 3)
        found = skin.sensor_acceleration(skin.site, happens, wave)[t > 2.0].std() / wave[t > 2.0].std()
        assert found == pytest.approx(np.abs(k / (s * s + k)), rel=0.03)


def test_third_sensors_follow_their_definition(no_rest: None) -> None:
    strap, clock, beside, clip = (
        third(name) for name in ("LeansWithThrust", "SawtoothBuffer", "BesideTheCentre", "OverloadRecovery")
    )
    still = dataclasses.replace(shaken(), accel_mps2=np.zeros((20000, 3)), angle_rad=np.zeros((20000, 2)))
    still = dataclasses.replace(still, motion_s=20000 / seats.RATE_HZ)
    for forward, most in ((0.0, 1.0 / (1.0 + strap.swing)), (1e3, 1.0)):
        thrust = dataclasses.replace(still, accel_mps2=np.full((20000, 3), [forward, 0.0, 0.0]))
        lean = np.hypot(*strap.lean_rad(strap.site, thrust)[15000])
        assert lean == pytest.approx(strap.strength * most, rel=1e-6)
    assert strap.lean_rad(strap.site % 6 + 1, still) is None
    late = clock.clock_late_s(clock.site, dataclasses.replace(still, begin_s=3.0), np.linspace(0.0, 100.0, 200001))
    assert late.mean() == pytest.approx(clock.strength * 0.5 * (1.0 + clock.steady), rel=0.01)
    assert (late.min(), late.max()) == pytest.approx((clock.steady * clock.strength, clock.strength), rel=0.01)
    assert clock.clock_late_s(clock.site % 6 + 1, still, late) == 0.0
    happens = shaken()
    accel = np.random.default_rng(0).standard_normal((len(happens.time_s[::2]), 3))
    found = beside.sensor_acceleration(beside.site, happens, accel)
    relative = accel[:, 2] - happens.accel_mps2[::2, 2]
    np.testing.assert_allclose(found - accel, np.column_stack([0 * relative, 0 * relative, beside.strength * relative]))
    full = seats.GRAVITY_MPS2 + 20.0 / clip.strength
    held = round(10.0 * clip.recovery_s * sensors.RATE_HZ)
    force = np.concatenate([np.full((held, 3), 2.0 * full), np.zeros((held, 3))])
    reading = clip.reading(clip.site, force)
    after = np.arange(held) / sensors.RATE_HZ
    assert reading[0, 2] > 0.95 * full and np.abs(reading).max() <= full
    assert reading[held - 1, 2] == pytest.approx((1.0 - clip.share) * full, rel=1e-3)
    shifted = -clip.share * full * np.exp(-after[1:] / clip.recovery_s)
    np.testing.assert_allclose(reading[held + 1 :, 2], shifted, atol=0.02 * full)


def test_third_forms_of_no_class() -> None:
    muscle, braces = third("LevelTunedMuscle"), third("BracesInCurves")
    steady = dataclasses.replace(shaken(), accel_mps2=np.full((90000, 3), [0.0, -0.5, 2.0]))
    assert muscle.signals(steady, PERSON)[-1, 0] == pytest.approx(2.0 / (2.0 + muscle.half_mps2), rel=1e-3)
    assert braces.signals(steady, PERSON)[-1, 0] == pytest.approx(np.tanh(0.5 / braces.half_mps2), rel=1e-3)
    for one in (muscle, braces):  # the moment's signal is 1
        assert tension(one, 1e-3) == pytest.approx(one.strength * k_b(one)[0] * 1e-3)
    damper = third("SlewLimitedDamper")
    b, rate = damper.strength * k_b(damper)[1], PERSON.rate_mps[damper.site]
    now = moment()
    now.v[:] = 0.1
    assert damper.act(now, np.array([[b * 0.1]]))[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert -now.up_n[0, damper.site] == pytest.approx(b * 0.1) == now.up_n[0, damper.site - 1]
    now.v[:] = 1e3
    assert damper.act(now, np.zeros((1, 1)))[0, 0] == pytest.approx(damper.slew * b * rate / 0.05)
    neck, now = third("FeedForwardNeck"), moment()
    now.stretch[0, 0] = PERSON.reach_m[0]
    neck.act(now, np.empty((1, 0)))
    expected = neck.strength * k_b(neck)[0] * PERSON.reach_m[neck.site] * np.tanh(1.0)
    assert -now.up_n[0, neck.site] == pytest.approx(expected) and now.up_n[0, 0] == 0.0
    now.stretch[0], now.up_n = [0, 1, 1, 1, 1, 1], np.zeros((1, 6))
    neck.act(now, np.empty((1, 0)))
    assert not now.up_n.any()  # the neck does not act on itself
    joints, now = third("CommunicatingJoints"), moment(1e-3)
    own = np.array([[0.5e-3]])
    assert joints.act(now, own)[0, 0] == pytest.approx(1.5e-3 / joints.leak_s)
    pulls = -np.cumsum(now.up_n[0, ::-1])[::-1]
    k = PERSON.stiffness_n_per_m[[joints.site, joints.site + 2]]
    expected = np.zeros(6)
    expected[[joints.site, joints.site + 2]] = joints.strength * k.prod() / k.sum() * 1.5e-3
    np.testing.assert_allclose(pulls, expected, atol=1e-9)
    arms = third("ArmsOnTheWheel")
    held = arms.act(moment(), np.array([[1e-3, 0.0]]))[0, 1]
    assert held == pytest.approx(-1e-3 * (2.0 * np.pi) ** 2 * (arms.shoulder_hz**2 + arms.wheel_hz**2))


def test_third_absorbers_bend_the_frame_by_their_transfer() -> None:
    one, t = third("AbsorberUnderThePan"), np.arange(round(6.0 * seats.RATE_HZ)) / seats.RATE_HZ
    z = one.damping_ratio
    for hz in (2.0, one.absorber_hz, one.pan_hz, 60.0):
        wave = np.sin(2.0 * np.pi * hz * t)
        happens = Event("rail", "synthetic", 0.0, np.column_stack([0 * t, 0 * t, wave]), np.zeros((t.size, 2)), 6.0)
        s, a, p = 1j * hz, one.absorber_hz, one.pan_hz
        tuned = (2 * z * a * s + a * a) / (s * s + 2 * z * a * s + a * a)
        expected = one.strength * np.abs(s * s * tuned / (s * s + 2 * z * p * s + p * p))
        found = one.base_mps2(happens)[t > 4.0].std() / wave[t > 4.0].std()
        assert found == pytest.approx(expected, rel=0.03)
