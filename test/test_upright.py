"""Where up is for a sensor that leans while it moves."""

import dataclasses

import hiding
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from biodyn_core.identification.problem import Case
from biodyn_core.kernels.lean import follow_up
from biodyn_core.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.tracing.upright import upright

HEAD = 4


def swaying(case: Case, degrees: float) -> tuple[Case, np.ndarray]:
    """The head's sensor pitches and rolls behind its first second; readings are those of the turned sensor."""
    n, rate_hz = case.seat_mps2.size, case.rate_hz
    time_s = np.arange(n) / rate_hz
    moving = np.clip(time_s - 1.0, 0.0, 1.0)
    pitch = np.deg2rad(degrees) * moving * np.sin(2.0 * np.pi * 1.3 * time_s)
    roll = 0.6 * np.deg2rad(degrees) * moving * np.sin(2.0 * np.pi * 0.9 * time_s + 0.4)
    turned = Rotation.from_euler("xy", np.column_stack([roll, pitch]))
    true = np.column_stack(
        [
            4.0 * moving * np.sin(9.0 * time_s),
            3.0 * moving * np.cos(7.0 * time_s),
            case.measured_mps2[:, HEAD] + STANDARD_GRAVITY_MPS2,
        ]
    )
    read = turned.inv().apply(true)
    steps = (turned[:-1].inv() * turned[1:]).as_rotvec() * rate_hz
    rates = np.vstack([steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:]])
    channels = {"head.x": read[:, 0], "head.y": read[:, 1]}
    channels |= {f"head.rate_{axis}": rates[:, i] + 0.003 for i, axis in enumerate("xyz")}
    measured = case.measured_mps2.copy()
    measured[:, HEAD] = read[:, 2] - STANDARD_GRAVITY_MPS2
    return dataclasses.replace(case, measured_mps2=measured, channels=channels), case.measured_mps2[:, HEAD]


def as_compared(case: Case) -> np.ndarray:
    return np.where(case.compared, case.measured_mps2, 0.0)


def test_a_leaning_sensor_is_set_upright() -> None:
    given = hiding.events(6)[0]
    leaning, true = swaying(given, 15.0)
    found, said = upright(leaning)
    used = given.compared[:, HEAD]
    before, after = ((case.measured_mps2[:, HEAD] - true)[used].std() for case in (leaning, found))
    assert before > 0.3 and after < 0.02 * before and said == []
    np.testing.assert_array_equal(
        found.measured_mps2[:, :HEAD], np.where(given.compared, given.measured_mps2, 0.0)[:, :HEAD]
    )
    assert found.energy[HEAD] == pytest.approx((found.measured_mps2[:, HEAD] ** 2).sum())


def test_without_rates_nothing_changes() -> None:
    case = hiding.events(6)[0]
    found, said = upright(dataclasses.replace(case, channels={}))
    np.testing.assert_array_equal(found.seat_mps2, case.seat_mps2)
    np.testing.assert_array_equal(found.measured_mps2[case.compared], case.measured_mps2[case.compared])
    assert said == []


def test_a_sensor_that_never_rests_is_left_as_it_is_and_named() -> None:
    leaning, _ = swaying(hiding.events(6)[0], 15.0)
    turning = {
        name: values + (np.sin(np.arange(values.size)) if "rate" in name else 0.0)
        for name, values in leaning.channels.items()
    }
    found, said = upright(dataclasses.replace(leaning, channels=turning))
    np.testing.assert_array_equal(
        found.measured_mps2[:, HEAD], np.where(leaning.compared, leaning.measured_mps2, 0.0)[:, HEAD]
    )
    assert len(said) == 1 and "head turns" in said[0]


def test_a_steady_turn_is_followed_exactly() -> None:
    rates = np.tile([0.3, -0.2, 0.1], (500, 1))
    up = np.empty_like(rates)
    follow_up(rates, 0.01, up)
    expected = Rotation.from_rotvec(-rates * 0.01 * np.arange(500)[:, None]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, expected, atol=1e-12)
