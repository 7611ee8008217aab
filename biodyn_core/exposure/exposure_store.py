"""Keeping: exposure since reset as plain data that outlives a process, and what must match before it goes on.

Another subject, other sensors or other settings are another exposure. What passed between two runs is missing, so
figures that go on are lower bounds.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.rest import Rest

STILL_AT_REST_S: Final = 60.0
"""A sensor that comes back so soon has the gravity and vertical that it had; later somebody may have taken it off."""


class Lost(NamedTuple):
    """What makes a sensor's figures lower bounds: samples clipped, and seconds that it did not truly measure.

    absent_s: seconds of which there is nothing; filled_s and flat_s are counted like others, though they were
    interpolated, or are of a reading that never changed.
    """

    clipped: int
    absent_s: float
    filled_s: float
    flat_s: float

    @property
    def missing_s(self) -> float:
        """All seconds that were not truly measured."""
        return self.absent_s + self.filled_s + self.flat_s

    @property
    def lower_bound(self) -> bool:
        """Whether figures are lower bounds because of it."""
        return self.clipped > 0 or self.missing_s > 0.0

    def since(self, before: Lost) -> Lost:
        """What was lost since then."""
        absent_s = max(0.0, self.absent_s - before.absent_s)  # a gap turns out to be none where time had leapt
        filled_s, flat_s = self.filled_s - before.filled_s, self.flat_s - before.flat_s
        return Lost(self.clipped - before.clipped, absent_s, filled_s, flat_s)

    def and_before(self, before: Lost) -> Lost:
        """What was lost by now and before."""
        absent_s, filled_s = self.absent_s + before.absent_s, self.filled_s + before.filled_s
        return Lost(self.clipped + before.clipped, absent_s, filled_s, self.flat_s + before.flat_s)


NOTHING_LOST: Final = Lost(0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class SensorCheckpoint:
    """One sensor: its newest stamp, up to when it is told what it lost, that, its rest, and what its meters counted.

    told_ns lies beyond newest_ns where the sensor had fallen silent: that silence is in `lost` already.
    """

    newest_ns: int
    told_ns: int
    lost: Lost
    rest: Rest
    meters: Mapping[str, Floats]


@dataclass(frozen=True, eq=False)
class ExposureCheckpoint:
    """Exposure since reset: of whom, by sensor, and beside the sensors that of the model and of comparisons."""

    belongs: Mapping[str, str]
    sensors: Mapping[str, SensorCheckpoint]
    beside: Mapping[str, Floats]

    @property
    def newest_ns(self) -> int:
        """The newest stamp of all."""
        return max(one.newest_ns for one in self.sensors.values())

    def newest_of(self, sensor: str) -> int:
        """The newest stamp of a sensor, by its own clock; of all where it sent nothing."""
        return self.sensors[sensor].newest_ns if sensor in self.sensors else self.newest_ns

    def foreign_to(self, belongs: Mapping[str, str]) -> str:
        """What tells it from an exposure that belongs so; empty where nothing does."""
        return ", ".join(name for name in belongs if self.belongs.get(name) != belongs[name])

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON."""
        return {
            "belongs": dict(self.belongs),
            "sensors": {
                name: {
                    "newest_ns": one.newest_ns,
                    "told_ns": one.told_ns,
                    "lost": list(one.lost),
                    "rest": dataclasses.asdict(one.rest),
                    "meters": _lists(one.meters),
                }
                for name, one in self.sensors.items()
            },
            "beside": _lists(self.beside),
        }

    @classmethod
    def from_dict(cls, document: object) -> ExposureCheckpoint:
        """Raises InputError for what `to_dict` never wrote."""
        try:
            top = _mapping(document)
            sensors = {name: _sensor(_mapping(one)) for name, one in _mapping(top["sensors"]).items()}
            if not sensors or not set(sensors) <= set(SENSORS):
                raise ValueError("no sensors, or unknown ones")
            belongs = {str(key): str(value) for key, value in _mapping(top["belongs"]).items()}
            return cls(belongs, sensors, _arrays(top["beside"]))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"no exposure that was kept ({' '.join(str(error).split())})") from None


def digest(document: object) -> str:
    """A short hash of plain data, the same for the same content."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _lists(meters: Mapping[str, Floats]) -> dict[str, Any]:
    return {name: rows.tolist() for name, rows in meters.items()}


def _sensor(document: Mapping[str, Any]) -> SensorCheckpoint:
    lost = [_number(value) for value in document["lost"]]
    if len(lost) != len(NOTHING_LOST) or min(lost) < 0.0:
        raise ValueError("a loss that is none")
    given = dict(_mapping(document["rest"]))
    for name in ("mean_mps2", "last_mps2"):
        x, y, z = (_number(value) for value in given[name])
        given[name] = x, y, z
    for name in ("period_s", "last_time_s", "jitter_s"):
        given[name] = _number(given[name])
    rest = Rest(**given)
    if not (0.0 < rest.period_s < 1.0 and rest.jitter_s >= 0.0 and isinstance(rest.samples, int)):
        raise ValueError("a rest that is none")
    newest_ns, told_ns = document["newest_ns"], document["told_ns"]
    if not (isinstance(newest_ns, int) and isinstance(told_ns, int) and 0 <= newest_ns <= told_ns < 2**63):
        raise ValueError("newest_ns or told_ns is no stamp")
    return SensorCheckpoint(newest_ns, told_ns, Lost(int(lost[0]), *lost[1:]), rest, _arrays(document["meters"]))


def _mapping(value: object) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("a list or a value where names are expected")
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ValueError(f"{str(value)[:40]} is no finite number")
    return float(value)


def _arrays(value: object) -> dict[str, Floats]:
    """Rows of finite numbers."""
    found = {name: np.array(rows, dtype=np.float64) for name, rows in _mapping(value).items()}
    for name, rows in found.items():
        if rows.ndim != 2 or not np.isfinite(rows).all():
            raise ValueError(f"{name}: expected rows of finite numbers")
    return found
