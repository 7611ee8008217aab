"""Findings: the rests, events and faults of a session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from biodyn_core.base.arrays import Floats
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.conditioning.tilt import Vector
from biodyn_core.sessions.relative_drift import RelativeDrift
from biodyn_core.signals.waterfall import Waterfall


@dataclass(frozen=True)
class Rest:
    """A rest of the seat, and the mean reading, (3,) m/s^2, of the sensors that rested too."""

    begin_s: float
    end_s: float
    gravity_mps2: Mapping[str, Vector]


@dataclass(frozen=True)
class Shock:
    """The largest peak of a group of shocks, vertical, low-passed."""

    time_s: float
    peak_mps2: float


@dataclass(frozen=True)
class Event:
    """A part of a session: times in seconds after the seat's first sample; case: its loading condition.

    peak and level: vertical, low-passed, peak and rms; aw: Wk-weighted rms. rest: number of the rest whose gravity is
    used, None without any. quality: faults within it, a line each.
    """

    name: str
    begin_s: float
    end_s: float
    case: str
    peak_mps2: float
    peak_s: float
    level_mps2: float
    aw_mps2: float
    shocks: tuple[Shock, ...]
    rest: int | None
    quality: tuple[str, ...]


@dataclass(frozen=True)
class Fault:
    """A stretch in which a sensor gives no usable samples; kind: missing, clipped or stuck."""

    sensor: str
    kind: str
    begin_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class Timeline:
    """The seat over time: rms and peak of the vertical acceleration, low-passed, (t,) by interval of width_s.

    NaN without a sample.
    """

    width_s: float
    rms_mps2: Floats
    peak_mps2: Floats


@dataclass(frozen=True, eq=False)
class Findings:
    """The results of a session.

    seconds: length of the seat's record. waterfall: of its vertical acceleration. drifts: of the clocks of sensors
    against the seat's, where they are sure and noticeable.
    """

    seconds: float
    rests: tuple[Rest, ...]
    events: tuple[Event, ...]
    faults: tuple[Fault, ...]
    timeline: Timeline
    waterfall: Waterfall | None
    statuses: Mapping[str, SensorStatus]
    drifts: Mapping[str, RelativeDrift]
    warnings: tuple[str, ...]
