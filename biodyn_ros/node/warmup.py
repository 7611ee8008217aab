"""Warm-up: compile the kernels before subscribing; the first compilation takes seconds, a cached one a third.

`biodyn compile` does it at installation. Compiled code cannot be shipped: it is for one processor and one numba, and
its cache checks the dates of the source files.
"""

from __future__ import annotations

import time

import numpy as np

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.subject import Subject
from biodyn_core.pipeline.pipeline import Pipeline

_RATE_HZ = 1129.3  # the native rate, whose weightings are then designed already
_SECONDS = 1.2


def warm_up(subject: Subject) -> float:
    """Run the pipeline over a second of rest; return the largest sampling rate per sensor that it can process, Hz."""
    pipeline = Pipeline(subject)
    stamps_ns = np.rint(np.arange(round(_SECONDS * _RATE_HZ)) * (1e9 / _RATE_HZ)).astype(np.int64)
    samples = np.zeros((stamps_ns.size, 3))
    samples[:, 2] = STANDARD_GRAVITY_MPS2
    rest = round(0.9 * stamps_ns.size)
    samples[rest - 1, 2] *= 2.0  # only high readings reach the search for rails
    for sensor in SENSORS:
        pipeline.push(sensor, stamps_ns[:rest], samples[:rest])
    begin = time.perf_counter()
    for at in range(rest, stamps_ns.size):  # the seat sample by sample, as live
        pipeline.push(SEAT, stamps_ns[at : at + 1], samples[at : at + 1])
    for sensor in MEASURED_SEGMENTS:
        pipeline.push(sensor, stamps_ns[rest:], samples[rest:])
    pipeline.exposure()
    pipeline.seat()
    return (stamps_ns.size - rest) / (time.perf_counter() - begin)
