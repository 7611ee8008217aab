"""Sensor warnings: what gravity, clock and repeated readings of one sensor show to be wrong, in one line each."""

from __future__ import annotations

from typing import Final

from biodyn_core.base.sampling_rate import RATE_TOLERANCE
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.rest import Rest
from biodyn_core.conditioning.tilt import is_gravity

MAX_RATE_CHANGE: Final = 0.0199
"""The tracked rate stays within 2 % of that at rest; so close to this bound it is no longer tracked."""

MAX_JITTER: Final = 0.35
"""With more mean jitter than so many periods, stamps do not show lost samples."""

MAX_COARSE_JITTER: Final = 0.45
"""The same for quantised stamps: up to a quantum of 1.8 periods each single loss is found (by simulation)."""

QUANTUM_JITTERS: Final = 4.0
"""A quantum is so many times the mean jitter of stamps that are rounded to it."""

LEAST_READINGS: Final = 100
"""So many readings before clear changes show whether a driver sends each one several times."""

LEAST_REGULAR: Final = 0.5
"""It does if at least this share of them is sent as often as the one before."""

LEAST_SENT: Final = 1.9
"""It does if these are sent so often on average."""


def gravity_warnings(gravity_mps2: float, rest: Rest, known: Gravity | None, vertical_given: bool) -> list[str]:
    """Warnings of a gravity, either that of the rest or known before it."""
    lines = ["no rest found: gravity was averaged over motion"] if rest.in_motion else []
    if known is not None and (origin := known.warning(vertical_given)):
        lines.append(origin)
    if not is_gravity(gravity_mps2):
        lines.append(f"gravity at rest reads {gravity_mps2:.2f} m/s^2: gain, unit or mounting is wrong")
    return lines


def clock_warnings(rest: Rest, period_s: float, jitter_s: float) -> list[str]:
    """Warnings of a clock by its tracked period and its mean jitter."""
    lines = []
    if abs(period_s / rest.period_s - 1.0) > MAX_RATE_CHANGE:
        lines.append("the rate differs by 2 % from that at rest: unnoticed losses, or a change by the driver")
    if rest.coarse and jitter_s > MAX_COARSE_JITTER * rest.period_s:
        shared = f"several samples share a stamp (about {1e3 * QUANTUM_JITTERS * jitter_s:.2g} ms)"
        lines.append(f"{shared}: shorter losses may not be counted")
    elif not rest.coarse and jitter_s > MAX_JITTER * rest.period_s:
        lines.append(f"stamps jitter by {1e3 * jitter_s:.2g} ms, too much to detect lost samples")
    return lines


def repeated_reading_warnings(
    readings: int, regular: int, regular_sent: int, rate_hz: float, least_rate_hz: float
) -> list[str]:
    """A warning where a driver sends each reading several times: even stamps then pretend a faster sensor.

    readings: before clear changes; regular: those that are sent as often as the one before; regular_sent: how often
    these are sent in total.
    """
    if readings < LEAST_READINGS or regular < LEAST_REGULAR * readings or regular_sent < LEAST_SENT * regular:
        return []
    times = regular_sent / regular
    own_hz = rate_hz / times
    line = f"each reading is sent {round(times, 1):g} times: the sensor measures at about {own_hz:.0f} Hz"
    if own_hz < least_rate_hz * (1.0 - RATE_TOLERANCE):
        line += f", and motion above {0.5 * own_hz:.0f} Hz gives wrong figures"
    return [line]
