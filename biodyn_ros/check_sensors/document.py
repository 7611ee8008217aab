"""The mapping of `biodyn check-sensors --json`."""

from __future__ import annotations

import dataclasses
from typing import Any

from biodyn_core.sensor_pairs.checks import Finding, SensorCheck, StretchCheck
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.check_sensors.checking import Report, SensorPair
from biodyn_ros.check_sensors.evidence import evidence_of


def check_document(report: Report) -> dict[str, Any]:
    """The whole mapping."""
    return {
        "bag": report.bag,
        "good": list(report.good),
        "good_until_s": report.options.good_until_s,
        "seconds": report.seconds,
        "seed": report.options.seed,
        "pairs": [_pair(pair, result) for pair, result in report.results],
        "suspects": list(report.suspects),
        "warnings": list(report.notes),
        "version": __version__,
    }


def _pair(pair: SensorPair, result: SensorCheck) -> dict[str, Any]:
    counted = evidence_of(result.finding.verdict)
    return {
        "sensor": pair.under_test,
        "reference": pair.reference,
        "axis": result.axis or None,
        "rate_hz": finite(result.rate_hz),
        "uses_gyro": result.uses_gyro,
        **_finding(result.finding),
        "evidence": dataclasses.asdict(counted) if counted else None,
        "stretches": [_stretch(one) for one in result.checks],
    }


def _finding(found: Finding) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "reason": found.reason,
        "fault": found.name or None,
        "ambiguous_with": list(found.ambiguous_with),
        "size": finite(found.size),
        "lower": finite(found.lower),
        "upper": finite(found.upper),
        "unit": found.unit,
        "agreeing": found.agreeing,
        "decidable": found.decidable,
        "background_percent": finite(found.background_percent),
        "before_percent": finite(found.before_percent),
        "after_percent": finite(found.after_percent),
    }


def _stretch(one: StretchCheck) -> dict[str, Any]:
    found = one.found
    return {
        "good": one.good,
        "good_begin_s": one.good_span.begin_s,
        "good_end_s": one.good_span.end_s,
        "begin_s": one.span.begin_s,
        "end_s": one.span.end_s,
        "verdict": found.verdict,
        "reason": found.reason,
        "fault": found.name or None,
        "ambiguous_with": list(found.ambiguous_with),
        "size": found.size if found.name else None,
        "lower": finite(found.lower),
        "upper": finite(found.upper),
        "background_percent": finite(found.background_percent),
        "before_percent": finite(found.before_percent),
        "after_percent": finite(found.after_percent),
        "gains": dict(found.gains) if found.gains else {},
        "threshold": finite(found.threshold),
    }
