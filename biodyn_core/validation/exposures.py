"""Exposures: doses and injury criteria of an event, measured and predicted.

All are after the warm-up, with the prediction masked like the measurement. Suspect samples may be raised, and doses
contain their time alone: those of the seat after a loss within strong motion, as in the live path (`suspect`), here by
its vertical motion alone, and those of a segment after masked samples or the warm-up of a later run, where its
weighting restarts in strong motion. Known limit: a line that `bridge_s` lets cross a gap of a segment is not suspect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import HEAD, MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.exposure.injury import HIC_LENGTHS_S, Dri, DriMeter, Hic, HicMeter
from biodyn_core.exposure.meters import Dose, DoseMeter
from biodyn_core.exposure.suspect import LONGEST_SETTLING_S, STRONG_MPS2, SuspectSamples, constant_parts
from biodyn_core.pipeline.intervals import (
    NO_WINDOW,
    IntervalEstimator,
    SegmentSpread,
    prediction_spread,
    undriven,
)
from biodyn_core.recording.flags import stretches
from biodyn_core.recording.recording import REPORTED_S
from biodyn_core.validation.predicted_run import PredictedRun

_HEAD: Final = SEGMENTS.index(HEAD)
_WINDOW_S: Final = 1.0
"""Of rolling figures, which are not used here."""


class Compared(NamedTuple):
    """Doses of the samples in which a segment is compared: measured, predicted, and as its sensor would read."""

    measured: Dose
    predicted: Dose
    as_read: Dose


@dataclass(frozen=True, eq=False)
class Exposures:
    """Doses by segment, DRI, and HIC by the name of its window, after the warm-up; seat and measurement are low-passed.

    seat and dri need no model, so that only the warm-up of the first run is left out of them; all others lack that of
    every run. predicted and predicted_hic: of the motion of the segments. suspect_s: time of the suspect samples of the
    seat and of each segment, of which doses contain the time alone. compared: by segment, with them, because all three
    channels are masked alike. seat_compared_mps175: VDV of the seat where a segment is compared; its weighting runs
    through the other samples too, so that no restart raises it. seat_with_suspect: of all samples. masked: segments,
    and the seat, with missing or suspect samples, so that their figures are lower bounds. spreads: of the predicted
    figures, by segment, for their intervals; no_interval: why there are none, empty if there are.
    """

    seat: Dose
    measured: Mapping[str, Dose]
    predicted: Mapping[str, Dose]
    suspect_s: Mapping[str, float]
    seat_with_suspect: Dose
    compared: Mapping[str, Compared]
    seat_compared_mps175: Mapping[str, float]
    masked: frozenset[str]
    dri: Dri
    measured_hic: Mapping[str, Hic]
    predicted_hic: Mapping[str, Hic]
    spreads: Mapping[str, SegmentSpread]
    no_interval: str


def exposures(runs: Sequence[PredictedRun], rate_hz: float, subject: Subject) -> Exposures:
    """The exposures of the runs of one event."""
    of_gaps, of_losses = _after_losses(runs, rate_hz, gaps=True), _after_losses(runs, rate_hz, gaps=False)
    of_seat, dri = DoseMeter("Wk", rate_hz, 1, _WINDOW_S), DriMeter(rate_hz, _WINDOW_S)
    for meter in (of_seat, dri):
        _count(runs, meter, lambda run: run.seat_mps2[:, None], of_gaps, needs_model=False)
    # After a gap the warm-up settles the model, so that it is suspect after losses within a run alone.
    suspect = [
        [restarted | lost for restarted, lost in zip(_after_restarts(runs, rate_hz, i), of_losses, strict=True)]
        for i in range(len(SEGMENTS))
    ]
    meters = {name: _segment_meter(runs, rate_hz, i, suspect[i]) for i, name in enumerate(SEGMENTS)}
    suspect_s = {
        name: float(meter.suspect_samples(rolling=False)[-1]) / rate_hz
        for name, meter in {SEAT: of_seat, **meters}.items()
    }
    spreads, no_interval = _spreads(runs, rate_hz, subject, suspect)
    return Exposures(
        seat=of_seat.since_reset()[0],
        measured={name: Compared(*meter.since_reset()).measured for name, meter in meters.items()},
        predicted={name: Compared(*meter.since_reset()).predicted for name, meter in meters.items()},
        suspect_s=suspect_s,
        seat_with_suspect=of_seat.with_suspect()[0],
        compared={name: Compared(*meter.with_suspect()) for name, meter in meters.items()},
        seat_compared_mps175={name: _seat_compared_mps175(runs, rate_hz, i) for i, name in enumerate(SEGMENTS)},
        masked=frozenset(_masked(runs)) | {name for name, seconds in suspect_s.items() if seconds > 0.0},
        dri=dri.since_reset(),
        measured_hic=_hics(runs, rate_hz, lambda run: run.measured_mps2, of_losses),
        predicted_hic=_hics(runs, rate_hz, lambda run: run.moved_mps2, of_losses),
        spreads=spreads,
        no_interval=no_interval,
    )


def _segment_meter(runs: Sequence[PredictedRun], rate_hz: float, i: int, suspect: Sequence[Flags]) -> DoseMeter:
    """The doses of one segment, in the order of `Compared`."""

    def channels(run: PredictedRun) -> Floats:
        return np.column_stack([run.measured_mps2[:, i], run.moved_mps2[:, i], run.predicted_mps2[:, i]])

    meter = DoseMeter("Wk", rate_hz, 3, _WINDOW_S)
    _count(runs, meter, channels, suspect)
    return meter


def _seat_compared_mps175(runs: Sequence[PredictedRun], rate_hz: float, i: int) -> float:
    """VDV of the seat where one segment is compared."""
    meter, apart = DoseMeter("Wk", rate_hz, 1, _WINDOW_S), []
    for number, run in enumerate(runs):
        not_compared = np.isnan(run.measured_mps2[:, i])
        not_compared[: run.begin if number else 0] = True
        apart.append(not_compared)
    # As suspect samples they run through the weighting, and are counted apart.
    _count(runs, meter, lambda run: run.seat_mps2[:, None], apart, needs_model=False)
    return meter.since_reset()[0].vdv_mps175


def _hics(
    runs: Sequence[PredictedRun], rate_hz: float, side: Callable[[PredictedRun], Floats], suspect: Sequence[Flags]
) -> dict[str, Hic]:
    """HIC of the head's vertical alone, by the name of its window."""
    found = {}
    for name, length_s in HIC_LENGTHS_S.items():
        meter = HicMeter(rate_hz, length_s, _WINDOW_S)
        _count(runs, meter, lambda run: np.pad(side(run)[:, [_HEAD]], ((0, 0), (2, 0))), suspect)
        found[name] = meter.since_reset()
    return found


def _spreads(
    runs: Sequence[PredictedRun], rate_hz: float, subject: Subject, suspect: Sequence[Sequence[Flags]]
) -> tuple[dict[str, SegmentSpread], str]:
    """Spreads of the predicted figures by segment, of the samples in them, and why there are none.

    The neighbouring chains are driven by the seat's vertical alone, as in the live node.
    """
    if needed := undriven(subject):
        return {}, needed
    spread, no_interval = prediction_spread(subject)
    if spread is None:
        return {}, no_interval
    estimator = IntervalEstimator(spread, rate_hz, _WINDOW_S)
    for number, run in enumerate(runs):
        counted = ~np.column_stack([flags[number] for flags in suspect])
        counted[:, MEASURED_SEGMENT_INDEX] &= np.isfinite(run.recording.measured_mps2)
        estimator.push_run(run.recording.stamps_ns, run.seat_mps2, run.response.accel_mps2, run.begin, counted)
    found = estimator.spreads(rolling=False)
    return found, "" if found else NO_WINDOW


def _masked(runs: Sequence[PredictedRun]) -> Iterator[str]:
    """Segments with masked samples, and the seat if it has invalid samples or a gap: the model settles after both.

    The end of a run does not count, where low-pass and interpolation lack samples.
    """
    if len(runs) > 1 or any(run.recording.seat_invalid_s + run.recording.left_out_s > 0.0 for run in runs):
        yield SEAT
    for name, column in zip(MEASURED_SEGMENTS, MEASURED_SEGMENT_INDEX.tolist(), strict=True):
        for run in runs:
            missing = np.isnan(run.measured_mps2[run.begin :, column])
            read = np.flatnonzero(~missing)
            within = missing[: read[-1]].any() if read.size else True
            allowed_s = REPORTED_S + run.recording.ends_s.get(name, 0.0)
            if within or missing.sum() > allowed_s * run.recording.rate_hz:
                yield name
                break


# --- counting --------------------------------------------------------------------------------------------------------


def _count(
    runs: Sequence[PredictedRun],
    meter: Any,
    rows: Callable[[PredictedRun], Floats],
    suspect: Sequence[Flags],
    needs_model: bool = True,
) -> None:
    """Push the runs to a meter without their warm-up; the first run's warm-up only settles its filters.

    The warm-up of a later run belongs to the break before it, so that times after it stay those of the clock. It is
    pushed if needs_model is False.
    """
    for number, run in enumerate(runs):
        values, flags = np.ascontiguousarray(rows(run)), suspect[number]
        begin = run.begin if needs_model or number == 0 else 0
        if number == 0:
            _push(meter, values[:begin], flags[:begin])
            meter.forget()
        else:
            before, now = runs[number - 1].recording.stamps_ns[-1], run.recording.stamps_ns[begin]
            # Samples that follow each other have no break between them, but one period.
            meter.skip(max(0.0, 1e-9 * float(now - before) - 1.0 / run.recording.rate_hz))
        _push(meter, values[begin:], flags[begin:])


def _push(meter: Any, values: Floats, suspect: Flags) -> None:
    for begin, end in constant_parts(suspect):
        meter.push(values[begin:end], bool(suspect[begin]))


def _after_losses(runs: Sequence[PredictedRun], rate_hz: float, gaps: bool) -> list[Flags]:
    """The suspect samples of the seat in each run; gaps: whether a run follows a loss, the gap before it."""
    samples, found = SuspectSamples(rate_hz), list[Flags]()
    for run in runs:
        samples.begin_run(follows_loss=gaps and bool(found))
        found.append(samples.flags(run.seat_mps2[:, None], run.recording.seat_losses))
    return found


def _after_restarts(runs: Sequence[PredictedRun], rate_hz: float, i: int) -> Iterator[Flags]:
    """The suspect samples of a segment in each run: until weightings settle that have restarted in strong motion.

    That is where one of the motions that are counted together is strong: seat, measurement or prediction.
    """
    settling = round(LONGEST_SETTLING_S * rate_hz)
    for number, run in enumerate(runs):
        moving = np.column_stack(
            [run.seat_mps2, run.measured_mps2[:, i], run.moved_mps2[:, i], run.predicted_mps2[:, i]]
        )
        strong = np.nanmax(np.abs(moving), axis=1) > STRONG_MPS2
        counted = np.isfinite(run.predicted_mps2[:, i])
        counted[: run.begin if number else 0] = False  # the warm-up of a later run is not pushed
        flags = np.zeros(counted.shape, dtype=np.bool_)
        for begin, end in stretches(counted):
            flags[begin : min(end, begin + settling)] = strong[begin]
        yield flags
