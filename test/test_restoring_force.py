"""The missing force by inverse dynamics, in data of another integrator and for the laws of the catalogue."""

from __future__ import annotations

import dataclasses
from functools import cache

import fitting
import hiding
import numpy as np
import pytest
from hiding import TRUTH, Floats, applied

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.problem import Case
from biodyn_core.tracing import results
from biodyn_core.tracing.findings import RestoringForce, Surface
from biodyn_core.tracing.inverse_dynamics import Target, measured_motion, missing_force, simulated_motion
from biodyn_core.tracing.restoring_force import FittedEffect, restoring_force
from biodyn_core.tracing.settings import TraceSettings

K = hiding.stiffness_and_damping()[0]
STOP = applied("stop", "pelvis", stiffness_ratio=2.0, gap_m=6e-4)
CUBIC = applied("cubic", "central_torso", cubic_per_m2=9e4)
HARNESS = applied("harness", "upper_torso", stiffness_n_per_m=25000.0, slack_m=1e-3)
ORIFICE = applied("quadratic_damping", "pelvis", growth_s_per_m=4.0)
LAWS = {
    STOP.effect.name: (STOP, lambda x: -2.0 * K[0] * np.maximum(-x - 6e-4, 0.0)),
    CUBIC.effect.name: (CUBIC, lambda x: 9e4 * K[2] * x**3),
    HARNESS.effect.name: (HARNESS, lambda x: -25000.0 * np.maximum(x - 1e-3, 0.0)),
}
EVENTS = 3
MOTIONS = ("displacement_m", "velocity_mps", "accel_mps2")


def with_effects(*effects: AppliedEffect) -> Subject:
    return dataclasses.replace(TRUTH, effects=effects)


@cache
def cases() -> dict[str, list[Case]]:
    """Road, pothole and rail of the true body with each of `LAWS`, by DOP853, with noise."""

    def tension(stretch: Floats, rate: Floats) -> Floats:
        more = np.zeros((len(LAWS), EVENTS, 6))
        d = stretch.reshape(more.shape)
        for number, (effect, law) in enumerate(LAWS.values()):
            at = SEGMENTS.index(effect.site)
            if effect.effect.place == "joint":
                more[number, :, at] = law(d[number, :, at])
            else:  # a force on a segment relieves all joints below it
                more[number, :, : at + 1] = -law(d[number, :, : at + 1].sum(axis=1))[:, None]
        return more.reshape(-1, 6)

    seats = hiding.seats()[:EVENTS]
    accel = hiding.answers(np.tile(seats, (len(LAWS), 1)), tension).reshape(len(LAWS), EVENTS, -1, 6)
    rng = np.random.default_rng(3)
    return {
        name: [noisy(*each, rng) for each in zip(seats, of, strict=True)] for name, of in zip(LAWS, accel, strict=True)
    }


def noisy(seat: Floats, accel: Floats, rng: np.random.Generator) -> Case:
    recording = fitting.recording(seat, accel)
    noise = fitting.low_passed(hiding.NOISE_MPS2 * rng.standard_normal(recording.measured_mps2.shape))
    measured = recording.measured_mps2 + noise
    return Case.of(dataclasses.replace(recording, measured_mps2=measured), fitting.SPECTRUM, fitting.LINES)


def found(name: str) -> RestoringForce:
    """The missing force of the true body where the law is hidden, before and after it is added with its true values."""
    effect = LAWS[name][0]
    fitted = FittedEffect(effect, 0.01 * np.eye(len(effect.effect.parameters)))
    target = Target.of(effect, Chain.of(TRUTH))
    whole = restoring_force(target, TRUTH, with_effects(effect), [fitted], cases()[name], 0)
    assert whole is not None
    return whole


@pytest.mark.parametrize("name", LAWS)
def test_the_missing_force_is_the_hidden_law(name: str) -> None:
    """Within 4 % of its largest value, in every bin of stretch."""
    one = found(name)
    profile, truth = one.over_stretch, LAWS[name][1](one.over_stretch.at)
    here = np.isfinite(profile.before_n)
    most = np.abs(truth[here]).max()
    assert here.sum() > 15 and most > 5.0 * one.missing_after_n
    # A bin is as wide as 1/25 of the range: the mean of a bent law is not its value in the middle.
    assert np.abs(profile.before_n - truth)[here].max() < 0.06 * most
    assert np.abs(profile.before_n - profile.law_n)[here & np.isfinite(profile.law_n)].max() < 0.06 * most
    assert np.abs(profile.after_n[here]).max() < 0.06 * most
    assert one.missing_after_n < 0.2 * one.missing_before_n
    assert one.over_stretch.explained > 0.9 and not one.over_rate_first


@pytest.mark.parametrize("name", LAWS)
def test_the_band_contains_the_law_and_widens_with_it(name: str) -> None:
    profile = found(name).over_stretch
    known = np.isfinite(profile.lower_n) & np.isfinite(profile.law_n)
    assert (profile.lower_n <= profile.law_n + 0.5)[known].all() and (profile.law_n <= profile.upper_n + 0.5)[
        known
    ].all()
    if name != "cubic":  # at the end of its range a strength cannot be drawn larger
        size, width = np.abs(profile.law_n)[known], (profile.upper_n - profile.lower_n)[known]
        assert width[size.argmax()] > 0.1 * size.max() > width[size.argmin()]


def test_without_a_covariance_there_is_a_law_and_no_band() -> None:
    unknown = [FittedEffect(STOP, np.empty((0, 0)))]
    target = Target.of(STOP, Chain.of(TRUTH))
    one = restoring_force(target, TRUTH, with_effects(STOP), unknown, cases()["stop"], 0)
    assert one is not None and np.isfinite(one.over_stretch.law_n).sum() > 10
    assert np.isnan(one.over_stretch.lower_n).all() and np.isnan(one.over_stretch.upper_n).all()


def test_without_an_effect_the_joint_of_the_surface_is_shown() -> None:
    flat = Surface("pelvis", np.zeros(5), np.zeros(3), np.zeros((3, 5)), 0.5)
    made = cases()["stop"]
    (one,) = results._restoring_forces(TRUTH, TRUTH, flat, made, made, TraceSettings(), 0)
    assert (one.site, one.joint, one.effects) == ("pelvis", True, ())
    deepest = one.over_stretch.before_n[np.isfinite(one.over_stretch.before_n)][0]
    assert deepest == one.over_stretch.after_n[0] < -100.0
    assert results._restoring_forces(TRUTH, TRUTH, None, made, made, TraceSettings(), 0) == ()


def test_the_balance_holds_for_both_mass_matrices() -> None:
    """And for no motion at all."""
    body = dataclasses.replace(TRUTH, mass_matrix="cascade", effects=(STOP,))
    chain, case = Chain.of(body), hiding.events(3)[2]
    motion = simulated_motion(body, case)
    for joint in range(6):
        assert np.abs(missing_force(chain, motion, Target.of_joint(joint, chain))).max() < 1e-6
    still = dataclasses.replace(motion, **{name: np.zeros_like(motion.accel_mps2) for name in MOTIONS})
    assert not missing_force(chain, still, Target.of_joint(0, chain)).any()


def test_the_surface_counts_every_sample_once() -> None:
    one = found("stop")
    assert one.samples.shape == one.before_n.shape == one.after_n.shape == (one.rate_mps.size, one.stretch_m.size)
    assert one.samples.sum() == one.over_stretch.samples.sum() == one.over_rate.samples.sum()
    np.testing.assert_array_equal(one.samples.sum(axis=0), one.over_stretch.samples)
    np.testing.assert_array_equal(one.samples.sum(axis=1), one.over_rate.samples)
    assert (np.isnan(one.before_n) == (one.samples < 3)).all()
    deep = one.before_n[:, one.stretch_m < -8e-4]
    assert deep[np.isfinite(deep)].size > 3 and deep[np.isfinite(deep)].max() < -5.0  # the stop pushes at every rate


def test_a_law_of_the_rate_is_shown_over_the_rate() -> None:
    fitted = FittedEffect(ORIFICE, 1e-4 * np.eye(1))
    target = Target.of(ORIFICE, Chain.of(TRUTH))
    events = hiding.events(3, law=hiding.orifice)
    one = restoring_force(target, TRUTH, with_effects(ORIFICE), [fitted], events, 0)
    assert one is not None and one.over_rate_first
    rate = np.zeros((one.rate_mps.size, 6))
    rate[:, 0] = one.rate_mps
    truth = hiding.orifice(rate, rate)[:, 0]
    here = np.isfinite(one.over_rate.before_n)
    assert np.abs(one.over_rate.before_n - truth)[here].max() < 0.06 * np.abs(truth[here]).max()


@pytest.mark.parametrize("joint", range(6))
def test_a_body_without_missing_force_leaves_noise(joint: int) -> None:
    """Less than a tenth of the force that the joint carries, without a trend over stretch or rate."""
    one = restoring_force(Target.of_joint(joint, Chain.of(TRUTH)), TRUTH, TRUTH, [], hiding.events(6), 0)
    assert one is not None and one.effects == ()
    assert one.missing_before_n == one.missing_after_n < 0.1 * one.carried_n
    assert max(one.over_stretch.explained, one.over_rate.explained) < 0.2
    assert np.isnan(one.over_stretch.law_n).all() and np.isnan(one.over_rate.upper_n).all()


def channels(case: Case) -> Case:
    rng = np.random.default_rng(8)
    more = {name: fitting.low_passed(rng.standard_normal(case.seat_mps2.size)) for name in ("seat.x", "seat.y")}
    return dataclasses.replace(case, channels=more)


@pytest.mark.parametrize(
    "effect",
    [
        STOP, HARNESS, applied("lift_off", "pelvis"), applied("friction", "pelvis"), applied("reflex", "pelvis"),
        applied("viscera", "central_torso"), applied("cross_axis", SEAT),
    ],
    ids=lambda one: one.effect.name,
)  # fmt: skip
def test_nothing_is_missing_of_a_simulated_body_with_its_effect(effect: AppliedEffect) -> None:
    """The law along the motion is that of the integrator: states, delay, channels and limits."""
    case, subject = channels(hiding.events(3)[2]), with_effects(effect)
    motion, target = simulated_motion(subject, case), Target.of(effect, Chain.of(TRUTH))
    lacking, left = (missing_force(Chain.of(one), motion, target) for one in (TRUTH, subject))
    assert np.abs(lacking).max() > 1.0
    assert np.std(left) < 0.02 * np.std(lacking)


def test_the_joints_of_the_central_torso_share_one_missing_force() -> None:
    """Its motion follows from its neighbours by the model: a law of joint 3 appears in joint 4 too, and below them."""
    case, missing = cases()["cubic"][2], {}
    for added in (False, True):
        subject = with_effects(CUBIC) if added else TRUTH
        chain = Chain.of(subject)
        targets = [Target.of_joint(joint, chain) for joint in (1, 2, 3, 4)]
        missing[added] = [
            missing_force(chain, measured_motion(subject, case, one.high_pass_hz), one)[targets[0].used(case)]
            for one in targets
        ]
    below, third, fourth, above = missing[False]
    assert np.std(fourth - third) < 0.1 * np.std(third)
    assert np.std(below) > np.std(third)
    assert np.std(above) < 0.05 * np.std(third)
    assert all(np.std(one) < 0.2 * np.std(third) for one in missing[True])


def test_two_effects_at_one_place_add() -> None:
    both = applied("lift_off", "pelvis"), STOP
    case = hiding.events(3)[2]
    motion = simulated_motion(with_effects(*both), case)
    target = Target.of_joint(0, Chain.of(TRUTH))
    assert np.abs(missing_force(Chain.of(with_effects(*both)), motion, target)).max() < 1e-6


def test_the_measured_motion_does_not_depend_on_the_joints_of_the_model() -> None:
    """Above the high-pass: another stiffness moves the prediction, not the stretch."""
    case = hiding.events(3)[1]
    theta = TRUTH.parameters.vector().copy()
    theta[0] *= 1.1
    other = dataclasses.replace(TRUTH, parameters=type(TRUTH.parameters).from_vector(theta))
    after = slice(case.begin + round(fitting.RATE_HZ), None)
    measured, simulated = (
        [motion(subject)[after] for subject in (TRUTH, other)]
        for motion in (
            lambda subject: measured_motion(subject, case, 0.5).displacement_m[:, 0],
            lambda subject: simulated_motion(subject, case).displacement_m[:, 0],
        )
    )
    difference, predicted = (np.abs(b - a).max() for a, b in (measured, simulated))
    assert difference < 0.2 * predicted


def test_masked_samples_and_lost_sensors_are_left_out() -> None:
    case = hiding.events(3)[0]
    head, neck = (MEASURED_SEGMENTS.index(name) for name in ("head", "neck"))
    compared = case.compared.copy()
    compared[1700:1800, head] = False
    masked = dataclasses.replace(case, compared=compared, measured_mps2=np.where(compared, case.measured_mps2, 0.0))
    chain = Chain.of(TRUTH)
    pelvis, top = Target.of_joint(0, chain), Target.of_joint(5, chain)
    assert not pelvis.used(masked)[1700:1800].any() and pelvis.used(masked)[1800:].all()
    lost = compared.copy()
    lost[:, neck] = False
    without_neck = dataclasses.replace(masked, compared=lost, energy=np.where(np.arange(5) == neck, 0.0, case.energy))
    assert pelvis.used(without_neck)[1800:].all()  # the neck is a fiftieth of the mass: its motion is predicted
    assert not top.used(without_neck).any()
    assert restoring_force(top, TRUTH, TRUTH, [], [without_neck], 0) is None


def test_events_count_by_their_time_whatever_their_rate() -> None:
    """The squared force of two events is that of each, weighted by its time, though one has half the samples."""
    first, second = cases()["stop"][:2]
    names = ("seat_mps2", "measured_mps2", "compared")
    halves = {name: np.ascontiguousarray(getattr(second, name)[::2]) for name in names}
    slow = dataclasses.replace(second, rate_hz=0.5 * second.rate_hz, **halves)
    target = Target.of(STOP, Chain.of(TRUTH))

    def square_and_time(*events: Case) -> tuple[float, float]:
        one = restoring_force(target, TRUTH, TRUTH, [], events, 0)
        assert one is not None
        return one.missing_before_n**2, one.samples.sum() / events[0].rate_hz

    of_first, of_slow = square_and_time(first), square_and_time(slow)
    both = square_and_time(first, slow)[0]
    squares, times = zip(of_first, of_slow, strict=True)
    assert both == pytest.approx(np.average(squares, weights=times), rel=1e-9)
    assert abs(of_first[0] / of_slow[0] - 1.0) > 0.1
