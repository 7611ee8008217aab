"""Six IMU streams for tests of pipeline and nodes, as bags and through the pipeline; some by another integrator."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from naive import STRETCH
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from scipy.integrate import solve_ivp

from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.model import MOTION_COLUMNS, Chain
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis import ImuStream, SensorSettings, imu_streams, load_case
from biodyn_core.pipeline.exposure import Exposure
from biodyn_core.pipeline.frames import PredictedFrames
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.bag.cdr import ACCEL_STAMPED_TYPE, IMU_TYPE, encode_imu
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.topics import INPUT
from biodyn_ros.info.document import info_document
from biodyn_ros.info.report import Report, info_of
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.simulate import motion_of_cases, simulate_bag

RATE_HZ = 1129.3
START_NS = 1_767_225_600 * 10**9
PERFECT = SensorSettings(
    tilt_deg=0.0,
    noise_mps2=0.0,
    bias_mps2=0.0,
    gyro_noise_radps=0.0,
    clock_offset_ms=0.0,
    clock_drift_ppm=0.0,
    jitter_ms=0.0,
)


@cache
def subject() -> Subject:
    """The paper's first subject."""
    return load_subject(subject_file("subject_1"))


@cache
def noisy_streams(seconds: float = 3.0, case: str = "pothole", seed: int = 5) -> tuple[ImuStream, ...]:
    """Streams with every sensor error on."""
    rng = np.random.default_rng(seed)
    return tuple(imu_streams(subject(), load_case(case, seconds, rng), rng, start_ns=START_NS))


def simulated(folder: Path, seconds: float, cases: dict[str, str]) -> dict[str, Path]:
    """Bags of the first subject by name, one load case each, their seeds counted from 1."""
    bags = {name: folder / f"{name}.mcap" for name in cases}
    for seed, (name, case) in enumerate(cases.items(), 1):
        simulate_bag(bags[name], subject(), motion_of_cases([case], seconds, seed), seed, SensorSettings())
    return bags


def write_bag(path: Path, streams: Iterable[ImuStream]) -> Path:
    """A bag of streams on the topics of their sensors, logged as they are stamped."""
    with BagWriter(path) as writer:
        for stream in streams:
            writer.add_topic(INPUT[stream.sensor], IMU_TYPE)
            messages = encode_imu(stream.stamps_ns, stream.accel_mps2, stream.gyro_radps, "imu")
            writer.write(INPUT[stream.sensor], stream.stamps_ns, messages)
    return path


def predicted_frames(stamps_ns: NDArray[np.int64], accel_mps2: NDArray[np.float64]) -> PredictedFrames:
    """Predictions of a body that does not move in the seat."""
    return PredictedFrames(stamps_ns, accel_mps2, np.zeros((len(stamps_ns), MOTION_COLUMNS)))


@dataclass(frozen=True, eq=False)
class Run:
    """All frames of one run, joined, and its figures."""

    predicted_ns: np.ndarray
    predicted: np.ndarray
    motion: np.ndarray
    measured_ns: np.ndarray
    measured: np.ndarray
    exposure: Exposure
    pipeline: Pipeline


def run(
    streams: tuple[ImuStream, ...],
    order: list[tuple[str, int, int]],
    finish: bool = True,
    pipeline: Pipeline | None = None,
) -> Run:
    """Push the cuts (sensor, first, end) in the order given."""
    by_name = {stream.sensor: stream for stream in streams}
    pipeline = pipeline or Pipeline(subject())
    frames = [pipeline.push(n, by_name[n].stamps_ns[a:b], by_name[n].accel_mps2[a:b]) for n, a, b in order]
    if finish:
        frames.append(pipeline.finish())
    return Run(
        np.concatenate([f.predicted.stamps_ns for f in frames]),
        np.concatenate([f.predicted.accel_mps2 for f in frames]),
        np.concatenate([f.predicted.motion for f in frames]),
        np.concatenate([f.measured.stamps_ns for f in frames]),
        np.concatenate([f.measured.accel_mps2 for f in frames]),
        pipeline.exposure(),
        pipeline,
    )


def quantised(stamps_ns: NDArray[np.int64], quantum_ms: int) -> NDArray[np.int64]:
    """Stamps (n,) ns of a clock that advances in steps."""
    return stamps_ns // (quantum_ms * 10**6) * (quantum_ms * 10**6)


def in_bursts(stamps_ns: NDArray[np.int64], size: int, step_ms: float) -> NDArray[np.int64]:
    """Stamps (n,) ns of a driver that sends samples in bursts, and stamps them then, so far apart."""
    within = np.arange(stamps_ns.size) % size
    first = np.arange(stamps_ns.size) - within
    return stamps_ns[first] + np.rint(1e6 * step_ms * within).astype(np.int64)


def in_turn(streams: tuple[ImuStream, ...], size: int = 280) -> list[tuple[str, int, int]]:
    """Blocks of one size, the sensors taking turns."""
    longest = max(len(stream.stamps_ns) for stream in streams)
    return [(s.sensor, at, at + size) for at in range(0, longest, size) for s in streams]


@cache
def independent_streams(seconds: float = 4.0) -> tuple[ImuStream, ...]:
    """Perfect sensors on a chain that SciPy's DOP853 integrates, from matrices, with a smooth seat motion."""
    chain = Chain.of(subject())
    linear = -np.hstack([chain.K, chain.C]) / chain.inertia_kg[:, None]
    stiffening = chain.stiffness_n_per_m * chain.stiffening_per_m

    def seat(t: float) -> float:
        rise = min(max((t - 1.5) / 0.5, 0.0), 1.0)
        swing = 3.0 * math.sin(2 * math.pi * 4.1 * t) + 2.0 * math.sin(2 * math.pi * 9.3 * t + 1.0)
        return rise**2 * (3 - 2 * rise) * swing

    def absolute(y: NDArray[np.float64]) -> NDArray[np.float64]:
        stretch = y[..., :6] @ STRETCH.T
        return y @ linear.T - (stiffening * stretch * np.abs(stretch)) @ STRETCH / chain.inertia_kg

    def slope(t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([y[6:], absolute(y) - seat(t)])

    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    answer = solve_ivp(slope, (0.0, t[-1]), np.zeros(12), "DOP853", t, rtol=1e-10, atol=1e-12, max_step=3e-3)
    moved, answered = np.array([seat(at) for at in t]), absolute(answer.y.T)
    stamps = START_NS + np.rint(t * 1e9).astype(np.int64)
    streams = []
    for name in SENSORS:
        accel = np.zeros((t.size, 3))
        accel[:, 2] = STANDARD_GRAVITY_MPS2 + (moved if name == SEAT else answered[:, SEGMENTS.index(name)])
        streams.append(ImuStream(name, stamps, accel, np.zeros_like(accel)))
    return tuple(streams)


@cache
def _types() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)


def accel_stamped(messages: Sequence[bytes]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Header stamps (n,) ns and linear accelerations (n, 3) m/s^2 of serialized AccelStamped messages, by rosbags."""
    read = [_types().deserialize_cdr(message, ACCEL_STAMPED_TYPE) for message in messages]
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in read]
    linear = [(each.accel.linear.x, each.accel.linear.y, each.accel.linear.z) for each in read]
    return np.array(stamps, dtype=np.int64), np.array(linear, dtype=np.float64).reshape(-1, 3)


def held_bytes(held: object) -> int:
    """The size of an object with everything that it holds."""
    return len(pickle.dumps(held))


def info(bag: str | Path, options: ReadingOptions | None = None) -> dict[str, Any]:
    """The mapping of `biodyn info --json`."""
    return info_document(info_report(bag, options))


def info_report(bag: str | Path, options: ReadingOptions | None = None) -> Report:
    """The report of `biodyn info`."""
    with open_bag(bag) as reader:
        return info_of(reader, str(bag), options or ReadingOptions())
