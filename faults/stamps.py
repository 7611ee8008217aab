"""Faults of stamps and samples: the change of a stream, the required message, and the allowed loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from faults.ride import BEGIN_S, END_S, RATE_HZ, SECONDS, Arriving

HOUR_NS: Final = 3600 * 10**9
OTHER_CLOCK_NS: Final = 1000 * 10**9
FEW: Final = 20
"""Number of samples of a short fault."""


@dataclass(frozen=True)
class Fault:
    """One fault of one sensor.

    spoil: applies it to a stream. expected: one of these texts must be in the diagnostics; empty if it is harmless or
    cannot be detected. missing_s: minimum and maximum of the time reported as missing. lasts: whether it continues to
    the end, without recovery. compared: whether the sensor is compared again. exact: whether the counted values are
    correct apart from missing samples. over_s: its end.
    """

    name: str
    spoil: Callable[[Arriving], Arriving]
    expected: tuple[str, ...] = ()
    missing_s: tuple[float, float] = (0.0, 0.0)
    lasts: bool = False
    compared: bool = True
    exact: bool = True
    over_s: float = END_S


def dead(one: Arriving) -> Arriving:
    """The sensor sends no more messages."""
    return one.only(one.arrival_s < BEGIN_S)


def late(one: Arriving) -> Arriving:
    """Messages are delayed by half a second."""
    return one.but(arrival_s=np.where(one.within(), np.maximum(one.arrival_s, BEGIN_S + 0.5) + 0.0, one.arrival_s))


def joins_late(one: Arriving) -> Arriving:
    """The sensor starts three seconds after the others."""
    return one.only(one.arrival_s >= 3.0)


def returning(one: Arriving) -> Arriving:
    """The sensor is silent for a second."""
    return one.only(~one.within())


def restarted(one: Arriving) -> Arriving:
    """The sensor is silent for a second and then has another clock."""
    gone = returning(one)
    return gone.but(stamps_ns=np.where(gone.arrival_s >= END_S, gone.stamps_ns - OTHER_CLOCK_NS, gone.stamps_ns))


def bursts(one: Arriving) -> Arriving:
    """Twenty messages arrive within two milliseconds, with their original stamps."""
    number = np.arange(one.arrival_s.size)
    last = np.minimum(number // 20 * 20 + 19, number.size - 1)
    arrival_s = one.arrival_s[last] + 1e-4 * (number % 20)
    return one.but(arrival_s=np.where(one.within(), arrival_s, one.arrival_s)).ordered()


def _lost(share: float) -> Callable[[Arriving], Arriving]:
    def spoil(one: Arriving) -> Arriving:
        drawn = np.random.default_rng(3).random(one.arrival_s.size) < share
        return one.only(~(drawn & one.within()))

    return spoil


def twice(one: Arriving) -> Arriving:
    """Every message arrives twice."""
    again = np.repeat(np.arange(one.arrival_s.size), np.where(one.within(), 2, 1))
    return Arriving(one.arrival_s[again], one.stamps_ns[again], one.accel_mps2[again])


def reordered(one: Arriving) -> Arriving:
    """Every message has its own delay of up to 50 ms."""
    delay_s = 0.05 * np.random.default_rng(4).random(one.arrival_s.size)
    return one.but(arrival_s=one.arrival_s + np.where(one.within(), delay_s, 0.0)).ordered()


def jitter(one: Arriving) -> Arriving:
    """Stamps have errors of up to 5 ms, in unchanged order of arrival."""
    off_ns = np.rint(5e6 * np.random.default_rng(5).uniform(-1.0, 1.0, one.arrival_s.size)).astype(np.int64)
    return one.but(stamps_ns=one.stamps_ns + np.where(one.within(), off_ns, 0))


def unset(one: Arriving) -> Arriving:
    """The driver sets no stamp."""
    return one.but(stamps_ns=np.where(one.within(), 0, one.stamps_ns))


def frozen(one: Arriving) -> Arriving:
    """Stamps do not change."""
    here = one.within()
    return one.but(stamps_ns=np.where(here, one.stamps_ns[here][0], one.stamps_ns))


def quantised(one: Arriving) -> Arriving:
    """Stamps are quantised to 10 ms."""
    return one.but(stamps_ns=np.where(one.within(), one.stamps_ns // 10**7 * 10**7, one.stamps_ns))


def _shifted(by_ns: int) -> Callable[[Arriving], Arriving]:
    return lambda one: one.but(stamps_ns=one.stamps_ns + np.where(one.within(), by_ns, 0))


def _drifting(ppm: float) -> Callable[[Arriving], Arriving]:
    def spoil(one: Arriving) -> Arriving:
        off_ns = 1e3 * ppm * np.maximum(0.0, one.arrival_s - BEGIN_S)
        return one.but(stamps_ns=one.stamps_ns + np.rint(off_ns).astype(np.int64))

    return spoil


def _reading(value: float, samples: int = FEW) -> Callable[[Arriving], Arriving]:
    def spoil(one: Arriving) -> Arriving:
        accel = one.accel_mps2.copy()
        begin = int(np.argmax(one.within()))
        accel[begin : begin + samples, 2] = value
        return one.but(accel_mps2=accel)

    return spoil


def flat(one: Arriving) -> Arriving:
    """The value does not change for three seconds."""
    accel, here = one.accel_mps2.copy(), one.within(BEGIN_S, BEGIN_S + 3.0)
    accel[here] = accel[np.argmax(here)]
    return one.but(accel_mps2=accel)


def _gravity(times: float) -> Callable[[Arriving], Arriving]:
    def spoil(one: Arriving) -> Arriving:
        at_rest = one.accel_mps2[: int(0.5 * RATE_HZ)].mean(axis=0)
        return one.but(accel_mps2=one.accel_mps2 + (times - 1.0) * at_rest)

    return spoil


def ten_times(one: Arriving) -> Arriving:
    """Ten samples instead of each, with interpolated stamps."""
    count = np.where(one.within(), 10, 1)
    source = np.repeat(np.arange(count.size), count)
    inner = np.arange(source.size) - np.repeat(np.cumsum(count) - count, count)
    between = inner / (count[source] * RATE_HZ)
    stamps_ns = one.stamps_ns[source] + np.rint(1e9 * between).astype(np.int64)
    return Arriving(one.arrival_s[source] + between, stamps_ns, one.accel_mps2[source])


def two_sources(one: Arriving) -> Arriving:
    """The samples of another sensor, half a period later, on the same topic."""
    here = one.within()
    other = Arriving(
        one.arrival_s[here] + 0.5 / RATE_HZ,
        one.stamps_ns[here] + round(0.5e9 / RATE_HZ),
        np.roll(one.accel_mps2[here], 400, axis=0),
    )
    both = [np.concatenate([getattr(one, name), getattr(other, name)]) for name in vars(one)]
    return Arriving(*both).ordered()


LEFT_S: Final = SECONDS - BEGIN_S
SECOND: Final = (0.95, 1.05)
EVERY: Final = (
    Fault("dead", dead, ("silent",), (LEFT_S - 0.1, LEFT_S + 0.1), lasts=True),
    Fault("late", late, (), (0.0, 0.0)),
    Fault("joining late, in motion", joins_late, ("waiting for rest",), (13.2, 13.4), lasts=True, exact=False),
    Fault("returning", returning, ("silent", "gap"), SECOND),
    Fault("restarted with another clock", restarted, ("silent", "clock was set"), (0.9, 1.3), compared=False),
)
"""For each of the six sensors."""

OTHERS: Final = (
    Fault("bursts of 20", bursts),
    Fault("1 % lost", _lost(0.01), ("interpolated",), (0.002, 0.05)),
    Fault("5 % lost", _lost(0.05), ("interpolated",), (0.02, 0.1)),
    Fault("20 % lost", _lost(0.2), ("interpolated",), (0.1, 0.35)),
    Fault("everything twice", twice, ("twice",)),
    Fault("reordered within 50 ms", reordered, ("late",), (0.5, 1.1)),
    Fault("stamps jitter by 5 ms", jitter, ("jitter", "late", "interpolated"), (0.0, 1.1), exact=False),
    Fault("stamps unset", unset, ("never set",), SECOND),
    Fault("stamps frozen", frozen, ("late", "twice", "gap", "implausible", "interpolated"), (0.0, 1.1)),
    Fault("stamps in steps of 10 ms", quantised, ("late", "twice"), (0.0, 1.1), exact=False),
    Fault("stamps an hour ahead", _shifted(HOUR_NS), ("gap", "clock was set")),
    Fault("stamps an hour back", _shifted(-HOUR_NS), ("gap", "clock was set")),
    Fault("clock half a second back", _shifted(-(10**9) // 2), ("late",), (0.45, 1.1)),
    Fault("clock drifting by 50 ppm", _drifting(50.0), lasts=True),
    Fault("clock drifting by 500 ppm", _drifting(500.0), lasts=True),
    Fault("readings NaN", _reading(float("nan")), ("no numbers",), (0.015, 0.02)),
    Fault("readings infinite", _reading(float("inf")), ("no numbers",), (0.015, 0.02)),
    Fault("readings of 1e300", _reading(1e300), ("no numbers",), (0.015, 0.02)),
    Fault("saturated", _reading(156.9), ("clipped",), exact=False),
    Fault("unchanging", flat, ("never changes",), (1.0, 3.1), exact=False, over_s=BEGIN_S + 3.0),
    Fault("gravity missing", _gravity(0.0), ("without gravity",), lasts=True, compared=False, exact=False),
    Fault("gravity doubled", _gravity(2.0), ("gravity at rest reads",), lasts=True, exact=False),
    Fault("ten times the rate", ten_times, ("late", "twice", "rate is"), (0.0, 1.1), exact=False),
    Fault("two sensors on one topic", two_sources, ("late", "jitter", "interpolated"), (0.0, 1.1), exact=False),
)
"""For the seat, which predictions use, and the head, which they do not."""
