"""The vertical of a sensor that tilts in motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from biodyn_core.base.segments import MEASURED_SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.attitude import estimated_attitude, true_vertical_mps2
from biodyn_core.conditioning.tilt import horizontal_axes
from biodyn_core.kernels.attitude import follow_attitude
from biodyn_core.recording.recording import Recorder, Recording, RecordingSettings

RATE_HZ = 1129.3
HEAD = MEASURED_SEGMENTS.index("head")
MOUNTED = Rotation.from_euler("xyz", [0.15, -0.1, 2.0])
"""Mounting of the head's sensor: tilted, and turned about the vertical."""


def swaying(degrees: float, seconds: float = 10.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), true motion (n, 3), and force and rates (n, 3) of a sensor that pitches and rolls after 3 s."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    moving = np.clip(time_s - 3.0, 0.0, 1.0)
    pitch = np.deg2rad(degrees) * moving * np.sin(2.0 * np.pi * 1.3 * time_s)
    roll = 0.6 * np.deg2rad(degrees) * moving * np.sin(2.0 * np.pi * 0.9 * time_s + 0.4)
    turned = Rotation.from_euler("xy", np.column_stack([roll, pitch])) * MOUNTED
    true = moving[:, None] * np.column_stack(
        [4.0 * np.sin(9.0 * time_s), 3.0 * np.cos(7.0 * time_s), 5.0 * np.sin(25.0 * time_s)]
    )
    force = turned.inv().apply(true + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
    steps = (turned[:-1].inv() * turned[1:]).as_rotvec() * RATE_HZ
    rates = np.vstack([steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:]])
    return time_s, true, force, rates


def recorded(rates_of=lambda rates: rates, degrees: float = 15.0, channels: bool = False, **settings) -> Recording:
    """The head sways, the seat does not; rates_of changes the rates of the head's gyro."""
    time_s, true, force, rates = swaying(degrees)
    stamps_ns = 1_000_000_000 + np.rint(time_s * 1e9).astype(np.int64)
    recorder = Recorder("road", "drive", settings=RecordingSettings(**settings), channels=channels)
    still = true * np.array([0.0, 0.0, 1.0]) + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
    recorder.push("seat", stamps_ns, still)
    recorder.push("head", stamps_ns, force, rates_of(rates))
    (recording,) = recorder.finish()
    return recording


def missed(recording: Recording) -> float:
    """Rms error of the head's reading: the seat has the same vertical."""
    return float(np.nanstd(recording.measured_mps2[:, HEAD] - recording.seat_mps2))


def test_a_tilted_sensor_gives_the_true_vertical() -> None:
    assert missed(recorded(keep_lean=True)) > 0.3
    assert missed(recorded()) < 0.003
    assert missed(recorded(lambda rates: rates + 0.02)) < 0.003  # a bias is found at rest


def test_with_and_without_channels_the_vertical_is_the_same() -> None:
    np.testing.assert_array_equal(recorded().measured_mps2, recorded(channels=True).measured_mps2)


def test_a_small_gap_of_the_gyro_is_interpolated() -> None:
    def with_gap(rates: np.ndarray, seconds: float) -> np.ndarray:
        changed = rates.copy()
        changed[6000 : 6000 + round(seconds * RATE_HZ)] = np.nan
        return changed

    assert missed(recorded(lambda rates: with_gap(rates, 0.02))) < 0.02
    late = recorded(lambda rates: with_gap(rates, 0.3))
    assert missed(late) == pytest.approx(missed(recorded(keep_lean=True)))
    assert any("head: its gyro has a gap of 0.3 s" in line for line in late.warnings)


def test_tilt_continues_across_a_short_break_and_a_longer_one_is_reported() -> None:
    time_s, true, force, rates = swaying(15.0)
    stamps_ns = 1_000_000_000 + np.rint(time_s * 1e9).astype(np.int64)
    still = true * np.array([0.0, 0.0, 1.0]) + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])

    def with_break(seconds: float, **settings: bool) -> Recording:
        begin = int(np.argmax(np.abs(force[6000:8000, :2]).sum(axis=1))) + 6000
        here = np.delete(np.arange(len(time_s)), np.s_[begin : begin + round(seconds * RATE_HZ)])
        recorder = Recorder("road", "drive", settings=RecordingSettings(**settings))
        recorder.push("seat", stamps_ns, still)
        recorder.push("head", stamps_ns[here], force[here], rates[here])
        (recording,) = recorder.finish()
        return recording

    short = with_break(0.06)
    assert missed(short) < 0.02 and missed(with_break(0.06, keep_lean=True)) > 0.3
    assert not any("break" in line for line in short.warnings)
    long = with_break(0.5)
    assert any("head: after 1 break of up to 0.5 s its vertical is the axis" in line for line in long.warnings)


@pytest.mark.parametrize(
    ("rates_of", "why"),
    [
        (np.rad2deg, "impossible for a seated person"),
        (lambda rates: rates + 0.2 * np.sin(np.arange(len(rates)))[:, None], "does not rest"),
    ],
    ids=["deg/s", "restless"],
)
def test_an_implausible_gyro_changes_nothing_and_is_reported(rates_of, why: str) -> None:
    found = recorded(rates_of)
    np.testing.assert_array_equal(found.measured_mps2, recorded(keep_lean=True).measured_mps2)
    assert sum("head: " in line and why in line and "at rest" in line for line in found.warnings) == 1


def test_one_gyro_in_another_unit_disables_all() -> None:
    """In deg/s the small rotation of the seat gives a plausible tilt, and that of the head an implausible one."""
    time_s, true, force, rates = swaying(15.0)
    stamps_ns = 1_000_000_000 + np.rint(time_s * 1e9).astype(np.int64)
    still = true * np.array([0.0, 0.0, 1.0]) + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
    moving = np.clip(time_s - 3.0, 0.0, 1.0)
    rocks = np.column_stack([0.0 * time_s, 0.3 * 3.0 * moving * np.cos(3.0 * time_s), 0.0 * time_s])

    def read(scale: float) -> Recording:
        recorder = Recorder("road", "drive")
        recorder.push("seat", stamps_ns, still, np.deg2rad(rocks) * scale)
        recorder.push("head", stamps_ns, force, rates * scale)
        return recorder.finish()[0]

    assert set(read(1.0).mean_tilts) == {"seat", "head"}
    found = read(np.rad2deg(1.0))
    assert found.mean_tilts == {}
    assert any("seat: another gyro of the record is not plausible" in line for line in found.warnings)
    np.testing.assert_allclose(found.measured_mps2, recorded(keep_lean=True).measured_mps2, atol=1e-9)


def test_without_a_gyro_no_tilt_is_reported() -> None:
    found = recorded(np.zeros_like)
    np.testing.assert_array_equal(found.measured_mps2, recorded(keep_lean=True).measured_mps2)
    assert not any("gyro" in line or "rates" in line for line in found.warnings)


def test_the_mean_tilt_is_given_in_the_axes_of_the_channels() -> None:
    """By definition: the share of a motion along x in the vertical reading. An oscillation gives no mean tilt."""
    time_s, true, *_ = swaying(0.0)
    turned = Rotation.from_euler("y", np.deg2rad(6.0) * np.clip(time_s - 1.5, 0.0, 0.5)[:, None] / 0.5) * MOUNTED
    gravity = turned.inv().apply(np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
    steps = (turned[:-1].inv() * turned[1:]).as_rotvec() * RATE_HZ
    rates = np.vstack([steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:]])
    stamps_ns = 1_000_000_000 + np.rint(time_s * 1e9).astype(np.int64)
    recorder = Recorder("road", "drive", channels=True)
    recorder.push("seat", stamps_ns, true * np.array([0.0, 0.0, 1.0]) + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2]))
    recorder.push("head", stamps_ns, gravity, rates)
    (recording,) = recorder.finish()
    assert set(recording.mean_tilts) == {"head"}
    lean = np.array(recording.mean_tilts["head"])
    assert np.degrees(np.arcsin(np.linalg.norm(lean))) == pytest.approx(6.0, abs=0.3)
    # At rest with a tilt, gravity along the horizontal axes is minus the tilt.
    first = MOUNTED.inv().apply([0.0, 0.0, 1.0])
    level = horizontal_axes(tuple(first))[:2] @ gravity[-1] / STANDARD_GRAVITY_MPS2
    np.testing.assert_allclose(lean, -level, atol=0.006)
    assert np.linalg.norm(recorded().mean_tilts["head"]) < 0.02 and recorded(keep_lean=True).mean_tilts == {}


def test_a_steady_turn_is_followed_exactly() -> None:
    rates = np.tile([0.3, -0.2, 0.1], (500, 1))
    up = np.tile([0.0, 0.0, 1.0], (500, 1))
    follow_attitude(rates, np.zeros_like(rates), 0.01, 0.0, up)
    expected = Rotation.from_rotvec(-rates * 0.01 * np.arange(500)[:, None]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, expected, atol=1e-12)


def test_a_bias_of_the_gyro_does_not_accumulate() -> None:
    """At rest for ten minutes with a wrong bias of 0.0003 rad/s: 10 deg without the pull, 60 s of it with."""
    rest, rates = np.zeros((60_000, 3)), np.tile([0.0003, 0.0, 0.0], (60_000, 1))
    up = estimated_attitude(rest, rates, 100.0, STANDARD_GRAVITY_MPS2)
    vertical = true_vertical_mps2(up, rest, STANDARD_GRAVITY_MPS2)
    leaned_rad = np.arccos(1.0 + vertical[-1] / STANDARD_GRAVITY_MPS2)
    assert leaned_rad == pytest.approx(0.0003 * 60.0, rel=0.01)


def test_an_implausible_tilt_is_refused() -> None:
    rates = np.tile([0.0, 0.5, 0.0], (500, 1))
    with pytest.raises(ValueError, match="impossible for a seated person"):
        estimated_attitude(np.zeros((500, 3)), rates, 100.0, STANDARD_GRAVITY_MPS2)
