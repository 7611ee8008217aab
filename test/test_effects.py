"""Effects in the chain: each against its equation integrated by another hand, and absent ones to the last bit."""

import dataclasses
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from equations import RATE_HZ, SUBJECT, carried, channels, law, turned, twin
from hiding import applied
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.effect_assembly import EffectAssembly
from biodyn_core.body.model import Chain, Stepper, predict
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis import SensorSettings, imu_streams, load_case
from biodyn_core.effects import CATALOGUE, AppliedEffect, ChainEffect, EffectParameter, apply_to_seat, apply_to_sensors
from biodyn_core.effects.effect import Joint, JointLimit, Kind
from biodyn_core.pipeline.pipeline import Pipeline

NAMES = sorted(CATALOGUE)
IN_TIME = [name for name in NAMES if isinstance(CATALOGUE[name], ChainEffect)]


def shock(seconds: float = 0.5, peak: float = 60.0) -> np.ndarray:
    """A seat that is thrown up and down, (n,)."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return peak * np.sin(2.0 * np.pi * 7.0 * time) * np.sin(np.pi * time / seconds) ** 2


def with_effects(*effects: AppliedEffect, subject: Subject = SUBJECT) -> Subject:
    return dataclasses.replace(subject, effects=effects)


def answer(chain: Chain, seat: np.ndarray) -> np.ndarray:
    """Accelerations (n, 6) of a chain to a seat and whatever else it needs."""
    return chain.simulate(seat, RATE_HZ, channels(seat.size)).accel_mps2


def seen(*effects: AppliedEffect, seat: np.ndarray) -> np.ndarray:
    """Accelerations (n, 6) as sensors show them of a subject with effects, on whatever they act."""
    driven = channels(seat.size)
    return apply_to_sensors(effects, predict(with_effects(*effects), seat, RATE_HZ, driven).accel_mps2, RATE_HZ, driven)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


STRONG = {
    "asymmetry": {"asymmetry_per_m": 30.0},
    "cubic": {"cubic_per_m2": 2000.0},
    "stop": {"gap_m": 0.002},
    "harness": {"slack_m": 0.001},
    "backrest": {"friction_n": 60.0, "smooth_mps": 0.005},
    "cushion": {"stiffening_per_m": 50.0},
    "added_mass": {"liner_hz": 20.0},
    "posture": {"jump": 0.5, "at_s": 200.5 / RATE_HZ},
    "friction": {"friction_n": 30.0, "smooth_mps": 0.004},
    "hysteresis": {"yield_n": 60.0, "yield_m": 1e-3},
    "bending": {"length_m": 0.8, "axis_rad": 0.7},
    "thixotropy": {"tau_s": 0.5, "softening": 0.8},
}


GENERAL = {
    "added_mass": {"liner_hz": 20.0, "exponent": 1.0, "held_hz": 5.0},
    "asymmetry": {"asymmetry_per_m": 100.0, "exponent": -1.0},
    "backrest": {"cubic_per_m2": 5000.0},
    "bending": {"length_m": 0.8, "axis_rad": 0.7, "rest_rad": 0.2, "across": 0.6},
    "cross_axis": {"corner_hz": 8.0, "damping_ratio": 0.3},
    "cubic": {"cubic_per_m2": 2e4, "exponent": -1.5},
    "cushion": {"stiffening_per_m": 50.0, "creep_ratio": 1.0, "creep_s": 0.02},
    "friction": {"friction_n": 30.0, "smooth_mps": 0.004, "stribeck": 0.8},
    "harness": {"slack_m": 0.001, "hardening": 2.5, "loss_s_per_m": 1.0},
    "hysteresis": {"yield_n": 60.0, "yield_m": 1e-3, "exponent": 1.3, "unloading": 0.4},
    "lift_off": {"width_n": 40.0, "fading": 0.8},
    "posture": {"jump": 0.5, "at_s": 0.2, "width_s": 0.05, "damping_share": 1.5},
    "quadratic_damping": {"growth_s_per_m": 20.0, "exponent": -0.7},
    "reflex": {"lag_s": 0.02, "lead_s": 0.05, "saturation_per_m": 100.0},
    "relaxation": {"second_share": 1.0, "second_tau_s": 0.02},
    "stop": {"gap_m": 0.002, "exponent": 1.0, "knee_m": 0.0006},
    "thixotropy": {"tau_s": 0.5, "softening": 0.8, "exponent": 0.6, "damping_share": 0.8},
    "viscera": {"exponent": -1.0},
}
"""Values of every general parameter that are not neutral."""


@pytest.mark.parametrize(
    ("name", "values"),
    [*((name, STRONG.get(name, {})) for name in IN_TIME), *GENERAL.items()],
    ids=[*IN_TIME, *(f"{name}, general" for name in GENERAL)],
)
def test_the_chain_follows_the_equation_of_motion(name: str, values: dict[str, float]) -> None:
    effect = applied(name, "pelvis" if name == "cross_axis" else None, **values)
    seat = shock(0.3)
    truth = twin(effect, seat)
    ours = answer(Chain.of(with_effects(effect)), seat)
    base = Chain.of(SUBJECT).simulate(seat, RATE_HZ).accel_mps2
    size = rms(truth - base)
    assert size > 0.005  # it is there at all
    # A jump that a step of RK4 straddles costs three orders; the equation itself is right or wrong by far more.
    jumps = name == "posture" and not effect.values["width_s"]
    assert rms(ours - truth) < (0.08 if jumps else 0.01) * size + 1e-4


@pytest.mark.parametrize(
    ("name", "site"), [("friction", "head"), ("reflex", "neck"), ("thixotropy", "lower_torso"), ("cross_axis", "neck")]
)
def test_at_another_site_it_is_the_same_law_of_the_same_integrator(name: str, site: str) -> None:
    effect, first = applied(name, site, **STRONG.get(name, {})), applied(name, "pelvis")
    seat = shock(0.3)
    truth = twin(effect, seat)
    size = rms(truth - Chain.of(SUBJECT).simulate(seat, RATE_HZ).accel_mps2)
    assert size > 0.001
    assert rms(answer(Chain.of(with_effects(effect)), seat) - truth) < 0.01 * size + 1e-4
    integrators = {EffectAssembly(Chain.of(with_effects(one)).elements, 0.001).integrate for one in (effect, first)}
    assert len(integrators) == 1


JOINT = Joint(6e4, 9e5, 700.0, 55.0, 7.0)


def law_beside_its_equation(effect: AppliedEffect, t: float, d: float, r: float, s: float, q: list[float]):
    """Force and rates (2, 1 + m) of a law as plain Python, and those of its equation, at one instant.

    d: stretch m, or tension N for a limit; q: states of the equation, of which the law has some in another form.
    """
    kind, p = effect.effect, dict(effect.values)
    constants = kind.constants(JOINT, p)
    if isinstance(kind, JointLimit):
        return [kind.law(d, r, *constants)], [carried(p, d, r, constants[0], JOINT.damping_n_s_per_m)]
    k, k_alpha = JOINT.stiffness_n_per_m, JOINT.stiffening_n_per_m2
    past: tuple[list, list] = ([0.0, 1.0], [-0.03, 0.05])
    size = round(RATE_HZ) + 1
    _, equation = law(kind.name, p, k, k_alpha, JOINT.damping_n_s_per_m, JOINT.segment_mass_kg, past, size)
    states, added = list(q[: kind.states]), []
    if kind.name in ("posture", "periodic"):
        states = [t]
    elif kind.name == "bending":  # the equation has the angles about both axes
        turn = turned(p["axis_rad"])
        states, q = list(q[:2]), turn.T @ q[:2]
        driven, times = channels(size), np.arange(size) / RATE_HZ
        added = [np.interp(t, times, driven[f"neck.bend_rate_{one}"]) for one in "xy"]
    elif kind.name == "reflex":  # the equation has the second lag and its rate
        lag_s = p["lag_s"] + 0.002
        states, added = [q[0] + lag_s * q[1], q[0]], [np.interp(t - p["delay_s"], *past, left=0.0)]
    force, rates = equation(t, d, r, s, np.array(q))
    found = kind.law(d, r, s, *added, *states, *constants)
    ours, *own = found if isinstance(found, tuple) else (found,)
    if kind.name in ("posture", "periodic"):
        assert own == [1.0]  # its state is the time
        own = []
    elif kind.name == "bending":
        rates = turn @ rates
    elif kind.name == "reflex":
        rise, fall = own
        own = [fall, (rise - fall) / lag_s] if p["lag_s"] or p["lead_s"] else own
    return [ours, *own], [force, *rates]


@pytest.mark.parametrize(
    ("name", "values"),
    [*((name, STRONG.get(name, {})) for name in IN_TIME if name != "cross_axis"),
     *((name, values) for name, values in GENERAL.items() if name != "cross_axis")],
)  # fmt: skip
def test_a_law_in_plain_python_is_its_equation_at_every_instant(name: str, values: dict[str, float]) -> None:
    """... without the integration, on both sides of whatever it distinguishes, and at rest."""
    rng = np.random.default_rng(5)
    sizes = [3000.0, 1.0, 0.0] if name == "lift_off" else [0.03, 0.3, 10.0]
    motion = np.vstack([np.zeros(3), rng.uniform(-1.0, 1.0, (200, 3)) * sizes])
    times, states = rng.uniform(0.05, 0.5, len(motion)), rng.uniform(-0.05, 0.05, (len(motion), 3))
    if name == "thixotropy":
        states = abs(states)
    effect = applied(name, **values)
    count = {"reflex": 2}.get(name, getattr(effect.effect, "states", 0))
    pairs = [
        law_beside_its_equation(effect, t, *of, list(q[:count])) for t, of, q in zip(times, motion, states, strict=True)
    ]
    ours, theirs = np.array(pairs).transpose(1, 0, 2)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * abs(theirs).max())
    assert np.unique(theirs[:, 0]).size > 20


@pytest.mark.parametrize("name", GENERAL)
def test_a_general_law_differs_from_its_textbook_form(name: str) -> None:
    effect = applied(name, "pelvis" if name == "cross_axis" else None, **GENERAL[name])
    seat = shock()
    general, textbook = (answer(Chain.of(with_effects(one)), seat) for one in (effect, effect.textbook))
    assert rms(general - textbook) > 0.005
    neutral = [p.name for p in effect.effect.parameters if p.neutral is not None]
    assert set(neutral) - {"creep_s", "stribeck_mps", "second_tau_s"} <= set(GENERAL[name])


def test_general_parameters_have_a_prior_and_a_source() -> None:
    for effect in CATALOGUE.values():
        general = [p for p in effect.parameters if p.neutral is not None]
        assert bool(general) == bool(effect.general_form), effect.name
        for p in general:
            assert p.kind == "shape" and p.spread > 0.0 and p.source != EffectParameter("x", "", 0, 1, 0).source, p
            assert p.lower <= p.neutral <= p.upper and p.start == p.neutral, (effect.name, p.name)


def test_omitted_general_parameters_are_neutral_and_not_written() -> None:
    given = {"stiffness_n_per_m": 25000.0, "slack_m": 0.01}
    effect = AppliedEffect(CATALOGUE["harness"], "upper_torso", given)
    assert effect.values == {**given, "hardening": 0.0, "loss_s_per_m": 0.0}
    assert effect.to_dict()["parameters"] == given
    changed = dataclasses.replace(effect, values={**effect.values, "hardening": 1.0})
    assert changed.to_dict()["parameters"] == {**given, "hardening": 1.0} and changed.textbook == effect


@pytest.mark.parametrize(
    ("name", "sizes", "expected"),
    [
        ("clock", (0.003,), {"delay_s": 0.003, "drift": 0.0}),
        ("clock", (-0.5, 1.0), {"delay_s": -0.02, "drift": 5e-4}),
        ("periodic", (0.0, 1.0, 24.0), {"cosine_mps2": 0.0, "sine_mps2": 1.0, "frequency_hz": 24.0}),
        ("posture", (-0.9,), {"jump": -0.6, "at_s": 0.0}),
        ("tilt", (0.1, -0.5), {"lean_x": 0.1, "lean_y": -0.4}),
    ],
)
def test_sizes_are_moved_into_their_ranges(name: str, sizes: tuple[float, ...], expected: dict[str, float]) -> None:
    effect = CATALOGUE[name]
    found = effect.sized(effect.sites[0], *sizes)
    assert found.stated_values == expected and found == found.textbook


def test_a_soft_frame_is_a_second_order_filter_of_the_added_motion() -> None:
    seat, driven = shock(1.0), channels(shock(1.0).size)
    rigid, soft = (applied("pitch", forward_m=0.2, softness_s=s) for s in (0.0, 1.0 / (2.0 * np.pi * 12.0)))
    added = apply_to_seat([rigid], seat, RATE_HZ, driven) - seat
    omega, zeta = 2.0 * np.pi * 12.0, soft.values["damping_ratio"]
    system = signal.TransferFunction([2.0 * zeta * omega, omega**2], [1.0, 2.0 * zeta * omega, omega**2])
    _, expected, _ = signal.lsim(system, added, np.arange(seat.size) / RATE_HZ)
    found = apply_to_seat([soft], seat, RATE_HZ, driven) - seat
    later = slice(600, None)  # the filter begins one sample before the motion
    np.testing.assert_allclose(found[later], expected[later], atol=1e-3 * np.abs(added).max())


def test_every_entry_of_the_catalogue_is_tested_against_an_equation() -> None:
    assert set(NAMES) - set(IN_TIME) == {"clock", "gain", "pitch", "skin", "tilt"}


def test_a_mass_on_a_stiff_liner_is_a_heavier_segment() -> None:
    """... without Rayleigh's damping, which a mass on a liner has none of; a liner differs as 1 / its frequency^2."""
    seat, base = shock(), dataclasses.replace(Chain.of(SUBJECT), rayleigh_rad_per_s=0.0)
    head = np.arange(6) == SEGMENTS.index("head")
    heavier = dataclasses.replace(base, mass_kg=base.mass_kg + 1.5 * head, inertia_kg=base.inertia_kg + 1.5 * head)
    rigid, plain = (answer(chain, seat) for chain in (heavier, base))
    apart = {
        liner: rms(answer(base.with_effects([applied("added_mass", "head", liner_hz=liner)]), seat) - rigid)
        for liner in (20.0, 40.0, 80.0)
    }
    assert rms(rigid - plain) > 0.1
    assert apart[80.0] < 0.05 * rms(rigid - plain)
    assert apart[20.0] > 3.0 * apart[40.0] > 9.0 * apart[80.0]


def test_organs_have_a_lower_frequency_than_a_liner() -> None:
    """Both are a mass on a spring: at one frequency they are indistinguishable."""
    organ, liner = (next(p for p in CATALOGUE[name].parameters if p.unit == "Hz") for name in ("viscera", "added_mass"))
    assert organ.upper < liner.lower


def test_a_backrest_without_friction_is_a_spring_and_a_damper() -> None:
    """... and the rate over which friction builds up has no influence."""
    seat, at = shock(), SEGMENTS.index("upper_torso")
    rough, smooth = (applied("backrest", "upper_torso", friction_n=0.0, smooth_mps=v) for v in (0.002, 0.05))
    ours = answer(Chain.of(with_effects(rough)), seat)
    assert np.array_equal(ours, answer(Chain.of(with_effects(smooth)), seat))
    expected = twin(rough, seat)
    assert rms(ours - expected) < 1e-4 * rms(expected)
    rubbing = answer(Chain.of(with_effects(applied("backrest", "upper_torso", friction_n=60.0))), seat)
    assert rms((rubbing - ours)[:, at]) > 0.1


def test_the_pelvis_on_a_pitching_seat_has_the_acceleration_of_a_rigid_body() -> None:
    seat, driven = shock(), channels(shock().size)
    effect = applied("pitch", forward_m=0.2, left_m=-0.1, up_m=0.3)
    expected = np.array([
        a + 0.2 * (q2 - q0) * RATE_HZ / 2 - 0.1 * (p2 - p0) * RATE_HZ / 2 - 0.3 * (p1 * p1 + q1 * q1)
        for a, q0, q1, q2, p0, p1, p2 in zip(
            seat[1:], driven["seat.rate_y"], driven["seat.rate_y"][1:], driven["seat.rate_y"][2:],
            driven["seat.rate_x"], driven["seat.rate_x"][1:], driven["seat.rate_x"][2:], strict=False,
        )
    ])  # fmt: skip
    np.testing.assert_allclose(apply_to_seat([effect], seat, RATE_HZ, driven)[1:-1], expected, atol=1e-9)
    base = Chain.of(SUBJECT).simulate(apply_to_seat([effect], seat, RATE_HZ, driven), RATE_HZ).accel_mps2
    assert np.array_equal(seen(effect, seat=seat), base)


def test_a_sensor_effect_changes_its_own_channel_alone() -> None:
    seat = shock(1.0)
    time = np.arange(seat.size) / RATE_HZ
    true = Chain.of(SUBJECT).simulate(seat, RATE_HZ).accel_mps2
    neck, rest = SEGMENTS.index("neck"), [0, 1, 2, 3, 5]
    driven = channels(seat.size)
    expected = {
        "gain": (applied("gain", "neck", gain=0.1), 1.1 * true[:, neck]),
        "tilt": (
            applied("tilt", "neck", lean_x=0.2, lean_y=-0.1),
            true[:, neck] + 0.2 * driven["neck.x"] - 0.1 * driven["neck.y"],
        ),
        "clock": (
            applied("clock", "neck", delay_s=0.003, drift=2e-4),
            np.interp(time - 0.003 - 2e-4 * time, time, true[:, neck]),
        ),
    }
    for name, (effect, column) in expected.items():
        found = seen(effect, seat=seat)
        assert rms(found[:, neck] - column) < (0.01 if name == "clock" else 1e-9) * rms(true[:, neck])
        assert np.array_equal(found[:, rest], true[:, rest])


def test_skin_rings_at_its_own_frequency() -> None:
    """Steady sines through it, against its transfer function."""
    softness, zeta = 1.0 / (2.0 * np.pi * 30.0), 0.3
    effect = applied("skin", "head", softness_s=softness, damping_ratio=zeta)
    time = np.arange(4000) / RATE_HZ
    for frequency in (3.0, 15.0, 30.0, 60.0):
        true = np.zeros((time.size, 6))
        true[:, 5] = np.sin(2.0 * np.pi * frequency * time)
        found = apply_to_sensors([effect], true, RATE_HZ, {})[2000:, 5]
        s, omega = 2j * np.pi * frequency, 1.0 / softness
        gain = abs((2 * zeta * omega * s + omega**2) / (s * s + 2 * zeta * omega * s + omega**2))
        assert np.sqrt(2.0) * rms(found) == pytest.approx(gain, rel=0.02)


# --- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in NAMES if CATALOGUE[n].strengths])
def test_zero_strength_is_the_base_model_to_the_last_bit(name: str) -> None:
    effect = applied(name, **dict.fromkeys(CATALOGUE[name].strengths, 0.0))
    assert effect.absent
    seat = shock()
    base = Stepper(Chain.of(SUBJECT), RATE_HZ).push(seat)
    assert np.array_equal(seen(effect, seat=seat), base)
    # A cushion of no compliance cannot be written down: it has 1 / 0 for a stiffness.
    if name in IN_TIME and name != "cushion":
        # ... also where it is written into the integrator.
        chain = Chain.of(with_effects(applied(name)))
        bounds = dataclasses.replace(chain.elements[0].bounds, stiffness_n_per_m=0.0, damping_n_s_per_m=0.0)
        plain = Chain.of(SUBJECT)
        constants = plain._element(effect, effect.effect, plain.mass_kg).constants
        none = dataclasses.replace(chain.elements[0], constants=constants, bounds=bounds)
        assert np.array_equal(answer(dataclasses.replace(chain, elements=(none,)), seat), base)


@pytest.mark.parametrize("name", [n for n in IN_TIME if CATALOGUE[n].strengths])
@pytest.mark.parametrize("share", [1e-3, 1e-15])
def test_a_tiny_strength_changes_nothing_and_takes_no_longer(name: str, share: float) -> None:
    sizes = {p.name: share * p.upper for p in CATALOGUE[name].parameters if p.kind == "strength"}
    effect, seat = applied(name, **sizes), shock(0.3)
    assert Chain.of(with_effects(effect)).substeps(RATE_HZ) <= 500
    base = Stepper(Chain.of(SUBJECT), RATE_HZ).push(seat)
    assert rms(seen(effect, seat=seat) - base) < 0.02 * rms(base)


def test_the_least_strength_has_almost_no_effect() -> None:
    (parameter,) = [p for p in CATALOGUE["cushion"].parameters if p.least]
    for more, absent in ((1.0, True), (1.01, False)):
        effect = applied("cushion", **{parameter.name: more * parameter.least})
        assert effect.absent == absent
    seat = shock(0.3)
    base = Stepper(Chain.of(SUBJECT), RATE_HZ).push(seat)
    assert 0.0 < rms(seen(effect, seat=seat) - base) < 0.02 * rms(base)


def test_a_chain_too_stiff_to_step_is_refused_in_one_line() -> None:
    theta = SUBJECT.parameters.vector()
    theta[5] = 1e6
    with pytest.raises(InputError, match=r"the chain is too stiff: .* steps per sample, at most 2000 are allowed"):
        Chain.of_theta(theta, 70.0, "segment").simulate(shock(), RATE_HZ)


@settings(max_examples=15, deadline=None)
@given(st.sampled_from(IN_TIME), st.lists(st.integers(1, 200), max_size=6))
def test_block_cuts_change_no_bit(name: str, cuts: list[int]) -> None:
    chain, seat = Chain.of(with_effects(applied(name, **STRONG.get(name, {})))), shock(0.3)
    driven = channels(seat.size)
    whole = Stepper(chain, RATE_HZ).push(seat, channels=driven)
    stepper, parts, begin = Stepper(chain, RATE_HZ), [], 0
    for length in [*cuts, seat.size]:
        cut = slice(begin, begin + length)
        parts.append(stepper.push(seat[cut], channels={name: values[cut] for name, values in driven.items()}))
        begin += length
    assert np.array_equal(np.concatenate(parts), whole)


def test_two_effects_act_together() -> None:
    one, other = applied("lift_off"), applied("viscera", "lower_torso")
    seat = shock()
    both, again = (
        Chain.of(with_effects(*pair)).simulate(seat, RATE_HZ).accel_mps2 for pair in ((one, other), (other, one))
    )
    np.testing.assert_allclose(both, again, rtol=1e-9, atol=1e-9)
    singles = [Chain.of(with_effects(effect)).simulate(seat, RATE_HZ).accel_mps2 for effect in (one, other)]
    assert all(np.abs(both - single).max() > 0.1 for single in singles)


def test_reset_of_a_stepper_resets_the_states_of_effects() -> None:
    seat = shock(0.3)
    for name in ("reflex", "relaxation", "cross_axis", "periodic"):
        stepper = Stepper(Chain.of(with_effects(applied(name, "upper_torso"))), RATE_HZ)
        first = stepper.push(seat, channels=channels(seat.size))
        stepper.reset()
        assert np.array_equal(stepper.push(seat, channels=channels(seat.size)), first), name


def test_a_channel_that_is_not_there_is_one_line() -> None:
    chain = Chain.of(with_effects(applied("cross_axis")))
    with pytest.raises(InputError, match=r"an effect needs the channel seat\.x, which is not measured here"):
        chain.simulate(shock(), RATE_HZ)


def test_a_seat_without_a_measured_rotation_is_one_line() -> None:
    seat = shock()
    driven = {name: values for name, values in channels(seat.size).items() if name != "seat.rate_y"}
    with pytest.raises(InputError, match=r"effect pitch needs the channel seat\.rate_y, which is not measured here"):
        apply_to_seat([applied("pitch")], seat, RATE_HZ, driven)


def test_skin_without_softness_is_the_limit_of_ever_harder_skin() -> None:
    accel, skin = shock(), CATALOGUE["skin"]
    rigid, hard, soft = (
        skin.transform(accel, RATE_HZ, {}, applied("skin", softness_s=s).values) for s in (0.0, 1e-6, 0.01)
    )
    np.testing.assert_array_equal(rigid, accel)
    assert rms(hard - rigid) < 1e-4 * rms(accel) < rms(soft - rigid)


def test_a_stiff_effect_makes_the_steps_smaller() -> None:
    hard = applied("friction", "neck", friction_n=80.0, presliding_m=2e-5)
    chain = Chain.of(with_effects(hard))
    assert Stepper(chain, RATE_HZ).substeps > Stepper(Chain.of(SUBJECT), RATE_HZ).substeps
    assert np.isfinite(chain.simulate(shock(peak=150.0), RATE_HZ).accel_mps2).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_whole_range_of_every_parameter_stays_finite(name: str) -> None:
    # A joint whose softening exceeds its stiffness diverges in reality too: asymmetry gets a weaker shock.
    effect, seat = CATALOGUE[name], shock(0.3, 5.0 if name == "asymmetry" else 60.0)
    general = {p.name: (p.lower, p.upper) for p in effect.parameters if p.neutral is not None}
    typical = {p.name: p.size for p in effect.parameters}
    textbook = [{p.name: getattr(p, end) for p in effect.textbook_parameters} for end in ("lower", "upper")]
    # General parameters at the ends of their ranges, with a typical strength: a hardening at the largest one is no law.
    tried = [*textbook, *({**typical, name: end} for name, ends in general.items() for end in ends)]
    for values in tried:
        if name == "cushion" and values["compliance_m_per_n"] == 0.0:
            continue
        site = effect.sites[-1]
        assert np.isfinite(seen(AppliedEffect(effect, site, values), seat=seat)).all(), (site, values)


@pytest.mark.parametrize("name", NAMES)
def test_every_entry_has_a_description(name: str) -> None:
    effect = CATALOGUE[name]
    assert effect.name == name and effect.equation and effect.signature and effect.family and effect.place
    for parameter in effect.parameters:
        assert parameter.lower <= parameter.start <= parameter.upper and parameter.source
        if parameter.kind == "strength":
            assert (parameter.lower <= 0.0 <= parameter.upper and parameter.start != 0.0) or len(effect.strengths) > 1
    if isinstance(effect, ChainEffect):
        free = set(inspect.getclosurevars(effect.law).globals) - {"math"}
        assert not free, f"{name} uses {free}: it is compiled apart from its module"


def test_only_values_near_an_end_of_their_range_are_on_a_bound() -> None:
    def on_bound(kind: Kind, lower: float, value: float) -> bool:
        return EffectParameter("p", "", lower, 10.0, 5.0, kind).on_bound(value)

    for kind in ("shape", "strength"):
        assert on_bound(kind, 2.0, 2.01) and not on_bound(kind, 2.0, 2.2)
        assert on_bound(kind, 0.0, 9.99) and on_bound(kind, 0.0, 10.0) and not on_bound(kind, 0.0, 9.8)
    assert not on_bound("shape", 0.0, 0.01)
    assert not on_bound("strength", 0.0, 0.01) and not on_bound("strength", 0.0, 0.0)
    assert on_bound("strength", -10.0, -9.99) and not on_bound("strength", -10.0, 0.0)
    assert not any(on_bound("nuisance", 0.0, value) for value in (0.0, 0.01, 5.0, 9.99, 10.0))


@pytest.mark.parametrize("hung", [applied("viscera", "lower_torso", mass_kg=12.0), applied("added_mass", "head")])
def test_no_body_lifts_off_in_less_than_free_fall(hung: AppliedEffect) -> None:
    """The seat falls ever faster, up to 0.9 g; what hangs on the body weighs on the seat too."""
    time_s = np.arange(round(1.2 * RATE_HZ)) / RATE_HZ
    seat = -0.9 * 9.80665 * np.clip(time_s / 0.8, 0.0, 1.0)
    bound, free = (
        Chain.of(with_effects(hung, *more)).simulate(seat, RATE_HZ).displacement_m[:, 0]
        for more in ((), (applied("lift_off"),))
    )
    assert np.abs(free).max() < 1.05 * np.abs(bound).max() < 0.01


def test_softening_by_a_fast_motion_is_stable() -> None:
    """Where the rate of softening would exceed what a step of the integration allows."""
    fast = applied("thixotropy", "head", rate_mps=0.002, exponent=2.5, tau_s=0.5)
    time_s = np.arange(round(0.5 * RATE_HZ)) / RATE_HZ
    seat = np.where(time_s < 0.04, 30.0 * np.sin(2.0 * np.pi * 25.0 * time_s), 0.0)
    chain = Chain.of(with_effects(fast))
    found = chain.simulate(seat, RATE_HZ).accel_mps2
    many = Stepper(chain, RATE_HZ, 20).push(seat)
    assert np.abs(found - many).max() < 0.01 * np.abs(many).max()


# --- files ------------------------------------------------------------------------------------------------------------


def test_effects_are_written_to_and_read_from_the_subject_file(tmp_path) -> None:
    subject = with_effects(applied("relaxation", "neck"), applied("lift_off"))
    path = tmp_path / "s.yaml"
    path.write_text(subject.to_yaml())
    assert load_subject(path) == subject


@pytest.mark.parametrize(
    ("effects", "wanted"),
    [
        ("{}", "expected a list"),
        ("[5]", "effects[0]"),
        ("[{name: magic, site: neck}]", "unknown effect 'magic', known are added_mass, asymmetry"),
        ("[{name: relaxation, site: knee, parameters: {stiffness_ratio: 0.4, tau_s: 0.1}}]", "site is 'knee', allowed"),
        ("[{name: lift_off, site: head}]", "site is 'head', allowed are pelvis"),
        (
            "[{name: relaxation, site: neck}]",
            "relaxation: missing under parameters: stiffness_ratio (0 to 2), tau_s (0.005 to 3 s)",
        ),
        ("[{name: lift_off, site: pelvis, parameters: {x: 1}}]", "unknown parameter 'x', known are width_n, fading"),
        (
            "[{name: relaxation, site: neck, parameters: {stiffness_ratio: 0.4, tau_s: 9}}]",
            "relaxation.tau_s is 9, allowed are 0.005 to 3 s",
        ),
        ("[{name: lift_off, site: pelvis}, {name: lift_off, site: pelvis}]", "lift_off at pelvis is given twice"),
        ("[{name: lift_off, site: pelvis, strength: 1}]", "unknown key 'strength'"),
    ],
)
def test_a_bad_effect_is_one_line(effects: str, wanted: str, tmp_path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SUBJECT.to_yaml().replace("effects: []", f"effects: {effects}"))
    with pytest.raises(InputError) as error:
        load_subject(path)
    assert wanted in str(error.value) and "\n" not in str(error.value)


def test_predictions_sample_by_sample_carry_an_effect() -> None:
    """Residuals of a person who lifts off, by the pipeline of node and replay, with and without the effect."""
    lifting = with_effects(applied("lift_off"), applied("relaxation", "lower_torso", stiffness_ratio=0.8))
    motion = load_case("rail", 4.0, np.random.default_rng(2))
    still = SensorSettings(clock_offset_ms=0.0, clock_drift_ppm=0.0)
    streams = imu_streams(lifting, motion, np.random.default_rng(1), still)
    left = {}
    for name, subject in (("knowing", lifting), ("ignorant", SUBJECT)):
        pipeline = Pipeline(subject)
        for begin in range(0, len(streams[0].stamps_ns), 100):
            for stream in streams:
                cut = slice(begin, begin + 100)
                pipeline.push(stream.sensor, stream.stamps_ns[cut], stream.accel_mps2[cut])
        pipeline.finish()
        left[name] = pipeline.exposure().residual["pelvis"]
    left = {name: residual[1] for name, residual in left.items()}
    assert left["knowing"] < 5.0
    assert left["ignorant"] > 3.0 * left["knowing"]


@pytest.mark.parametrize("name", ["cross_axis", "bending", "pitch"])
def test_sample_by_sample_prediction_refuses_effects_that_need_other_channels(name: str) -> None:
    with pytest.raises(InputError, match=rf"effect {name} needs .*, which predictions sample by sample do not have"):
        Pipeline(with_effects(applied(name)))
    Pipeline(with_effects(applied("tilt", "head")))  # on a sensor: predictions are of the segment itself


def test_the_page_of_effects_lists_every_effect_with_its_parameters() -> None:
    page = (Path(__file__).resolve().parents[1] / "docs" / "effects.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]*) \| (?:yes|no|-) \|$", page, re.MULTILINE)
    listed = {name: re.findall(r"`(\w+)`", parameters) for name, parameters in rows}
    assert listed == {name: [p.name for p in effect.textbook_parameters] for name, effect in CATALOGUE.items()}
    general = {name: [p for p in effect.parameters if p.neutral is not None] for name, effect in CATALOGUE.items()}
    section = page[page.index("## General forms") :]
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| ([^|]*) \|$", section, re.MULTILINE)
    assert {name: parameters for name, _, parameters in rows} == {
        name: ", ".join(f"`{p.name}` ({p.neutral:g})" for p in its) for name, its in general.items() if its
    }
    for name, form, _ in rows:
        assert form.replace("\\|", "|") == CATALOGUE[name].general_form


RUN = """
import dataclasses, numpy as np, time
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import load_subject
from biodyn_ros.base.resources import subject_file
effect = CATALOGUE["relaxation"]
values = {p.name: p.start for p in effect.parameters}
subject = dataclasses.replace(load_subject(subject_file("subject_1")), effects=(AppliedEffect(effect, "neck", values),))
accel = Chain.of(subject).simulate(np.sin(np.arange(500) / 30.0), 1129.3).accel_mps2
print(accel[-1].tolist())
"""


@pytest.mark.slow
def test_a_second_process_uses_the_compilation_cache(tmp_path) -> None:
    """... and one that may write nowhere does without."""

    def run(place: str) -> str:
        environment = {**os.environ, "NUMBA_CACHE_DIR": place, "HOME": place, "TMPDIR": place}
        environment.pop("XDG_CACHE_HOME", None)
        return subprocess.run(
            [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, timeout=120, check=True
        ).stdout

    answers, files = [], []
    for _ in range(2):
        answers.append(run(str(tmp_path)))
        files.append({path: path.stat().st_mtime_ns for path in tmp_path.rglob("*chain_*") if path.is_file()})
    assert any(path.suffix == ".nbi" for path in files[0])
    assert answers[0] == answers[1] == run("/proc/none") and files[0] == files[1]


def test_a_tampered_file_is_not_run(tmp_path, monkeypatch) -> None:
    from biodyn_core.kernels import generated

    text = "def integrate_chain():\n    return 'ours'\n"
    path = tmp_path / "generated" / "chain_x.py"
    path.parent.mkdir()
    path.write_text("raise SystemExit('theirs')\n")
    assert generated.cached_file(path, text).read_text() == text


@pytest.mark.parametrize(
    "name",
    [
        "reflex",
        "lift_off",
        "viscera",
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("cubic", "friction", "bending")),
    ],
)  # one of each kind
def test_a_second_effect_does_not_move_the_first(name: str) -> None:
    """Idle ones before and after it change nothing."""
    effect, seat = applied(name, **STRONG.get(name, {})), shock()
    before, after = (applied("cubic", site, cubic_per_m2=1e-12) for site in ("upper_torso", "neck"))
    alone = answer(Chain.of(with_effects(effect)), seat)
    chain = Chain.of(with_effects(before, effect, after))
    steps = Stepper(Chain.of(with_effects(effect)), RATE_HZ).substeps
    found = Stepper(chain, RATE_HZ, steps).push(seat, channels=channels(seat.size))
    np.testing.assert_allclose(found, alone, rtol=0.0, atol=1e-12 * np.abs(alone).max())


def test_an_effect_on_the_whole_body_is_a_force_on_every_segment() -> None:
    seat = shock()
    whole = answer(Chain.of(with_effects(applied("cross_axis", "seat"))), seat)
    every = answer(Chain.of(with_effects(*(applied("cross_axis", site) for site in SEGMENTS))), seat)
    assert rms(whole - Chain.of(SUBJECT).simulate(seat, RATE_HZ).accel_mps2) > 0.01
    np.testing.assert_allclose(whole, every, rtol=0.0, atol=1e-10 * np.abs(every).max())


def test_bending_uses_its_own_joint_and_is_independent_of_the_sign_of_its_axis() -> None:
    seat, driven = shock(), channels(shock().size)
    still = {name: np.zeros_like(values) for name, values in driven.items()}

    def bent(site: str, measured: dict[str, np.ndarray], axis_rad: float = 0.7) -> np.ndarray:
        effect = applied("bending", site, length_m=0.8, axis_rad=axis_rad)
        return Chain.of(with_effects(effect)).simulate(seat, RATE_HZ, measured).accel_mps2

    head_alone = still | {name: driven[name] for name in ("head.bend_rate_x", "head.bend_rate_y")}
    np.testing.assert_array_equal(bent("head", driven), bent("head", head_alone))
    base = Chain.of(SUBJECT).simulate(seat, RATE_HZ).accel_mps2
    np.testing.assert_allclose(bent("neck", head_alone), base, rtol=0.0, atol=1e-9)
    assert rms(bent("head", driven) - base) > 0.01
    np.testing.assert_allclose(bent("head", driven), bent("head", driven, 0.7 + np.pi), rtol=0.0, atol=1e-9)
    with pytest.raises(InputError, match=r"needs the channel neck\.bend_rate_x"):
        bent("neck", {name: values for name, values in driven.items() if name != "neck.bend_rate_x"})
