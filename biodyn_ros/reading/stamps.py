"""Chooses the time of samples: header stamps, or the recorder's log times if a driver sets none; compares both.

Header stamps are the sensor's own and preferred. Log times are delayed by the transport, and in bursts.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.clocks import ClockDrift
from biodyn_ros.bag import BagReader, imu_blocks
from biodyn_ros.bag.cdr import decode_imu_in

FIRST_MESSAGES: Final = 20
"""Number of messages that show whether a driver sets stamps."""

DRIFT_TOLERATED_S: Final = 1e-3
"""A larger drift between two clocks over a record distorts the residual: 1 ms is 11 degrees at 30 Hz."""

OFFSET_TOLERATED_S: Final = 5e-3
"""A larger difference of offsets against log time gives a warning; clock and transport cannot be distinguished."""

RATE_TOLERATED_PPM: Final = 500.0
"""No quartz has a larger error: such stamps are counted, not read from a clock."""


class TimeChoice(NamedTuple):
    """The time of a topic, "header" or "log"; defect: why its header stamps are not usable, empty if they are."""

    time: str
    defect: str = ""


def choose_times(reader: BagReader, topics: Iterable[str], requested: str) -> dict[str, TimeChoice]:
    """Choose header or log time for each Imu topic; requested: "header" (if usable) or "log".

    Reads a topic's first messages. InputError as `imu_blocks`.
    """
    topics = tuple(topics)
    if requested != "header":
        return dict.fromkeys(topics, TimeChoice(requested))
    found = _first_of_all(reader, topics)
    for topic in topics:
        if topic not in found or found[topic].size < FIRST_MESSAGES:
            found[topic] = _first_of(reader, topic)
    return {topic: _choice(found[topic]) for topic in topics}


def _choice(stamps_ns: Integers) -> TimeChoice:
    if stamps_ns.size and not stamps_ns.any():
        return TimeChoice("log", "header stamps are zero")
    if stamps_ns.size > 1 and (stamps_ns == stamps_ns[0]).all():
        return TimeChoice("log", "header stamps do not change")
    return TimeChoice("header")


def _first_of_all(reader: BagReader, topics: tuple[str, ...]) -> dict[str, Integers]:
    """Header stamps of the first chunk, which contains the first messages of all topics in most bags."""
    blocks = next((list(chunk.blocks()) for chunk in reader.chunks(topics)), [])
    first, found = slice(FIRST_MESSAGES), {}
    for block in blocks:
        try:
            found[block.topic] = decode_imu_in(block.buffer, block.offsets[first], block.lengths[first]).stamps_ns
        except InputError as error:
            raise InputError(f"{reader.path}: topic {block.topic}: {error}") from None
    return found


def _first_of(reader: BagReader, topic: str) -> Integers:
    parts = [np.empty(0, dtype=np.int64)]
    for _, block in imu_blocks(reader, [topic]):
        parts.append(block.header_ns)
        if sum(part.size for part in parts) >= FIRST_MESSAGES:
            break
    return np.concatenate(parts)[:FIRST_MESSAGES]


@dataclass(frozen=True)
class SensorClock:
    """A sensor's choice of time, and the drift of its header stamps against log time; None if no stamp is set."""

    choice: TimeChoice
    drift: ClockDrift | None


def clock_warnings(clocks: Mapping[str, SensorClock], seconds: float) -> list[str]:
    """Warnings about stamps and clocks in a record of this length, a line each; `clocks` by name."""
    lines = [line for name, clock in clocks.items() for line in _own_warnings(name, clock)]
    by_header = {
        name: clock.drift
        for name, clock in clocks.items()
        if clock.choice.time == "header" and clock.drift and not clock.drift.copied
    }
    return [*lines, *_mixed(clocks, by_header), *_apart_by_drift(by_header, seconds), *_apart_by_offset(by_header)]


def _own_warnings(name: str, clock: SensorClock) -> list[str]:
    lines, drift = [], clock.drift
    if clock.choice.defect:
        lines.append(f"{name}: {clock.choice.defect}: log time is used instead")
    if drift is None or clock.choice.time == "log":
        return lines
    if drift.quantum_s:
        quantum_ms = 1e3 * drift.quantum_s
        lines.append(
            f"{name}: header stamps are quantised to {quantum_ms:g} ms: an even clock is fitted to them,"
            f" with an error of up to {quantum_ms:g} ms"
        )
    if drift.leaps:
        times = "once" if drift.leaps == 1 else f"{drift.leaps} times"
        lines.append(f"{name}: header time jumped against log time {times}: a clock was set")
    if drift.ppm is not None and drift.ppm_error is not None and abs(drift.ppm) - drift.ppm_error > RATE_TOLERATED_PPM:
        lines.append(
            f"{name}: its header stamps drift by {drift.ppm:+.0f} ppm against log time, more than a clock: the driver"
            " may count samples; compare with --time log"
        )
    return lines


def _mixed(clocks: Mapping[str, SensorClock], by_header: Mapping[str, ClockDrift]) -> list[str]:
    defective = [name for name, clock in clocks.items() if clock.choice.defect]
    if not defective or not by_header:
        return []
    late_ms = 1e3 * statistics.median(drift.offset_s for drift in by_header.values())
    line = (
        f"{', '.join(defective)} by log time, others by header time, and log time is {late_ms:.1f} ms later:"
        " the residual between them is not reliable; use --time log for all"
    )
    return [line]


def _apart_by_drift(by_header: Mapping[str, ClockDrift], seconds: float) -> list[str]:
    rates = {
        name: (drift.ppm, drift.ppm_error)
        for name, drift in by_header.items()
        if drift.ppm is not None and drift.ppm_error is not None
    }
    if len(rates) < 2:
        return []
    fast, slow = max(rates.values()), min(rates.values())
    apart_s = 1e-6 * (fast[0] - slow[0]) * seconds
    if apart_s - 1e-6 * math.hypot(fast[1], slow[1]) * seconds <= DRIFT_TOLERATED_S:
        return []
    each = ", ".join(f"{name} {ppm:+.1f}" for name, (ppm, _) in rates.items())
    line = (
        f"header clocks drift apart by {1e3 * apart_s:.1f} ms over {seconds:.0f} s (ppm against log time: {each}):"
        " the residual is not reliable; use --time log"
    )
    return [line]


def _apart_by_offset(by_header: Mapping[str, ClockDrift]) -> list[str]:
    offsets = [drift.offset_s for drift in by_header.values()]
    noise_s = max((drift.scatter_s for drift in by_header.values()), default=0.0)
    if not offsets or max(offsets) - min(offsets) <= OFFSET_TOLERATED_S + 3.0 * noise_s:
        return []
    each = ", ".join(f"{name} {1e3 * drift.offset_s:.1f}" for name, drift in by_header.items())
    line = (
        f"the offset of log time from header stamps differs between sensors (ms: {each}): clocks or transport differ;"
        " if clocks differ, the residual is not reliable; compare with --time log"
    )
    return [line]
