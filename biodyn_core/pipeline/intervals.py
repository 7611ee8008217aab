"""Intervals of predictions: the spread of every predicted figure, and of the acceleration second by second.

A fitted subject has the covariance of its parameters and the usual residual of its held-out events. Both are needed.
A subject of the population has the covariance between people alone: what the model misses of them is not known.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import signal  # noqa: TID253 - loads all parts before the first sample of a pipeline, not at it

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import N_SEGMENTS, SEGMENTS
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.origin import origin_of
from biodyn_core.body.parameter_spread import largest_steps, neighbours, parameter_spread
from biodyn_core.body.subject import Subject
from biodyn_core.body.usual_residual import UsualResidual, usual_residuals
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.effects import beyond_vertical
from biodyn_core.exposure.figure_spread import (
    ACCEL_FACTORS,
    FORCE_FACTORS,
    FigureSpread,
    PeakSpread,
    PeakSpreadMeter,
    SpreadMeter,
)
from biodyn_core.exposure.meters import Meter
from biodyn_core.exposure.sensor_meters import Batch
from biodyn_core.pipeline.windows import LEAST_COVERED, SecondWindows, Window
from biodyn_core.signals.octaves import N_BANDS, octave_squares
from biodyn_core.signals.weighting import weighting_sections

NEIGHBOURS: Final = 4
"""Steps to neighbouring chains: four have nearly the spread of as many as there are parameters (docs/science.md)."""

NO_WINDOW: Final = "no whole second was predicted"
"""Why predictions of a subject with a spread have no interval."""

PIECE: Final = 1000
"""Samples of a whole run that are carried at once: little memory, and a chain that diverges soon begins again."""

REMEMBERED: Final = 120
"""Windows whose spread of the acceleration is remembered, for curves."""


class AccelSpread(NamedTuple):
    """Standard deviation of the predicted acceleration of each segment (6,), m/s^2, in a second from begin_ns."""

    begin_ns: int
    accel_mps2: Floats


class ForceSpread(NamedTuple):
    """Standard deviations of the logarithms of a joint force's rms and peaks; None without a peak."""

    of_rms: float
    of_compression: float | None
    of_tension: float | None


class SegmentSpread(NamedTuple):
    """Spreads of the figures of one segment, and of the force in the joint below it."""

    accel: FigureSpread
    force: ForceSpread


@dataclass(frozen=True, eq=False)
class PredictionSpread:
    """Errors of a subject's predictions: chains one standard deviation off, and the share of the motion missed.

    share (6, 6): by band and segment; mass_kg (6,): of the segments. both_sides: the second half of the chains is
    opposite the first, because the covariance is that between people, along which figures bend.
    """

    chains: tuple[Chain, ...]
    share: Floats
    mass_kg: Floats
    both_sides: bool = False


def undriven(subject: Subject) -> str:
    """Why the seat's vertical alone does not drive the neighbouring chains; empty if it does."""
    found = beyond_vertical(subject.effects)
    return f"its effect {found.effect.name} needs more than the vertical acceleration of the seat" if found else ""


def prediction_spread(subject: Subject) -> tuple[PredictionSpread | None, str]:
    """The spread of a subject's predictions, and why there is none, empty if there is."""
    parameters, no_parameters = parameter_spread(subject.provenance)
    laws, no_laws = usual_residuals(subject.provenance)
    if parameters is None or (no_laws and origin_of(subject) != "group"):
        return None, no_parameters or no_laws
    steps, between_people = largest_steps(subject, parameters, NEIGHBOURS), bool(no_laws)
    chains = neighbours(subject, np.concatenate([steps, -steps]) if between_people else steps)
    return PredictionSpread(tuple(chains), _shares(laws), Chain.of(subject).mass_kg, between_people), ""


def _shares(laws: Mapping[str, UsualResidual]) -> Floats:
    """The shares (6, 6) by band and segment: without a law the largest of those beside it, without any law zero."""
    if not laws:
        return np.zeros((N_BANDS, N_SEGMENTS))
    known = {SEGMENTS.index(name): np.array(law.share) for name, law in laws.items()}
    columns = []
    for segment in range(N_SEGMENTS):
        nearest = min(abs(other - segment) for other in known)
        columns.append(np.max([share for other, share in known.items() if abs(other - segment) == nearest], axis=0))
    return np.column_stack(columns)


class IntervalEstimator:
    """`push` the seat with its predictions; read the `spreads` of the figures, and `recent` ones of the acceleration.

    meter: of the segments' weighted accelerations (6) and of the joint forces (6). accel_peaks, force_peaks: of the
    weighted peaks of the segments, and of the peaks of the joint forces, by the chains' own peaks; None unless there
    are chains on both sides. (By `meter` 80 % of the weighted peaks and 71 % of the peaks of forces of the people of
    the population were within their interval. The factors of a fitted subject are calibrated for `meter`.)
    """

    def __init__(self, spread: PredictionSpread, rate_hz: float, window_s: float) -> None:
        self._spread = spread
        self._steppers = [Stepper(chain, rate_hz) for chain in spread.chains]
        self._rate_hz, self._batch, self._windows, self._epoch_ns = rate_hz, Batch(), SecondWindows(), 0
        factors = (*(ACCEL_FACTORS,) * N_SEGMENTS, *(FORCE_FACTORS,) * N_SEGMENTS)
        self.meter = SpreadMeter(factors, len(self._steppers), window_s, spread.both_sides)
        chains = 1 + len(self._steppers)
        self.accel_peaks = PeakSpreadMeter(N_SEGMENTS, chains, window_s) if spread.both_sides else None
        self.force_peaks = PeakSpreadMeter(N_SEGMENTS, chains, window_s) if spread.both_sides else None
        self._sections = weighting_sections("Wk", rate_hz)
        self._weighting = np.zeros((len(self._sections), 2, N_SEGMENTS * chains))
        self.recent: deque[AccelSpread] = deque(maxlen=REMEMBERED)

    def push(self, block: Block, accel_mps2: Floats) -> None:
        """Add a block of the seat with its predictions (n, 6)."""
        if block.begins_run:
            self._begin_run(block.gap_s)
        # Nanoseconds since the sensor's first stamp are exact in a float for a hundred days.
        since_ns = (block.stamps_ns - block.epoch_ns).astype(np.float64)
        self._epoch_ns = block.epoch_ns
        self._advance(self._batch.add(np.column_stack([since_ns, block.low_passed_mps2, accel_mps2])))

    def push_run(
        self, stamps_ns: Integers, seat_mps2: Floats, accel_mps2: Floats, begin: int, counted: Flags | None = None
    ) -> None:
        """Add a whole run of the seat with its predictions (n, 6), of which the samples before `begin` do not count.

        counted (n, 6): flags of samples that the figures contain, all without it. A segment's spread is that of the
        windows with nearly all of its samples (`LEAST_COVERED`).
        """
        flags = np.ones(accel_mps2.shape, dtype=bool) if counted is None else counted
        self._begin_run(0.0)
        if begin > 0:
            self._with_neighbours(seat_mps2[:begin], accel_mps2[:begin])
        since_ns = stamps_ns - stamps_ns[begin]
        for at in range(begin, len(seat_mps2), PIECE):
            part = slice(at, at + PIECE)
            self._count_windows(since_ns[part], seat_mps2[part], accel_mps2[part], flags[part])
        for window in self._windows.end():
            self._count(window)

    def _begin_run(self, gap_s: float) -> None:
        """Begin from rest, after a gap."""
        self.count_all()
        for stepper in self._steppers:
            stepper.reset()
        self._weighting[:] = 0.0
        for meter in self.meters.values():
            meter.skip(gap_s)

    def count_all(self) -> None:
        """Count all samples that still wait."""
        self._advance(self._batch.take())

    def reset(self) -> None:
        """Set everything "since reset" to zero."""
        self.count_all()
        for meter in self.meters.values():
            meter.reset()

    @property
    def meters(self) -> dict[str, Meter[Any]]:
        """The meters by the names of their stored totals."""
        peaks = {"spread_of_accel_peaks": self.accel_peaks, "spread_of_force_peaks": self.force_peaks}
        return {"spread": self.meter, **{name: meter for name, meter in peaks.items() if meter is not None}}

    def _advance(self, rows: Floats | None) -> None:
        """Carry the neighbouring chains over the seat's samples that have waited."""
        if rows is None:
            return
        stamps_ns, seat_mps2 = rows[:, 0].astype(np.int64) + self._epoch_ns, np.ascontiguousarray(rows[:, 1])
        accel_mps2 = rows[:, 2:]
        self._count_windows(stamps_ns, seat_mps2, accel_mps2, np.ones(accel_mps2.shape, dtype=bool))

    def _count_windows(self, stamps_ns: Integers, seat_mps2: Floats, accel_mps2: Floats, counted: Flags) -> None:
        """Add samples with their predictions and flags (n, 6), and count the windows that they complete."""
        rows = np.concatenate([self._with_neighbours(seat_mps2, accel_mps2), counted], axis=1)
        for window in self._windows.push(stamps_ns, rows, self._rate_hz):
            self._count(window)

    def _with_neighbours(self, seat_mps2: Floats, accel_mps2: Floats) -> Floats:
        """Accelerations (n, 6 (1 + k)) as predicted and by the neighbouring chains; then weighted for their peaks."""
        accel = np.concatenate([accel_mps2, *(stepper.push(seat_mps2) for stepper in self._steppers)], axis=1)
        if self.accel_peaks is None:
            return accel
        # A sample without a number would stay in the filter for good; its window is not counted.
        finite = np.where(np.isfinite(accel), accel, 0.0)
        weighted, self._weighting = signal.sosfilt(self._sections, finite, axis=0, zi=self._weighting)
        return np.concatenate([accel, weighted], axis=1)

    def _count(self, window: Window) -> None:
        columns = self._weighting.shape[-1]
        rows, counted = window.rows[:, :columns], window.rows[:, -N_SEGMENTS:].mean(axis=0) >= LEAST_COVERED
        accel = rows.reshape(len(rows), -1, N_SEGMENTS)
        finite = np.asarray(np.isfinite(accel).all(axis=(0, 2)))
        for stepper, is_finite in zip(self._steppers, finite[1:], strict=True):
            if not is_finite:
                stepper.reset()
        if not finite.all():
            return
        nominal, share, mass_kg = accel[:, 0], self._spread.share, self._spread.mass_kg
        weighted = octave_squares(rows, window.rate_hz, "Wk").reshape(N_BANDS, -1, N_SEGMENTS) * counted
        errors = share**2 * octave_squares(nominal, window.rate_hz)
        forces = carried(accel * mass_kg)
        squares = np.concatenate([weighted.sum(axis=0), np.mean(forces**2, axis=0)], axis=1)
        # As if the errors of the segments above a joint had all one sign; the factor of forces allows for it.
        force_errors = (carried(np.sqrt(errors) * mass_kg) ** 2).sum(axis=0)
        accel_errors = (share**2 * weighted[:, 0]).sum(axis=0)
        self.meter.push(squares[0], np.append(accel_errors, force_errors), squares[1:].T)
        if self.accel_peaks:
            weighted_mps2 = window.rows[:, columns:-N_SEGMENTS].reshape(accel.shape)
            self.accel_peaks.push(np.abs(weighted_mps2) * counted)
        if self.force_peaks:
            self.force_peaks.push(forces)
        changes = np.mean((accel[:, 1:] - accel[:, :1]) ** 2, axis=0).sum(axis=0)
        if self._spread.both_sides:
            changes *= 0.5
        self.recent.append(AccelSpread(window.begin_ns, np.sqrt(errors.sum(axis=0) + changes)))

    def spreads(self, rolling: bool) -> dict[str, SegmentSpread]:
        """The spreads by segment since reset, or over the last `window_s`; without those that no window has counted."""
        self.count_all()
        found = self.meter.rolling() if rolling else self.meter.since_reset()
        of_accel, of_forces = found[:N_SEGMENTS], found[N_SEGMENTS:]
        if self.accel_peaks is not None:
            own = self.accel_peaks.rolling() if rolling else self.accel_peaks.since_reset()
            of_accel = tuple(
                replace(one, of_peaks=peak.of_positive) if one and peak.of_positive is not None else one
                for one, peak in zip(of_accel, own, strict=True)
            )
        if self.force_peaks is None:
            peaks = [PeakSpread(one.of_peaks, one.of_peaks) if one else None for one in of_forces]
        else:
            peaks = [*(self.force_peaks.rolling() if rolling else self.force_peaks.since_reset())]
        return {
            name: SegmentSpread(accel, ForceSpread(force.of_means, peak.of_positive, peak.of_negative))
            for name, accel, force, peak in zip(SEGMENTS, of_accel, of_forces, peaks, strict=True)
            if accel and force and peak
        }


def carried(of_segments: Floats) -> Floats:
    """Sums (..., 6) over each segment and those above it."""
    return np.asarray(np.cumsum(of_segments[..., ::-1], axis=-1)[..., ::-1])
