"""Compares a ride with a fault with the same ride without: messages, losses, errors."""

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

STARTING: Final = ("gravity needs", "waiting for rest", "no message")
"""Messages of every sensor at its start."""

WITHIN_S: Final = 2.0
"""Time after the end of a fault until everything must be normal."""

TOLERANCE_MPS2: Final = 0.05
"""Tolerance of predictions after a new fit of a clock; the ride has 1 m/s^2."""

DOSE_TOLERANCE: Final = 0.02
"""Relative tolerance of doses, apart from missing samples."""


@dataclass(frozen=True)
class Row:
    """One fault of one sensor: the diagnostic message, the recovery time, missing seconds, and the errors."""

    fault: str
    sensor: str
    message: str
    recovered_s: float | None
    missing_s: float
    wrong: tuple[str, ...]


@cache
def reference() -> Driven:
    """The ride without a fault."""
    return drive(ride())


def judged(fault: Fault, sensor: str) -> Row:
    """Drive a ride with one fault, and compare it."""
    driven = drive(ride() | {sensor: fault.spoil(ride()[sensor])})
    end_s = fault.over_s
    recovered = _recovered_s(driven, sensor, fault, end_s)
    wrong = (
        *_not_reported(driven, sensor, fault),
        *_about_others(driven, sensor),
        *_missed(driven, sensor, fault),
        *_wrong_numbers(driven, sensor, fault, end_s),
        *_wrong_doses(driven, sensor, fault),
        *([f"not normal {WITHIN_S:g} s after it"] if not fault.lasts and recovered is None else []),
    )
    message = next((m for m in _messages(driven, sensor) if any(word in m for word in fault.expected)), "")
    return Row(fault.name, sensor, message, recovered, driven.pipeline.losses(sensor).missing_s, wrong)


def _messages(driven: Driven, sensor: str) -> list[str]:
    return [check.statuses[sensor].message for check in driven.checks]


def _not_reported(driven: Driven, sensor: str, fault: Fault) -> Iterator[str]:
    if fault.expected and not any(word in message for message in _messages(driven, sensor) for word in fault.expected):
        yield f"no message with {' or '.join(fault.expected)}: {sorted(set(_messages(driven, sensor)))}"


def _about_others(driven: Driven, sensor: str) -> Iterator[str]:
    """A fault of one sensor must not be reported for others."""
    for name in SENSORS:
        found = {check.statuses[name].message for check in driven.checks if check.statuses[name].level != OK}
        found = {message for message in found if not any(word in message for word in STARTING)}
        if name != sensor and found:
            yield f"{name} is reported: {sorted(found)}"
        if name != sensor and driven.pipeline.losses(name).missing_s > 0.0:
            yield f"{name} is reported missing for {driven.pipeline.losses(name).missing_s:.3f} s"


def _missed(driven: Driven, sensor: str, fault: Fault) -> Iterator[str]:
    """The reported missing time must be correct."""
    low, high = fault.missing_s
    found = driven.pipeline.losses(sensor).missing_s
    if not low <= found <= high + 0.02:
        yield f"{found:.3f} s are reported missing, {low:g} to {high:g} are"


def _recovered_s(driven: Driven, sensor: str, fault: Fault, end_s: float) -> float | None:
    """Time from the fault's end until all later checks are normal; None if it is too long."""
    normal = [
        all(status.level == OK for name, status in check.statuses.items() if fault.compared or name != sensor)
        for check in driven.checks
    ]
    wrong_at = [check.time_s for check, is_normal in zip(driven.checks, normal, strict=True) if not is_normal]
    recovered = max(0.0, max([t for t in wrong_at if t > 1.5], default=0.0) - end_s)
    return recovered if recovered <= WITHIN_S else None


def _wrong_numbers(driven: Driven, sensor: str, fault: Fault, end_s: float) -> Iterator[str]:
    """Predictions must be those of the ride without the fault outside of it; comparisons must continue after it."""
    clean, found = reference().frames.predicted, driven.frames.predicted
    if sensor != SEAT:
        if not np.array_equal(clean.accel_mps2, found.accel_mps2):
            yield "predictions changed, which use the seat only"
    elif not fault.lasts and fault.compared:
        time_s = seconds_of(found.stamps_ns)
        late = (time_s > end_s + WITHIN_S) & (time_s < SECONDS)
        if late.sum() < 0.9 * (SECONDS - end_s - WITHIN_S) * RATE_HZ:
            yield f"{late.sum()} predictions after recovery"
        apart = np.abs(_at(found, time_s[late]) - _at(clean, time_s[late])).max(initial=0.0)
        if apart > TOLERANCE_MPS2:
            yield f"predictions differ by {apart:.3f} m/s^2 after recovery"
    if np.isinf(found.accel_mps2).any():
        yield "an infinite prediction"
    measured = driven.frames.measured
    time_s = seconds_of(measured.stamps_ns)
    here = (time_s > end_s + WITHIN_S) & (time_s < SECONDS - 1.5)
    column = measured.accel_mps2[here, SENSORS.index(sensor)]
    if fault.compared and not fault.lasts and not (column.size and np.isfinite(column).mean() > 0.99):
        yield "it is not compared again"
    if not fault.compared and np.isfinite(column).any() and sensor != SEAT:
        yield "it is compared with another clock"


def _at(frames, time_s: np.ndarray) -> np.ndarray:
    own_s = seconds_of(frames.stamps_ns)
    order = np.argsort(own_s, kind="stable")
    return np.column_stack([np.interp(time_s, own_s[order], column[order]) for column in frames.accel_mps2.T])


def _wrong_doses(driven: Driven, sensor: str, fault: Fault) -> Iterator[str]:
    """Doses must not exceed the true ones, apart from clipping and jitter; without losses they must be equal."""
    clean, found = reference().pipeline.exposure(), driven.pipeline.exposure()
    for name, dose in found.sensors.items():
        whole, bound = clean.sensors[name], driven.pipeline.losses(name).lower_bound
        if not np.isfinite([dose.vdv_mps175, dose.aw_mps2, dose.peak_mps2]).all():
            yield f"{name}: a dose is not finite"
        if name == sensor and not fault.exact:
            if not bound and not fault.expected and dose.vdv_mps175 > 1.1 * whole.vdv_mps175:
                yield f"{name}: VDV {dose.vdv_mps175:.3f}, {whole.vdv_mps175:.3f} without the fault, not reported"
            continue
        if dose.vdv_mps175 > (1.0 + DOSE_TOLERANCE) * whole.vdv_mps175:
            yield f"{name}: VDV {dose.vdv_mps175:.4f}, {whole.vdv_mps175:.4f} without the fault"
        if not bound and dose.vdv_mps175 < (1.0 - DOSE_TOLERANCE) * whole.vdv_mps175:
            yield f"{name}: VDV {dose.vdv_mps175:.4f}, {whole.vdv_mps175:.4f} without the fault, and no lower bound"
