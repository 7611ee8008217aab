"""Unsteady causes hidden in events are found with their site."""

import dataclasses
from functools import cache

import fitting
import hiding
import naive
import numpy as np
import pytest
from scipy import signal

from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEGMENTS
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.local_fit import LocalFit, fit_locally
from biodyn_core.tracing.nuisance_model import EventSet, NuisanceModel
from biodyn_core.tracing.settings import UnsteadySettings
from biodyn_core.tracing.unsteady import UnsteadyCause, unsteady_causes

LINE_HZ, LINE_MPS2 = 24.0, 0.5
JOINT, STIFFER, CHANGED = "central_torso", 0.3, 6
"""A joint that is stiffer by so much from that event on."""

Found = dict[tuple[str, str], UnsteadyCause]


@cache
def jumping(sensor: str) -> hiding.Change:
    """A clock that is 2 ms late and 1 ms early by turns, a second each."""
    column = MEASURED_SEGMENTS.index(sensor)

    def change(measured: np.ndarray) -> np.ndarray:
        time = np.arange(len(measured)) / fitting.RATE_HZ
        late = np.where(time.astype(int) % 2 == 0, 0.002, -0.001)
        measured[:, column] = np.interp(time - late, time, measured[:, column])
        return measured

    return change


@cache
def wandering(segment: str) -> hiding.Change:
    """A force on one segment whose frequency wanders within 0.75 Hz, and whose phase is another in every event."""

    def change(measured: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(int(1e6 * np.abs(measured).max()))
        time = np.arange(len(measured)) / fitting.RATE_HZ
        wanders = 0.4 * np.sin(2.0 * np.pi * 0.3 * time + rng.uniform(0.0, 6.0))
        force = LINE_MPS2 * np.cos(2.0 * np.pi * (LINE_HZ * time + wanders + rng.uniform()))
        return measured + pushed(SEGMENTS.index(segment), force)

    return change


def pushed(segment: int, force_mps2: np.ndarray) -> np.ndarray:
    """Accelerations (n, 5) of the linear chain, as matrices, to a force (n,) on a segment, over its mass."""
    M, C, K, _, _ = naive.chain_matrices(hiding.TRUTH.parameters.vector(), hiding.TRUTH.body_mass_kg, "segment")
    inverse, on = np.linalg.inv(M), np.eye(6)[:, segment]  # M is the segments' masses
    a = np.block([[np.zeros((6, 6)), np.eye(6)], [-inverse @ K, -inverse @ C]])
    b = np.concatenate([np.zeros(6), on])[:, None]
    time = np.arange(len(force_mps2)) / fitting.RATE_HZ
    return signal.lsim((a, b, a[6:], b[6:]), force_mps2, time)[1][:, MEASURED_SEGMENT_INDEX]


@cache
def stiffening() -> tuple[Case, ...]:
    """Nine events in the order of their stamps, one joint stiffer by 30 % from the seventh on."""

    def law(stretch: np.ndarray, rate: np.ndarray) -> np.ndarray:
        out, joint = np.zeros_like(stretch), SEGMENTS.index(JOINT)
        out[CHANGED:, joint] = STIFFER * hiding.stiffness_and_damping()[0][joint] * stretch[CHANGED:, joint]
        return out

    rng, cases = np.random.default_rng(5), []
    for number, (seat, accel) in enumerate(zip(hiding.seats(), hiding.answers(hiding.seats(), law), strict=True)):
        noise = fitting.low_passed(hiding.NOISE_MPS2 * rng.standard_normal((len(seat), 5)))
        measured = accel[:, MEASURED_SEGMENT_INDEX] + noise
        cases.append(fitting.ready(seat, measured, hiding.KINDS[number % len(hiding.KINDS)]))
    return in_order(cases)


def in_order(cases) -> tuple[Case, ...]:
    """Stamped ten seconds apart."""
    return tuple(dataclasses.replace(case, begins_ns=(1 + 10 * i) * 1_000_000_000) for i, case in enumerate(cases))


@cache
def nothing_in_order() -> tuple[Case, ...]:
    return in_order(hiding.events(9))


@cache
def by_turns(cases: tuple[Case, ...]) -> NuisanceModel:
    """Alternate events for fitting and for choosing."""
    fit = fit_joint(cases[::2], hiding.TRUTH, 1, hiding.QUICK_BASE)
    return NuisanceModel.of(fit.subject, cases[::2], cases[1::2])


@cache
def without(nuisance: NuisanceModel) -> LocalFit:
    return fit_locally(nuisance, None)


@cache
def found(nuisance: NuisanceModel) -> Found:
    causes = unsteady_causes(nuisance, without(nuisance), UnsteadySettings())
    found = {(one.applied.effect.name, one.applied.site): one for one in causes}
    windows = len(nuisance.choose.products.square)
    assert all(one.residual_square.shape == (windows,) and (one.residual_square >= 0.0).all() for one in found.values())
    return found


def gains(nuisance: NuisanceModel) -> dict[tuple[str, str], float]:
    """The mean log ratio of the residual without and with it; all windows have one length."""
    before = without(nuisance).residual_square
    return {name: float(np.log(before / one.residual_square).mean()) for name, one in found(nuisance).items()}


def assert_found(nuisance: NuisanceModel, name: str, site: str, least: float, times: float) -> AppliedEffect:
    """Its gain is at least this, and this multiple of every other gain."""
    gained, causes = gains(nuisance), found(nuisance)
    others = {key: gain for key, gain in gained.items() if key != (name, site)}
    assert gained[name, site] > least and gained[name, site] > times * max(others.values()), gained
    assert min(causes, key=lambda key: causes[key].residual_square.sum()) == (name, site)
    assert causes[name, site].objection == ""
    return causes[name, site].applied


def test_a_jumping_clock_is_found_with_its_sensor() -> None:
    sensor = "upper_torso"
    clock = assert_found(hiding.nuisance(jumping(sensor)), "clock", sensor, 0.3, 3.0)
    assert clock.values == {"delay_s": pytest.approx(0.002, rel=0.25), "drift": 0.0}  # two windows of three


@pytest.mark.parametrize(
    "segment", ["central_torso", pytest.param("head", marks=pytest.mark.slow)]
)  # one has no sensor
def test_a_wandering_line_is_found_with_its_segment(segment: str) -> None:
    line = assert_found(hiding.nuisance(wandering(segment)), "periodic", segment, 1.0, 1.5)
    assert line.values["frequency_hz"] == pytest.approx(LINE_HZ, abs=1.0)
    assert line.values["cosine_mps2"] == pytest.approx(LINE_MPS2, rel=0.15) and line.values["sine_mps2"] == 0.0


@cache
def trembling(segment: str) -> hiding.Change:
    """A force on one segment at a constant frequency that grows with the motion, unlike an engine's."""

    def change(measured: np.ndarray) -> np.ndarray:
        time = np.arange(len(measured)) / fitting.RATE_HZ
        moving = signal.sosfiltfilt(signal.butter(2, 2.0, fs=fitting.RATE_HZ, output="sos"), (measured**2).sum(axis=1))
        force = 0.4 * np.sqrt(np.maximum(moving, 0.0)) * np.cos(2.0 * np.pi * LINE_HZ * time)
        return measured + pushed(SEGMENTS.index(segment), force)

    return change


def test_a_line_that_grows_with_the_motion_has_an_objection() -> None:
    """It is as prominent and gains as much as an engine line; the objection is its growth with the motion."""
    nuisance = hiding.nuisance(trembling("head"))
    lines = {site: one for (name, site), one in found(nuisance).items() if name == "periodic"}
    assert gains(nuisance)["periodic", "head"] > 0.3
    assert all("grows" in one.objection for one in lines.values())


def test_a_joint_that_stiffens_between_two_events_is_found() -> None:
    posture = assert_found(by_turns(stiffening()), "posture", JOINT, 0.5, 2.0)
    assert posture.stated_values == {"jump": pytest.approx(STIFFER, rel=0.15), "at_s": 0.0}


def test_gains_are_small_without_a_hidden_cause() -> None:
    """No clock is fitted, because no offset is atypical."""
    assert gains(hiding.nuisance()) == {}  # all of one stamp
    gained = gains(by_turns(nothing_in_order()))
    assert {name for name, _ in gained} == {"posture"} and len(gained) == len(SEGMENTS)
    assert max(gained.values()) < 0.05, gained


def test_no_line_is_tried_without_a_prominent_one() -> None:
    for nuisance in (hiding.nuisance(), by_turns(nothing_in_order())):
        assert "periodic" not in names(nuisance)
    assert "periodic" in names(hiding.nuisance(wandering("head")))


def test_events_of_one_stamp_have_no_posture() -> None:
    nuisance = by_turns(stiffening())
    assert "posture" in names(nuisance)
    assert "posture" not in names(stamped(nuisance, [7] * 5, [7] * 4))
    assert "posture" not in names(stamped(nuisance, [7] * 5, [1, 2, 8, 9]))  # events for choosing do not matter


def test_postures_depend_on_the_order_of_stamps_and_not_of_events() -> None:
    nuisance = by_turns(stiffening())
    train, choose = nuisance.train.cases, nuisance.choose.cases
    shuffled = NuisanceModel.of(nuisance.subject, [train[i] for i in (3, 0, 4, 2, 1)], choose)
    assert_same_postures(shuffled, nuisance)
    for name, one in found(shuffled).items():
        np.testing.assert_allclose(one.residual_square, found(nuisance)[name].residual_square, rtol=1e-4)


def test_only_events_for_fitting_determine_a_posture() -> None:
    """Other events for choosing, without the change or all before it, give the same postures."""
    nuisance = by_turns(stiffening())
    steady = NuisanceModel.of(nuisance.subject, nuisance.train.cases, nothing_in_order()[1::2])
    all_before = stamped(nuisance, [2, 4, 6, 8, 10], [1, 1, 1, 1])
    for other in (steady, all_before):
        assert_same_postures(other, nuisance)
        assert gains(other)["posture", JOINT] < 0.5 * gains(nuisance)["posture", JOINT]


def test_reversed_time_softens_the_joint() -> None:
    """Time is reversed; no event for choosing lies between those around the change."""
    nuisance = by_turns(stiffening())
    other = stamped(nuisance, [9, 7, 5, 3, 1], [8, 6, 5, 2])
    stiffer, softer = (found(one)["posture", JOINT].applied.values["jump"] for one in (nuisance, other))
    assert (1.0 + stiffer) * (1.0 + softer) == pytest.approx(1.0, abs=1e-6) and softer < -0.15
    # One direction has an event between those around the change, which does not count.
    assert gains(other)["posture", JOINT] == pytest.approx(gains(nuisance)["posture", JOINT], rel=0.15)


def names(nuisance: NuisanceModel) -> set[str]:
    """The names of the found effects."""
    return {name for name, _ in found(nuisance)}


def stamped(nuisance: NuisanceModel, train: list[int], choose: list[int]) -> NuisanceModel:
    """The same events, begun at other instants."""

    def of(events: EventSet, stamps: list[int]) -> EventSet:
        cases = zip(events.cases, stamps, strict=True)
        return dataclasses.replace(events, cases=tuple(dataclasses.replace(case, begins_ns=at) for case, at in cases))

    return dataclasses.replace(nuisance, train=of(nuisance.train, train), choose=of(nuisance.choose, choose))


def assert_same_postures(one: NuisanceModel, other: NuisanceModel) -> None:
    for site in SEGMENTS:
        jump, expected = (found(nuisance)["posture", site].applied.values["jump"] for nuisance in (one, other))
        assert jump == pytest.approx(expected, rel=1e-4)


def test_a_short_event_is_accepted() -> None:
    cases, samples = hiding.events(6), round(2.7 * fitting.RATE_HZ)
    measured = cases[4].measured_mps2[:samples]
    short = dataclasses.replace(
        cases[4],
        seat_mps2=cases[4].seat_mps2[:samples],
        measured_mps2=measured,
        compared=cases[4].compared[:samples],
        energy=(measured**2).sum(axis=0),
    )
    nuisance = NuisanceModel.of(hiding.nuisance().subject, cases[:3], (cases[3], short, cases[5]))
    assert list(unsteady_causes(nuisance, fit_locally(nuisance, None), UnsteadySettings())) == []
