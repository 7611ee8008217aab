"""The mapping of `biodyn info --json`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from biodyn_ros.info.report import Report
from biodyn_ros.info.survey import SurveyedTopic

Document = dict[str, Any]


def info_document(report: Report) -> Document:
    """The whole mapping of `biodyn info --json`."""
    return {
        "bag": report.bag,
        "storage": report.storage,
        "recovered": report.recovered,
        "messages": report.messages,
        "seconds": report.seconds,
        "topics": [_topic(each) for each in report.topics],
        "other_topics": [
            {"topic": each.name, "type": each.type, "messages": each.messages} for each in report.other_topics
        ],
        "replay": asdict(report.replay),
        "warnings": report.warnings,
    }


def _topic(found: SurveyedTopic) -> Document:
    status, drift = found.status, found.drift
    return {
        "topic": found.topic,
        "sensor": found.sensor,
        "messages": found.messages,
        "time": found.time,
        "rate_hz": found.rate_hz,
        "clock_ppm": drift.ppm if drift else None,
        "clock_ppm_error": drift.ppm_error if drift else None,
        "offset_ms": _ms(drift.offset_s) if drift else None,
        "offset_scatter_ms": _ms(drift.scatter_s) if drift else None,
        "quantum_ms": _ms(drift.quantum_s) if drift else None,
        "jitter_ms": _ms(status.jitter_s),
        "median_step_ms": _ms(found.median_step_s),
        "longest_step_ms": _ms(found.longest_step_s),
        "gaps": found.gaps,
        "gap_s": status.gap_s,
        "filled": status.filled,
        "rejected": status.rejected,
        "rejected_by_cause": found.rejected_by_cause,
        "flat": status.flat,
        "dead": status.dead,
        "clipped": status.clipped,
        "gravity_mps2": status.gravity_mps2,
        "vertical": list(status.vertical) if status.vertical else None,
    }


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds
