"""Pipeline: six raw streams in, predictions, aligned measurements, residual and exposure out; live and replay are one.

The live node pushes from callbacks, replay from a bag. Predictions need the seat alone and never wait; measurements and
residual wait for the slowest sensor, in stamp time and within a bound. Any cut into blocks and any interleaving of the
sensors within that bound gives the same frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biodyn_core.comparison import NO_MEASURED, Comparison, MeasuredFrames
from biodyn_core.conditioning import Block, Conditioner, ConditioningSettings, SensorStatus
from biodyn_core.errors import InputError
from biodyn_core.exposure import Dose, DoseMeter, Dri, DriMeter, Hic, HicMeter, HorizontalMeter
from biodyn_core.limits import EU_LIMITS, Limits, SeatExposure, seat_exposure
from biodyn_core.model import Chain, Stepper
from biodyn_core.segments import MEASURED_SEGMENTS, N_SEGMENTS, SEAT, SEGMENTS, SENSORS
from biodyn_core.settings import check_settings, setting
from biodyn_core.subject import Subject

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

HEAD: Final = SENSORS[-1]
METER_BATCH: Final = 128
"""Exposure is counted in batches of at least so many samples, predictions come first. No figure depends on it."""

MISSING_SHARE_TRUSTED: Final = 0.01
"""Times to the limits are withheld once more of the seat's record than this is missing."""


@dataclass(frozen=True)
class PipelineSettings:
    """What the pipeline itself may be told; conditioning has settings of its own."""

    window_s: float = setting(10.0, "length of the rolling window", "s", 0.5, 3600.0)
    wait_s: float = setting(1.0, "how long measurements wait for the slowest sensor, in stamp time", "s", 0.3, 10.0)
    yaw_deg: float | None = setting(None, "angle from forward to the seat sensor's first axis", "deg", -360.0, 360.0)

    def __post_init__(self) -> None:
        check_settings(self)


class PredictedFrames(NamedTuple):
    """Predictions: stamps_ns (n,) of the instants answered, accel_mps2 (n, 6) absolute, gravity-free, up."""

    stamps_ns: Integers
    accel_mps2: Floats


NO_PREDICTED: Final = PredictedFrames(np.empty(0, dtype=np.int64), np.empty((0, N_SEGMENTS)))


class Frames(NamedTuple):
    """What one push brought forth; either part may be empty."""

    predicted: PredictedFrames
    measured: MeasuredFrames


@dataclass(frozen=True)
class Exposure:
    """Every figure of one span (since reset, or rolling). Whatever has not been counted yet is absent.

    sensors: Wk-weighted, before the low-pass; predicted and measured_low_passed are comparable with each other.
    residual: (rms m/s^2, rms over measured rms in percent) by segment.
    """

    sensors: dict[str, Dose]
    predicted: dict[str, Dose]
    measured_low_passed: dict[str, Dose]
    dri: Dri | None
    hic15: Hic | None
    hic36: Hic | None
    residual: dict[str, tuple[float, float]]


class Pipeline:
    """`push(sensor, stamps_ns, samples)` gives frames, `finish()` those still waiting, `exposure()` the figures."""

    def __init__(
        self,
        subject: Subject,
        conditioning: ConditioningSettings | None = None,
        settings: PipelineSettings | None = None,
        limits: Limits = EU_LIMITS,
    ) -> None:
        self.subject = subject
        self.settings = settings or PipelineSettings()
        self.limits = limits
        self._chain = Chain.of(subject)
        self._conditioners = {name: Conditioner(name, conditioning) for name in SENSORS}
        self._meters: dict[str, _SensorMeters] = {}
        self._seat: _SeatSide | None = None
        self._early: list[tuple[str, list[Block]]] = []

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> Frames:
        """Take raw specific force (n, 3) m/s^2 of one sensor with its stamps (n,) ns, in order of arrival."""
        blocks = self._condition(sensor, stamps_ns, samples_mps2)
        if not blocks:
            return Frames(NO_PREDICTED, NO_MEASURED)
        self._count(sensor, blocks)
        if sensor == SEAT:
            return self._predict(blocks)
        return Frames(NO_PREDICTED, self._compare(sensor, blocks))

    def finish(self) -> Frames:
        """Give up waiting: answer every instant still pending with what is there."""
        return Frames(NO_PREDICTED, self._seat.comparison.release(give_up=True) if self._seat else NO_MEASURED)

    def reset(self) -> None:
        """Start exposure "since reset" anew; filters, model and rolling figures go on."""
        for meters in self._meters.values():
            meters.reset()
        if self._seat:
            self._seat.reset()

    def exposure(self, rolling: bool = False) -> Exposure:
        """The figures since reset, or over the last `window_s`."""
        seat, head, side = self._meters.get(SEAT), self._meters.get(HEAD), self._seat
        return Exposure(
            sensors={name: meters.vertical(rolling) for name, meters in self._meters.items()},
            predicted=side.predicted(rolling) if side else {},
            measured_low_passed=side.measured(rolling, tuple(self._meters)) if side else {},
            dri=seat.dri(rolling) if seat else None,
            hic15=head.hic(0, rolling) if head else None,
            hic36=head.hic(1, rolling) if head else None,
            residual=side.residual(rolling) if side else {},
        )

    def seat(self) -> SeatExposure | None:
        """The seat's three axes against the limits, since reset; None until the seat counts."""
        meters = self._meters.get(SEAT)
        if meters is None:
            return None
        yaw = None if self.settings.yaw_deg is None else -math.radians(self.settings.yaw_deg)
        trusted = not self.lower_bound(SEAT, MISSING_SHARE_TRUSTED)
        return seat_exposure(meters.vertical(), meters.plane(), yaw, self.limits, trusted)

    def status(self, sensor: str) -> SensorStatus:
        """What a sensor's conditioning has seen."""
        return self._conditioners[sensor].status()

    def missing_s(self, sensor: str) -> float:
        """Seconds of a sensor's record that are interpolated, lie in gaps, or have passed since it fell silent."""
        status = self.status(sensor)
        interpolated_s = status.filled / status.rate_hz if status.rate_hz else 0.0
        return status.gap_s + interpolated_s + self._silent_s(sensor)

    def _silent_s(self, sensor: str) -> float:
        """How far a sensor's newest stamp lies behind the newest of all, once that is longer than `wait_s`."""
        own = self._conditioners[sensor].newest_ns
        newest = [stamp for c in self._conditioners.values() if (stamp := c.newest_ns) is not None]
        silent_s = 1e-9 * (max(newest) - own) if own is not None else 0.0
        return silent_s if silent_s > self.settings.wait_s else 0.0

    def lower_bound(self, sensor: str, share: float = 0.0) -> bool:
        """Whether the sensor's figures are lower bounds: samples clipped, or more than a share of them missing."""
        missing = self.missing_s(sensor)
        counted = self._meters[sensor].vertical().seconds if sensor in self._meters else 0.0
        return self.status(sensor).clipped > 0 or missing > share * (counted + missing)

    @property
    def substeps(self) -> int | None:
        """Integration steps per seat sample; None until the seat's rate is known."""
        return self._seat.stepper.substeps if self._seat else None

    @property
    def divergences(self) -> int:
        """How often the model left the finite numbers and was put back to rest."""
        return self._seat.divergences if self._seat else 0

    def _condition(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> list[Block]:
        if sensor not in self._conditioners:
            raise InputError(f"sensor {sensor!r} is unknown, known are {', '.join(SENSORS)}")
        return self._conditioners[sensor].push(stamps_ns, samples_mps2)

    def _count(self, sensor: str, blocks: list[Block]) -> None:
        """Measured exposure comes before the low-pass, at the sensor's own rate."""
        if sensor not in self._meters:
            self._meters[sensor] = _SensorMeters(sensor, self._conditioners[sensor].rate_hz, self.settings.window_s)
        for block in blocks:
            self._meters[sensor].push(block)

    def _predict(self, blocks: list[Block]) -> Frames:
        """Carry the chain over the seat's samples; what they complete in the comparison comes along."""
        if self._seat is None:
            self._seat = _SeatSide(self._chain, self._conditioners[SEAT].rate_hz, self.settings)
            for sensor, early in self._early:
                self._seat.comparison.sensor(sensor, early)
            self._early.clear()
        side = self._seat
        accel = [side.push(block) for block in blocks]
        measured = side.comparison.release() if side.comparison.overdue or blocks[0].stamps_ns.size > 1 else NO_MEASURED
        if len(blocks) == 1:
            return Frames(PredictedFrames(blocks[0].stamps_ns, accel[0]), measured)
        stamps = np.concatenate([block.stamps_ns for block in blocks])
        return Frames(PredictedFrames(stamps, np.concatenate(accel)), measured)

    def _compare(self, sensor: str, blocks: list[Block]) -> MeasuredFrames:
        if self._seat is None:
            self._early.append((sensor, blocks))
            return NO_MEASURED
        self._seat.comparison.sensor(sensor, blocks)
        return self._seat.comparison.release()


class _Batch:
    """Gathers rows until there are METER_BATCH; a run's first row is preceded by NaN, the meters' sign of a break."""

    def __init__(self, columns: int) -> None:
        self._break = np.full((1, columns), np.nan)
        self._rows: list[Floats] = []
        self._size = 0

    def add(self, rows: Floats, begins_run: bool) -> Floats | None:
        """Add rows (n, c); returns what has gathered once it is enough."""
        if begins_run:
            self._rows.append(self._break)
        self._rows.append(rows)
        self._size += rows.shape[0]
        return self.take() if self._size >= METER_BATCH else None

    def take(self) -> Floats | None:
        """Hand out what has gathered, None where that is nothing."""
        if not self._rows:
            return None
        rows = np.concatenate(self._rows)
        self._rows, self._size = [], 0
        return rows


class _SensorMeters:
    """One sensor's exposure at its native rate: Wk for all, Wd and DRI for the seat, HIC for the head."""

    def __init__(self, sensor: str, rate_hz: float, window_s: float) -> None:
        self._batch = _Batch(3)
        self._vertical = DoseMeter("Wk", rate_hz, 1, window_s)
        self._plane = HorizontalMeter(rate_hz, window_s) if sensor == SEAT else None
        self._dri = DriMeter(rate_hz, window_s) if sensor == SEAT else None
        self._hics = [HicMeter(rate_hz, length, window_s) for length in (0.015, 0.036)] if sensor == HEAD else []

    def push(self, block: Block) -> None:
        self._digest(self._batch.add(block.levelled_mps2, block.begins_run))

    def _digest(self, rows: Floats | None) -> None:
        if rows is None:
            return
        up = np.ascontiguousarray(rows[:, 2:])
        self._vertical.push(up)
        if self._dri:
            self._dri.push(up)
        if self._plane:
            self._plane.push(np.ascontiguousarray(rows[:, :2]))
        for hic in self._hics:
            hic.push(rows)

    def _settle(self) -> None:
        self._digest(self._batch.take())

    def vertical(self, rolling: bool = False) -> Dose:
        self._settle()
        return (self._vertical.rolling() if rolling else self._vertical.since_reset())[0]

    def plane(self) -> HorizontalMeter:
        self._settle()
        assert self._plane is not None
        return self._plane

    def dri(self, rolling: bool) -> Dri:
        self._settle()
        assert self._dri is not None
        return self._dri.rolling() if rolling else self._dri.since_reset()

    def hic(self, which: int, rolling: bool) -> Hic:
        self._settle()
        return self._hics[which].rolling() if rolling else self._hics[which].since_reset()

    def reset(self) -> None:
        self._settle()
        for meter in (self._vertical, self._plane, self._dri, *self._hics):
            if meter:
                meter.reset()


class _SeatSide:
    """What lives on the seat's grid: the model, the doses of its predictions, and the comparison with the sensors."""

    def __init__(self, chain: Chain, rate_hz: float, settings: PipelineSettings) -> None:
        self.stepper = Stepper(chain, rate_hz)
        self.divergences = 0
        self.comparison = Comparison(rate_hz, settings.wait_s, settings.window_s)
        self.doses = DoseMeter("Wk", rate_hz, N_SEGMENTS, settings.window_s)
        self._batch = _Batch(N_SEGMENTS)

    def push(self, block: Block) -> Floats:
        """Predict the segments' accelerations (n, 6); each run starts from rest."""
        if block.begins_run:
            self.stepper.reset()
        accel = self.stepper.push(block.low_passed_mps2)
        if not math.isfinite(accel[-1, 0] + accel[-1, -1]):
            self._restart_behind_divergence(block.low_passed_mps2, accel)
        self._digest(self._batch.add(accel, block.begins_run))
        self.comparison.seat(block, accel)
        return accel

    def _digest(self, rows: Floats | None) -> None:
        if rows is not None:
            self.doses.push(rows)

    def _restart_behind_divergence(self, seat_mps2: Floats, accel: Floats) -> None:
        """Never a wrong number as a good one: predict nothing where the chain left the finite numbers, and start anew.

        Sample by sample the same as in blocks: once it has diverged, every later row of a block is not finite either.
        """
        lost: list[int] = []
        start = 0
        while not (finite := np.isfinite(accel[start:]).all(axis=1)).all():
            lost.append(start + int(np.argmin(finite)))
            start = lost[-1] + 1
            self.stepper.reset()
            accel[start:] = self.stepper.push(seat_mps2[start:])
        accel[lost] = np.nan
        self.divergences += len(lost)

    def reset(self) -> None:
        self._digest(self._batch.take())
        self.doses.reset()
        self.comparison.reset()

    def predicted(self, rolling: bool) -> dict[str, Dose]:
        self._digest(self._batch.take())
        return dict(zip(SEGMENTS, self.doses.rolling() if rolling else self.doses.since_reset(), strict=True))

    def measured(self, rolling: bool, sensors: tuple[str, ...]) -> dict[str, Dose]:
        doses = self.comparison.doses.rolling() if rolling else self.comparison.doses.since_reset()
        return {name: dose for name, dose in zip(SENSORS, doses, strict=True) if name in sensors}

    def residual(self, rolling: bool) -> dict[str, tuple[float, float]]:
        meter = self.comparison.residual
        rms, percent = meter.rolling() if rolling else meter.since_reset()
        pairs = zip(MEASURED_SEGMENTS, rms.tolist(), percent.tolist(), strict=True)
        return {name: (value, share) for name, value, share in pairs if not math.isnan(value)}
