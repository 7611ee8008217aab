"""Events of a two-hour session of six IMUs, 49 million messages, compared with reading and decoding only.

Every measurement is a child process, `python -m bench.sessions TASK BAG`, which prints its CPU seconds without
start-up and its peak of resident memory. Tasks are read and events.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.replay import peak_mb
from bench.table import Row, render
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import SeatMotion, imu_streams
from biodyn_core.body.synthesis_settings import SensorSettings
from biodyn_ros.bag import BagWriter, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.topics import INPUT
from biodyn_ros.events.finding import find_events
from biodyn_ros.simulate import START_NS, motion_of_cases

LONG_S, SHORT_S = 7200.0, 600.0
PIECE_S = 100.0
STILL_S = 10.0
TASKS = ("read", "events")


@dataclass(frozen=True)
class Cost:
    """CPU seconds of a task on one core, wall seconds, peak resident MB, and the number of events."""

    cpu_s: float
    wall_s: float
    peak_mb: float
    events: int = 0


def rows() -> list[Row]:
    """Measure; about eight minutes, and 5 GB of disk."""
    with TemporaryDirectory() as directory:
        long, short = (_session(Path(directory, f"{seconds:g}.mcap"), seconds) for seconds in (LONG_S, SHORT_S))
        costs = {(task, bag): _cost(task, bag) for bag in (short, long) for task in TASKS}
    read, events, brief = costs["read", long], costs["events", long], costs["events", short]
    unit = "x real time"
    return [
        Row(
            f"events of {LONG_S / 3600:g} h", LONG_S / events.wall_s, unit, LONG_S / read.wall_s, "read, decode only",
            ">= 100", LONG_S / events.wall_s >= 100.0,
        ),
        Row(f"events of {LONG_S / 3600:g} h: time", events.wall_s, "s", read.wall_s, "read, decode only", "-", None),
        Row(
            f"events: peak, {LONG_S / 3600:g} h", events.peak_mb, "MB", brief.peak_mb, f"{SHORT_S / 60:g} min", "flat",
            events.peak_mb < 1.25 * brief.peak_mb,
        ),
    ]  # fmt: skip


def _session(path: Path, seconds: float) -> Path:
    """A drive of 90 s and a standstill, repeated; each message is in the bag with its own stamp."""
    drive = motion_of_cases(["road", "pothole", "rail"], (PIECE_S - STILL_S) / 3.0, seed=1)
    count = round(drive.rate_hz * STILL_S)
    motion = SeatMotion(
        drive.rate_hz,
        np.concatenate([np.zeros((count, 3)), drive.accel_mps2]),
        np.concatenate([np.zeros(count), drive.pitch_rate_radps]),
    )
    sensors = SensorSettings(clock_drift_ppm=0.0)
    subject = load_subject(subject_file("subject_1"))
    streams = imu_streams(subject, motion, np.random.default_rng(1), sensors, START_NS, quiet_s=0.0)
    seat = streams[0].stamps_ns
    piece_ns = int(seat[-1] - seat[0] + (seat[-1] - seat[0]) // (seat.size - 1))
    with BagWriter(path, compression="lz4") as writer:
        for stream in streams:
            writer.add_topic(INPUT[stream.sensor], IMU_TYPE)
        for number in range(round(1e9 * seconds / piece_ns)):
            later_ns = piece_ns * number
            for second in range(round(PIECE_S)):
                for stream in streams:
                    since_s = 1e-9 * (stream.stamps_ns - START_NS)
                    here = slice(*np.searchsorted(since_s, (second, second + 1)).tolist())
                    stamps = stream.stamps_ns[here] + later_ns
                    payload = encode_imu(stamps, stream.accel_mps2[here], stream.gyro_radps[here], "imu")
                    writer.write(INPUT[stream.sensor], stamps, payload)
    return path


def _cost(task: str, bag: Path) -> Cost:
    line = [sys.executable, "-m", "bench.sessions", task, str(bag)]
    done = subprocess.run(line, check=True, capture_output=True, text=True)
    return Cost(**json.loads(done.stdout))


def _run(task: str, bag: Path) -> Cost:
    """One task in this process."""
    cpu_s, wall_s, events = time.process_time(), time.perf_counter(), 0
    if task == "read":
        with open_bag(bag) as reader:
            for _ in imu_blocks(reader, INPUT.values()):
                pass
    else:
        events = len(find_events(bag).findings.events)
    return Cost(time.process_time() - cpu_s, time.perf_counter() - wall_s, peak_mb(), events)


if __name__ == "__main__":
    if sys.argv[1:]:
        print(json.dumps(asdict(_run(sys.argv[1], Path(sys.argv[2])))))
    else:
        print(render(rows()))
