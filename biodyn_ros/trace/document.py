"""The mapping of trace.json, and the provenance that a traced subject's file carries."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.problem import Case, Errors
from biodyn_core.tracing.findings import (
    ComparedEvent,
    Diagnostics,
    Interval,
    RankedCandidate,
    Round,
    SensorFinding,
    Surface,
    Trace,
)
from biodyn_core.tracing.sensor_limits import LIMITS, within_limits
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.fit.document import by_segment
from biodyn_ros.reading.events import BagEvent, Prepared
from biodyn_ros.reading.provenance import rests_on
from biodyn_ros.trace.refit import parameters_moved

Document = dict[str, Any]

PROOF: Final = (
    "Tracing of effects in tissue is proved on simulated bodies only: there is no recording of a person whose missing"
    " effect is known."
)


def trace_document(trace: Trace) -> Document:
    """All that a trace finds; the bags and the seconds it took are `trace_bags`' to add."""
    first = trace.rounds[0].ranking if trace.rounds else ()
    return {
        "subject": trace.before.name,
        "verdict": trace.verdict,
        "reasons": list(trace.reasons),
        "effects": [
            _effect(*each) | {"added": each[0] in trace.after.effects}
            for each in zip(trace.effects, trace.intervals, strict=True)
        ],
        "sensors": [_sensor(each) for each in trace.sensors],
        "family": trace.family,
        "ambiguous_with": [_site(applied) for applied in trace.ambiguous_with],
        "separating_experiment": trace.experiment,
        "to_record": [dataclasses.asdict(need) for need in trace.needs],
        "error": {"before": _errors_by_use(trace, "before"), "after": _errors_by_use(trace, "after")},
        "floor": _known(trace.floor_percent),
        "p_value": _known(trace.p_value),
        "threshold": _known(trace.threshold),
        "calibrated": trace.calibrated,
        "candidates": [_candidate(candidate) for candidate in first],
        "rounds": [_round(each) for each in trace.rounds],
        "diagnostics": _diagnostics(trace.diagnostics) if trace.diagnostics else {},
        "departures": [{"name": each.name, "times_usual": finite(each.typical_multiple)} for each in trace.nuisance],
        "parameters_moved": parameters_moved(trace),
        "subject_written": "with_effect" if trace.adds else "as_given",
        "surface": _surface(trace.surface) if trace.surface else None,
        "events": [event_document(event) for event in trace.events],
        "untestable": list(trace.untestable),
        "left_out": list(trace.left_out),
        "lacking": list(trace.lacking),
        "proof": PROOF,
        "seed": trace.seed,
        "version": __version__,
    }


def provenance(document: Document, trace: Trace, bags: Sequence[Prepared], subject: Subject) -> Document:
    """What the subject's file keeps of its trace.

    Bags that chose the effect count as fitted to. So do those that an effect already in the file rests on.
    """
    origins = [origin(event, case, trace) for event, case in bags]
    earlier = rests_on(subject, besides={each["sha256"] for each in origins})
    return {
        "made_by": "biodyn trace",
        "version": document["version"],
        "seed": document["seed"],
        "verdict": document["verdict"],
        "fitted": [each for each in origins if each["use"] != "held_out"] + earlier,
        "held_out": [each for each in origins if each["use"] == "held_out"],
        "error": {
            when: {use: each["all"] for use, each in by_use.items()} for when, by_use in document["error"].items()
        },
        "seat_peak_mps2": max(case.seat_peak_mps2 for event, case in bags if not event.held_out),
        "effects": {
            f"{effect['name']} at {effect['site']}": {
                name: [of["lower"], of["upper"]] for name, of in effect["intervals"].items()
            }
            for effect in document["effects"]
        },
    }


def origin(event: BagEvent, case: Case, trace: Trace) -> Document:
    """One bag with what it was for in the end, and its error after, None where the event was left out."""
    found = [each for each in trace.events if each.name == case.name]
    return {
        "bag": event.bag,
        "case": case.case,
        "sha256": event.sha256,
        "use": found[0].use if found else "held_out" if event.held_out else "train",
        "nrmse_rms_percent": _mean_error([found[0].after])["all"] if found else None,
    }


# --- effects ---------------------------------------------------------------------------------------------------------


def _site(applied: AppliedEffect) -> Document:
    return {"name": applied.effect.name, "site": applied.site}


def _effect(applied: AppliedEffect, intervals: Sequence[Interval]) -> Document:
    return _site(applied) | {
        "family": applied.effect.family,
        "parameters": dict(applied.values),
        "intervals": {each.name: _interval(each) for each in intervals},
    }


def _sensor(found: SensorFinding) -> Document:
    limit = LIMITS[found.fault.effect.name]
    return _site(found.fault) | {
        "parameters": dict(found.fault.values),
        "size": limit.size(found.fault.values),
        "unit": limit.unit,
        "limit": limit.limit,
        "limit_source": limit.source,
        "within_limit": within_limits(found.fault),
        "told_by": found.source,
        "gain": _known(found.gain),
        "explains": found.explains,
    }


def _interval(interval: Interval) -> Document:
    value, lower, upper = (finite(each) for each in (interval.value, interval.lower, interval.upper))
    return {"value": value, "unit": interval.unit, "lower": lower, "upper": upper}


def _candidate(candidate: RankedCandidate) -> Document:
    return _site(candidate.applied) | {
        "parameters": dict(candidate.applied.values),
        "gain": finite(candidate.gain),
        "score": _score(candidate.p_value) if candidate.steady else None,
        "absorbed": finite(candidate.absorbed),
        "p_value": finite(candidate.p_value) if candidate.steady else None,
        "steady": candidate.steady,
        "helps": candidate.helps,
        "refitted": candidate.refitted,
        "against": list(candidate.against),
    }


def _score(p_value: float) -> float | None:
    """-log10 of the p-value."""
    return -math.log10(p_value) + 0.0 if p_value > 0.0 else None


def _round(found: Round) -> Document:
    return {
        "threshold": finite(found.threshold),
        "taken": _site(found.chosen.applied) if found.chosen else None,
        "ambiguous_with": [_site(candidate.applied) for candidate in found.ambiguous_with],
        "candidates": [_candidate(candidate) for candidate in found.ranking],
    }


# --- errors ----------------------------------------------------------------------------------------------------------


def _errors_by_use(trace: Trace, when: str) -> Document:
    """Of each use the mean over its events; the two that scripts read are there even where they have no event."""
    uses = ("train", "choose", "held_out")
    found = {use: [getattr(event, when) for event in trace.events if event.use == use] for use in uses}
    return {use: _mean_error(errors) for use, errors in found.items() if errors or use != "choose"}


def _mean_error(errors: Sequence[Errors]) -> Document:
    """Of each segment over the events that have it, and over all: the mean of the events' own means."""
    by_event = np.array([error.nrmse_rms_percent for error in errors]).reshape(-1, len(MEASURED_SEGMENTS))
    return by_segment(np.array([_mean(column) for column in by_event.T])) | {
        "all": finite(_mean(np.array([_mean(row) for row in by_event])))
    }


def _mean(values: Floats) -> float:
    """The mean of what is known, NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def event_document(event: ComparedEvent) -> Document:
    """One event with its errors."""
    return {
        "name": event.name,
        "case": event.case,
        "use": event.use,
        "seconds": len(event.measured_mps2) / event.rate_hz,
        "given": _mean_error([event.given]) if event.given else None,
        "before": _mean_error([event.before]),
        "after": _mean_error([event.after]),
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
        "level_slope": _known(found.level_slope),
        "jump": {"event": found.jump[0], "p_value": finite(found.jump[1])} if found.jump else None,
        "pinned": list(found.pinned),
        "drift": {name: finite(spread) for name, spread in found.drift.items()},
        "pulled_down": finite(found.pulled_down),
    }


def _surface(surface: Surface) -> Document:
    return {
        "site": surface.site,
        "stretch_m": surface.stretch_m.tolist(),
        "rate_mps": surface.rate_mps.tolist(),
        "force_n": [[finite(force) for force in row] for row in surface.force_n.tolist()],
        "gain": finite(surface.gain),
    }


def _known(value: float | None) -> float | None:
    return None if value is None else finite(value)
