"""The mapping of fit.json, and the provenance in a fitted subject's file."""

from __future__ import annotations

import dataclasses
from typing import Any

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body import parameter_spread, usual_residual
from biodyn_core.body.subject import Subject
from biodyn_core.identification.compare import body_effects
from biodyn_core.identification.fit import Fit, mean_percent
from biodyn_core.identification.problem import Errors
from biodyn_core.identification.profiles import Profile
from biodyn_core.identification.residuals import ResidualCheck
from biodyn_core.identification.settings import FitSettings
from biodyn_core.identification.uncertainty import Estimate
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.fit.report import FitEvent, Report
from biodyn_ros.reading.provenance import effect_recordings

Document = dict[str, Any]


def fit_document(report: Report) -> Document:
    """The whole mapping of fit.json."""
    found, sure, idealized = report.identification, report.uncertainty, report.identification.idealized
    return {
        "subject": report.given.name,
        "body_mass_kg": report.given.body_mass_kg,
        "effects": [applied.to_dict() for applied in body_effects(report.given)],
        "result": report.result,
        "parameters": _parameters(found.subject),
        "cases": [_case(event, fit) for event, fit in zip(report.fitted, found.fits, strict=True)],
        "phase1": [{"case": name, **_starts(one.costs, one.reached)} for name, one in report.searches],
        "joint": _joint(report),
        "prior": _prior(report),
        "idealized": _idealized(report),
        "weights": dict(idealized.weights),
        "cv": {name: finite(percent) for name, percent in idealized.cv_percent.items()},
        "flagged": list(idealized.flagged),
        "intervals": {estimate.name: _interval(estimate) for estimate in sure.estimates},
        "identifiable": {estimate.name: estimate.identifiability for estimate in sure.estimates},
        "correlation": {"names": list(sure.names), "matrix": sure.correlation.tolist()},
        "least_known": {"combination": sure.least_known, "half_width": finite(sure.least_known_half_width)},
        "profiles": {profile.name: _profile(profile) for profile in report.profiles},
        "not_profiled": list(report.not_profiled),
        "residuals": [_residual(check) for check in report.residual_checks],
        "held_out": [_held_out(event) for event in report.held_out],
        "mass_matrix": _mass_matrix(report),
        "refiners": _refiners(report),
        "evaluations": found.evaluations,
        "penalties": dict(report.penalties),
        "dealt": report.dealt,
        "seed": report.seed,
        "settings": _settings(found.settings),
        "warnings": list(report.warnings),
        "seconds": report.seconds,
        "version": __version__,
    }


def fitted_subject(report: Report) -> Subject:
    """The resulting subject with its provenance."""
    return dataclasses.replace(report.identification.subject, provenance=provenance(report))


def provenance(report: Report) -> Document:
    """The provenance in the subject's file; recordings of given effects count as fitted."""
    result = report.result
    fitted = [
        _origin(event) | {"nrmse_rms_percent": finite(event.errors[result].mean_percent)} for event in report.fitted
    ]
    estimates = report.uncertainty.estimates if result == "joint" else ()
    return {
        "made_by": "biodyn fit",
        "version": __version__,
        "seed": report.seed,
        "result": result,
        "prior": report.joint.settings.prior,
        "fitted": fitted + effect_recordings(report.given, excluded=[event.bag.source for event in report.fitted]),
        "held_out": [
            _origin(event) | {"nrmse_rms_percent": by_segment(event.errors[result].nrmse_rms_percent)}
            for event in report.held_out
        ],
        "at_bound": list(report.joint.at_bound) if result == "joint" else [],
        "seat_peak_mps2": max(event.case.seat_peak_mps2 for event in report.fitted),
        "intervals": {estimate.name: [float(estimate.lower), float(estimate.upper)] for estimate in estimates},
        "identifiable": {estimate.name: estimate.identifiability for estimate in estimates},
        **_of_predictions(report),
    }


def _of_predictions(report: Report) -> Document:
    """The errors of predictions: of the joint result, as far as they are known."""
    found: Document = usual_residual.to_provenance(report.usual_residual)
    if report.result == "joint":
        spread = parameter_spread.ParameterSpread(report.uncertainty.names, report.uncertainty.covariance)
        found[parameter_spread.PROVENANCE] = spread.to_dict()
    return found


def _origin(event: FitEvent) -> Document:
    return {"bag": event.bag.bag, "case": event.case.case, **event.bag.source.to_dict()}


# --- events ----------------------------------------------------------------------------------------------------------


def _case(event: FitEvent, fit: Fit) -> Document:
    """One case fitted alone."""
    case = event.case
    return {
        "bag": event.bag.bag,
        **event.bag.source.to_dict(),
        "case": case.case,
        "seconds": event.seconds,
        "compared_s": by_segment(case.compared.sum(axis=0) / case.rate_hz),
        "not_fitted": [name for name in MEASURED_SEGMENTS if name not in case.fitted],
        "seat_rms_mps2": event.seat_rms_mps2,
        "seat_peak_mps2": case.seat_peak_mps2,
        "error": _error(event.errors["alone"]) | {"objective": fit.refined.objective},
        "parameters": _parameters(fit.subject),
        "at_bound": list(fit.at_bound),
        "starts": _starts(fit.refined.costs, fit.reached),
        "clock_delay_ms": _delays(fit, 0),
        "clock_drift_ppm": _drifts(fit, 0),
        **_predictions(event),
    }


def _held_out(event: FitEvent) -> Document:
    return {
        "bag": event.bag.bag,
        **event.bag.source.to_dict(),
        "case": event.case.case,
        "why": event.use,
        **_predictions(event),
    }


def _predictions(event: FitEvent) -> Document:
    """Errors of the results of all cases; `without_prior` where there is one."""
    return {name: _error(error) for name, error in event.errors.items() if name != "alone"}


def _error(error: Errors) -> Document:
    return {
        "nrmse_rms": by_segment(error.nrmse_rms_percent),
        "nrmse_range": by_segment(error.nrmse_range_percent),
        "mean": finite(error.mean_percent),
    }


def _residual(check: ResidualCheck) -> Document:
    return {
        "bag": check.name,
        "case": check.case,
        "input_coherence": by_segment(check.coherent),
        "chance_coherence": by_segment(check.chance),
        "coloured": by_segment(check.coloured),
    }


# --- fits ------------------------------------------------------------------------------------------------------------


def _joint(report: Report) -> Document:
    fit, cases = report.joint, report.identification.cases
    return {
        "parameters": _parameters(fit.subject),
        "objective": fit.refined.objective,
        "error_percent": finite(fit.error_percent),
        "at_bound": list(fit.at_bound),
        "starts": _starts(fit.refined.costs, fit.reached),
        "clock_delay_ms": {case.name: _delays(fit, number) for number, case in enumerate(cases)},
        "clock_drift_ppm": {case.name: _drifts(fit, number) for number, case in enumerate(cases)},
    }


def _prior(report: Report) -> Document | None:
    """The prior of the joint fit, None without one."""
    fit, without = report.joint, report.identification.without_prior
    if fit.prior is None:
        return None
    return {
        "name": fit.settings.prior,
        "distance": report.distance,
        "scale": fit.prior.scale,
        "data_variance": fit.prior.variance,
        "without": {"parameters": _parameters(without.subject), "error_percent": finite(without.error_percent)},
    }


def _idealized(report: Report) -> Document:
    idealized = report.identification.idealized
    return {
        "parameters": _parameters(idealized.subject),
        "weighted_error_percent": idealized.weighted_error_percent,
        "error_percent": finite(mean_percent([event.errors["idealized"] for event in report.fitted])),
    }


def _mass_matrix(report: Report) -> Document:
    return {
        "declared": report.given.mass_matrix,
        "better": report.better_mass_matrix,
        "error_percent": {name: finite(percent) for name, percent in report.mass_matrix_percent.items()},
        "judged_by": "held_out" if report.held_out else "fitted",
        "other_parameters": _parameters(report.identification.other.subject),
    }


def _refiners(report: Report) -> Document:
    return {
        "case": report.identification.compared_on.case,
        "objective": {name: refined.objective for name, refined in report.refiners.items()},
        "evaluations": {name: refined.evaluations for name, refined in report.refiners.items()},
    }


def _settings(s: FitSettings) -> Document:
    return {
        "phase1": s.phase1, "refine": s.refine, "regularization": s.regularization, "lambda_1": s.surrogate.lambda_1,
        "lambda_2": s.lambda_2, "clocks": s.clocks, "prior": s.prior, "mass_scale": s.mass_scale,
        "particles": s.swarm.particles, "iterations": s.swarm.iterations, "starts": s.swarm.starts,
        "refined_starts": s.refined_starts, "segment_weights": list(s.surrogate.segment_weights),
    }  # fmt: skip


def _starts(costs: Floats, reached: int) -> Document:
    """Final objectives of all starts, and how many reached the lowest."""
    return {"objectives": costs.tolist(), "reached": reached, "of": int(costs.size)}


def _delays(fit: Fit, number: int) -> Document:
    """Delay of each sensor relative to the seat, ms, at the middle of a case; None if delays are not fitted."""
    if not fit.clock_delays_s.size:
        return dict.fromkeys(MEASURED_SEGMENTS)
    return by_segment(1e3 * fit.clock_delays_s[number, :, 0])


def _drifts(fit: Fit, number: int) -> Document:
    """Growth of that delay, ppm; None if delays are not fitted."""
    if not fit.clock_delays_s.size:
        return dict.fromkeys(MEASURED_SEGMENTS)
    return by_segment(1e6 * fit.clock_delays_s[number, :, 1])


# --- parameters ------------------------------------------------------------------------------------------------------


def _parameters(subject: Subject) -> Document:
    parameters: Document = subject.to_dict()["parameters"]
    return parameters


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


def by_segment(values: Floats) -> Document:
    """Values (5,) by measured segment, None where one is not finite."""
    return {name: finite(float(value)) for name, value in zip(MEASURED_SEGMENTS, values, strict=True)}
