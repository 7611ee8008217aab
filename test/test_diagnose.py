"""Diagnostics of a residual with a known cause."""

import dataclasses
from functools import cache
from unittest import mock

import fitting
import hiding
import numpy as np
import pytest

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.identification.problem import Case
from biodyn_core.tracing import diagnose as diagnose_module
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.diagnose import bracket, coherent, diagnose, peeling
from biodyn_core.tracing.findings import Diagnostics
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.settings import DiagnosticSettings

RATE_HZ = fitting.RATE_HZ
FAILING = DiagnosticSettings().failing
NODES = ("neck", "upper_torso", "lower_torso", "pelvis", "seat")
QUIET = 0.05
"""A share of the seat at which the true body's own stiffening does nothing."""


def with_channels(number: int) -> Case:
    """A quiet event with two channels that are noise, each its own."""
    rng, one = np.random.default_rng(number), hiding.events(6)[number]
    n = len(one.seat_mps2)
    return dataclasses.replace(
        one, channels={name: fitting.low_passed(rng.standard_normal(n)) for name in ("seat.x", "seat.y")}
    )


def test_a_coherent_channel_has_its_segment_and_share() -> None:
    """0.3 of a channel of unit power beside as much noise power of its own: half the power is its."""
    rng, cases = np.random.default_rng(9), [with_channels(number) for number in range(3)]
    residuals = []
    for case in cases:
        residual = 0.3 * fitting.low_passed(rng.standard_normal((len(case.seat_mps2), 5)))
        residual[:, hiding.HEAD] += 0.3 * case.channels["seat.x"]
        residuals.append(residual)
    found = coherent(cases, residuals)
    assert set(found) == {"seat.z", "seat.x", "seat.y"}
    assert found["seat.x"][0] == "head" and found["seat.x"][1] == pytest.approx(0.5, abs=0.15)
    assert found["seat.z"][1] < 0.15 and found["seat.y"][1] < 0.15


def test_a_sensor_gain_is_coherent_with_the_seat() -> None:
    cases = list(hiding.events(6, hiding.louder)[:3])
    residuals = [np.where(c.compared, c.measured_mps2 - answer(hiding.TRUTH, c), 0.0) for c in cases]
    segment, share = coherent(cases, residuals)["seat.z"]
    assert segment == "neck" and share > 0.4


BROKEN = {"": -1, "pelvis": 0, "central_torso": 2, "neck": 4}
"""The joints that are four times as stiff in compression, in turn."""


@cache
def _quiet() -> np.ndarray:
    """Absolute accelerations (broken, 2, n, 6) to a quiet road and a quiet pothole."""

    def harder(stretch: np.ndarray, rate: np.ndarray) -> np.ndarray:
        out = np.zeros_like(stretch)
        for number, joint in enumerate(BROKEN.values()):
            own = slice(2 * number, 2 * number + 2)
            if joint >= 0:
                size = 3.0 * hiding.stiffness_and_damping()[0][joint]
                out[own, joint] = size * np.minimum(stretch[own, joint], 0.0)
        return out

    seats = np.tile(QUIET * hiding.seats()[:2], (len(BROKEN), 1))
    return hiding.answers(seats, harder).reshape(len(BROKEN), 2, -1, 6)


def quiet(joint: str) -> list[Case]:
    """A quiet road and pothole on the true body with one joint broken."""
    seats, accel = QUIET * hiding.seats()[:2], _quiet()[list(BROKEN).index(joint)]
    return [fitting.ready(seat, one, kind) for seat, one, kind in zip(seats, accel, hiding.KINDS, strict=False)]


def test_no_sub_chain_of_a_true_chain_fails() -> None:
    found = peeling(hiding.TRUTH, quiet(""))
    assert tuple(found) == NODES
    assert max(found.values()) < 12.0  # 3 s, the ends of which no window follows
    assert bracket(found, FAILING) == ()


def test_joints_of_another_size_are_refitted() -> None:
    theta = hiding.TRUTH.parameters.vector()
    theta[:6] *= 1.1
    wrong = dataclasses.replace(hiding.TRUTH, parameters=type(hiding.TRUTH.parameters).from_vector(theta))
    found, true = peeling(wrong, quiet("")), peeling(hiding.TRUTH, quiet(""))
    np.testing.assert_allclose(list(found.values()), list(true.values()), rtol=1e-2)


def test_much_stiffer_joints_are_bounded() -> None:
    """A rigid body has infinitely stiff joints: an unbounded search had an error of 85 % at one of them."""
    rigid = [
        dataclasses.replace(case, measured_mps2=np.repeat(case.seat_mps2[:, None], 5, axis=1)) for case in quiet("")
    ]
    assert max(peeling(hiding.TRUTH, rigid).values()) < 30.0


@pytest.mark.parametrize(
    ("joint", "expected"),
    [("pelvis", ("pelvis",)), ("central_torso", ("central_torso", "upper_torso")), ("neck", ("neck",))],
)
def test_a_nonlinear_joint_is_bracketed(joint: str, expected: tuple[str, ...]) -> None:
    found = peeling(hiding.TRUTH, quiet(joint))
    assert bracket(found, FAILING) == expected


@pytest.mark.parametrize(
    ("percent", "expected"),
    [
        ((1.0, 1.0, 1.1, 1.2, 1.3), ()),
        ((1.0, 1.0, 1.1, 1.2, 9.0), ("pelvis",)),
        ((1.0, 1.0, 9.0, 9.0, 9.0), ("central_torso", "upper_torso")),
        ((1.0, 9.0, 8.0, 7.0, 6.0), ("neck",)),
        ((9.0, 1.0, 1.0, 1.0, 1.0), ("head",)),
    ],
)
def test_the_bracket_is_at_the_first_failing_sub_chain(percent: tuple, expected: tuple[str, ...]) -> None:
    assert bracket(dict(zip(NODES, percent, strict=True)), FAILING) == expected


def without(case: Case, column: int) -> Case:
    """A case whose sensor failed."""
    measured, compared, energy = case.measured_mps2.copy(), case.compared.copy(), case.energy.copy()
    measured[:, column], compared[:, column], energy[column] = 0.0, False, 0.0
    return dataclasses.replace(case, measured_mps2=measured, compared=compared, energy=energy)


def test_a_missing_sensor_makes_no_sub_chain_fail() -> None:
    """The sub-chain above a missing sensor has no drive and must not fail."""
    cases = [without(case, MEASURED_SEGMENTS.index("lower_torso")) for case in quiet("")]
    assert bracket(peeling(hiding.TRUTH, cases), FAILING) == ()


def nuisance(cases: list[Case]) -> NuisanceModel:
    return NuisanceModel.of(hiding.TRUTH, cases, cases[:1])


def diagnosed(subject: Subject, of: NuisanceModel) -> Diagnostics:
    """The diagnostics without the sub-chains, which other tests peel."""
    with mock.patch.object(diagnose_module, "peeling", return_value=dict.fromkeys(NODES, 1.0)):
        return diagnose(subject, of)


def test_a_missing_sensor_has_no_coherent_residual() -> None:
    cases = [without(case, hiding.HEAD) for case in hiding.events(6)[:3]]
    _, share = diagnosed(hiding.TRUTH, nuisance(cases)).coherent["seat.z"]
    assert share < 0.2


def loud_by(power: float, lengths: tuple[int, ...]) -> list[Case]:
    """Events of the true body of growing peaks whose relative residual goes as a power of the peak."""
    rng, made = np.random.default_rng(5), []
    source = hiding.events(6)[1]
    for number, n in enumerate(lengths):
        scale = 0.05 * 2.0**number
        seat = scale * source.seat_mps2[:n] / np.abs(source.seat_mps2[:n]).max()
        one = dataclasses.replace(source, seat_mps2=seat, compared=source.compared[:n])
        plain = np.where(one.compared, answer(hiding.TRUTH, one), 0.0)
        rms = np.sqrt((plain**2).sum(axis=0) / one.compared.sum(axis=0))
        noise = 0.1 * scale**power * rms * rng.standard_normal(plain.shape)
        measured = np.where(one.compared, plain + noise, 0.0)
        made.append(dataclasses.replace(one, measured_mps2=measured, energy=(measured**2).sum(axis=0)))
    return made


@pytest.mark.parametrize("power", [-0.5, 0.0, 0.5])
def test_the_slope_is_the_power_of_the_relative_residual(power: float) -> None:
    cases = loud_by(power, (3000, 3000, 3000, 3000))
    found = diagnosed(hiding.TRUTH, nuisance(cases)).level_slope
    assert found == pytest.approx(power, abs=0.1)


def test_longer_events_have_no_larger_relative_residual() -> None:
    cases = loud_by(0.0, (1500, 1800, 2400, 3000))
    assert diagnosed(hiding.TRUTH, nuisance(cases)).level_slope == pytest.approx(0.0, abs=0.1)


def test_equal_peaks_have_no_slope() -> None:
    case = hiding.events(6)[0]
    assert diagnosed(hiding.TRUTH, nuisance([case, case, case])).level_slope is None


def test_the_event_of_a_jump_of_the_residual_is_named() -> None:
    """A sensor comes loose before the fourth event: it rings from there on."""
    before, after = hiding.events(6), hiding.events(6, loose)
    cases = [*before[:3], *after[3:]]
    found = diagnosed(hiding.TRUTH, nuisance(cases)).jump
    assert found is not None and found[1] < 0.05
    assert found[0] == cases[3].name
    # Events may be given in another order; the residual changes in that of time.
    timed = [dataclasses.replace(case, begins_ns=number * 10**10) for number, case in enumerate(cases)]
    dealt = [timed[number] for number in (4, 0, 3, 2, 5, 1)]
    name, p_value = diagnosed(hiding.TRUTH, nuisance(dealt)).jump or ("", 1.0)
    assert name == cases[3].name and p_value < 0.05


def test_the_p_value_is_large_without_a_jump() -> None:
    found = diagnosed(hiding.TRUTH, nuisance(list(hiding.events(6)))).jump
    assert found is not None and found[1] > 0.05


def loose(measured: np.ndarray) -> np.ndarray:
    return hiding.on_skin(hiding.later(measured))


def test_diagnostics_of_a_true_body() -> None:
    cases = list(hiding.events(6)[:3])
    found = diagnose(hiding.TRUTH, nuisance(cases))
    assert found.at_bound == () and found.seat_tension > 1.0  # a rail of 6 g lifts the body off
    assert set(found.amplitude_transfer) == set(hiding.KINDS)
    for quiet_alone, everything in found.amplitude_transfer.values():
        assert 0.0 < everything < 1.5 and quiet_alone < 2.0
    assert all(apart < 0.2 for name, apart in found.drift.items() if name.startswith("f_n"))


def test_theta_of_quiet_events_has_a_larger_residual_in_loud_ones_with_a_hidden_law() -> None:
    hidden = diagnosed(hiding.fitted(hiding.nothing, hiding.orifice), hiding.nuisance(hiding.nothing, hiding.orifice))
    plain = diagnosed(hiding.fitted(), hiding.nuisance())
    apart = {name: both[0] / both[1] for name, both in hidden.amplitude_transfer.items()}
    typical = {name: both[0] / both[1] for name, both in plain.amplitude_transfer.items()}
    assert apart["rail"] > 1.5 * typical["rail"]
    assert max(hidden.drift.values()) > 1.5 * max(plain.drift.values())
