"""Simulates a bag of six IMUs from a subject and a seat motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from biodyn_core.body.subject import Subject
from biodyn_core.body.synthesis import SeatMotion, imu_streams, joined, load_case
from biodyn_core.body.synthesis_settings import SensorSettings
from biodyn_ros import __version__
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.base.topics import INPUT
from biodyn_ros.reading.provenance import MADE_BY, RECORD

START_NS: Final = 1_767_225_600 * 10**9
"""2026-01-01; constant, so that the same seed gives the same bag."""


@dataclass(frozen=True)
class Simulated:
    """The written bag."""

    bag: str
    messages: int
    seconds: float
    seed: int


def motion_of_cases(cases: list[str], seconds: float, seed: int) -> SeatMotion:
    """Random load cases of `seconds` each, one after the other."""
    rng = _generator(seed, 0)
    return joined([load_case(case, seconds, rng) for case in cases])


def simulate_bag(
    path: Path,
    subject: Subject,
    motion: SeatMotion,
    seed: int,
    sensors: SensorSettings,
    compression: str = "zstd",
    progress: OnProgress = ignore_progress,
) -> Simulated:
    """Write the bag, with its origin in the metadata. Raises InputError if the path cannot be written.

    `progress` is called with (sensors written, all sensors).
    """
    streams = imu_streams(subject, motion, _generator(seed, 1), sensors, START_NS)
    with BagWriter(path, compression=compression) as writer:
        for written, stream in enumerate(streams):
            progress(written, len(streams))
            writer.add_topic(INPUT[stream.sensor], IMU_TYPE)
            payload = encode_imu(stream.stamps_ns, stream.accel_mps2, stream.gyro_radps, f"imu_{stream.sensor}")
            writer.write(INPUT[stream.sensor], stream.stamps_ns, payload)
        progress(len(streams), len(streams))
        writer.add_metadata(
            RECORD, {"made_by": MADE_BY, "subject": subject.name, "seed": str(seed), "version": __version__}
        )
    first = min(int(stream.stamps_ns[0]) for stream in streams)
    last = max(int(stream.stamps_ns[-1]) for stream in streams)
    return Simulated(str(path), sum(len(stream.stamps_ns) for stream in streams), 1e-9 * (last - first), seed)


def _generator(seed: int, stream: int) -> np.random.Generator:
    """Independent streams of one seed: the sensors' errors do not depend on the drawn motion."""
    return np.random.default_rng([seed, stream])
