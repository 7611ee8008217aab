"""Checkpoint: exposure since reset as plain data that outlives a process, and its identity.

Another subject or other sensor topics are another exposure; other settings are not. The time between two runs is
missing, so the figures of a continued exposure are lower bounds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.rest import Rest
from biodyn_core.exposure.losses import Losses

STORED_LOSSES: Final = 5
"""The first so many losses of a sensor are stored; its suspect seconds are among the totals of its meters."""


@dataclass(frozen=True, eq=False)
class SensorCheckpoint:
    """One sensor: its newest stamp, its losses up to `covered_ns`, its rest, and the totals of its meters by name.

    covered_ns lies beyond newest_ns where the sensor is silent: `losses` contain that silence.
    """

    newest_ns: int
    covered_ns: int
    losses: Losses
    rest: Rest
    totals: Mapping[str, Floats]


@dataclass(frozen=True, eq=False)
class ExposureCheckpoint:
    """Exposure since reset: digests that identify it, sensors by name, and the prediction's totals by name.

    elapsed_s: time since it began, breaks between runs included. A sensor that joins in a later run has missed it.
    """

    identity: Mapping[str, str]
    sensors: Mapping[str, SensorCheckpoint]
    prediction: Mapping[str, Floats]
    elapsed_s: float

    @property
    def newest_ns(self) -> int:
        """The newest stamp of all sensors."""
        return max(one.newest_ns for one in self.sensors.values())

    def differences(self, identity: Mapping[str, str]) -> str:
        """The names of the digests that differ from an identity, with commas; empty where all match."""
        return ", ".join(name for name in identity if self.identity.get(name) != identity[name])

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON."""
        return {
            "belongs": dict(self.identity),
            "sensors": {
                name: {
                    "newest_ns": one.newest_ns,
                    "told_ns": one.covered_ns,
                    "lost": list(one.losses[:STORED_LOSSES]),
                    "rest": dataclasses.asdict(one.rest),
                    "meters": _lists(one.totals),
                }
                for name, one in self.sensors.items()
            },
            "beside": _lists(self.prediction),
            "elapsed_s": self.elapsed_s,
        }

    @classmethod
    def from_dict(cls, document: object) -> ExposureCheckpoint:
        """Read the result of `to_dict`; raises InputError for anything else."""
        try:
            top = _mapping(document)
            sensors = {name: _sensor(_mapping(one)) for name, one in _mapping(top["sensors"]).items()}
            if not sensors or not set(sensors) <= set(SENSORS):
                raise ValueError("no sensors, or unknown ones")
            identity = {str(key): str(value) for key, value in _mapping(top["belongs"]).items()}
            elapsed_s = _number(top["elapsed_s"])
            if elapsed_s < 0.0:
                raise ValueError("elapsed_s is below zero")
            return cls(identity, sensors, _arrays(top["beside"]), elapsed_s)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"not a stored exposure ({' '.join(str(error).split())})") from None


def _lists(totals: Mapping[str, Floats]) -> dict[str, Any]:
    return {name: rows.tolist() for name, rows in totals.items()}


def _sensor(document: Mapping[str, Any]) -> SensorCheckpoint:
    losses = [_number(value) for value in document["lost"]]
    if len(losses) != STORED_LOSSES or min(losses) < 0.0:
        raise ValueError("lost: expected five numbers, none below zero")
    newest_ns, covered_ns = document["newest_ns"], document["told_ns"]
    if not (isinstance(newest_ns, int) and isinstance(covered_ns, int) and 0 <= newest_ns <= covered_ns < 2**63):
        raise ValueError("newest_ns or told_ns is not a stamp")
    return SensorCheckpoint(
        newest_ns, covered_ns, Losses(int(losses[0]), *losses[1:]), _rest(document["rest"]), _arrays(document["meters"])
    )


def _rest(document: object) -> Rest:
    given = dict(_mapping(document))
    for name in ("mean_mps2", "last_mps2"):
        x, y, z = (_number(value) for value in given[name])
        given[name] = x, y, z
    for name in ("period_s", "last_time_s", "jitter_s"):
        given[name] = _number(given[name])
    rest = Rest(**given)
    if not (0.0 < rest.period_s < 1.0 and rest.jitter_s >= 0.0 and isinstance(rest.samples, int)):
        raise ValueError("rest: period_s, jitter_s or samples out of range")
    return rest


def _mapping(value: object) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise TypeError("expected a mapping, found a list or a value")
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ValueError(f"{str(value)[:40]} is not a finite number")
    return float(value)


def _arrays(value: object) -> dict[str, Floats]:
    """Rows of finite numbers by name."""
    found = {name: np.array(rows, dtype=np.float64) for name, rows in _mapping(value).items()}
    for name, rows in found.items():
        if rows.ndim != 2 or not np.isfinite(rows).all():
            raise ValueError(f"{name}: expected rows of finite numbers")
    return found
