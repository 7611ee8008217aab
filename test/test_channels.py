"""Further channels: known motions of any mounting, masks, gyros with gaps or none, and an independent simulation."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import recordings
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import interpolate, signal
from scipy.spatial.transform import Rotation
from streams import RATE_HZ, START_NS, noisy_streams
from world import seats, sensors

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.channels import interpolated
from biodyn_core.conditioning.tilt import horizontal_axes, rotation_to_vertical
from biodyn_core.recording.recording import REPORTED_S, Recorder, Recording, RecordingSettings
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.topics import INPUT
from biodyn_ros.reading.recordings import RecordingOptions, read_recordings
from biodyn_ros.reading.seat_motion import read_seat_motion

Floats = NDArray[np.float64]
REACH = round(0.0288 * RATE_HZ)
"""Reach of the low-pass to either side."""


@dataclass(frozen=True, eq=False)
class Stream:
    """The data of one sensor: stamps (n,) ns, specific force (n, 3) m/s^2, angular rates (n, 3) rad/s or none."""

    stamps_ns: NDArray[np.int64]
    accel_mps2: Floats
    rates_radps: Floats | None


Streams = dict[str, Stream]


def recorder(**settings) -> Recorder:
    # The rates of these tests are of no motion: verticals set upright by them would be none.
    return Recorder("road", "drive", settings=RecordingSettings(**({"keep_lean": True} | settings)), channels=True)


def recorded(streams: Streams, **settings) -> Recording:
    """Streams through a Recorder, each pushed as one block."""
    found = recorder(**settings)
    for name, stream in streams.items():
        found.push(name, stream.stamps_ns, stream.accel_mps2, stream.rates_radps)
    (recording,) = found.finish()
    return recording


def same(one: Recording, other: Recording) -> None:
    """Assert that two recordings and their channels do not differ by a bit."""
    assert one.warnings == other.warnings
    np.testing.assert_array_equal(one.stamps_ns, other.stamps_ns)
    np.testing.assert_array_equal(one.seat_mps2, other.seat_mps2)
    np.testing.assert_array_equal(one.measured_mps2, other.measured_mps2)
    assert list(one.channels) == list(other.channels)
    for name, channels in one.channels.items():
        np.testing.assert_array_equal(channels.horizontal_mps2, other.channels[name].horizontal_mps2)
        np.testing.assert_array_equal(channels.rates_radps, other.channels[name].rates_radps)


# --- a motion with an answer -----------------------------------------------------------------------------------------


TIME_S = np.arange(round(6.0 * RATE_HZ)) / RATE_HZ
ARM_M = np.array([0.4, -0.1, 0.9])


@cache
def angle(size_rad: float, frequency_hz: float) -> interpolate.BSpline:
    """A turning that sets in at 1.5 s: a spline of degree seven, so that its derivatives are exact."""
    rise = np.clip((TIME_S - 1.5) / 0.5, 0.0, 1.0)
    smooth = rise**4 * (35.0 - 84.0 * rise + 70.0 * rise**2 - 20.0 * rise**3)
    swing = size_rad * smooth * np.sin(2.0 * np.pi * frequency_hz * (TIME_S - 1.5))
    return interpolate.make_interp_spline(TIME_S, swing, k=7)


@cache
def rigid_body() -> tuple[Floats, Floats]:
    """Specific force and angular rates (n, 3) in a body that yaws by psi, then pitches by theta, on a moving ground.

    R = Rz(psi) Ry(theta), so the rates are Ry(-theta) (0, 0, psi') + (0, theta', 0); a point at `ARM_M` has the
    acceleration w' x r + w x (w x r) of its own.
    """
    psi, theta = angle(0.15, 0.8), angle(0.05, 3.3)
    yaw, pitch = psi(TIME_S), theta(TIME_S)
    dyaw, dpitch, ddyaw, ddpitch = psi(TIME_S, 1), theta(TIME_S, 1), psi(TIME_S, 2), theta(TIME_S, 2)
    rates = np.column_stack([-dyaw * np.sin(pitch), dpitch, dyaw * np.cos(pitch)])
    turning = np.column_stack([
        -ddyaw * np.sin(pitch) - dyaw * dpitch * np.cos(pitch),
        ddpitch,
        ddyaw * np.cos(pitch) - dyaw * dpitch * np.sin(pitch),
    ])  # fmt: skip
    arm = np.cross(turning, ARM_M) + np.cross(rates, np.cross(rates, ARM_M))
    ground = np.column_stack([angle(2.0, 5.1)(TIME_S), angle(1.0, 2.3)(TIME_S), angle(3.0, 7.7)(TIME_S)])
    ground[:, 2] += STANDARD_GRAVITY_MPS2
    force = Rotation.from_euler("ZY", np.column_stack([yaw, pitch])).inv().apply(ground)
    return force + arm, rates


def mounted(axes: Floats, bias_radps: float = 0.0) -> Stream:
    """The rigid body by a sensor whose axes in the body are these rows (3, 3)."""
    force, rates = rigid_body()
    stamps = START_NS + np.rint(TIME_S * 1e9).astype(np.int64)
    bias = bias_radps * np.array([1.0, -2.0, 0.5])
    return Stream(stamps, np.ascontiguousarray(force @ axes.T), rates @ axes.T + bias)


def everywhere(stream: Stream) -> Streams:
    return dict.fromkeys(SENSORS, stream)


def turned(order: str, *degrees: float) -> Floats:
    """Axes of a sensor turned so from the body's, rows (3, 3)."""
    return Rotation.from_euler(order, degrees, degrees=True).as_matrix().T


MOUNTINGS = {
    # How it is mounted, and where its x, laid level, points in the body: degrees from forward, counted to the left.
    "as the body": (turned("Z", 0.0), 0.0),
    "leaning aside": (turned("ZX", 70.0, 12.0), 70.0),
    "leaning ahead, biased": (turned("ZY", -160.0, -25.0), -160.0),
    "upside down": (turned("ZX", 30.0, 180.0), 30.0),
    "upside down, askew": (turned("ZXY", 30.0, 183.0, 2.0), None),
    "on its side": (turned("ZX", 30.0, 90.0), 30.0),
    # Its second axis points to 40 degrees, so x lies a right angle behind.
    "first axis up": (turned("ZY", -50.0, -90.0), -50.0),
    "first axis down": (turned("ZY", -50.0, 90.0), -50.0),
}


@pytest.mark.parametrize(("axes", "azimuth_deg"), MOUNTINGS.values(), ids=MOUNTINGS)
def test_a_known_motion_is_recovered_for_any_mounting(axes: Floats, azimuth_deg: float | None) -> None:
    streams = everywhere(mounted(turned("Z", 0.0)))
    streams["seat"] = streams["head"] = mounted(axes, bias_radps=0.02)
    recording = recorded(streams, keep_level=True)
    force, rates = rigid_body()
    azimuth = np.arctan2(axes[0, 1], axes[0, 0]) if azimuth_deg is None else np.deg2rad(azimuth_deg)
    level = Rotation.from_euler("Z", azimuth).inv()
    at_s = 1e-9 * (recording.stamps_ns - START_NS)
    for name in ("seat", "head"):
        channels = recording.channels[name]
        for found, true in ((channels.horizontal_mps2, force[:, :2]), (channels.rates_radps, rates)):
            padded = np.column_stack([true, np.zeros((len(true), 3 - true.shape[1]))])
            expected = interpolate.CubicSpline(TIME_S, level.apply(padded)[:, : true.shape[1]])(at_s)
            inside = ~np.isnan(found[:, 0])
            assert inside.sum() > found.shape[0] - 2 * (REACH + 5)
            # At 7.7 Hz the low-pass takes 1e-9 off, reading between samples less than 1e-4.
            np.testing.assert_allclose(found[inside], expected[inside], atol=2e-4 * np.abs(expected).max())


@given(st.floats(-1.0, 1.0), st.floats(-np.pi, np.pi))
def test_levelled_axes_are_orthonormal_for_any_vertical(height: float, around_rad: float) -> None:
    side = np.sqrt(1.0 - height**2)
    axes = horizontal_axes((height, side * np.cos(around_rad), side * np.sin(around_rad)))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes[2], [height, side * np.cos(around_rad), side * np.sin(around_rad)], atol=1e-12)
    assert axes[1, 0] == pytest.approx(0.0, abs=1e-12) or axes[0, 1] == pytest.approx(0.0, abs=1e-12)


def test_an_upside_down_sensor_keeps_its_axes_where_the_smallest_rotation_does_not() -> None:
    """Why it is not by that one: leaning by 2 degrees to one side or the other would turn it around."""
    one, other = ((np.sin(lean), 0.0, -np.cos(lean)) for lean in (np.deg2rad(2.0), np.deg2rad(-2.0)))
    across = (0.0, np.sin(np.deg2rad(2.0)), -np.cos(np.deg2rad(2.0)))
    np.testing.assert_allclose(horizontal_axes(one), horizontal_axes(other), atol=0.08)
    np.testing.assert_allclose(horizontal_axes(one), horizontal_axes(across), atol=0.08)
    assert np.abs(rotation_to_vertical(np.array(one)) - rotation_to_vertical(np.array(across))).max() > 1.9


def test_a_lasting_turn_is_not_removed_as_bias() -> None:
    """The reading at rest is subtracted, so a lasting turn remains."""
    bend = angle(0.0, 1.0)(TIME_S) + 0.2 * np.clip((TIME_S - 1.5) / 0.5, 0.0, 1.0)
    stream = mounted(turned("ZX", 20.0, 5.0), bias_radps=0.03)
    rates = stream.rates_radps + (turned("ZX", 20.0, 5.0) @ [0.0, 0.0, 1.0]) * bend[:, None]
    streams = everywhere(dataclasses.replace(stream, rates_radps=rates))
    bent, straight = recorded(streams), recorded(everywhere(stream)).channels["seat"].rates_radps
    later = 1e-9 * (bent.stamps_ns - START_NS) > 2.1
    for channels in bent.channels.values():
        assert np.nanmean(channels.rates_radps[later, 2] - straight[later, 2]) == pytest.approx(0.2, abs=1e-3)


def test_the_filter_is_that_of_the_vertical() -> None:
    """Forward and backward: half of a tone at the cut-off is left, in phase."""
    stream = mounted(turned("Z", 0.0))
    tone = np.where(TIME_S > 1.5, np.sin(2.0 * np.pi * 100.0 * TIME_S), 0.0)[:, None]
    force = stream.accel_mps2 + 0.5 * tone
    recording = recorded(everywhere(Stream(stream.stamps_ns, force, stream.rates_radps + 0.1 * tone)), keep_level=True)
    without = recorded(everywhere(stream), keep_level=True)
    at_s = 1e-9 * (recording.stamps_ns - START_NS)
    later = (at_s > 2.0) & (at_s < 5.0)
    half = 0.5 * np.sin(2.0 * np.pi * 100.0 * at_s[later])
    seat, plain = recording.channels["seat"], without.channels["seat"]
    for size, found, base in (
        (0.5, seat.horizontal_mps2[:, 0], plain.horizontal_mps2[:, 0]),
        (0.1, seat.rates_radps[:, 2], plain.rates_radps[:, 2]),
    ):
        np.testing.assert_allclose((found - base)[later], size * half, atol=0.01 * size)


# --- masks and cuts --------------------------------------------------------------------------------------------------


def of_model(streams=None) -> Streams:
    """The synthetic sensors, which have gyros."""
    return {s.sensor: Stream(s.stamps_ns, s.accel_mps2, s.gyro_radps) for s in streams or noisy_streams(6.0)}


def changed(streams: Streams, sensor: str, change) -> Streams:
    """The streams, one sensor's (stamps, samples, rates) put through `change`."""
    stream = streams[sensor]
    return streams | {sensor: Stream(*change(stream.stamps_ns.copy(), stream.accel_mps2.copy(), stream.rates_radps))}


def clip(stamps, samples, rates):
    samples[5000:5003, 2] = 16.0 * STANDARD_GRAVITY_MPS2
    return stamps, samples, rates


def lose(count: int):
    rows = slice(4000, 4000 + count)
    return lambda *stream: tuple(np.delete(column, rows, axis=0) for column in stream)


def spoil(stamps, samples, rates):
    samples[4500:4510] = np.nan
    return stamps, samples, rates


def stick(stamps, samples, rates):
    samples[4000:] = samples[4000]
    return stamps, samples, rates


@pytest.mark.parametrize("change", [clip, lose(3), lose(4), lose(30), lose(100), spoil, stick])
@pytest.mark.parametrize("sensor", ["head", "seat"])
def test_a_mask_of_the_vertical_masks_the_other_channels(sensor: str, change) -> None:
    streams = changed(of_model(noisy_streams(9.0)), sensor, change)
    found = recorder()
    for name, stream in streams.items():
        found.push(name, stream.stamps_ns, stream.accel_mps2, stream.rates_radps)
    for recording in found.finish():
        assert set(recording.channels) == set(SENSORS)
        for k, name in enumerate(MEASURED_SEGMENTS):
            channels, masked = recording.channels[name], np.isnan(recording.measured_mps2[:, k])
            for column in (*channels.horizontal_mps2.T, *channels.rates_radps.T):
                np.testing.assert_array_equal(np.isnan(column), masked)
        seat = recording.channels["seat"]
        masked = np.isnan(seat.horizontal_mps2[:, 0])
        for column in (*seat.horizontal_mps2.T, *seat.rates_radps.T):
            np.testing.assert_array_equal(np.isnan(column), masked)
        assert np.isnan(recording.measured_mps2[masked]).all()
        assert masked.any() == any(line.startswith("seat: invalid samples") for line in recording.warnings)


def test_channels_change_nothing_else() -> None:
    streams = changed(of_model(), "head", clip)
    plain = Recorder("road", "drive")
    for name, stream in streams.items():
        plain.push(name, stream.stamps_ns, stream.accel_mps2, stream.rates_radps)
    (without,) = plain.finish()
    assert without.channels == {}
    same(dataclasses.replace(recorded(streams, keep_lean=False), channels={}), without)


@pytest.mark.parametrize(("lost", "is_masked"), [(1, False), (3, False), (4, True), (80, True)])
def test_a_gap_of_the_gyro_alone_masks_the_gyro_alone(lost: int, is_masked: bool) -> None:
    streams = everywhere(mounted(turned("ZX", 20.0, 8.0)))
    good = recorded(streams)

    def gap(stamps, samples, rates):
        return stamps, samples, np.where((np.arange(len(rates)) // lost == 4000 // lost)[:, None], np.nan, rates)

    recording = recorded(changed(streams, "head", gap))
    np.testing.assert_array_equal(recording.measured_mps2, good.measured_mps2)
    head, whole = recording.channels["head"], good.channels["head"]
    np.testing.assert_array_equal(head.horizontal_mps2, whole.horizontal_mps2)
    masked = np.isnan(head.rates_radps[:, 0]) & ~np.isnan(whole.rates_radps[:, 0])
    assert masked.any() == is_masked
    assert masked.sum() <= is_masked * (lost + 2 * REACH + 12)
    # Effects take what is masked as zero, so it is said.
    said = [line for line in recording.warnings if "angular rates" in line]
    assert len(said) == (masked.sum() > REPORTED_S * recording.rate_hz)
    assert all(line.startswith("head: no angular rates in 0.") for line in said)
    # A bridge of 3.5 ms over 3.3 Hz errs by (pi f gap)^2 / 2 = 0.07 %.
    np.testing.assert_allclose(head.rates_radps[~masked], whole.rates_radps[~masked], atol=1e-3)


@pytest.mark.parametrize("wild", [np.nan, np.inf, 1e6, 1e300])
def test_an_impossible_angular_rate_counts_as_lost(wild: float) -> None:
    streams = everywhere(mounted(turned("ZX", 20.0, 8.0)))
    good = recorded(streams).channels["seat"].rates_radps

    def spike(stamps, samples, rates):
        return stamps, samples, np.where(np.arange(rates.size).reshape(-1, 3) == 3 * 4000 + 1, wild, rates)

    np.testing.assert_allclose(recorded(changed(streams, "seat", spike)).channels["seat"].rates_radps, good, atol=1e-3)


def test_a_horizontal_level_is_subtracted_like_a_vertical_one() -> None:
    streams = everywhere(mounted(turned("Z", 0.0)))
    good = recorded(streams).channels["head"].horizontal_mps2

    def lean(stamps, samples, rates):
        return stamps, samples + np.where(TIME_S > 0.9, 0.5, 0.0)[:, None] * [1.0, -2.0, 0.0], rates

    leant = changed(streams, "head", lean)
    later = slice(round(0.2 * RATE_HZ), -REACH - 10)
    found = recorded(leant).channels["head"].horizontal_mps2
    np.testing.assert_allclose(found[later], good[later], atol=1e-3)
    one, other = (recorded(each, keep_level=True).channels["head"].horizontal_mps2 for each in (leant, streams))
    np.testing.assert_allclose((one - other)[later], np.broadcast_to([0.5, -1.0], one[later].shape), atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_block_cuts_and_interleaving_never_change_a_bit(seed: int) -> None:
    streams = changed(changed(of_model(), "head", lose(20)), "seat", clip)
    whole, rng, queues = recorded(streams), np.random.default_rng(seed), {}
    for name, stream in streams.items():
        cuts = [0, *sorted(rng.choice(len(stream.stamps_ns), 20, replace=False).tolist()), len(stream.stamps_ns)]
        queues[name] = [slice(*ends) for ends in pairwise(cuts)]
    cut = recorder()
    while waiting := [name for name, queue in queues.items() if queue]:
        name = str(rng.choice(waiting))
        part, stream = queues[name].pop(0), streams[name]
        cut.push(name, stream.stamps_ns[part], stream.accel_mps2[part], stream.rates_radps[part])
    (found,) = cut.finish()
    same(found, whole)


def repeat(stamps, samples):
    rows = np.sort(np.concatenate([np.arange(len(stamps)), np.arange(0, len(stamps), 3)]))
    return stamps[rows], samples[rows]


def out_of_order(stamps, samples):
    rows = np.arange(len(stamps))
    rows[1500::50], rows[1501::50] = rows[1501::50].copy(), rows[1500::50].copy()
    return stamps[rows], samples[rows]


def quantised(stamps, samples):
    return stamps - (stamps - START_NS) % 4_000_000, samples


def unset_first(stamps, samples):
    return np.concatenate([np.zeros(7, dtype=np.int64), stamps]), np.concatenate([samples[:7] + 1.0, samples])


def another_lap(stamps, samples):
    """Three seconds of wild motion whose stamps come again, when time leaps back."""
    wild = samples[:3000] + np.random.default_rng(1).normal(size=(3000, 3))
    return np.concatenate([stamps[:3000], stamps]), np.concatenate([wild, samples])


def holes(stamps, samples):
    samples[4500:4502] = np.nan
    rows = slice(5000, 5003)
    return np.delete(stamps, rows), np.delete(samples, rows, axis=0)


@pytest.mark.parametrize("change", [repeat, out_of_order, quantised, unset_first, another_lap, holes])
def test_rates_stay_with_the_samples_they_came_with(change) -> None:
    """A gyro with the samples of the accelerometer ends where that ends, for any stamps."""
    streams = of_model()
    stamps, samples = change(streams["head"].stamps_ns.copy(), streams["head"].accel_mps2.copy())
    streams["head"] = Stream(stamps, samples, samples)
    recording = recorded(streams, keep_level=True)
    head = recording.channels["head"]
    vertical = recording.measured_mps2[:, MEASURED_SEGMENTS.index("head")]
    assert np.isfinite(vertical).mean() > 0.9
    difference = head.rates_radps - np.column_stack([head.horizontal_mps2, vertical])
    np.testing.assert_array_equal(np.isnan(difference[:, 0]), np.isnan(vertical))
    assert np.nanstd(difference, axis=0).max() < 1e-10
    # Of several samples with the first stamp at rest, the bias may miss some: 3 of 900, of noise of 0.05 m/s^2.
    assert np.nanmax(np.abs(difference)) < (5e-4 if change in (quantised, repeat) else 1e-10)


# --- no gyro ---------------------------------------------------------------------------------------------------------


def silent_at_rest(rates: Floats) -> Floats:
    return np.where((TIME_S < 1.2)[:, None], np.nan, rates)


NONE, NO_BIAS = "head: no angular rates in the record", "head: no angular rates at rest, so their bias is unknown"


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        (lambda rates: None, NONE),
        (np.zeros_like, NONE),
        (lambda rates: np.full(rates.shape, np.nan), NONE),
        (lambda rates: np.full(rates.shape, np.inf), NONE),
        (lambda rates: np.where(np.arange(3 * len(rates)).reshape(-1, 3) % 2, 0.0, np.nan), NONE),
        (lambda rates: np.full(rates.shape, 131.0), NONE),
        (silent_at_rest, NO_BIAS),
    ],
)
def test_without_a_gyro_there_are_no_rates(change, warning: str) -> None:
    streams = everywhere(mounted(turned("Z", 0.0)))
    good = recorded(streams)
    recording = recorded(changed(streams, "head", lambda t, x, rates: (t, x, change(rates))))
    assert recording.channels["head"].rates_radps is None
    assert [line for line in recording.warnings if line.startswith(warning)]
    np.testing.assert_array_equal(recording.channels["head"].horizontal_mps2, good.channels["head"].horizontal_mps2)
    assert recording.channels["neck"].rates_radps is not None


def test_a_missing_sensor_has_channels_without_numbers() -> None:
    streams = everywhere(mounted(turned("Z", 0.0)))
    del streams["neck"]
    neck = recorded(streams).channels["neck"]
    assert neck.rates_radps is None
    assert np.isnan(neck.horizontal_mps2).all()


def test_rates_that_do_not_fit_their_samples_are_refused() -> None:
    with pytest.raises(InputError, match=r"seat: rates of shape \(4, 3\), samples have \(5, 3\)"):
        recorder().push("seat", np.arange(5), np.zeros((5, 3)), np.zeros((4, 3)))


# --- bags ------------------------------------------------------------------------------------------------------------


def bag_of(path: Path, streams: Streams, without_gyro: str = "") -> Path:
    """Streams as a bag; the covariance of one sensor marks a missing gyro, for any values."""
    with BagWriter(path) as writer:
        for name, stream in streams.items():
            payload = encode_imu(stream.stamps_ns, stream.accel_mps2, stream.rates_radps, "imu")
            if name == without_gyro:
                payload[:, -168:-160] = np.frombuffer(np.float64(-1.0).tobytes(), dtype=np.uint8)
            writer.add_topic(INPUT[name], IMU_TYPE)
            writer.write(INPUT[name], stream.stamps_ns, payload)
    return path


def test_angular_rates_of_a_bag_are_read_on_request(tmp_path: Path) -> None:
    streams = of_model(noisy_streams(4.0))
    bag = bag_of(tmp_path / "road.mcap", streams)
    (found,) = read_recordings(bag, options=RecordingOptions(channels=True))
    direct = recorded(streams, keep_lean=False)
    same(dataclasses.replace(found, warnings=direct.warnings), direct)
    (plain,) = read_recordings(bag)
    assert plain.channels == {}
    np.testing.assert_array_equal(plain.measured_mps2, found.measured_mps2)


def test_a_covariance_in_a_bag_marks_a_missing_gyro(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "road.mcap", of_model(noisy_streams(4.0)), without_gyro="pelvis")
    (found,) = read_recordings(bag, options=RecordingOptions(channels=True))
    assert [name for name, channels in found.channels.items() if channels.rates_radps is None] == ["pelvis"]
    assert "pelvis: no angular rates in the record" in found.warnings


def test_a_seat_without_a_gyro_does_not_pitch(tmp_path: Path) -> None:
    """The other reader of rates: `biodyn simulate --seat`."""
    streams = of_model(noisy_streams(4.0))
    pitching = read_seat_motion(bag_of(tmp_path / "a.mcap", streams), None, {})
    still = read_seat_motion(bag_of(tmp_path / "b.mcap", streams, without_gyro="seat"), None, {})
    assert pitching.pitch_rate_radps.std() > 0.002
    assert not still.pitch_rate_radps.any()
    np.testing.assert_array_equal(still.accel_mps2, pitching.accel_mps2)


def test_a_seat_motion_with_invalid_readings_is_refused(tmp_path: Path) -> None:
    def spoil(stamps, samples, rates):
        samples[[5, 7], 2] = np.nan
        return stamps, samples, rates

    streams = changed(of_model(noisy_streams(4.0)), "seat", spoil)
    with pytest.raises(InputError, match=r"imu/seat/data: 2 samples are not finite"):
        read_seat_motion(bag_of(tmp_path / "a.mcap", streams), None, {})


# --- a world that is not ours ----------------------------------------------------------------------------------------


RATES_PER_UNIT = 25.0
"""The world has no gyros: its accelerometers are read in units of 1/25 rad/s, so noise and bias are 0.002 rad/s."""


def worn(imu: sensors.Imu, accel: Floats, rates: Floats, seed: int) -> Stream:
    """A sensor of that world, accelerations and rates on one clock: the same draws, twice."""
    stamps, force = imu.stream(accel, seats.RATE_HZ, np.random.default_rng(seed))
    again, reading = imu.stream(RATES_PER_UNIT * rates, seats.RATE_HZ, np.random.default_rng(seed))
    np.testing.assert_array_equal(stamps, again)
    gravity = imu.axes @ [0.0, 0.0, sensors.GRAVITY_MPS2]
    return Stream(START_NS + stamps, force, (reading - gravity) / RATES_PER_UNIT)


@pytest.mark.parametrize("case", ["road", "pothole", "rail"])
def test_the_seat_of_the_independent_simulation_is_recovered(case: seats.Case) -> None:
    """Low-passed truth of the seat against the recovered motion, each sensor turned by its own unknown yaw."""
    rng = np.random.default_rng(11)
    quiet = np.zeros((round(2.5 * seats.RATE_HZ), 3))
    accel = np.concatenate([quiet, seats.motion(case, "synthetic", 6.0, rng).accel_mps2, quiet])
    slow = signal.butter(2, 5.0, fs=seats.RATE_HZ, output="sos")
    # A car pitches with its bumps, and a little otherwise.
    pitch = 0.02 * signal.sosfiltfilt(slow, accel[:, 2]) + 0.01 * accel[:, 0]
    rates = np.column_stack([0.3 * pitch, pitch, 0.1 * pitch])
    low = signal.butter(4, 100.0, fs=seats.RATE_HZ, output="sos")
    truth = signal.sosfiltfilt(low, np.column_stack([accel, rates]), axis=0)
    imus = {name: sensors.drawn(rng) for name in SENSORS}
    recording = recorded({name: worn(imu, accel, rates, k) for k, (name, imu) in enumerate(imus.items())})
    at_s = 1e-9 * (recording.stamps_ns - START_NS)
    expected = interpolate.CubicSpline(np.arange(len(truth)) / seats.RATE_HZ, truth)(at_s)
    up, ahead, pitching = expected[:, 2].std(), expected[:, :2].std(), expected[:, 4].std()
    # White noise of 0.05 m/s^2 and 0.002 rad/s over 565 Hz, of which 100 Hz are left. A bias of 0.05 m/s^2 leans the
    # vertical by 5 mrad, and clocks are 0.2 ms off, 2 % at 15 Hz: three times either. The bias of 900 samples at rest.
    noise, rate_noise = 1.05 * 0.05 * np.sqrt(100.0 / 565.0), 1.05 * 0.002 * np.sqrt(100.0 / 565.0)
    for name, imu in imus.items():
        level = Rotation.from_euler("Z", np.arctan2(imu.axes[0, 1], imu.axes[0, 0])).inv().as_matrix()
        channels = recording.channels[name]
        inside = ~np.isnan(channels.horizontal_mps2[:, 0])
        error = channels.horizontal_mps2[inside] - (expected[inside, :3] @ level.T)[:, :2]
        assert (error.std(axis=0) < np.sqrt(noise**2 + (0.015 * up) ** 2 + (0.06 * ahead) ** 2)).all()
        error = channels.rates_radps[inside] - expected[inside, 3:] @ level.T
        assert (error.std(axis=0) < np.sqrt(rate_noise**2 + (0.06 * pitching) ** 2)).all()
        assert (np.abs(error.mean(axis=0)) < 4.0 * 0.002 / np.sqrt(900.0)).all()


# --- a real car ------------------------------------------------------------------------------------------------------


def test_turns_and_braking_of_a_real_car_match_its_speed(shared_data: Path) -> None:
    """Forward, right, down on a windscreen: x is forward, so y is left, and in a bend its acceleration is v times r.

    At 104 Hz it is no recording, so it is raised to 1129 Hz, which adds nothing. Below 0.5 Hz, where camber and grades
    of the road show as well; their share is why it is no better.
    """
    values, rate_hz, speed_mps = recordings.comma_turning(shared_data)
    count = round(58.0 * seats.RATE_HZ)
    samples = seats.raised(values, rate_hz, count)[::4]
    at_s = 4.0 * np.arange(len(samples)) / seats.RATE_HZ
    stamps = START_NS + np.rint(1e9 * at_s).astype(np.int64)
    car = Stream(stamps, np.ascontiguousarray(samples[:, :3]), samples[:, 3:])
    recording = recorded(dict.fromkeys(("seat", "head"), car), keep_level=True)
    slow = signal.butter(2, 0.5, fs=recording.rate_hz, output="sos")
    seat, at_s = recording.channels["seat"], 1e-9 * (recording.stamps_ns - START_NS)
    ahead, left = signal.sosfiltfilt(slow, seat.horizontal_mps2, axis=0).T
    yaw = signal.sosfiltfilt(slow, seat.rates_radps[:, 2])
    speed = signal.sosfiltfilt(slow, np.interp(at_s, np.arange(len(speed_mps)) / rate_hz, speed_mps))
    for expected, found in ((speed * yaw, left), (np.gradient(speed, at_s), ahead)):
        assert np.corrcoef(expected, found)[0, 1] > 0.65
        assert np.polyfit(expected, found, 1)[0] == pytest.approx(1.0, abs=0.2)


def test_values_that_are_all_unknown_are_interpolated_as_zero() -> None:
    values = np.array([[np.nan, 1.0], [2.0, np.nan]])
    np.testing.assert_array_equal(interpolated(np.arange(2.0), values), np.zeros((2, 2)))
    np.testing.assert_array_equal(
        interpolated(np.arange(3.0), np.array([[1.0], [np.nan], [3.0]])), [[1.0], [2.0], [3.0]]
    )
