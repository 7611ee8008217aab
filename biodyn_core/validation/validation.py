"""Validation: a model's forward prediction of an event that it was not fitted to, against the measurement.

All comparisons are after the warm-up, with the prediction masked like the measurement. The measurement and the seat,
which drives the prediction, are low-passed; the prediction itself is not. A law that is not linear answers also above
the cut-off, and there the comparison errs. A small error over time is not enough: the paper's is below 10 %, and its
model transmits 2.6 times too much to the head.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import HEAD, MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain, Response, SeatForce, predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import apply_to_sensors
from biodyn_core.exposure.injury import HIC_LENGTHS_S, Dri, DriMeter, Hic, HicMeter
from biodyn_core.exposure.meters import Dose, DoseMeter
from biodyn_core.pipeline.intervals import (
    NO_WINDOW,
    IntervalEstimator,
    SegmentSpread,
    prediction_spread,
    undriven,
)
from biodyn_core.recording.recording import REPORTED_S, Recording
from biodyn_core.signals.response import CrossSpectra, Peak, common_rate_hz, cross_spectra, peak
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.validation.driving_point import DrivingPoint, driving_point, linear_driving_point

_HEAD: Final = SEGMENTS.index(HEAD)
_MEASURED: Final = dict(zip(MEASURED_SEGMENTS, MEASURED_SEGMENT_INDEX.tolist(), strict=True))
_WINDOW_S: Final = 1.0
"""Of rolling figures, which are not used here."""


@dataclass(frozen=True, eq=False)
class PredictedRun:
    """A recording and its prediction; predicted_mps2 (n, 6) is NaN wherever measured_mps2 (n, 6) is masked.

    Both by segment. predicted_mps2 is what sensors with the subject's effects would read, to compare with
    measured_mps2; moved_mps2 is the motion of the segments itself. The central torso, which has no sensor, is masked in
    measured_mps2 alone.
    """

    recording: Recording
    response: Response
    measured_mps2: Floats
    predicted_mps2: Floats

    @classmethod
    def of(cls, recording: Recording, subject: Subject) -> PredictedRun:
        """Predict a recording from its seat alone; raises InputError where the model diverges."""
        channels = recording.named_channels()
        response = predict(subject, recording.seat_mps2, recording.rate_hz, channels)
        if not np.isfinite(response.accel_mps2).all():
            raise InputError(f"{recording.name}: the model of {subject.name} diverges: fit it again")
        measured = np.full(response.accel_mps2.shape, np.nan)
        measured[:, MEASURED_SEGMENT_INDEX] = recording.measured_mps2
        predicted = apply_to_sensors(subject.effects, response.accel_mps2, recording.rate_hz, channels).copy()
        masked = np.isnan(recording.measured_mps2)
        predicted[:, MEASURED_SEGMENT_INDEX] = np.where(masked, np.nan, predicted[:, MEASURED_SEGMENT_INDEX])
        return cls(recording, response, measured, predicted)

    @property
    def moved_mps2(self) -> Floats:
        """The predicted motion of the segments, (n, 6), NaN as predicted_mps2."""
        return np.where(np.isnan(self.predicted_mps2), np.nan, self.response.accel_mps2)

    @property
    def begin(self) -> int:
        """The first sample after the warm-up."""
        return self.recording.begin

    @property
    def seat_mps2(self) -> Floats:
        """The model's input, (n,)."""
        return self.recording.seat_mps2


@dataclass(frozen=True)
class SegmentError:
    """Error of one segment's prediction over time; percentages are None for a segment that did not move."""

    nrmse_rms_percent: float | None
    nrmse_range_percent: float | None
    rms_mps2: float
    measured_rms_mps2: float
    compared_s: float


class PeakRatio(NamedTuple):
    """The predicted peak over the measured one, its relative standard error, and the measured coherence there.

    is_distinct: whether the measurement is lower where the predicted peak is, by two standard errors of each.
    """

    magnitude: float | None
    relative_error: float
    frequency: float
    coherence: float
    is_distinct: bool


@dataclass(frozen=True)
class HeadPeaks:
    """Peaks of seat-to-head transmissibility at frequencies of sufficient measured coherence; coherent_share: of all.

    predicted_anywhere: at frequencies of sufficient own coherence; linear_anywhere: at all. ratio: None without a peak.
    """

    least_coherence: float
    coherent_share: float
    measured: Peak | None
    predicted: Peak | None
    predicted_anywhere: Peak | None
    linear_anywhere: Peak | None
    ratio: PeakRatio | None


@dataclass(frozen=True, eq=False)
class Exposures:
    """Doses by segment, DRI, and HIC by the name of its window, after the warm-up; seat and measurement are low-passed.

    seat and dri need no model, so that only the warm-up of the first run is left out of them; all others lack that of
    every run. predicted and predicted_hic: of the motion of the segments; as_read: of what their sensors would read,
    comparable with measured. seat_compared: of the seat, where each segment is compared. masked: segments, and the
    seat, with missing samples, so that their figures are lower bounds. spreads: of the predicted figures, by segment,
    for their intervals; no_interval: why there are none, empty if there are.
    """

    seat: Dose
    seat_compared: Mapping[str, Dose]
    measured: Mapping[str, Dose]
    predicted: Mapping[str, Dose]
    as_read: Mapping[str, Dose]
    masked: frozenset[str]
    dri: Dri
    measured_hic: Mapping[str, Hic]
    predicted_hic: Mapping[str, Hic]
    spreads: Mapping[str, SegmentSpread]
    no_interval: str


@dataclass(frozen=True, eq=False)
class Validation:
    """All comparisons over the runs of one event; errors by measured segment, None without a measurement.

    measured and predicted are spectra of all segments; both driving points are None where forces are refused.
    """

    subject: Subject
    runs: tuple[PredictedRun, ...]
    rate_hz: float
    errors: Mapping[str, SegmentError | None]
    measured: CrossSpectra
    predicted: CrossSpectra
    head: HeadPeaks
    driving_point: DrivingPoint | None
    linear_driving_point: DrivingPoint | None
    exposures: Exposures

    @property
    def seconds(self) -> float:
        """Length of all runs, the warm-up included."""
        return sum(run.seat_mps2.size for run in self.runs) / self.rate_hz

    @property
    def mean_nrmse_rms_percent(self) -> float | None:
        """The mean error of the segments that moved."""
        shares = list(self._shares.values())
        return sum(shares) / len(shares) if shares else None

    @property
    def worst(self) -> tuple[str | None, float | None]:
        """The segment with the largest error over its rms, and that error in percent."""
        shares = self._shares
        segment = max(shares, key=shares.__getitem__, default=None)
        return segment, shares[segment] if segment else None

    @property
    def _shares(self) -> dict[str, float]:
        known = {name: error.nrmse_rms_percent for name, error in self.errors.items() if error}
        return {name: percent for name, percent in known.items() if percent is not None}


def validate(
    recordings: Sequence[Recording],
    subject: Subject,
    least_coherence: float,
    spectra: SpectrumSettings | None = None,
    seat_force: SeatForce = "inertia",
    as_printed: bool = False,
) -> Validation:
    """Predict the runs of one event from their seats alone and compare; options of forces as in `Chain.seat_force`.

    Raises InputError for a model that diverges, and as `cross_spectra`.
    """
    runs = tuple(PredictedRun.of(recording, subject) for recording in recordings)
    rate_hz = common_rate_hz([recording.rate_hz for recording in recordings])
    measured = cross_spectra([(r.seat_mps2[r.begin :], r.measured_mps2[r.begin :]) for r in runs], rate_hz, spectra)
    predicted = cross_spectra([(r.seat_mps2[r.begin :], r.predicted_mps2[r.begin :]) for r in runs], rate_hz, spectra)
    force = exact = None
    if subject.mass_matrix == "segment" or as_printed:
        force = driving_point(subject, [run.response for run in runs], seat_force, as_printed, spectra)
        exact = linear_driving_point(subject, measured.frequency_hz, seat_force, as_printed)
    return Validation(
        subject=subject,
        runs=runs,
        rate_hz=rate_hz,
        errors=_errors(runs, rate_hz),
        measured=measured,
        predicted=predicted,
        head=_head_peaks(measured, predicted, subject, least_coherence),
        driving_point=force,
        linear_driving_point=exact,
        exposures=_exposures(runs, rate_hz, subject),
    )


# --- over time -------------------------------------------------------------------------------------------------------


def _errors(runs: Sequence[PredictedRun], rate_hz: float) -> dict[str, SegmentError | None]:
    measured = np.concatenate([run.measured_mps2[run.begin :] for run in runs])
    predicted = np.concatenate([run.predicted_mps2[run.begin :] for run in runs])
    return {name: _error(predicted[:, i], measured[:, i], rate_hz) for name, i in _MEASURED.items()}


def _error(predicted: Floats, measured: Floats, rate_hz: float) -> SegmentError | None:
    here = np.isfinite(measured)
    if not here.any():
        return None
    error, truth = predicted[here] - measured[here], measured[here]
    rms, own = math.sqrt(float(np.mean(error**2))), math.sqrt(float(np.mean(truth**2)))
    return SegmentError(
        nrmse_rms_percent=_ratio(100.0 * rms, own),
        nrmse_range_percent=_ratio(100.0 * rms, float(np.ptp(truth))),
        rms_mps2=rms,
        measured_rms_mps2=own,
        compared_s=np.count_nonzero(here) / rate_hz,
    )


def _exposures(runs: Sequence[PredictedRun], rate_hz: float, subject: Subject) -> Exposures:
    def channels(run: PredictedRun) -> Floats:
        compared = np.where(np.isnan(run.measured_mps2), np.nan, run.seat_mps2[:, None])
        return np.column_stack([compared, run.measured_mps2, run.moved_mps2, run.predicted_mps2])

    def seat(run: PredictedRun) -> Floats:
        return run.seat_mps2[:, None]

    doses = DoseMeter("Wk", rate_hz, 4 * len(SEGMENTS), _WINDOW_S)
    of_seat, dri = DoseMeter("Wk", rate_hz, 1, _WINDOW_S), DriMeter(rate_hz, _WINDOW_S)
    _count(runs, doses, channels)
    for meter in (of_seat, dri):
        _count(runs, meter, seat, needs_model=False)
    found = doses.since_reset()
    compared, measured, moved, read = (
        dict(zip(SEGMENTS, found[at : at + len(SEGMENTS)], strict=True)) for at in range(0, len(found), len(SEGMENTS))
    )
    spreads, no_interval = _spreads(runs, rate_hz, subject)
    return Exposures(
        seat=of_seat.since_reset()[0],
        seat_compared=compared,
        measured=measured,
        predicted=moved,
        as_read=read,
        masked=frozenset(_masked(runs)),
        dri=dri.since_reset(),
        measured_hic=_hics(runs, rate_hz, lambda run: run.measured_mps2),
        predicted_hic=_hics(runs, rate_hz, lambda run: run.moved_mps2),
        spreads=spreads,
        no_interval=no_interval,
    )


def _spreads(runs: Sequence[PredictedRun], rate_hz: float, subject: Subject) -> tuple[dict[str, SegmentSpread], str]:
    """Spreads of the predicted figures by segment, of the seconds that are not masked, and why there are none.

    The neighbouring chains are driven by the seat's vertical alone, as in the live node.
    """
    if needed := undriven(subject):
        return {}, needed
    spread, no_interval = prediction_spread(subject)
    if spread is None:
        return {}, no_interval
    estimator = IntervalEstimator(spread, rate_hz, _WINDOW_S)
    for run in runs:
        counted = np.ones(run.response.accel_mps2.shape, dtype=bool)
        counted[:, MEASURED_SEGMENT_INDEX] = np.isfinite(run.recording.measured_mps2)
        estimator.push_run(run.recording.stamps_ns, run.seat_mps2, run.response.accel_mps2, run.begin, counted)
    found = estimator.spreads(rolling=False)
    return found, "" if found else NO_WINDOW


def _masked(runs: Sequence[PredictedRun]) -> Iterator[str]:
    """Segments with masked samples, and the seat if it has invalid samples or a gap: the model settles after both.

    The end of a run does not count, where low-pass and interpolation lack samples.
    """
    if len(runs) > 1 or any(run.recording.seat_invalid_s + run.recording.left_out_s > 0.0 for run in runs):
        yield SEAT
    for name, column in _MEASURED.items():
        for run in runs:
            missing = np.isnan(run.measured_mps2[run.begin :, column])
            read = np.flatnonzero(~missing)
            within = missing[: read[-1]].any() if read.size else True
            allowed_s = REPORTED_S + run.recording.ends_s.get(name, 0.0)
            if within or missing.sum() > allowed_s * run.recording.rate_hz:
                yield name
                break


def _hics(runs: Sequence[PredictedRun], rate_hz: float, side: Callable[[PredictedRun], Floats]) -> dict[str, Hic]:
    """HIC of the head's vertical alone, by the name of its window."""
    found = {}
    for name, length_s in HIC_LENGTHS_S.items():
        meter = HicMeter(rate_hz, length_s, _WINDOW_S)
        _count(runs, meter, lambda run: np.pad(side(run)[:, [_HEAD]], ((0, 0), (2, 0))))
        found[name] = meter.since_reset()
    return found


def _count(
    runs: Sequence[PredictedRun], meter: Any, rows: Callable[[PredictedRun], Floats], needs_model: bool = True
) -> None:
    """Push the runs to a meter without their warm-up; the first run's warm-up only settles its filters.

    The warm-up of a later run belongs to the break before it, so that times after it stay those of the clock. It is
    pushed if needs_model is False.
    """
    for number, run in enumerate(runs):
        values = np.ascontiguousarray(rows(run))
        begin = run.begin if needs_model or number == 0 else 0
        if number == 0:
            meter.push(values[:begin])
            meter.forget()
        else:
            before, now = runs[number - 1].recording.stamps_ns[-1], run.recording.stamps_ns[begin]
            # Samples that follow each other have no break between them, but one period.
            meter.skip(max(0.0, 1e-9 * float(now - before) - 1.0 / run.recording.rate_hz))
        meter.push(values[begin:])


# --- over frequency --------------------------------------------------------------------------------------------------


def _head_peaks(measured: CrossSpectra, predicted: CrossSpectra, subject: Subject, least_coherence: float) -> HeadPeaks:
    frequency = measured.frequency_hz
    linear = peak(frequency, np.abs(Chain.of(subject).transmissibility(frequency)[:, _HEAD]))
    coherent = measured.is_coherent(least_coherence)[:, _HEAD]
    anywhere = peak(frequency, np.abs(predicted.h1[:, _HEAD]), predicted.is_linear(least_coherence)[:, _HEAD])
    own, model = (peak(frequency, np.abs(spectra.h1[:, _HEAD]), coherent) for spectra in (measured, predicted))
    return HeadPeaks(
        least_coherence=max(least_coherence, float(measured.chance_coherence[_HEAD])),
        coherent_share=float(np.mean(coherent)),
        measured=own,
        predicted=model,
        predicted_anywhere=anywhere,
        linear_anywhere=linear,
        ratio=_peak_ratio(own, model, measured) if own and model else None,
    )


def _peak_ratio(own: Peak, model: Peak, measured: CrossSpectra) -> PeakRatio:
    at, there = (int(np.searchsorted(measured.frequency_hz, one.frequency_hz)) for one in (own, model))
    height, error = np.abs(measured.h1[:, _HEAD]), measured.relative_error[:, _HEAD]
    return PeakRatio(
        magnitude=_ratio(model.magnitude, own.magnitude),
        relative_error=float(error[at]),
        frequency=model.frequency_hz / own.frequency_hz,
        coherence=float(measured.coherence[at, _HEAD]),
        is_distinct=bool(height[there] * (1.0 + 2.0 * error[there]) < height[at] * (1.0 - 2.0 * error[at])),
    )


def _ratio(above: float, below: float) -> float | None:
    return above / below if below > 0.0 else None
