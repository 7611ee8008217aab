"""Rails below the set limit: sensors whose range is known by construction, and real ones that never reach theirs."""

from __future__ import annotations

import dataclasses
import io
import re
import tarfile
from pathlib import Path

import numpy as np
import pytest
import recordings
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal
from streams import START_NS, in_turn, info, noisy_streams, run, subject, write_bag

from biodyn_core.base.segments import MEASURED_SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.synthesis import ImuStream
from biodyn_core.conditioning.conditioner import Conditioner, ConditioningSettings
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.recording.recording import Recorder
from biodyn_ros.base.topics import INPUT
from biodyn_ros.node.health import WARN, SensorHealth, sensor_status
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.replay.replaying import replay

Floats = NDArray[np.float64]

TWO_G = 19.6
"""The limit of a sensor of 2 g."""

TWO_G_STEP = TWO_G / 2**15

LSM9DS1_STEP = 0.061e-3 * STANDARD_GRAVITY_MPS2
"""Of the tram's sensor at 2 g, by its data sheet; its readings are 16-bit numbers."""

ANY_STEP = st.floats(np.log(0.0006), np.log(0.08)).map(lambda log_step: float(np.exp(log_step)))
"""From 16 bits over 2 g to 12 bits over 16 g."""


def motion(seed: int, seconds: float, rate_hz: float, rms_mps2: float, up_to_hz: float) -> Floats:
    """Band-limited Gaussian motion (n, 3) with gravity, behind a second at rest; the sensor's own noise on all axes."""
    rng = np.random.default_rng(seed)
    sos = signal.butter(4, up_to_hz, fs=rate_hz, output="sos")
    moving = signal.sosfilt(sos, rng.standard_normal((round(seconds * rate_hz), 3)), axis=0)
    moving *= rms_mps2 / moving.std()
    accel = np.concatenate([np.zeros((round(1.2 * rate_hz), 3)), moving])
    return accel + [0.0, 0.0, STANDARD_GRAVITY_MPS2] + 0.02 * rng.standard_normal(accel.shape)


def read_by_sensor(accel: Floats, step_mps2: float, range_mps2: float = np.inf) -> Floats:
    """The readings of a sensor of this step and range."""
    limit = np.floor(range_mps2 / step_mps2)
    return np.clip(np.rint(accel / step_mps2), -limit, limit) * step_mps2


def at_limit(samples: Floats, step_mps2: float, range_mps2: float) -> Floats:
    """Whether each sample has an axis at the end of the range."""
    return (np.abs(samples) > (np.floor(range_mps2 / step_mps2) - 0.5) * step_mps2).any(axis=1)


def conditioned(samples: Floats, rate_hz: float = 1000.0, cuts: tuple[int, ...] = ()) -> Conditioner:
    """A sensor's samples at an even rate, cut into blocks."""
    stamps_ns = START_NS + np.rint(np.arange(len(samples)) * 1e9 / rate_hz).astype(np.int64)
    sensor = Conditioner("seat", ConditioningSettings(rest_patience_s=1.0))
    for first, end in zip((0, *cuts), (*cuts, len(samples)), strict=True):
        sensor.push(stamps_ns[first:end], samples[first:end])
    sensor.finish()
    return sensor


def rail_warnings(warnings) -> list[str]:
    return [line for line in warnings if "own limit" in line]


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), ANY_STEP, st.floats(14.0, 30.0), st.floats(15.0, 60.0), st.floats(2.0, 6.0))
def test_a_sensor_that_rails_is_found_and_one_that_does_not_never_is(seed, step, end, up_to_hz, rms):
    accel = motion(seed, 12.0, 1000.0, rms, up_to_hz)
    free = conditioned(read_by_sensor(accel, step)).status()
    assert free.clipped == 0 and not rail_warnings(free.warnings)
    samples = read_by_sensor(accel, step, end)
    ends = np.array([side * axis > (np.floor(end / step) - 0.5) * step for axis in samples.T for side in (1, -1)])
    status = conditioned(samples).status()
    assert status.clipped <= ends.any(axis=0).sum()
    is_fast = rms * 2.0 * np.pi * up_to_hz / 1000.0 > 20.0 * step  # by rms, at a rail it is slower
    if is_fast and not any(0 < count < 200 for count in ends.sum(axis=1)):
        assert status.clipped == ends.any(axis=0).sum()
        assert bool(rail_warnings(status.warnings)) == ends.any()


@settings(max_examples=24)
@given(
    st.integers(0, 2**32 - 1), st.one_of(st.just(0.0), ANY_STEP, st.sampled_from([0.16, 0.6, 1.2])),
    st.sampled_from(["sine", "sweep", "beat", "half-sines", "white", "looped", "held", "lost"]), st.floats(3.0, 60.0),
    st.sampled_from([3.0, 7.3, 50.0, 100.0, 100.01, 71.43, 333.3]), st.booleans(),
)  # fmt: skip
def test_turning_points_of_a_motion_are_no_rail(seed, step, kind, size, frequency_hz, is_noisy):
    rng = np.random.default_rng(seed)
    t = np.arange(8000) / 1000.0
    up = {
        "sine": lambda: np.sin(2 * np.pi * frequency_hz * t + rng.uniform(0, 6)),
        "sweep": lambda: np.sin(2 * np.pi * np.cumsum(np.linspace(1.0, frequency_hz, t.size)) / 1000.0),
        "beat": lambda: np.sin(2 * np.pi * frequency_hz * t) * np.sin(0.4 * np.pi * t),
        "half-sines": lambda: np.sin(np.pi * (t % 0.25) / 0.03) * (t % 0.25 < 0.03),
        "white": lambda: 0.3 * rng.standard_normal(t.size),
        "looped": lambda: np.tile(motion(seed, 0.4, 1000.0, 0.3, 40.0)[-400:, 0], 20),
        "held": lambda: np.repeat(motion(seed, 8.0, 250.0, 0.3, 40.0)[-2000:, 0], 4),
        "lost": lambda: motion(seed, 8.0, 1000.0, 0.3, 40.0)[-8000:, 0],
    }[kind]()
    period = {"looped": 400, "held": 4}
    beside = (0.05 if is_noisy else 0.0) * rng.standard_normal((8000, 2))
    if kind == "looped":
        beside = np.tile(beside[:400], (20, 1))
    if kind == "held":
        beside = np.repeat(beside[::4], 4, axis=0)
    assert kind not in period or not (8000 % period[kind])
    samples = np.zeros((9200, 3))
    samples[1200:, 2], samples[1200:, :2] = size * up, beside
    samples[:, 2] += STANDARD_GRAVITY_MPS2
    samples = read_by_sensor(samples, step) if step else samples
    if kind == "lost":
        samples[rng.random(9200) < 0.03] = np.nan
    status = conditioned(samples).status()
    assert not rail_warnings(status.warnings)
    assert status.clipped == (np.abs(samples[1000:]) >= 156.8).any(axis=1).sum()


def every_real_motion(data: Path):
    """Name, stamps and accelerations of every real recording that is no bag."""
    for name in ("L3_StnVinohrady_Riazanska.csv", "L20_3014_Zaluhy_Drobneho.csv", "L35_1915_Most_Kutiky_neutral.csv"):
        yield name, *recordings.tram(data, name)
    for read in (recordings.baja, recordings.android, recordings.parachute, recordings.comma):
        yield read.__name__, *read(data)
    with tarfile.open(data / "gonzalez_road_events_50hz" / "gonzalez_2017.tar.gz") as archive:
        for member in archive.getmembers():
            file = archive.extractfile(member) if member.name.endswith(".csv") else None
            if file:
                accel = np.zeros((len(up := np.loadtxt(io.TextIOWrapper(file), skiprows=1)), 3))
                accel[:, 2] = up
                yield member.name, START_NS + np.arange(len(up)) * 20_000_000, accel


def test_real_recordings_within_their_range_have_no_rail(shared_data: Path):
    count = 0
    for name, stamps_ns, accel in every_real_motion(shared_data):
        sensor = Conditioner("seat", ConditioningSettings(rest_patience_s=0.2, rest_s=0.2), "survey")
        for lap in range(3):
            sensor.push(stamps_ns + lap * (stamps_ns[-1] - stamps_ns[0] + 10_000_000), accel)
        sensor.finish()
        assert not rail_warnings(sensor.status().warnings), name
        count += 1
    assert count == 507


def test_a_real_tram_ride_that_is_five_times_as_rough_rails_where_its_sensor_ends(shared_data: Path):
    _, accel = recordings.tram(shared_data, "L3_StnVinohrady_Riazanska.csv")
    rough = accel.mean(axis=0) + 5.0 * (accel - accel.mean(axis=0))
    samples = read_by_sensor(rough, LSM9DS1_STEP, 2**15 * LSM9DS1_STEP)
    status = conditioned(samples, 500.0).status()
    assert status.clipped == at_limit(samples, LSM9DS1_STEP, 2**15 * LSM9DS1_STEP).sum() > 300
    (line,) = rail_warnings(status.warnings)
    assert line.startswith(f"{status.clipped} readings lie at the sensor's own limit of +19.60")
    assert "(below saturation_mps2 156.8)" in line


@pytest.mark.parametrize("seed", [1, 2])
def test_block_cuts_never_change_a_count(seed):
    samples = read_by_sensor(motion(seed, 4.0, 1000.0, 6.0, 40.0), 0.01, TWO_G)
    samples[3000:3003] = np.nan
    rng = np.random.default_rng(seed)
    whole = conditioned(samples)
    for cuts in (tuple(range(1, len(samples))), tuple(sorted(rng.choice(len(samples), 40, replace=False).tolist()))):
        cut = conditioned(samples, cuts=cuts)
        assert cut.status() == whole.status()
        np.testing.assert_array_equal(cut.clipping().samples, whole.clipping().samples)
    assert whole.status().clipped == at_limit(samples, 0.01, TWO_G).sum() > 100


def ramp_to_limit(stays: int, readings: int, limit: float = TWO_G) -> Floats:
    """Stays of some readings at a limit, each entered from elsewhere, behind levels below it; the other axes live."""
    rng = np.random.default_rng(0)
    rows = [
        np.full(1000, STANDARD_GRAVITY_MPS2),
        np.linspace(12.5, limit - 0.05, 300),
        np.linspace(limit - 2.0, 0.0, 40),
    ]
    for k in range(stays):
        rows += [np.full(1, limit - 4.0 * 1.04**k), np.full(readings, limit), np.zeros(3)]
    up = np.concatenate(rows)
    return np.column_stack([0.05 * rng.standard_normal((len(up), 2)), up])


def test_a_rail_needs_enough_readings():
    assert conditioned(ramp_to_limit(1, 9)).status().clipped == 0
    assert conditioned(ramp_to_limit(1, 10)).status().clipped == 10  # one shock
    assert conditioned(ramp_to_limit(8, 2)).status().clipped == 0
    assert conditioned(ramp_to_limit(9, 2)).status().clipped == 18  # nine of them
    assert conditioned(ramp_to_limit(33, 1)).status().clipped == 0
    assert conditioned(ramp_to_limit(34, 1)).status().clipped == 34  # single samples, as each next level was read once


@pytest.mark.parametrize(
    "spoil",
    [
        lambda samples: samples * [0.0, 0.0, 1.0],  # no other axis moves: held, or sent again
        lambda samples: np.repeat(samples[:1340], 1, axis=0),  # nothing lies there
        lambda samples: samples * 0.6,  # no range ends so close to gravity
    ],
)
def test_readings_that_are_no_evidence_do_not_count(spoil):
    assert conditioned(spoil(ramp_to_limit(1, 40))).status().clipped == 0


def test_a_stay_behind_a_gap_is_no_evidence():
    samples = ramp_to_limit(1, 40)
    samples[1340:1342] = np.nan
    assert conditioned(samples).status().clipped == 0


def test_a_sample_at_two_rails_counts_once():
    samples = ramp_to_limit(9, 3)
    samples[:, 0] = -samples[:, 2] * (samples[:, 2] > 12.0)
    status = conditioned(samples).status()
    (line,) = rail_warnings(status.warnings)
    assert status.clipped == 27 and line.startswith("27 readings lie at the sensor's own limit of +19.60 and -19.60 m")


def test_a_reading_beyond_disproves_a_rail():
    samples = ramp_to_limit(9, 3)
    whole, beyond = conditioned(samples), conditioned(np.concatenate([samples, [[0.0, 0.0, TWO_G + 0.1]]]))
    assert whole.status().clipped == 27
    assert beyond.status().clipped == 0 and not rail_warnings(beyond.status().warnings)


def test_samples_beyond_the_set_limit_are_counted_once():
    samples = ramp_to_limit(9, 3, limit=160.0)
    status = conditioned(samples).status()
    assert status.clipped == (samples[:, 2] >= 156.8).sum() and not rail_warnings(status.warnings)


# --- through the pipeline, and into files ----------------------------------------------------------------------------


def of_two_g(stream: ImuStream) -> ImuStream:
    """The stream of a sensor that has 16 bits over 2 g."""
    return dataclasses.replace(stream, accel_mps2=read_by_sensor(stream.accel_mps2, TWO_G_STEP, TWO_G))


def railing(streams: tuple[ImuStream, ...], sensor: str) -> tuple[tuple[ImuStream, ...], Floats]:
    """The streams, one sensor of which has 16 bits over 2 g, and which of its samples lie at an end of that."""
    changed = tuple(of_two_g(one) if one.sensor == sensor else one for one in streams)
    (samples,) = (one.accel_mps2 for one in changed if one.sensor == sensor)
    return changed, at_limit(samples, TWO_G_STEP, TWO_G)


SHOCKS = "rail"


def test_live_replay_and_info_count_the_same_and_figures_are_lower_bounds(tmp_path: Path):
    streams, railed = railing(noisy_streams(6.0, SHOCKS, 3), "seat")
    bag = write_bag(tmp_path / "bag.mcap", streams)
    document = replay(bag, subject()).document
    seat = document["sensors"]["seat"]
    assert seat["clipped_samples"] == railed.sum() > 20
    assert seat["lower_bound"] and seat["aw_lower_bound"] and document["seat"]["lower_bound"]
    assert not document["sensors"]["head"]["aw_lower_bound"]
    assert document["seat"]["withheld"] == f"{railed.sum()} samples are clipped at the seat"
    line = re.compile(r"seat: \d+ readings lie at the sensor's own limit of \+19\.60 and -19\.60 m/s\^2 \(below")
    assert any(line.match(warning) for warning in document["warnings"])
    live = run(streams, in_turn(streams, 23)).pipeline
    assert live.losses("seat").clipped == railed.sum()
    health = SensorHealth()
    health.arrived()
    shown = sensor_status("seat", health, live)
    assert shown.level == WARN and "own limit" in shown.message and shown.values["lower_bound"] == "true"
    seen = info(bag, ReadingOptions())
    assert next(row for row in seen["topics"] if row["topic"] == INPUT["seat"].lstrip("/"))["clipped"] == railed.sum()
    assert any(line.match(warning) for warning in seen["warnings"])


def test_clipped_samples_since_reset_are_counted_though_the_rail_is_found_later():
    samples = ramp_to_limit(9, 2)
    stamps_ns = START_NS + np.arange(len(samples)) * 1_000_000
    reset_at = 1340 + 5 * 6  # five stays lie before it
    pipeline = Pipeline(subject())
    pipeline.push("seat", stamps_ns[:reset_at], samples[:reset_at])
    assert pipeline.losses("seat").clipped == 0
    pipeline.reset()
    pipeline.push("seat", stamps_ns[reset_at:], samples[reset_at:])
    assert pipeline.status("seat").clipped == 18 and pipeline.losses("seat").clipped == 8
    pipeline.reset()
    assert pipeline.losses("seat").clipped == 0 and not pipeline.losses("seat").lower_bound
    pipeline.push("seat", stamps_ns[-1:] + 1_000_000, np.array([[0.0, 0.0, TWO_G + 0.1]]))
    assert pipeline.status("seat").clipped == 0 == pipeline.losses("seat").clipped


def test_a_recording_masks_samples_at_a_rail():
    streams, railed = railing(noisy_streams(6.0, SHOCKS, 3), "lower_torso")
    recorder = Recorder("rail", "drive")
    for stream in streams:
        recorder.push(stream.sensor, stream.stamps_ns, stream.accel_mps2)
    (recording,) = recorder.finish()
    (stamps_ns,) = (stream.stamps_ns for stream in streams if stream.sensor == "lower_torso")
    column = recording.measured_mps2[:, MEASURED_SEGMENTS.index("lower_torso")]
    inside = stamps_ns[railed & (stamps_ns > recording.stamps_ns[0]) & (stamps_ns < recording.stamps_ns[-1])]
    assert inside.size > 20
    assert np.isnan(column[np.searchsorted(recording.stamps_ns, inside)]).all()
    assert np.isfinite(column).mean() > 0.3
    assert f"lower_torso: {railed.sum()} samples clipped, masked" in recording.warnings
    assert rail_warnings(recording.warnings)
