"""First stamps: whether a stored exposure is recent enough, by the stamps of the sensors after a restart.

One stamp decides nothing: it may be stray, or come from a clock of its own.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from biodyn_core.base.arrays import Integers
from biodyn_core.base.segments import SEAT
from biodyn_core.exposure.checkpoint import ExposureCheckpoint
from biodyn_core.pipeline.continued_exposure import FIRST_SAMPLES

PATIENCE_S: Final = 10.0
"""Samples of one sensor for this time, by its stored rate, are enough to decide without the other sensors.

Drivers that start together send sooner; until then nothing is predicted, and all samples are held.
"""


class FirstStamps:
    """`add` stamps of all sensors until the checkpoint is continued or refused.

    Continued: by any stored sensor whose newest stamps lie within max_age_h of its own stored ones. Refused: when no
    stored sensor fits, or none has sent, and one sensor has sent for `PATIENCE_S`; then a sensor that fits the newest
    of all stored stamps still continues it.
    """

    def __init__(self, checkpoint: ExposureCheckpoint, max_age_h: float) -> None:
        self._checkpoint, self._max_age_h = checkpoint, max_age_h
        self._newest: dict[str, Integers] = {}
        self._samples: dict[str, int] = {}

    def add(self, sensor: str, stamps_ns: Integers) -> str | None:
        """Add stamps (n,) ns; return None while nothing is decided, "" to continue, or why not."""
        given_ns = stamps_ns[stamps_ns != 0]  # a stamp of zero was never set
        before_ns = self._newest.get(sensor, given_ns[:0])
        self._newest[sensor] = np.concatenate([before_ns, given_ns])[-FIRST_SAMPLES:]
        self._samples[sensor] = self._samples.get(sensor, 0) + stamps_ns.size
        stored = self._checkpoint.sensors
        ages_h = {name: self._age_h(name, stored[name].newest_ns) for name in self._confirmed() if name in stored}
        if any(self._fits(age_h) for age_h in ages_h.values()):
            return ""
        if len(ages_h) < len(stored) and not self._is_patience_over(sensor):
            return None
        others_h = {name: self._age_h(name, self._checkpoint.newest_ns) for name in self._confirmed()}
        if any(self._fits(age_h) for age_h in others_h.values()):
            return ""
        return self._refusal(others_h | ages_h)

    def _confirmed(self) -> list[str]:
        """The sensors with enough stamps."""
        return [name for name, stamps_ns in self._newest.items() if stamps_ns.size >= FIRST_SAMPLES]

    def _age_h(self, sensor: str, stored_ns: int) -> float:
        """Age by the median of a sensor's newest stamps, so that stray ones do not count."""
        return (int(np.sort(self._newest[sensor])[FIRST_SAMPLES // 2]) - stored_ns) / 3.6e12

    def _fits(self, age_h: float) -> bool:
        return abs(age_h) <= self._max_age_h

    def _is_patience_over(self, sensor: str) -> bool:
        # By the present rate, which may be another than the stored one; few stamps do not show it.
        newest_ns = self._newest[sensor]
        period_s = 1e-9 * float(np.median(np.diff(np.sort(newest_ns)))) if newest_ns.size == FIRST_SAMPLES else 0.0
        stored_s = max(one.rest.period_s for one in self._checkpoint.sensors.values())
        return self._samples[sensor] * (period_s or stored_s) >= PATIENCE_S

    def _refusal(self, ages_h: dict[str, float]) -> str:
        if not ages_h:
            return "no sensor sends stamps that show how old it is"
        age_h = ages_h.get(SEAT, next(iter(ages_h.values())))
        when = f"{age_h:.1f} h older" if age_h > 0.0 else f"{-age_h:.1f} h newer"
        return f"by its stamps it is {when} than the first samples, up to {self._max_age_h:g} h is continued"
