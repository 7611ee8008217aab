"""Records for end-to-end tests: motions are written as Imu messages to a bag, and `replay` gives the results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SENSORS
from biodyn_core.body.subject import load_subject
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.pipeline.frames import Frames
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.topics import INPUT
from biodyn_ros.replay.replaying import Replayed, ReplayOptions, replay

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

START_NS: Final = 1_767_225_600 * 10**9
GRAVITY_MPS2: Final = 9.80665
REST_S: Final = 0.8
"""The pipeline's default: the time to find gravity is not counted."""

BEGIN_S: Final = 1.0
"""Every motion starts after this time at rest."""

CHUNK_BYTES: Final = 150_001
"""Small and odd, so that the pipeline receives uneven blocks, about fifteen per second."""

NOISE_MPS2: Final = 1e-6
"""Far below every tolerance, but enough that successive values differ, as for a real sensor."""

_TURN_S: Final = 0.5

# Sensors have different mountings, so that every result includes the search for the vertical. The seat is upright,
# because only its horizontal axes are evaluated. Rows are the sensor's axes.
_MOUNTING: Final[dict[str, Floats]] = {
    "seat": np.eye(3),
    "pelvis": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "lower_torso": np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "upper_torso": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "neck": np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
    "head": np.array([[1.0, 2.0, 2.0], [2.0, 1.0, -2.0], [-2.0, 2.0, -1.0]]) / 3.0,
}


@dataclass(frozen=True)
class Stream:
    """Messages of one sensor in the order of arrival: header stamps and log times (n,) ns, specific force (n, 3)."""

    stamps_ns: Integers
    log_ns: Integers
    force_mps2: Floats

    def picked(self, which: NDArray[Any]) -> Stream:
        """The messages selected by an index, logged in the order of the index."""
        return Stream(self.stamps_ns[which], np.sort(self.log_ns[which]), self.force_mps2[which])

    def stamped(self, seconds: Floats) -> Stream:
        """The same messages with other header stamps, seconds since the start (n,)."""
        return replace(self, stamps_ns=_nanoseconds(seconds))

    def logged(self, seconds: Floats) -> Stream:
        """The same messages with other log times, seconds since the start (n,), ascending."""
        return replace(self, log_ns=_nanoseconds(seconds))


def instants(rate_hz: float, seconds: float, late_samples: float = 0.0) -> Floats:
    """Times of samples, seconds (n,) from the start; `late_samples` shifts the clock by a fraction of a sample."""
    return (np.arange(math.floor(seconds * rate_hz)) + late_samples) / rate_hz


def stream(
    sensor: str, time_s: Floats, up: Floats, forward: Floats | float = 0.0, left: Floats | float = 0.0
) -> Stream:
    """The messages of a sensor at times time_s (n,) for a motion in m/s² (n,), with gravity and exact stamps."""
    force = np.column_stack([np.broadcast_to(part, time_s.shape) for part in (forward, left, up + GRAVITY_MPS2)])
    noise = NOISE_MPS2 * np.random.default_rng(SENSORS.index(sensor)).standard_normal(force.shape)
    stamps = _nanoseconds(time_s)
    return Stream(stamps, stamps, force @ _MOUNTING[sensor].T + noise)


def _nanoseconds(seconds: Floats) -> Integers:
    return START_NS + np.rint(seconds * 1e9).astype(np.int64)


def first_counted(time_s: Floats) -> int:
    """The first counted sample, after the rest, for exact stamps."""
    return int(np.searchsorted(time_s - time_s[0], REST_S - 1e-9))


def replayed(
    streams: Mapping[str, Stream],
    also_weighted: str = "",
    conditioning: ConditioningSettings | None = None,
    each: Callable[[Frames], Any] = lambda frames: None,
) -> Replayed:
    """Write the streams to a bag and replay it."""
    with bag_of(streams) as bag:
        return replay_of(bag, also_weighted, conditioning, each)


def replay_of(
    bag: Path,
    also_weighted: str = "",
    conditioning: ConditioningSettings | None = None,
    each: Callable[[Frames], Any] = lambda frames: None,
) -> Replayed:
    """Replay a bag as `biodyn replay` does; the seat's first axis points forward."""
    settings = PipelineSettings(yaw_deg=0.0, also_weighted=also_weighted)
    options = ReplayOptions(conditioning=conditioning, pipeline=settings)
    return replay(bag, load_subject(subject_file("subject_1")), options, each)


@contextmanager
def bag_of(streams: Mapping[str, Stream]) -> Iterator[Path]:
    """A temporary bag with these streams."""
    with TemporaryDirectory() as directory:
        bag = Path(directory, "record.mcap")
        write_bag(bag, streams)
        yield bag


def write_bag(path: Path, streams: Mapping[str, Stream]) -> None:
    """Write the streams as sensor_msgs/Imu, interleaved every half second, so that the file is in order of log time."""
    with BagWriter(path, compression="none", chunk_bytes=CHUNK_BYTES) as writer:
        for sensor in streams:
            writer.add_topic(INPUT[sensor], IMU_TYPE)
        end_ns = max(int(s.log_ns[-1]) for s in streams.values())
        turns = np.arange(START_NS - 10**9, end_ns + 1, round(_TURN_S * 1e9))
        edges = {sensor: [*np.searchsorted(s.log_ns, turns).tolist(), s.log_ns.size] for sensor, s in streams.items()}
        for turn in range(turns.size):
            for sensor, s in streams.items():
                part = slice(edges[sensor][turn], edges[sensor][turn + 1])
                force = s.force_mps2[part]
                payload = encode_imu(s.stamps_ns[part], force, np.zeros_like(force), f"imu_{sensor}")
                writer.write(INPUT[sensor], s.log_ns[part], payload)
