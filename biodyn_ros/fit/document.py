"""The mapping of fit.json, and the provenance in a fitted subject's file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.base.wording import counted
from biodyn_core.body.subject import MassMatrix, Subject
from biodyn_core.identification.fit import Fit, mean_percent
from biodyn_core.identification.idealize import Idealized
from biodyn_core.identification.identify import Identification
from biodyn_core.identification.problem import Case, Errors
from biodyn_core.identification.profiles import Profile
from biodyn_core.identification.residuals import ResidualCheck
from biodyn_core.identification.uncertainty import Estimate, Uncertainty
from biodyn_ros.base.json_files import finite
from biodyn_ros.reading.events import BagEvent, Prepared
from biodyn_ros.reading.provenance import MADE_BY_MODEL, effect_recordings, without_note

Document = dict[str, Any]

Subjects = Literal["joint", "idealized"]


@dataclass(frozen=True, eq=False)
class Findings:
    """Uncertainty of the joint fit's parameters, residual checks, and prediction errors.

    errors: of the joint and the idealized subject, in the events fitted to and then in those held out. mass_matrix: the
    one that predicts better, None where neither does, and both mean errors in percent.
    """

    uncertainty: Uncertainty
    profiles: tuple[Profile, ...]
    not_profiled: tuple[str, ...]
    residual_checks: Sequence[ResidualCheck]
    errors: Mapping[Subjects, Sequence[Errors]]
    mass_matrix: tuple[MassMatrix | None, Mapping[MassMatrix, float]]


def fit_document(
    subject: Subject,
    found: Identification,
    findings: Findings,
    fitted: list[Prepared],
    held_out: list[Prepared],
    seed: int,
) -> Document:
    """The mapping of fit.json without seconds and version."""
    sure, errors = findings.uncertainty, findings.errors
    predicted = [{name: _error(of[number]) for name, of in errors.items()} for number in range(len(fitted + held_out))]
    return {
        "subject": subject.name,
        "body_mass_kg": subject.body_mass_kg,
        "result": found.settings.result,
        "parameters": _parameters(found.subject),
        "cases": [
            _case(event, case, fit) | both
            for (event, case), fit, both in zip(fitted, found.fits, predicted[: len(fitted)], strict=True)
        ],
        "phase1": _swarms(found),
        "joint": _joint(found),
        "idealized": _idealized(found.idealized, errors["idealized"][: len(fitted)]),
        "weights": dict(found.idealized.weights),
        "cv": {name: finite(percent) for name, percent in found.idealized.cv_percent.items()},
        "flagged": list(found.idealized.flagged),
        "intervals": {estimate.name: _interval(estimate) for estimate in sure.estimates},
        "identifiable": {estimate.name: estimate.identifiability for estimate in sure.estimates},
        "correlation": {"names": list(sure.names), "matrix": sure.correlation.tolist()},
        "least_known": {"combination": sure.least_known, "half_width": finite(sure.least_known_half_width)},
        "profiles": {profile.name: _profile(profile) for profile in findings.profiles},
        "not_profiled": list(findings.not_profiled),
        "residuals": [_residual(check) for check in findings.residual_checks],
        "held_out": [
            _held_out(event, case) | both
            for (event, case), both in zip(held_out, predicted[len(fitted) :], strict=True)
        ],
        "mass_matrix": _mass_matrix(found, *findings.mass_matrix, judged_by="held_out" if held_out else "fitted"),
        "refiners": _refiners(found),
        "evaluations": found.evaluations,
        "penalties": dict(_penalties(found)),
        "seed": seed,
        "settings": _settings(found),
        "warnings": [*warnings_of([*fitted, *held_out]), *not_new(subject, held_out)],
    }


def provenance(document: Document, given: Subject) -> Document:
    """The provenance in the subject's file; recordings of given effects count as fitted."""
    result = document["result"]
    fitted = [_origin(event) | {"nrmse_rms_percent": event[result]["mean"]} for event in document["cases"]]
    intervals = {name: [of["lower"], of["upper"]] for name, of in document["intervals"].items()}
    return {
        "made_by": "biodyn fit",
        "version": document["version"],
        "seed": document["seed"],
        "result": result,
        "fitted": fitted + effect_recordings(given, excluded={each["sha256"] for each in fitted}),
        "held_out": [
            _origin(event) | {"nrmse_rms_percent": event[result]["nrmse_rms"]} for event in document["held_out"]
        ],
        "at_bound": document["joint"]["at_bound"] if result == "joint" else [],
        "seat_peak_mps2": max(event["seat_peak_mps2"] for event in document["cases"]),
        "intervals": intervals if result == "joint" else {},
        "identifiable": document["identifiable"] if result == "joint" else {},
    }


def _case(event: BagEvent, case: Case, fit: Fit) -> Document:
    """One case fitted alone."""
    seconds = case.seat_mps2.size / case.rate_hz
    return {
        "bag": event.bag,
        "sha256": event.sha256,
        "case": case.case,
        "seconds": seconds,
        "compared_s": by_segment(case.compared.sum(axis=0) / case.rate_hz),
        "not_fitted": [name for name in MEASURED_SEGMENTS if name not in case.fitted],
        "seat_rms_mps2": float(np.sqrt(np.mean(case.seat_mps2**2))),
        "seat_peak_mps2": case.seat_peak_mps2,
        "error": _error(fit.errors[0]) | {"objective": fit.refined.objective},
        "parameters": _parameters(fit.subject),
        "at_bound": list(fit.at_bound),
        "starts": _starts(fit),
        "clock_delay_ms": _delays(fit, 0),
    }


def _joint(found: Identification) -> Document:
    fit = found.joint
    return {
        "parameters": _parameters(fit.subject),
        "objective": fit.refined.objective,
        "error_percent": fit.error_percent,
        "at_bound": list(fit.at_bound),
        "starts": _starts(fit),
        "clock_delay_ms": {case.name: _delays(fit, number) for number, case in enumerate(found.cases)},
    }


def _idealized(idealized: Idealized, errors: Sequence[Errors]) -> Document:
    return {
        "parameters": _parameters(idealized.subject),
        "weighted_error_percent": idealized.weighted_error_percent,
        "error_percent": mean_percent(errors),
    }


def _held_out(event: BagEvent, case: Case) -> Document:
    why = "held out" if event.held_out else "another repetition"
    return {"bag": event.bag, "sha256": event.sha256, "case": case.case, "why": why}


def _mass_matrix(
    found: Identification, better: MassMatrix | None, errors: Mapping[MassMatrix, float], judged_by: str
) -> Document:
    return {
        "declared": found.joint.subject.mass_matrix,
        "better": better,
        "error_percent": dict(errors),
        "judged_by": judged_by,
        "other_parameters": _parameters(found.other.subject),
    }


def _refiners(found: Identification) -> Document:
    """Both refiners on Eq. 33 as printed, with the regularization of the settings, from one start."""
    return {
        "case": found.compared_on.case,
        "objective": {run.refiner: run.refined.objective for run in found.refiners},
        "evaluations": {run.refiner: run.refined.evaluations for run in found.refiners},
    }


def _penalties(found: Identification) -> Counter[str]:
    """Objectives that were not finite, by cause."""
    refined = [fit.refined for fit in (*found.fits, found.joint, found.other)] + [run.refined for run in found.refiners]
    return sum((part.penalties for part in (*found.searches, *refined)), Counter())


def _settings(found: Identification) -> Document:
    s = found.settings
    return {
        "phase1": s.phase1, "refine": s.refine, "regularization": s.regularization, "lambda_1": s.surrogate.lambda_1,
        "lambda_2": s.lambda_2, "clocks": s.clocks, "mass_scale": s.mass_scale, "particles": s.swarm.particles,
        "iterations": s.swarm.iterations, "starts": s.swarm.starts, "refined_starts": s.refined_starts,
        "segment_weights": list(s.surrogate.segment_weights),
    }  # fmt: skip


def _starts(fit: Fit) -> Document:
    """Final objectives of all refined starts, and how many reached the lowest."""
    return {"objectives": fit.refined.costs.tolist(), "reached": fit.reached, "of": int(fit.refined.costs.size)}


def _swarms(found: Identification) -> list[Document]:
    """Starts of phase 1 with the subject's own mass matrix: one search per case, or one for all."""
    searches = found.searches[: len(found.searches) // 2]
    names = [case.case for case in found.cases] if len(searches) == len(found.cases) else ["all"]
    return [
        {"case": name, "objectives": one.costs.tolist(), "reached": one.reached, "of": int(one.costs.size)}
        for name, one in zip(names, searches, strict=True)
    ]


def _error(error: Errors) -> Document:
    return {
        "nrmse_rms": by_segment(error.nrmse_rms_percent),
        "nrmse_range": by_segment(error.nrmse_range_percent),
        "mean": error.mean_percent,
    }


def _interval(estimate: Estimate) -> Document:
    return {
        "value": estimate.value,
        "unit": estimate.unit,
        "lower": float(estimate.lower),
        "upper": float(estimate.upper),
        "half_width_percent": finite(100.0 * estimate.half_width),
        "at_bound": estimate.at_bound,
    }


def _profile(profile: Profile) -> Document:
    return {
        "values": profile.values.tolist(),
        "rise": profile.rise.tolist(),
        "threshold": profile.threshold,
        "lower": profile.lower,
        "upper": profile.upper,
    }


def _residual(check: ResidualCheck) -> Document:
    return {
        "bag": check.name,
        "case": check.case,
        "input_coherence": by_segment(check.coherent),
        "chance_coherence": by_segment(check.chance),
        "coloured": by_segment(check.coloured),
    }


def _delays(fit: Fit, number: int) -> Document:
    """Delay of each sensor relative to the seat, ms, at the middle of a case; None if delays are not fitted."""
    if not fit.clock_delays_s.size:
        return dict.fromkeys(MEASURED_SEGMENTS)
    return by_segment(1e3 * fit.clock_delays_s[number, :, 0])


def warnings_of(events: Sequence[Prepared]) -> list[str]:
    """Warnings on the events with their bags, each once; recordings made by the model share one line."""
    made, rest = without_note(dict.fromkeys(f"{event.bag}: {line}" for event, case in events for line in case.warnings))
    return [f"{len(made)} of {counted(len(events), 'recording')}: {MADE_BY_MODEL}", *rest] if made else rest


def not_new(given: Subject, held_out: Sequence[Prepared]) -> list[str]:
    """Warnings on held-out bags to which an effect of the given subject was fitted."""
    known = {each.get("sha256") for each in effect_recordings(given, excluded=())}
    bags = dict.fromkeys(event.bag for event, _ in held_out if event.sha256 in known)
    return [f"{bag}: held out, but an effect of the given subject was fitted to it" for bag in bags]


def _origin(event: Document) -> Document:
    return {key: event[key] for key in ("bag", "case", "sha256")}


def _parameters(subject: Subject) -> Document:
    parameters: Document = subject.to_dict()["parameters"]
    return parameters


def by_segment(values: Floats) -> Document:
    """Values (5,) by measured segment, None where one is not finite."""
    return {name: finite(float(value)) for name, value in zip(MEASURED_SEGMENTS, values, strict=True)}
