"""Clocks: one motion with injected faults of the stamps; six faults at a time, one per sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.conditioner import CLOCK_TIME_CONSTANT_S
from biodyn_ros.bag import open_bag
from biodyn_ros.info.document import info_document
from biodyn_ros.info.report import info_of
from biodyn_ros.reading.sensors import ReadingOptions
from conformance import record, twins
from conformance.record import Stream
from conformance.table import Row, RowTable

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RATE_HZ: Final = 1129.3
SECONDS: Final = 60.0
TIME_S: Final = record.instants(RATE_HZ, SECONDS)
QUIET_S: Final = (19.0, 23.0)
GAP_S: Final = 1.0
"""The pause of the motion, and the length of the gap in its middle."""

SPOILT: Final = np.arange(math.ceil(2.0 * RATE_HZ), TIME_S.size - 200, 100)
"""1 % of the messages; not during the search for gravity, nor at the end, where no later stamp confirms one."""

TRANSPORT_S: Final = 2e-3
DELAY_S: Final = 2e-5
"""The smallest delay of logging, and the mean of the additional delay."""

FIGURE_TOLERANCE: Final = 0.001
PPM_FLOOR: Final = 0.1
OFFSET_FLOOR_S: Final = 2e-5

BURST: Final = 20
HOUR_NS: Final = 3600 * 10**9


@dataclass(frozen=True)
class Fault:
    """A change of a sensor's messages, and the expected result.

    ppm: drift of the stamps; late_s: their delay; error_s: rms of their errors about an even clock; counts: the causes
    under which changed messages are counted; gap: whether there is one; by_log: whether log time is used instead, so
    that the clock of the stamps is unknown.
    """

    what: str
    apply: Callable[[Stream], Stream]
    ppm: float = 0.0
    late_s: float = 0.0
    error_s: float = 0.0
    counts: tuple[str, ...] = ()
    gap: bool = False
    by_log: bool = False


@cache
def motion() -> Floats:
    """Three sines with a rise and decay of a second, twice."""
    swells = ((record.BEGIN_S, QUIET_S[0]), (QUIET_S[1], SECONDS - 3.0))
    inside = np.maximum(*(np.minimum(TIME_S - begin, end - TIME_S) for begin, end in swells))
    tones = sum(a * np.sin(2.0 * np.pi * f * TIME_S) for a, f in ((1.2, 1.3), (2.0, 4.1), (1.5, 9.3)))
    return np.sin(0.5 * np.pi * np.clip(inside, 0.0, 1.0)) ** 2 * tones


@cache
def weighted() -> Floats:
    """The motion weighted by the analog Wk."""
    return twins.weighted("Wk", motion(), RATE_HZ)


# --- faults ----------------------------------------------------------------------------------------------------------


def _drift(ppm: float) -> Fault:
    return Fault(f"clock {ppm:+g} ppm", lambda s: s.stamped(TIME_S * (1.0 + 1e-6 * ppm)), ppm=ppm)


def _jitter(rms_s: float) -> Fault:
    error_s = rms_s * np.random.default_rng(0).standard_normal(TIME_S.size)
    return Fault(f"jitter of {1e3 * rms_s:g} ms rms", lambda s: s.stamped(TIME_S + error_s), error_s=rms_s)


def _quantised(step_s: float) -> Fault:
    stamps_s = np.floor(TIME_S / step_s) * step_s
    what = f"stamps in steps of {1e3 * step_s:g} ms"
    return Fault(what, lambda s: s.stamped(stamps_s), error_s=step_s / math.sqrt(12.0))


def _in_bursts(s: Stream) -> Stream:
    number = np.arange(TIME_S.size)
    handed_s = (number // BURST + 1) * BURST / RATE_HZ + 1e-4 * (number % BURST)
    return s.stamped(handed_s).logged(handed_s + TRANSPORT_S)


def _lost(s: Stream) -> Stream:
    return s.picked(np.setdiff1d(np.arange(TIME_S.size), SPOILT))


def _twice(s: Stream) -> Stream:
    return s.picked(np.sort(np.concatenate([np.arange(TIME_S.size), SPOILT])))


def _overtaken(s: Stream) -> Stream:
    log_ns = s.log_ns.copy()
    log_ns[SPOILT] = log_ns[SPOILT + 1]
    order = np.arange(TIME_S.size)
    order[SPOILT], order[SPOILT + 1] = SPOILT + 1, SPOILT
    return replace(s, log_ns=log_ns).picked(order)


def _restamped(change: Callable[[Integers], Integers]) -> Callable[[Stream], Stream]:
    def apply(s: Stream) -> Stream:
        stamps_ns = s.stamps_ns.copy()
        stamps_ns[SPOILT] = change(stamps_ns[SPOILT])
        return replace(s, stamps_ns=stamps_ns)

    return apply


def _without_reading(s: Stream) -> Stream:
    force_mps2 = s.force_mps2.copy()
    force_mps2[SPOILT, 1] = np.nan
    return replace(s, force_mps2=force_mps2)


def _beside_gap() -> NDArray[np.bool_]:
    return np.abs(TIME_S - 0.5 * sum(QUIET_S)) > 0.5 * GAP_S


FAULTS: Final = (
    Fault("no fault", lambda s: s),
    Fault("set 0.4 s late", lambda s: s.stamped(TIME_S + 0.4), late_s=0.4),
    _drift(20.0),
    _drift(-50.0),
    _drift(500.0),
    _jitter(1e-4),
    _jitter(1e-3),
    _jitter(5e-3),
    _quantised(1e-3),
    _quantised(1e-2),
    Fault("20 samples in 2 ms, then a pause", _in_bursts, error_s=BURST / RATE_HZ / math.sqrt(12.0)),
    Fault("1 % lost", _lost, counts=("filled",)),
    Fault("1 % twice", _twice, counts=("duplicate",)),
    Fault("1 % overtaken", _overtaken, counts=("stray", "filled")),
    Fault("1 % of stamps zero", _restamped(np.zeros_like), counts=("unset", "filled")),
    Fault("1 % of stamps an hour ahead", _restamped(lambda stamps: stamps + HOUR_NS), counts=("stray", "filled")),
    Fault("1 % of stamps an hour back", _restamped(lambda stamps: stamps - HOUR_NS), counts=("late", "filled")),
    Fault("1 % without a reading", _without_reading, counts=("non_finite", "filled")),
    Fault("a gap of 1 s", lambda s: s.picked(np.flatnonzero(_beside_gap())), gap=True),
    Fault("all stamps zero", lambda s: replace(s, stamps_ns=np.zeros_like(s.stamps_ns)), error_s=DELAY_S, by_log=True),
)


# --- records ---------------------------------------------------------------------------------------------------------


def fault_rows(faults: tuple[Fault, ...]) -> list[Row]:
    """Rows of up to six faults in one record, from `replay` and `info`."""
    streams = {}
    for number, (sensor, fault) in enumerate(zip(SENSORS, faults, strict=False)):
        delay_s = np.random.default_rng(number).exponential(DELAY_S, TIME_S.size)
        logged_s = np.maximum.accumulate(TIME_S + TRANSPORT_S + delay_s)
        streams[sensor] = fault.apply(record.stream(sensor, TIME_S, motion()).logged(logged_s))
    with record.bag_of(streams) as bag, open_bag(bag) as reader:
        doses = record.replay_of(bag).document["sensors"]
        document = info_document(info_of(reader, str(bag), ReadingOptions()))
    seen = {topic["sensor"]: topic for topic in document["topics"]}
    rows = []
    for sensor, fault in zip(streams, faults, strict=True):
        rows += [*_clock_rows(fault, seen[sensor]), *_count_rows(fault, seen[sensor])]
        rows += _figure_rows(fault, doses[sensor])
    return rows


def _clock_rows(fault: Fault, seen: dict[str, Any]) -> list[Row]:
    rate_ppm, allowed_ppm = 1e6 * (RATE_HZ / seen["rate_hz"] - 1.0), rate_tolerance_ppm(fault)
    rows = [Row(f"{fault.what}: clock by `rate_hz`", rate_ppm, fault.ppm, allowed_ppm, "ppm", absolute=True)]
    if fault.by_log:
        return rows
    ppm, allowed_ppm = seen["clock_ppm"], log_tolerance_ppm(fault)
    offset_ms, wanted_ms = seen["offset_ms"], 1e3 * (TRANSPORT_S - fault.late_s)
    allowed_ms = 1e3 * (OFFSET_FLOOR_S + 5.0 * fault.error_s + 1e-6 * abs(fault.ppm))
    return [
        *rows,
        Row(f"{fault.what}: `clock_ppm`", ppm, fault.ppm, allowed_ppm, "ppm", absolute=True),
        Row(f"{fault.what}: `offset_ms`", offset_ms, wanted_ms, allowed_ms, "ms", absolute=True),
    ]


def _count_rows(fault: Fault, seen: dict[str, Any]) -> list[Row]:
    counts = {**seen["rejected_by_cause"], "filled": seen["filled"], "gaps": seen["gaps"]}
    expected = dict.fromkeys(fault.counts, SPOILT.size) | ({"gaps": 1} if fault.gap else {})
    others = sum(count for cause, count in counts.items() if cause not in expected)
    rows = [
        Row(f"{fault.what}: `{cause}`", counts[cause], number, 0.0, absolute=True) for cause, number in expected.items()
    ]
    return [*rows, Row(f"{fault.what}: any other count", others, 0.0, 0.0, absolute=True)]


def _figure_rows(fault: Fault, dose: dict[str, float]) -> list[Row]:
    counted = np.arange(TIME_S.size) >= record.first_counted(TIME_S)
    if fault.gap:
        counted &= _beside_gap()
    aw = math.sqrt(float((weighted()[counted] ** 2).mean()))
    vdv = float((weighted()[counted] ** 4).sum() / RATE_HZ) ** 0.25
    return [
        Row(f"{fault.what}: aw", dose["aw_mps2"], aw, FIGURE_TOLERANCE, "m/s²"),
        Row(f"{fault.what}: VDV", dose["vdv_mps175"], vdv, FIGURE_TOLERANCE, "m/s¹·⁷⁵"),
    ]


def rate_tolerance_ppm(fault: Fault) -> float:
    """Four standard deviations of the rate estimated by a critically damped loop from stamps with white errors."""
    return PPM_FLOOR + 4e6 * fault.error_s / (2.0 * CLOCK_TIME_CONSTANT_S**1.5 * math.sqrt(RATE_HZ))


def log_tolerance_ppm(fault: Fault) -> float:
    """Four standard deviations of the slope of a line through the smallest lag of every second.

    The minimum of 1129 white errors has 0.35 of their standard deviation; the smallest lag under a drift has that of a
    Rayleigh distribution, 0.655 of the root of drift x mean delay / rate.
    """
    least_s = 0.35 * fault.error_s + 0.655 * math.sqrt(1e-6 * abs(fault.ppm) * DELAY_S / RATE_HZ)
    return PPM_FLOOR + 4e6 * least_s * math.sqrt(12.0 / SECONDS**3)


WORDS: Final = f"""\
A minute at {RATE_HZ:g} Hz, one fault for each sensor. Messages are logged {1e3 * TRANSPORT_S:g} ms late and,
exponentially distributed, {1e3 * DELAY_S:g} ms more. Clocks and counts are those of `biodyn info --json`, aw and VDV
those of `exposure.json`. Tolerances: counts equal those injected; aw and VDV of the motion after the analog Wk 0.1 %.
With white errors σ of the stamps, a loop of τ = {CLOCK_TIME_CONSTANT_S:g} s determines the rate to σ / (2 τ^1.5 √f),
and a line through the least lags of T seconds to 0.35 σ √(12 / T³), a drift adding to σ: four times that and
{PPM_FLOOR:g} ppm; of the offset 5 σ, the drift of the first second and {1e3 * OFFSET_FLOOR_S:g} ms."""


def sections() -> list[RowTable]:
    """All sections; about five seconds."""
    size = len(SENSORS)
    rows = [row for at in range(0, len(FAULTS), size) for row in fault_rows(FAULTS[at : at + size])]
    return [RowTable("Faults of the stamps", WORDS, tuple(rows))]
