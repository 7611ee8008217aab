"""A ride without faults: samples of six sensors in order of arrival."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis import imu_streams, load_case
from biodyn_ros.base.resources import subject_file

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RATE_HZ: Final = 1129.3
START_NS: Final = 1_767_225_600 * 10**9
SECONDS: Final = 14.0
BEGIN_S, END_S = 6.0, 7.0
"""Start and end of faults, unless they last."""


@dataclass(frozen=True, eq=False)
class Arriving:
    """One sensor's samples in order of arrival: arrival_s (n,) since the start, stamps_ns (n,), accel_mps2 (n, 3)."""

    arrival_s: Floats
    stamps_ns: Integers
    accel_mps2: Floats

    def only(self, kept: NDArray[np.bool_]) -> Arriving:
        """The selected samples."""
        return Arriving(self.arrival_s[kept], self.stamps_ns[kept], self.accel_mps2[kept])

    def ordered(self) -> Arriving:
        """The samples sorted by arrival."""
        order = np.argsort(self.arrival_s, kind="stable")
        return Arriving(self.arrival_s[order], self.stamps_ns[order], self.accel_mps2[order])

    def but(self, **changed: Any) -> Arriving:
        """The same with other arrays."""
        return replace(self, **changed)

    def within(self, begin_s: float = BEGIN_S, end_s: float = END_S) -> NDArray[np.bool_]:
        """Samples that arrive during the fault."""
        return (self.arrival_s >= begin_s) & (self.arrival_s < end_s)


@cache
def subject() -> Subject:
    """The paper's first subject."""
    return load_subject(subject_file("subject_1"))


@cache
def ride() -> dict[str, Arriving]:
    """All six sensors on a road, with noise, tilt and jitter, without delay."""
    rng = np.random.default_rng(11)
    streams = imu_streams(subject(), load_case("road", SECONDS - 2.0, rng), rng, start_ns=START_NS)
    return {one.sensor: Arriving(1e-9 * (one.stamps_ns - START_NS), one.stamps_ns, one.accel_mps2) for one in streams}
