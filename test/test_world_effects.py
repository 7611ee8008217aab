"""The independent simulation of effects: each form against its own law, and sittings, bags and background."""

import ast
import dataclasses
import itertools
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy import integrate, interpolate
from scipy.spatial.transform import Rotation
from world import body, ride, seats, sensors
from world.effects import (
    absorbing,
    development_forms,
    earlier_forms,
    event,
    moving,
    second_forms,
    sitting,
    third_forms,
    wearing,
)
from world.effects.background import NOTHING
from world.effects.draw import KINDS, forms
from world.effects.effect import Effect, Moment, Person
from world.effects.event import FARTHEST_RAD, HELD_HZ, Event
from world.seats import GRAVITY_MPS2, RATE_HZ

from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from biodyn_ros.reading.recordings import read_recordings

WORLD = Path(__file__).parent / "world"
ALL = (*development_forms.FORMS, *earlier_forms.FORMS)
EVERY = (*ALL, *second_forms.FORMS, *third_forms.FORMS)
PERSON = dataclasses.replace(
    Person.of(body.drawn(2, np.random.default_rng(3)), 0),
    reach_m=np.array([8.0, 6.0, 5.0, 4.0, 2.0, 2.0]) * 1e-3,
    rise_m=np.full(6, 8e-3),
    rate_mps=np.array([0.1, 0.08, 0.06, 0.05, 0.04, 0.03]),
)
SHORT_S = 0.25
QUICK = FitSettings(swarm=SwarmSettings(particles=30, iterations=60, starts=2), evaluations=600)


def of_kind(*kinds: str, among: tuple[type[Effect], ...] = ALL) -> list[type[Effect]]:
    return [form for form in among if form.kind in kinds]


def made(form: type[Effect], seed: int = 0) -> Effect:
    one = form.drawn(np.random.default_rng(seed))
    return dataclasses.replace(one, at_s=0.4 * SHORT_S) if hasattr(one, "at_s") else one


def shaken() -> Event:
    """Half a second of strong shaking on every axis, without rest before it, which is all of the sitting."""
    t = np.arange(2 * round(0.5 * SHORT_S * seats.RATE_HZ) + 1) / seats.RATE_HZ
    rise = np.sin(np.pi * np.minimum(t / SHORT_S, 1.0)) ** 2
    up = 25.0 * np.sin(2 * np.pi * 9.0 * t) + 15.0 * np.sin(2 * np.pi * 4.0 * t)
    forward, left = 4.0 * np.sin(2 * np.pi * 5.0 * t), 3.0 * np.sin(2 * np.pi * 6.0 * t)
    angle = 0.03 * np.column_stack([np.sin(2 * np.pi * 4.0 * t), np.sin(2 * np.pi * 3.0 * t)])
    accel = np.column_stack([forward, left, up])
    return Event("rail", "synthetic", 0.0, rise[:, None] * accel, rise[:, None] * angle, SHORT_S, 1.0, SHORT_S)


@pytest.fixture
def no_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (event, moving):
        monkeypatch.setattr(module, "REST_S", (0.0, 0.0))


def moment(stretch: float = 0.0, rate: float = 0.0, count: int = 1) -> Moment:
    """A body whose joints are all stretched so far and so fast."""
    now = Moment()
    now.person, now.up_n = PERSON, np.zeros((count, 6))
    now.stretch, now.rate = np.full((count, 6), stretch), np.full((count, 6), rate)
    now.x, now.v = np.cumsum(now.stretch, axis=1), np.cumsum(now.rate, axis=1)
    now.joint_n = PERSON.stiffness_n_per_m * now.stretch + PERSON.damping_ns_per_m * now.rate
    now.base_mps2, now.signal, now.late = np.zeros(count), np.ones((count, 1)), np.zeros((count, 2))
    now.time_s, now.share, now.moving_s = np.full(count, 1.0), np.full(count, 0.5), 1.0
    return now


def tension(effect: Effect, stretch: float, rate: float = 0.0, own: np.ndarray | None = None) -> float:
    """Force of an effect in its joint, N."""
    now = moment(stretch, rate)
    effect.act(now, np.zeros((1, effect.states)) if own is None else own)
    return float(-now.up_n[0, effect.site])


def followed(effect: Effect, stretch: Callable[[float], float], rate: Callable[[float], float], t: np.ndarray):
    """The joint's pull (n,) along a given path, its states integrated by LSODA."""

    def slope(at: float, own: np.ndarray) -> np.ndarray:
        return effect.act(moment(stretch(at), rate(at)), own[None])[0]

    own = integrate.solve_ivp(slope, (0.0, t[-1]), np.zeros(effect.states), "LSODA", t, rtol=1e-8, atol=1e-12).y.T
    return np.array([tension(effect, stretch(at), rate(at), one[None]) for at, one in zip(t, own, strict=True)])


def k_b(effect: Effect) -> tuple[float, float]:
    return PERSON.stiffness_n_per_m[effect.site], PERSON.damping_ns_per_m[effect.site]


# --- the split, and what the world is made of ------------------------------------------------------------------------


def test_the_world_of_effects_shares_nothing_with_the_package() -> None:
    allowed = {*sys.stdlib_module_names, "numpy", "scipy", "mcap", "world", "typing_extensions"}
    for path in WORLD.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert {name.split(".")[0] for name in names} <= allowed, path


def test_splits_are_disjoint_and_each_has_every_class() -> None:
    splits = {split: forms(split) for split in ("development", "second", "earlier", "third")}
    for (_, ours), (_, theirs) in itertools.combinations(splits.items(), 2):
        assert not set(ours) & set(theirs) and not {f.__name__ for f in ours} & {f.__name__ for f in theirs}
    for split, found in splits.items():
        assert {f.__module__ for f in found} == {f"world.effects.{split}_forms"}
        assert {form.kind for form in found} == {*KINDS, "outside"}
    assert len({(form.kind, form.family) for form in EVERY}) == len(KINDS) + 1


def test_drawing_for_development_does_not_even_import_the_forms_for_scoring() -> None:
    code = (
        "import sys, numpy as np; from world.effects import draw, sitting\n"
        "draw.effect('development', np.random.default_rng(0))\n"
        "draw.effect('second', np.random.default_rng(0))\n"
        "draw.effect('earlier', np.random.default_rng(0))\n"
        "sys.exit('world.effects.third_forms' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=WORLD.parent, check=False).returncode == 0


@pytest.mark.parametrize("form", EVERY)
def test_draws_stay_in_their_ranges_and_truth_is_plain(form: type[Effect]) -> None:
    for seed in range(5):
        one = made(form, seed)
        assert one.site in form.sites and form.strengths[0] <= one.strength <= form.strengths[1]
        assert {type(value) for value in one.truth().values()} <= {str, int, float}
    assert form.__doc__ and form.__doc__.rstrip(".").endswith(form.kind)


# --- moving ----------------------------------------------------------------------------------------------------------


def test_bodies_without_effects_match_dop853(no_rest: None) -> None:
    people, happens = body.drawn(2, np.random.default_rng(1)), shaken()
    seat = happens.accel_mps2[:, 2]
    expected = body.accelerations(people, seats.RATE_HZ, np.column_stack([seat, seat]))[:, ::2]
    found = moving.moved([moving.Party(Person.of(people, i), [happens]) for i in range(2)])
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.accel_mps2[0], other, atol=2e-5 * np.abs(expected).max())


@cache
def answers() -> tuple[np.ndarray, dict[type[Effect], np.ndarray], dict[type[Effect], np.ndarray]]:
    """The shaken body: plain, with nothing of each form, and with each form."""
    none = [dataclasses.replace(made(form), strength=0.0) for form in EVERY]
    parties = [moving.Party(PERSON, [shaken()], (one,)) for one in [*none, *map(made, EVERY)]]
    plain, *found = moving.moved([moving.Party(PERSON, [shaken()]), *parties])
    accel = [one.accel_mps2[0] for one in found]
    count = len(EVERY)
    return (
        plain.accel_mps2[0],
        dict(zip(EVERY, accel[:count], strict=True)),
        dict(zip(EVERY, accel[count:], strict=True)),
    )


SENSOR_KINDS = ("skin", "tilt", "clock", "gain", "saturation")


@pytest.mark.parametrize("form", EVERY)
def test_zero_strength_is_the_base_simulation(form: type[Effect], no_rest: None) -> None:
    plain, none, _ = answers()
    np.testing.assert_allclose(none[form], plain, atol=1e-9 * np.abs(plain).max())
    nothing, up = dataclasses.replace(made(form), strength=0.0), plain[:, made(form).site - 1]
    for ours, theirs in zip(*(sent(effects, up, made(form).site) for effects in ((), (nothing,))), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("form", EVERY)
def test_a_strength_above_zero_changes_the_simulation(form: type[Effect], no_rest: None) -> None:
    plain, _, some = answers()
    assert np.isfinite(some[form]).all()
    moves = np.abs(some[form] - plain).max() / np.abs(plain).max()
    one = made(form)
    before, after = (sent(effects, plain[:, one.site - 1], one.site)[1] for effects in ((), (one,)))
    if form.kind in SENSOR_KINDS:
        assert moves == 0.0
        if form.kind != "saturation":
            assert np.abs(after - before).max() > 0.01
    else:
        assert 1e-3 < moves < 5.0
        np.testing.assert_array_equal(after, before)


def sent(effects: tuple[Effect, ...], up: np.ndarray, site: int) -> wearing.Stream:
    imu = sensors.Imu(np.eye(3), np.zeros(3), 0.0)
    return wearing.stream(max(site, 1), imu, shaken(), up, effects, NOTHING, np.random.default_rng(0))


@pytest.mark.slow
def test_a_four_times_finer_step_changes_little_even_at_kinks(no_rest: None, monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = ("stop", "friction", "hysteresis", "lift_off", "harness", "quadratic_damping", "reflex", "thixotropy")
    chosen = [made(form) for form in of_kind(*kinds, among=EVERY)]
    coarse = moving.moved([moving.Party(PERSON, [shaken()], (one,)) for one in chosen])
    happens = shaken()
    fine_s = np.linspace(0.0, happens.time_s[-1], 4 * (len(happens.time_s) - 1) + 1)
    curve = interpolate.CubicSpline(happens.time_s, happens.accel_mps2)(fine_s)
    finer = dataclasses.replace(happens, accel_mps2=curve, angle_rad=np.zeros((len(curve), 2)))
    monkeypatch.setattr(moving, "STEP_S", 0.25 / HELD_HZ)
    fine = moving.moved([moving.Party(PERSON, [finer], (one,)) for one in chosen])
    for effect, one, other in zip(chosen, coarse, fine, strict=True):
        accel = other.accel_mps2[0][::4]
        assert np.abs(one.accel_mps2[0] - accel).max() < 2e-3 * np.abs(accel).max(), effect


def test_delays_interpolate_by_cubic_polynomials() -> None:
    effect = made(development_forms.LatePull)
    acting = moving._Acting(effect, moving.Party(PERSON, [shaken()], (effect,)), slice(0, 1), 12, 4001)
    t = np.arange(acting.memory.shape[1]) * moving.STEP_S
    acting.memory[0, :, 0, 0], acting.memory[1, :, 0, 0] = np.sin(60.0 * t), 60.0 * np.cos(60.0 * t)
    assert acting._recalled(100.37)[0, 0] == pytest.approx(np.sin(60.0 * 100.37 * moving.STEP_S), abs=1e-8)
    assert acting._recalled(-3.0)[0, 0] == 0.0


FROM_THE_SEAT = (third_forms.TetheredHead, third_forms.AbsorberUnderThePan, third_forms.ArmsOnTheWheel)
"""Effects of no class that act from the seat, so that their forces on the body have a sum."""


@pytest.mark.parametrize(
    "form",
    [f for f in EVERY if f.family in ("elastic", "rubbing", "drifting", "outside") and f not in FROM_THE_SEAT],
)
def test_forces_between_segments_are_equal_and_opposite(form: type[Effect]) -> None:
    one = dataclasses.replace(made(form), site=form.sites[-1])
    now = moment(-PERSON.reach_m[one.site], 0.01)
    now.share[:] = 1.0
    one.act(now, np.full((1, one.states), 1e-3))
    assert now.up_n.any()
    if one.site or form.kind == "outside":
        assert now.up_n.sum() == pytest.approx(0.0, abs=1e-9 * np.abs(now.up_n).max())


# --- each form against its own law -----------------------------------------------------------------------------------


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


@dataclasses.dataclass(frozen=True, eq=False)
class Fixed(Effect):
    """A sensor with a given tilt."""

    lean: np.ndarray

    def lean_rad(self, sensor: int, event: Event) -> np.ndarray:
        """Always."""
        return self.lean


# --- the second forms, against their own laws ------------------------------------------------------------------------


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


# --- the third forms, against their own laws -------------------------------------------------------------------------


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


def test_third_engines_have_two_close_lines() -> None:
    one = third("BeatingShafts", frequency_hz=20.0, apart_hz=0.5)
    t = np.arange(round(40.0 * seats.RATE_HZ)) / seats.RATE_HZ
    rest = Event("rail", "synthetic", 7.0, np.zeros((t.size, 3)), np.zeros((t.size, 2)), 36.0)
    shake = one.signals(rest, PERSON)[:, 0]
    assert not shake[t < 2.4].any() and not shake[t > 38.6].any()
    inside = (t >= 3.0) & (t < 37.0)  # whole turns of both lines
    for hz, size in ((20.0, 1.0), (20.5, one.other), (21.0, 0.0)):
        line = 2.0 * np.abs((np.exp(-2j * np.pi * hz * t) * shake)[inside].mean())
        assert line == pytest.approx(size, abs=2e-3)


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


# --- sittings, bags and background -----------------------------------------------------------------------------------

BRIEF = sitting.Plan(counts=(1, 1, 1), seconds=(2.5, 2.5, 2.5), uses=("fit",), recorded=False)


@cache
def sittings() -> list[sitting.Sitting]:
    """One that hides something in the head's sensor, and one that hides something in a joint."""
    hidden = (development_forms.GainInMotion(6, 0.1), development_forms.RubbingBackrest(3, 3e3))
    return sitting.drawn(2, 5, plan=BRIEF, chosen=lambda i: hidden[i])


def test_a_sitting_has_the_floor_of_data_for_each_use_and_takes_turns() -> None:
    planned = sitting._planned(sitting.Plan(recorded=False), np.random.default_rng(0))
    for use in sitting.USES:
        own = [one for one in planned if one.use == use]
        assert sum(one.event.motion_s for one in own if one.event.case == "road") >= 30.0
        assert [sum(one.event.case == case for one in own) for case in seats.CASES] == [3, 3, 3]
        assert {one.name for one in own} == {f"{case}_{n}" for case in seats.CASES for n in (1, 2, 3)}
        assert own[-1].event.begin_s > 0.7 * planned[-1].event.whole_s
    begins = [one.event.begin_s for one in planned]
    assert all(b - a >= 2.0 for a, b in itertools.pairwise(begins))
    rails = [one.event.accel_mps2[:, 2] for one in planned if one.event.case == "rail"]
    assert max(abs(np.corrcoef(a, b)[0, 1]) for a, b in itertools.pairwise(rails)) < 0.5


def test_with_and_without_are_the_same_but_for_the_effect() -> None:
    gain, backrest = sittings()
    for one in (gain, backrest):
        rest = round(event.REST_S[0] * HELD_HZ)
        assert np.abs(one.hidden[0][:rest]).max() < 1e-9
    hidden, plain = gain.streams(0), gain.streams(0, with_effects=False)
    for name in ride.WORN:
        for with_it, without in zip(hidden[name], plain[name], strict=True):
            assert np.array_equal(with_it, without) == (name != "head" or with_it is not hidden["head"][1])
    np.testing.assert_array_equal(gain.hidden[0], gain.plain[0])
    assert np.abs(backrest.hidden[0] - backrest.plain[0]).max() > 0.05
    assert gain.mass_matrix != backrest.mass_matrix


def test_a_sitting_repeats_alone() -> None:
    again, first = sitting.draft_of(1, 5, BRIEF, np.random.default_rng([5, 1])), sittings()[1]
    np.testing.assert_array_equal(again.theta, first.theta)
    for one, other in zip(again.events, first.events, strict=True):
        np.testing.assert_array_equal(one.event.accel_mps2, other.event.accel_mps2)


def test_bags_have_six_topics_without_the_truth(tmp_path: Path) -> None:
    one = sittings()[1]
    paths = one.write(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in paths] == [f"fit/{c}_1.mcap" for c in seats.CASES]
    forbidden = {"truth", "effect", "hidden", "blind", "theta", "segment", "cascade", *KINDS}
    forbidden |= {form.__name__ for form in EVERY} | {form.family for form in EVERY if form.family != "sensor"}
    with paths[0].open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        words = " ".join([s.name + s.data.decode() for s in summary.schemas.values()])
        words += " ".join(f"{c.topic} {c.metadata}" for c in summary.channels.values())
        messages = list(reader.iter_messages())
        assert not list(reader.iter_metadata()) and not list(reader.iter_attachments())
        header = reader.get_header()
    assert {c.topic for c in summary.channels.values()} == {f"imu/{name}/data" for name in ride.WORN}
    assert (header.profile, header.library) == ("ros2", "")
    raw = paths[0].read_bytes() + b"".join(message.data for _, _, message in messages)
    for word in forbidden:
        assert word.lower() not in words.lower()
        assert len(word) < 5 or word.lower().encode() not in raw.lower(), word
    stamps, force, gyro = one.streams(0)["seat"]
    first = next(message for _, channel, message in messages if channel.topic == "imu/seat/data")
    values = np.frombuffer(first.data[20:], "<f8")
    assert first.log_time == sitting.START_NS + round(one.events[0].event.begin_s * 1e9) + stamps[0]
    np.testing.assert_array_equal(values[25:28], force[0])
    np.testing.assert_array_equal(values[13:16], gyro[0])
    assert values[3] == 1.0 and values[4] == -1.0


@pytest.mark.slow
def test_effects_are_scaled_to_the_requested_ratio(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sitting, "GLANCE_S", 1.5)
    one, other = sittings()
    weak = dataclasses.replace(one, effects=(development_forms.LinedHelmet(5, 0.2),), background=other.background)
    (found,) = absorbing.scaled([weak], [0.8])
    assert found.ratio == pytest.approx(0.8, rel=0.3)
    assert found.effects[0].strength > 0.2 and found.truth()["ratio"] == found.ratio


@pytest.mark.slow
def test_the_background_has_the_residual_of_the_paper(tmp_path: Path) -> None:
    plan = sitting.Plan(counts=(0, 1, 1), seconds=(3.0, 3.0, 3.0), uses=("fit",), recorded=False)
    (one,) = sitting.drawn(1, 8, effects=0, plan=plan)
    cases = [Case.of(recording) for path in one.write(tmp_path) for recording in read_recordings(path)]
    assert [case.case for case in cases] == ["pothole", "rail"]
    middle = Parameters.from_vector(0.5 * (LOWER + UPPER))
    fit = fit_joint(cases, Subject("drawn", one.body_mass_kg, 1.75, one.mass_matrix, middle), 0, QUICK)
    percent = np.array([errors.nrmse_rms_percent for errors in fit.errors])
    assert 4.0 < np.median(percent) < 11.0 and percent.min() > 2.0 and percent.max() < 20.0


def test_rates_and_forces_of_a_leaning_sensor_agree() -> None:
    """Its orientation, integrated from its rates, shows gravity where its forces show it."""
    t = np.arange(3 * round(RATE_HZ)) / RATE_HZ
    angle = np.column_stack([0.8 * np.sin(3.0 * t) ** 2, -0.6 * np.sin(2.0 * t) ** 2])
    leaning = Event("road", "synthetic", 0.0, np.zeros((t.size, 3)), angle, 1.0)
    force, spin = wearing.sensed(0, leaning, np.zeros(t[::2].size), (), NOTHING)
    ground = Rotation.from_euler("XY", angle[::2]).apply(force)
    np.testing.assert_allclose(ground, np.broadcast_to([0.0, 0.0, GRAVITY_MPS2], ground.shape), atol=1e-12)
    turned = Rotation.identity()
    for rate, measured in zip(0.5 * (spin[1:] + spin[:-1]), force[1:], strict=True):
        turned = turned * Rotation.from_rotvec(rate / HELD_HZ)
        np.testing.assert_allclose(turned.apply(measured), [0.0, 0.0, GRAVITY_MPS2], atol=0.01)
    assert np.abs(force[:, :2]).max() > 5.0


def test_segments_lean_no_farther_than_a_spine_allows() -> None:
    hard = dataclasses.replace(shaken(), accel_mps2=20.0 * shaken().accel_mps2)
    for sensor, farthest in enumerate(FARTHEST_RAD):
        beyond = np.abs(hard.leaning_rad(sensor) - hard.angle_rad).max()
        assert beyond < farthest and (sensor == 0 or beyond > 0.5 * farthest)
