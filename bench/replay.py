"""Replay of 300 s of six IMUs, without and with the full-rate predicted bag, compared with reading and decoding only.

Every measurement is a child process, `python -m bench.replay TASK BAG DIRECTORY`, which prints its CPU seconds without
start-up and its peak of resident memory. Tasks are read, replay and predicted.
"""

from __future__ import annotations

import itertools
import json
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.writer import CompressionType, Writer

from bench.table import Row, render
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis_settings import CASES, SensorSettings
from biodyn_ros.bag import imu_blocks, open_bag
from biodyn_ros.bag.cdr import ACCEL_STAMPED_TYPE, encode_accel_stamped
from biodyn_ros.base.resources import subject_file
from biodyn_ros.node.warmup import warm_up
from biodyn_ros.replay.replaying import replay_to_directory
from biodyn_ros.simulate import motion_of_cases, simulate_bag

LONG_S, SHORT_S = 300.0, 60.0
ROUNDS = 3
PART = 60_000
"""Number of messages written one by one, enough for the time per message."""

TASKS = ("read", "replay", "predicted")
NAMES = {"read": "read, decode only", "replay": "replay", "predicted": "replay with predicted bag"}


@dataclass(frozen=True)
class Cost:
    """Cost of a task: CPU seconds of its process on one core, peak resident MB, and messages written."""

    cpu_s: float
    peak_mb: float
    written: int = 0


def rows() -> list[Row]:
    """Measure; about two minutes."""
    # In memory if possible, to exclude the disk.
    memory = Path("/dev/shm")  # noqa: S108
    with TemporaryDirectory(dir=memory if memory.is_dir() else None) as directory:
        long, short = (_simulate(Path(directory, f"{seconds:g}.mcap"), seconds) for seconds in (LONG_S, SHORT_S))
        brief = {task: _cost(task, short) for task in TASKS}  # first, to fill the caches
        rounds = [{task: _cost(task, long) for task in TASKS} for _ in range(ROUNDS)]
        # The second run: the first also loads the compressor.
        singly_s = [_seconds_a_message(Path(directory, "singly.mcap")) for _ in range(2)][1]
    costs = {task: _middle([each[task] for each in rounds]) for task in TASKS}
    return [*_speed_rows(costs, singly_s), *_memory_rows(costs, brief)]


def _speed_rows(costs: dict[str, Cost], singly_s: float) -> list[Row]:
    read, plain, full = (LONG_S / costs[task].cpu_s for task in TASKS)
    singly = LONG_S / (costs["replay"].cpu_s + singly_s * costs["predicted"].written)
    unit = "x real time"
    return [
        Row(NAMES["replay"], plain, unit, read, NAMES["read"], ">= 200", plain >= 200.0),
        Row(NAMES["predicted"], full, unit, read, NAMES["read"], ">= 50", full >= 50.0),
        Row(NAMES["predicted"], full, unit, singly, "mcap, message by message", "-", None),
    ]


def _memory_rows(costs: dict[str, Cost], brief: dict[str, Cost]) -> list[Row]:
    """The target is for an hour; a constant peak between one and five minutes is sufficient evidence."""
    return [
        Row(
            f"{NAMES[task]}: peak, {LONG_S:g} s", costs[task].peak_mb, "MB", brief[task].peak_mb, f"{SHORT_S:g} s",
            "<= 600, flat", costs[task].peak_mb <= 600.0 and costs[task].peak_mb <= 1.15 * brief[task].peak_mb,
        )
        for task in TASKS[1:]
    ]  # fmt: skip


def _simulate(path: Path, seconds: float) -> Path:
    motion = motion_of_cases(list(CASES), seconds / len(CASES), seed=0)
    simulate_bag(path, load_subject(subject_file("subject_1")), motion, 0, SensorSettings())
    return path


def _cost(task: str, bag: Path) -> Cost:
    """Run a task in a child process; its output is removed, because it may be in memory."""
    with TemporaryDirectory(dir=bag.parent) as directory:
        command = [sys.executable, "-m", "bench.replay", task, str(bag), directory]
        answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        return Cost(**json.loads(answer.stdout))


def _middle(costs: list[Cost]) -> Cost:
    return Cost(statistics.median(cost.cpu_s for cost in costs), max(cost.peak_mb for cost in costs), costs[0].written)


def _seconds_a_message(path: Path) -> float:
    """Seconds of the mcap library to write one predicted sample, measured on a part."""
    stamps_ns = np.arange(PART // len(SEGMENTS)) * 885_000
    wave = np.random.default_rng(0).normal(size=stamps_ns.size)
    messages = [encode_accel_stamped(stamps_ns, wave, name) for name in SEGMENTS]
    begin = time.process_time()
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start("ros2")
        schema = writer.register_schema(ACCEL_STAMPED_TYPE, "ros2msg", b"")
        channels = [writer.register_channel(name, "cdr", schema) for name in SEGMENTS]
        for (row, stamp), column in itertools.product(enumerate(stamps_ns.tolist()), range(len(SEGMENTS))):
            writer.add_message(channels[column], stamp, messages[column][row].tobytes(), stamp)
        writer.finish()
    return (time.process_time() - begin) / PART


# --- in the child ----------------------------------------------------------------------------------------------------


def _child(task: str, bag: str, directory: str) -> Cost:
    subject, out = load_subject(subject_file("subject_1")), Path(directory)
    warm_up(subject)
    begin = time.process_time()
    if task == "read":
        with open_bag(bag) as reader:
            for _ in imu_blocks(reader, [topic.name for topic in reader.topics]):
                pass
    else:
        replay_to_directory(bag, subject, out, predicted=task == "predicted", report=False)
    cpu_s = time.process_time() - begin
    return Cost(cpu_s, peak_mb(), _messages(out / "predicted.mcap") if task == "predicted" else 0)


def peak_mb() -> float:
    """The peak of resident memory; not ru_maxrss, which a child inherits from its parent."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1024.0


def _messages(bag: Path) -> int:
    with open_bag(bag) as reader:
        return sum(topic.messages for topic in reader.topics)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        print(render(rows()))
    else:
        print(json.dumps(asdict(_child(*sys.argv[1:]))))
