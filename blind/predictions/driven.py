"""One person is fitted and driven: predicted and true figures event by event, and the windows of the residual."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal
from world.effects.event import HELD_HZ, Event
from world.effects.sitting import START_NS
from world.effects.wearing import Stream

from biodyn_core.base.errors import InputError
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import SEAT, SEGMENTS
from biodyn_core.body import parameter_spread, usual_residual
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import UNFITTED
from biodyn_core.body.subject import Subject
from biodyn_core.exposure.joint_forces import JointForceMeter
from biodyn_core.exposure.meters import DoseMeter
from biodyn_core.identification import held_out
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.problem import Case
from biodyn_core.identification.uncertainty import uncertainty
from biodyn_core.pipeline.exposure import Exposure
from biodyn_core.pipeline.fit_monitor import squares_of
from biodyn_core.pipeline.frames import Frames, MeasuredFrames, PredictedFrames
from biodyn_core.pipeline.interleaving import in_turns
from biodyn_core.pipeline.intervals import carried
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.windows import WINDOW_NS, SecondWindows
from biodyn_core.recording.recording import Recorder
from blind.predictions.people import Person

Floats = NDArray[np.float64]

FIGURES: Final = ("aw", "vdv", "peak", "rms", "compression", "tension")
"""Figures of each segment, and of the force in the joint below it."""

WHOLE: Final = "drive"
LOW_PASS_HZ: Final = 100.0
SLICE_S: Final = 0.25
WINDOW_S: Final = 60.0
DIGITS: Final = 5
WIDTHS: Final = (1.0, 1.1, 1.2, 1.3, 1.4, 1.6)
"""Of the band of curves, times that without a factor."""

UNKNOWN: Final = np.full((len(WIDTHS), len(SEGMENTS)), np.nan)
MOVING_MPS2: Final = 0.2
"""Rms of the pelvis from which a second has motion."""


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of one event, or of the whole drive before the effect (`WHOLE`).

    log_ratio (6, 6): ln of true over predicted, by figure and segment, NaN where unknown. sums (12, 2 (2 + k)): see
    `SpreadMeter`. fitted: whether the fit has had motion of this kind. within (6, 6): share of the time in motion in
    which the true acceleration of a segment is within the band of the predicted one, by `WIDTHS`.
    """

    kind: str
    fitted: bool
    log_ratio: Floats
    sums: Floats
    within: Floats


@dataclass(frozen=True, eq=False)
class Drive:
    """One person's drive. kind and ratio of the effect, "" and None without one; provenance of the fitted subject.

    begin_s (w,), residual (w, 5) and predicted (w, 6, 5): the windows of the residual. begins_s: when the effect
    begins; seconds: of the drive before it. drifts: whether the joints of the person change slowly in any case.
    """

    number: int
    kind: str
    ratio: float | None
    error_percent: float
    provenance: dict[str, Any]
    figures: list[Figures]
    begin_s: Floats
    residual: Floats
    predicted: Floats
    begins_s: float
    seconds: float
    drifts: bool

    def line(self) -> str:
        """As one line of JSON."""
        return json.dumps(dataclasses.asdict(self), default=_rounded, separators=(",", ":"))

    @classmethod
    def of_line(cls, line: str) -> Drive:
        """From one line of JSON."""
        facts = json.loads(line)
        for name in ("begin_s", "residual", "predicted"):
            facts[name] = np.array(facts[name], dtype=np.float64)
        facts["figures"] = [
            Figures(**one | {name: np.array(one[name], dtype=np.float64) for name in ("log_ratio", "sums", "within")})
            for one in facts["figures"]
        ]
        return cls(**facts)


def _rounded(values: Floats) -> Any:
    """Lists of the numbers with few digits, None for NaN."""
    return np.vectorize(lambda value: None if np.isnan(value) else float(f"{value:.{DIGITS}g}"), otypes=[object])(
        values
    ).tolist()


def driven(person: Person) -> Drive | None:
    """Fit and drive a person; None if the fit has no interval or no usual residual."""
    subject, error_percent = fitted(person)
    pipeline, one = Pipeline(subject), person.sitting
    if pipeline.no_interval or pipeline.not_monitored:
        return None
    kinds = {p.event.case for p, role in zip(one.events, person.roles, strict=True) if role == "fit"}
    figures, windows, collected = [], SecondWindows(), []
    whole, before, end_s = Pipeline(subject), Truth(subject), 0.0
    for index in (i for i, role in enumerate(person.roles) if role == "drive"):
        event, has_effect = one.events[index].event, person.has_effect(index)
        streams = one.streams(index, has_effect)
        pipeline.reset()
        predicted = []
        for frames in _pushed(pipeline, streams, event):
            predicted.append(frames.predicted)
            collected += _squares(windows, pipeline, frames.measured)
        if not has_effect:
            truth = Truth(subject)
            truth.push(one.plain[index])
            within = _within(pipeline, predicted, one.plain[index], event)
            figures.append(_figures(pipeline, truth, event.case, event.case in kinds, within))
            if end_s:
                before.skip(event.begin_s - end_s)
            before.push(one.plain[index])
            end_s = event.begin_s + event.time_s[-1]
            list(_pushed(whole, {"seat": streams["seat"]}, event))
    figures.append(_figures(whole, before, WHOLE, True, UNKNOWN))
    begin_ns, residual, predicted_squares = (np.array(column) for column in zip(*collected, strict=True))
    begins_s = one.events[person.begins].event.begin_s if one.effects else np.inf
    seconds = 1e-9 * (begin_ns - START_NS)
    plain = (seconds >= 0.0) & (seconds < begins_s)
    return Drive(
        person.number, person.kind, person.ratio, error_percent, dict(subject.provenance), figures, seconds, residual,
        predicted_squares, float(min(begins_s, 1e9)), float(plain.sum()), person.drifts,
    )  # fmt: skip


def _squares(windows: SecondWindows, pipeline: Pipeline, measured: MeasuredFrames) -> Iterator[tuple[Any, ...]]:
    """Begin, ns, and mean squares of residual and prediction of each window that these frames complete."""
    if measured.stamps_ns.size:
        rows = np.concatenate([measured.residual_mps2, measured.accel_mps2[:, 1:]], axis=1)
        for window in windows.push(measured.stamps_ns, rows, pipeline.conditioners[SEAT].rate_hz):
            yield window.begin_ns, *squares_of(window)


def fitted(person: Person) -> tuple[Subject, float]:
    """The subject fitted to the person's events, with its covariance and usual residual; and the error, percent."""
    one = person.sitting
    cases: dict[str, list[Case]] = {"fit": [], "held": []}
    for index, role in enumerate(person.roles):
        if role in cases:
            cases[role].append(case_of(one.events[index].event, one.events[index].name, one.streams(index, False)))
    given = Subject("drawn", one.body_mass_kg, 1.75, one.mass_matrix, UNFITTED)
    fit = fit_joint(cases["fit"], given, 0)
    sure = uncertainty(fit, cases["fit"])
    spread = parameter_spread.ParameterSpread(sure.names, sure.covariance)
    laws = held_out.usual_residual(fit.subject, cases["held"])
    provenance = {
        parameter_spread.PROVENANCE: spread.to_dict(),
        **usual_residual.to_provenance(laws),
    }
    return dataclasses.replace(fit.subject, provenance=provenance), fit.error_percent


def case_of(event: Event, name: str, streams: dict[str, Stream]) -> Case:
    """The streams of one event as a case for fits; raises InputError for a recording of several runs."""
    recorder = Recorder(event.case, name)
    for sensor, (stamps_ns, force_mps2, _) in streams.items():
        recorder.push(sensor, stamps_ns + _begin_ns(event), force_mps2)
    recordings = recorder.finish()
    if len(recordings) != 1:
        raise InputError(f"{name} has {len(recordings)} runs")
    return Case.of(recordings[0])


def _begin_ns(event: Event) -> int:
    return START_NS + round(event.begin_s * 1e9)


def _pushed(pipeline: Pipeline, streams: dict[str, Stream], event: Event) -> Iterator[Frames]:
    """Push the streams of one event in slices; the frames of each."""
    names = list(streams)
    for number, begin, end in in_turns([1e-9 * streams[name][0] for name in names], SLICE_S):
        stamps_ns, force_mps2, _ = streams[names[number]]
        yield pipeline.push(names[number], stamps_ns[begin:end] + _begin_ns(event), force_mps2[begin:end])


def _within(pipeline: Pipeline, predicted: list[PredictedFrames], truth_mps2: Floats, event: Event) -> Floats:
    """Share of the time in motion in which the truth (n, 6) is within so many times the band, (6, 6)."""
    assert pipeline.predictor is not None
    assert pipeline.predictor.intervals is not None
    stamps_ns = np.concatenate([frames.stamps_ns for frames in predicted])
    accel = np.concatenate([frames.accel_mps2 for frames in predicted])
    time_s = np.arange(len(truth_mps2)) / HELD_HZ
    true = interpolate.CubicSpline(time_s, low_passed(truth_mps2))(1e-9 * (stamps_ns - _begin_ns(event)))
    inside = []
    for begin_ns, spread_mps2 in pipeline.predictor.intervals.recent:
        here = (stamps_ns >= begin_ns) & (stamps_ns < begin_ns + WINDOW_NS)
        if here.any() and true[here, 0].std() > MOVING_MPS2:
            ratio = np.abs(true[here] - accel[here]) / (NORMAL_95 * spread_mps2)
            inside.append([np.mean(ratio <= width, axis=0) for width in WIDTHS])
    return np.mean(inside, axis=0) if inside else UNKNOWN


def low_passed(accel_mps2: Floats) -> Floats:
    """Accelerations (n, 6) at `HELD_HZ` after the low-pass of the package, without delay."""
    sos = signal.butter(4, LOW_PASS_HZ, fs=HELD_HZ, output="sos")
    return np.ascontiguousarray(signal.sosfiltfilt(sos, accel_mps2, axis=0))


class Truth:
    """True figures: `push` accelerations (n, 6) at `HELD_HZ`. Forces are for the assumed masses of a subject."""

    def __init__(self, subject: Subject) -> None:
        self._mass_kg = Chain.of(subject).mass_kg
        self._doses = DoseMeter("Wk", HELD_HZ, len(SEGMENTS), WINDOW_S)
        self._forces = JointForceMeter(HELD_HZ, len(SEGMENTS), WINDOW_S)

    def push(self, accel_mps2: Floats) -> None:
        """Count the motion of one event."""
        true = low_passed(accel_mps2)
        self._doses.push(true)
        self._forces.push(np.ascontiguousarray(carried(true * self._mass_kg)))

    def skip(self, seconds: float) -> None:
        """Move on by a break."""
        self._doses.skip(seconds)
        self._forces.skip(seconds)

    def figures(self) -> Floats:
        """(6, 6) by figure and segment."""
        doses = [(d.aw_mps2, d.vdv_mps175, d.peak_mps2) for d in self._doses.since_reset()]
        forces = [(f.rms_n, f.compression_n, f.tension_n) for f in self._forces.since_reset()]
        return np.concatenate([np.array(doses).T, np.array(forces).T])


def _figures(pipeline: Pipeline, truth: Truth, kind: str, is_fitted: bool, within: Floats) -> Figures:
    assert pipeline.predictor is not None
    assert pipeline.predictor.intervals is not None
    predicted = _predicted(pipeline.exposure())
    pipeline.predictor.intervals.count_all()
    sums = pipeline.predictor.intervals.meter.totals()
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(truth.figures() / predicted)
    return Figures(kind, is_fitted, np.where(np.isfinite(log_ratio), log_ratio, np.nan), sums, within)


def _predicted(exposure: Exposure) -> Floats:
    """Predicted figures (6, 6) by figure and segment, NaN for unknown forces."""
    rows = np.full((len(FIGURES), len(SEGMENTS)), np.nan)
    for column, name in enumerate(SEGMENTS):
        dose, force = exposure.predicted[name], exposure.joint_forces.get(name)
        rows[:3, column] = dose.aw_mps2, dose.vdv_mps175, dose.peak_mps2
        if force:
            rows[3:, column] = force.rms_n, force.compression_n, force.tension_n
    return rows
