"""A driven ride judged beside the same ride without a fault: what was said, what was lost, what was wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_ros.node.health import OK
from faults.drive import Driven, drive, seconds_of
from faults.ride import RATE_HZ, SECONDS, ride
from faults.stamps import Fault

BEGINNING: Final = ("gravity needs", "waiting for rest", "no message")
"""Said of every sensor that begins."""

WITHIN_S: Final = 2.0
"""So long after a fault's end everything is to be normal again."""

NEAR_MPS2: Final = 0.05
"""Predictions may differ by so much where a clock is followed anew; the ride is of 1 m/s^2."""

AS_GOOD: Final = 0.02
"""Doses may differ by this share beyond what is missing."""


@dataclass(frozen=True)
class Row:
    """What was injected where, what was said, after how long all was normal, what is missing, what is wrong."""

    fault: str
    sensor: str
    said: str
    recovered_s: float | None
    missing_s: float
    wrong: tuple[str, ...]


@cache
def unspoilt() -> Driven:
    """The ride as it is."""
    return drive(ride())


def judged(fault: Fault, sensor: str) -> Row:
    """Drive a ride with one fault, and judge it."""
    driven = drive(ride() | {sensor: fault.spoil(ride()[sensor])})
    end_s = fault.over_s
    recovered = _recovered_s(driven, sensor, fault, end_s)
    wrong = (
        *_unsaid(driven, sensor, fault),
        *_about_others(driven, sensor),
        *_missed(driven, sensor, fault),
        *_wrong_numbers(driven, sensor, fault, end_s),
        *_wrong_doses(driven, sensor, fault),
        *([f"not normal {WITHIN_S:g} s after it"] if not fault.lasts and recovered is None else []),
    )
    said = next((m for m in _messages(driven, sensor) if any(word in m for word in fault.says)), "")
    return Row(fault.name, sensor, said, recovered, driven.pipeline.losses(sensor).missing_s, wrong)


def _messages(driven: Driven, sensor: str) -> list[str]:
    return [look.statuses[sensor].message for look in driven.looks]


def _unsaid(driven: Driven, sensor: str, fault: Fault) -> Iterator[str]:
    if fault.says and not any(word in message for message in _messages(driven, sensor) for word in fault.says):
        yield f"nothing said of {' or '.join(fault.says)}: {sorted(set(_messages(driven, sensor)))}"


def _about_others(driven: Driven, sensor: str) -> Iterator[str]:
    """A fault of one is nobody else's."""
    for name in SENSORS:
        said = {look.statuses[name].message for look in driven.looks if look.statuses[name].level != OK}
        said = {message for message in said if not any(word in message for word in BEGINNING)}
        if name != sensor and said:
            yield f"{name} is blamed: {sorted(said)}"
        if name != sensor and driven.pipeline.losses(name).missing_s > 0.0:
            yield f"{name} is called missing for {driven.pipeline.losses(name).missing_s:.3f} s"


def _missed(driven: Driven, sensor: str, fault: Fault) -> Iterator[str]:
    """What is missing is said, and nothing that is not."""
    low, high = fault.missing_s
    found = driven.pipeline.losses(sensor).missing_s
    if not low <= found <= high + 0.02:
        yield f"{found:.3f} s are called missing, {low:g} to {high:g} are"


def _recovered_s(driven: Driven, sensor: str, fault: Fault, end_s: float) -> float | None:
    """From the fault's end to the first look from which on all looks are normal; None where that is too late."""
    normal = [
        all(status.level == OK for name, status in look.statuses.items() if fault.compared or name != sensor)
        for look in driven.looks
    ]
    wrong_at = [look.time_s for look, fine in zip(driven.looks, normal, strict=True) if not fine]
    recovered = max(0.0, max([t for t in wrong_at if t > 1.5], default=0.0) - end_s)
    return recovered if recovered <= WITHIN_S else None


def _wrong_numbers(driven: Driven, sensor: str, fault: Fault, end_s: float) -> Iterator[str]:
    """Predictions are those of the ride without the fault, where nothing is spoilt; comparisons come again."""
    clean, found = unspoilt().frames.predicted, driven.frames.predicted
    if sensor != SEAT:
        if not np.array_equal(clean.accel_mps2, found.accel_mps2):
            yield "predictions changed, which need the seat alone"
    elif not fault.lasts and fault.compared:
        time_s = seconds_of(found.stamps_ns)
        late = (time_s > end_s + WITHIN_S) & (time_s < SECONDS)
        if late.sum() < 0.9 * (SECONDS - end_s - WITHIN_S) * RATE_HZ:
            yield f"{late.sum()} predictions after recovery"
        apart = np.abs(_at(found, time_s[late]) - _at(clean, time_s[late])).max(initial=0.0)
        if apart > NEAR_MPS2:
            yield f"predictions are off by {apart:.3f} m/s^2 after recovery"
    if np.isinf(found.accel_mps2).any():
        yield "an infinite prediction"
    measured = driven.frames.measured
    time_s = seconds_of(measured.stamps_ns)
    here = (time_s > end_s + WITHIN_S) & (time_s < SECONDS - 1.5)
    column = measured.accel_mps2[here, SENSORS.index(sensor)]
    if fault.compared and not fault.lasts and not (column.size and np.isfinite(column).mean() > 0.99):
        yield "it is not compared again"
    if not fault.compared and np.isfinite(column).any() and sensor != SEAT:
        yield "it is compared, by a clock that is not the others'"


def _at(frames, time_s: np.ndarray) -> np.ndarray:
    own_s = seconds_of(frames.stamps_ns)
    order = np.argsort(own_s, kind="stable")
    return np.column_stack([np.interp(time_s, own_s[order], column[order]) for column in frames.accel_mps2.T])


def _wrong_doses(driven: Driven, sensor: str, fault: Fault) -> Iterator[str]:
    """Never more than was there, but for what clipping and jitter make of it; without losses as much."""
    clean, found = unspoilt().pipeline.exposure(), driven.pipeline.exposure()
    for name, dose in found.sensors.items():
        whole, bound = clean.sensors[name], driven.pipeline.losses(name).lower_bound
        if not np.isfinite([dose.vdv_mps175, dose.aw_mps2, dose.peak_mps2]).all():
            yield f"{name}: a dose that is no number"
        if name == sensor and not fault.exact:
            if not bound and not fault.says and dose.vdv_mps175 > 1.1 * whole.vdv_mps175:
                yield f"{name}: VDV {dose.vdv_mps175:.3f}, {whole.vdv_mps175:.3f} without the fault, and no word of it"
            continue
        if dose.vdv_mps175 > (1.0 + AS_GOOD) * whole.vdv_mps175:
            yield f"{name}: VDV {dose.vdv_mps175:.4f}, {whole.vdv_mps175:.4f} without the fault"
        if not bound and dose.vdv_mps175 < (1.0 - AS_GOOD) * whole.vdv_mps175:
            yield f"{name}: VDV {dose.vdv_mps175:.4f}, {whole.vdv_mps175:.4f} without the fault, and no lower bound"
