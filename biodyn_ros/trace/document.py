"""Documents of a trace: the mapping of trace.json, and the provenance in a traced subject's file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

from biodyn_core.base.arrays import Floats
from biodyn_core.body.subject import Subject
from biodyn_core.body.usual_residual import to_provenance
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.held_out import usual_residual
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.findings import (
    ComparedEvent,
    Diagnostics,
    ForceProfile,
    Interval,
    NamedBodies,
    RankedCandidate,
    RestoringForce,
    Round,
    SensorFinding,
    Surface,
    Trace,
)
from biodyn_core.tracing.sensor_limits import LIMITS, within_limits
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.reading.events import BagEvent
from biodyn_ros.reading.provenance import effect_recordings
from biodyn_ros.trace.errors import WHEN, errors_by_use, known, mean_errors
from biodyn_ros.trace.refit import ParameterChange, Refit, parameter_changes
from biodyn_ros.trace.report import Report

Document = dict[str, Any]

PROOF: Final = (
    "Tracing of effects in tissue is tested on simulated bodies only: there is no recording of a person whose missing"
    " effect is known."
)


def trace_document(report: Report) -> Document:
    """The whole mapping of trace.json."""
    trace = report.trace
    first = trace.rounds[0].ranking if trace.rounds else ()
    return {
        "subject": trace.before.name,
        "verdict": trace.verdict,
        "reasons": list(trace.reasons),
        "effects": [
            _effect(*each) | {"added": each[0] in trace.added}
            for each in zip(trace.effects, trace.intervals, strict=True)
        ],
        "sensors": [_sensor(each) for each in trace.sensors],
        "family": trace.family,
        "ambiguous_with": [_site(applied) for applied in trace.ambiguous_with],
        "separating_experiment": trace.experiment,
        "to_record": [
            {
                "use": need.use,
                "road_s": need.road_s,
                "shocks": need.shocks,
                "hard_shocks": need.hard_shocks,
                "how": need.conditions,
            }
            for need in trace.needs
        ],
        "further_recordings": [dataclasses.asdict(each) for each in trace.further],
        "louder_recordings": [dataclasses.asdict(each) for each in trace.louder],
        "error": {when: errors_by_use(trace, when) for when in WHEN},
        "floor": known(trace.floor_percent),
        "p_value": known(trace.p_value),
        "named_from": known(trace.named_from),
        "power": _share(trace.named_bodies[0]) if trace.named_bodies else None,
        "named_in_simulation": [dataclasses.asdict(each) for each in trace.named_bodies],
        "calibrated": trace.calibrated,
        "candidates": [_candidate(candidate) for candidate in first],
        "rounds": [_round(each) for each in trace.rounds],
        "diagnostics": _diagnostics(trace.diagnostics) if trace.diagnostics else {},
        "departures": [{"name": each.name, "times_usual": finite(each.typical_multiple)} for each in trace.nuisance],
        "parameters_moved": {each.name: _change(each, adds=trace.adds) for each in parameter_changes(trace)},
        "subject_written": "with_effect" if trace.adds else "as_given",
        "surface": _surface(trace.surface) if trace.surface else None,
        "restoring_force": [_restoring_force(each) for each in trace.restoring_forces],
        "events": [event_document(event) for event in trace.events],
        "untestable": list(trace.untestable),
        "left_out": list(trace.left_out),
        "lacking": list(trace.lacking),
        "proof": PROOF,
        "seed": trace.seed,
        "version": __version__,
        "bags": [_origin(event, case, trace) for event, case in report.events],
        "dealt": report.dealt,
        "warnings": list(report.warnings),
        "seconds": report.seconds,
        "refit": refit_document(report.refit) if report.refit else None,
    }


def traced_subject(report: Report) -> Subject:
    """The subject with the added effects and its provenance, or the given one if none is added."""
    trace = report.trace
    return dataclasses.replace(trace.after, provenance=provenance(report)) if trace.adds else trace.given


def provenance(report: Report) -> Document:
    """The provenance of a trace in the subject's file.

    Bags for choosing the effect count as fitted. So do those of an effect that the given file already has.
    """
    trace = report.trace
    reported = [case for event, case in report.events if use_of(event, case, trace) == "held_out"]
    origins = [_origin(event, case, trace) for event, case in report.events]
    earlier = effect_recordings(trace.given, excluded=[event.source for event, _ in report.events])
    return {
        "made_by": "biodyn trace",
        "version": __version__,
        "seed": trace.seed,
        "verdict": trace.verdict,
        "fitted": [each for each in origins if each["use"] != "held_out"] + earlier,
        "held_out": [each for each in origins if each["use"] == "held_out"],
        "error": {when: {use: errors["all"] for use, errors in errors_by_use(trace, when).items()} for when in WHEN},
        "seat_peak_mps2": max(case.seat_peak_mps2 for event, case in report.events if not event.held_out),
        "effects": {
            f"{applied.effect.name} at {applied.site}": {
                each.name: [finite(each.lower), finite(each.upper)] for each in intervals
            }
            for applied, intervals in zip(trace.effects, trace.intervals, strict=True)
            if applied in trace.added
        },
        **to_provenance(usual_residual(trace.after, reported)),
    }


def _origin(event: BagEvent, case: Case, trace: Trace) -> Document:
    """One bag with its use, and its error after, None if the event was left out."""
    found = [each for each in trace.events if each.name == case.name]
    return {
        "bag": event.bag,
        "case": case.case,
        **event.source.to_dict(),
        "use": use_of(event, case, trace),
        "nrmse_rms_percent": mean_errors([found[0].after])["all"] if found else None,
    }


def use_of(event: BagEvent, case: Case, trace: Trace) -> str:
    """The use of a bag's event: by the trace, or as it was given if the trace left it out."""
    by_trace = next((each.use for each in trace.events if each.name == case.name), None)
    return by_trace or ("held_out" if event.held_out else "train")


# --- effects ---------------------------------------------------------------------------------------------------------


def _site(applied: AppliedEffect) -> Document:
    return {"name": applied.effect.name, "site": applied.site}


def _effect(applied: AppliedEffect, intervals: Sequence[Interval]) -> Document:
    return _site(applied) | {
        "family": applied.effect.family,
        "parameters": applied.stated_values,
        "intervals": {each.name: _interval(each) for each in intervals},
    }


def _sensor(found: SensorFinding) -> Document:
    limit = LIMITS[found.fault.effect.name]
    return _site(found.fault) | {
        "parameters": found.fault.stated_values,
        "size": limit.size(found.fault.values),
        "unit": limit.unit,
        "limit": limit.limit,
        "limit_source": limit.source,
        "within_limit": within_limits(found.fault),
        "told_by": found.source,
        "gain": known(found.gain),
        "explains": found.explains,
    }


def _interval(interval: Interval) -> Document:
    value, lower, upper = (finite(each) for each in (interval.value, interval.lower, interval.upper))
    return {"value": value, "unit": interval.unit, "lower": lower, "upper": upper}


def _share(one: NamedBodies) -> float | None:
    return one.named / one.bodies if one.bodies else None


def _candidate(candidate: RankedCandidate) -> Document:
    return _site(candidate.applied) | {
        "parameters": candidate.applied.stated_values,
        "probability": finite(candidate.probability),
        "gain": finite(candidate.gain),
        "score": _score(candidate.p_value) if candidate.steady else None,
        "absorbed": finite(candidate.absorbed),
        "p_value": finite(candidate.p_value) if candidate.steady else None,
        "steady": candidate.steady,
        "helps": candidate.improved_events,
        "refitted": candidate.refitted,
        "remarks": list(candidate.remarks),
    }


def _score(p_value: float) -> float | None:
    """-log10 of the p-value."""
    return -math.log10(p_value) + 0.0 if p_value > 0.0 else None


def _round(found: Round) -> Document:
    return {
        "probabilities": {answer: finite(p) for answer, p in found.answers.items()},
        "set_90": list(found.likely),
        "taken": _site(found.chosen.applied) if found.chosen else None,
        "ambiguous_with": [_site(candidate.applied) for candidate in found.rivals],
        "candidates": [_candidate(candidate) for candidate in found.ranking],
    }


# --- errors ----------------------------------------------------------------------------------------------------------


def event_document(event: ComparedEvent) -> Document:
    """One event with its errors."""
    return {
        "name": event.name,
        "case": event.case,
        "use": event.use,
        "seconds": len(event.measured_mps2) / event.rate_hz,
        "given": mean_errors([event.given]) if event.given else None,
        "before": mean_errors([event.before]),
        "after": mean_errors([event.after]),
    }


def _change(change: ParameterChange, adds: bool) -> Document:
    return {
        "given": change.given,
        "given_interval": list(change.interval) if change.interval else None,
        "refitted": change.refitted,
        "with_effect": change.after if adds else None,
        "before": change.refitted,
        "after": change.after,
        "percent": change.percent,
        "refit_percent": change.refit_percent,
        "unit": change.unit,
    }


def refit_document(refit: Refit) -> Document:
    """The refit with its text."""
    return {
        "outside_intervals": [change.name for change in refit.outside],
        "intervals_known": refit.has_intervals,
        "given_fitted": refit.is_given_fitted,
        "recordings": refit.recordings,
        "given_recordings": refit.given_recordings,
        "shared_recordings": refit.shared_recordings,
        "error_percent": {"given": refit.given_percent, "refitted": refit.refitted_percent},
        "text": refit.text,
    }


# --- the rest --------------------------------------------------------------------------------------------------------


def _diagnostics(found: Diagnostics) -> Document:
    return {
        "amplitude_transfer": {
            case: {"quietest_alone": finite(alone), "all": finite(together)}
            for case, (alone, together) in found.amplitude_transfer.items()
        },
        "coherent": {
            channel: {"segment": segment, "share": finite(share)}
            for channel, (segment, share) in found.coherent.items()
        },
        "peeling": {chain: finite(percent) for chain, percent in found.peeling.items()},
        "bracket": list(found.bracket),
        "level_slope": known(found.level_slope),
        "jump": {"event": found.jump[0], "p_value": finite(found.jump[1])} if found.jump else None,
        "pinned": list(found.at_bound),
        "drift": {name: finite(spread) for name, spread in found.drift.items()},
        "pulled_down": finite(found.seat_tension),
    }


def _surface(surface: Surface) -> Document:
    return {
        "site": surface.site,
        "stretch_m": surface.stretch_m.tolist(),
        "rate_mps": surface.rate_mps.tolist(),
        "force_n": [[finite(force) for force in row] for row in surface.force_n.tolist()],
        "gain": finite(surface.gain),
    }


def _restoring_force(found: RestoringForce) -> Document:
    return {
        "site": found.site,
        "place": "joint" if found.joint else "segment",
        "effects": [applied.effect.name for applied in found.effects],
        "events": list(found.events),
        "body_mass_kg": found.body_mass_kg,
        "high_pass_hz": found.high_pass_hz,
        "rms_n": {
            "carried": finite(found.carried_n),
            "missing_before": finite(found.missing_before_n),
            "missing_after": finite(found.missing_after_n),
        },
        "stretch_m": found.stretch_m.tolist(),
        "rate_mps": found.rate_mps.tolist(),
        "samples": found.samples.tolist(),
        "before_n": [_known(row) for row in found.before_n],
        "after_n": [_known(row) for row in found.after_n],
        "over_stretch": _profile(found.over_stretch),
        "over_rate": _profile(found.over_rate),
    }


def _profile(found: ForceProfile) -> Document:
    return {
        "at": found.at.tolist(),
        "samples": found.samples.tolist(),
        "before_n": _known(found.before_n),
        "measured_n": _known(found.measured_n),
        "after_n": _known(found.after_n),
        "law_n": _known(found.law_n),
        "law_lower_n": _known(found.lower_n),
        "law_upper_n": _known(found.upper_n),
        "explained": finite(found.explained),
    }


def _known(values: Floats) -> list[float | None]:
    return [finite(value) for value in values.tolist()]
