"""The result of an import: the document for --json and the bag's metadata, its warnings, and the text output."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.base.wording import counted
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings
from biodyn_core.conditioning.range_alignment import Alignment
from biodyn_ros.base.wording import number, table
from biodyn_ros.blue_trident.exports import ChosenExports, FoundExports
from biodyn_ros.blue_trident.high_g import Replacement
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export
from biodyn_ros.blue_trident.survey import SensorSurvey, SurveyResult

MAX_RANGES: Final = 10_000
RESAMPLED_RAIL_SHARE: Final = 0.5
"""From this fraction of the range on, samples resampled by Nexus may hide clipped ones."""

_DAMAGE: Final = {
    "ragged": "rows with a wrong number of cells, left out",
    "untimed": "rows without a valid time, left out",
    "no_number": "cells without a valid number",
}
_LEFT_OUT: Final = {
    "late_start": "of zeros before it started",
    "dropouts": "of zeros during the recording, now gaps",
    "early_end": "of zeros after it ended",
    "faded": "mixed with zeros by Nexus",
    "unreadable": "without a readable acceleration",
}


@dataclass
class SampleCounts:
    """Samples of one sensor: written, with a high-g value on any axis, and still clipped."""

    written: int = 0
    from_high_g: int = 0
    clipped: int = 0


@dataclass(frozen=True, eq=False)
class Outcome:
    """The results of an import; replacements and counts by serial; damage, sizes and hashes by file."""

    found: FoundExports
    chosen: ChosenExports
    read: SurveyResult
    replacements: Mapping[str, Replacement]
    counts: Mapping[str, SampleCounts]
    damage: Mapping[Export, Damage]
    sizes: Mapping[Export, int]
    hashes: Mapping[Export, str]
    start_ns: int | None
    settings: DualRangeSettings
    high_g: bool


def document_of(outcome: Outcome) -> dict[str, Any]:
    """The mapping of `--json` without the bag's name and the version."""
    chosen = outcome.chosen
    by_sensor = {sensor: serial for serial, sensor in chosen.sensors.items()}
    ordered = [sensor for sensor in SENSORS if sensor in by_sensor]
    return {
        "format": chosen.exports[0].kind,
        "take": ", ".join(sorted({export.take for export in chosen.exports})),
        "start": _start(outcome),
        "files": [_file(outcome, export) for export in chosen.exports],
        "sensors": {sensor: _row(outcome, by_sensor[sensor]) for sensor in ordered},
        "missing": [sensor for sensor in SENSORS if sensor not in by_sensor],
        "not_mapped": [serial for serial in outcome.found.serials() if serial not in chosen.sensors],
        "aside": [*outcome.found.ignored, *outcome.found.refused],
        "warnings": _warnings(outcome, ordered, by_sensor),
    }


def ranges(replacement: Replacement) -> str:
    """The stamp ranges of high-g as JSON, [first_ns, last_ns, axes] each; only their number if they are too many."""
    if len(replacement.replaced) > MAX_RANGES:
        return json.dumps({"ranges": len(replacement.replaced)})
    stamps_ns, axes = replacement.stamps_ns, replacement.share > 0.0
    cuts = np.flatnonzero((axes[1:] != axes[:-1]).any(axis=1) | (np.diff(stamps_ns) > 20_000_000)) + 1
    edges = [0, *cuts.tolist(), len(axes)]
    found = [
        [int(stamps_ns[lo]), int(stamps_ns[hi - 1]), "".join(np.array(["x", "y", "z"])[axes[lo]])]
        for lo, hi in pairwise(edges)
        if hi > lo
    ]
    return json.dumps(found)


def text_of(document: Mapping[str, Any]) -> str:
    """The document as text."""
    sensors = document["sensors"]
    total = sum(row["samples"] for row in sensors.values())
    lines = [f"{document['bag']}: {counted(total, 'message')} from {document['format']}, take {document['take']}", ""]
    rows = [("sensor", "serial", "samples", "Hz", "seconds", "left out", "gaps", "from high-g", "clipped")]
    for name, row in sensors.items():
        out, rate = sum(row["left_out"].values()), row["rate_hz"]
        rows.append(
            (
                name, row["serial"], str(row["samples"]), f"{rate:.2f}" if rate else "-", f"{row['seconds']:.1f}",
                str(out), str(row["gaps"]), str(row["from_high_g"]), str(row["clipped"]),
            )
        )  # fmt: skip
    lines += table(rows, left=(0, 1))
    lines += ["", *(f"{name}: high-g {_alignment_text(row)}" for name, row in sensors.items() if row["high_g"])]
    lines += [f"not read: {line}" for line in document["aside"][:12]]
    if len(document["aside"]) > 12:
        lines.append(f"not read: {counted(len(document['aside']) - 12, 'more file')}")
    return "\n".join([*lines, *(f"note: {line}" for line in document["warnings"])]).replace("\n\n\n", "\n\n")


def _alignment_text(row: Mapping[str, Any]) -> str:
    high = row["high_g"]
    bias = ", ".join(number(value) for value in high["bias_mps2"])
    gain = ", ".join(
        f"{value:.3f}" if known else "1" for value, known in zip(high["gain"], high["gain_measured"], strict=True)
    )
    delay = f"{1e3 * high['delay_s']:.2f} ms" if high["delay_measured"] else "not measured"
    noise = ", ".join(number(value) for value in high["noise_mps2"])
    return f"bias {bias} m/s^2, gain {gain}, delay {delay}, difference {noise} m/s^2 rms"


def _start(outcome: Outcome) -> str:
    if outcome.chosen.exports[0].kind == "Capture.U":
        return "Unix time of the export"
    if outcome.start_ns is None:
        return "none: stamps are frame numbers divided by the rate"
    return datetime.fromtimestamp(1e-9 * outcome.start_ns, timezone.utc).isoformat() + " of the first row, as given"


def _file(outcome: Outcome, export: Export) -> dict[str, Any]:
    damage = outcome.damage.get(export)
    return {
        "path": str(export.path),
        "bytes": outcome.sizes[export],
        "sha256": outcome.hashes[export],
        "read": damage is not None,
        "holds": [
            {"serial": info.serial, "channel": info.channel, "accel_unit": info.accel_unit, "gyro_unit": info.gyro_unit}
            for info in export.channels
        ],
        "ragged_rows": damage.ragged if damage else 0,
        "untimed_rows": damage.untimed if damage else 0,
        "cells_no_number": damage.no_number if damage else 0,
        "cut": bool(damage and damage.cut),
    }


def _row(outcome: Outcome, serial: str) -> dict[str, Any]:
    seen, counts = outcome.read.sensors[serial], outcome.counts[serial]
    replacement = outcome.replacements.get(serial)
    return {
        "serial": serial,
        "samples": counts.written,
        "rate_hz": seen.rate_hz(),
        "first_ns": seen.first_ns,
        "seconds": 1e-9 * (seen.last_ns - seen.first_ns),
        "left_out": asdict(seen.cleaner.omitted),
        "gaps": seen.gaps,
        "gyro": seen.gyro,
        "from_high_g": counts.from_high_g,
        "clipped": counts.clipped,
        "high_g": _high(replacement) if replacement else None,
    }


def _high(replacement: Replacement) -> dict[str, Any]:
    alignment: Alignment = replacement.alignment
    return {
        "taken_over": len(replacement.replaced),
        "left": len(replacement.remaining),
        "bias_mps2": [float(value) for value in replacement.bias_mps2],
        "gain": list(alignment.gain),
        "gain_measured": list(alignment.measured),
        "delay_s": alignment.delay_s,
        "delay_measured": alignment.delay_measured,
        "noise_mps2": list(alignment.noise_mps2),
    }


def _warnings(outcome: Outcome, ordered: list[str], by_sensor: Mapping[str, str]) -> list[str]:
    lines = [] if SEAT in ordered else [f"{SEAT}: not mapped, needed for every prediction: --map {SEAT}=SERIAL"]
    missing = [sensor for sensor in SENSORS if sensor not in by_sensor and sensor != SEAT]
    if missing:
        lines.append(f"not mapped: {', '.join(missing)}")
    if outcome.chosen.exports[0].kind == "Nexus" and outcome.start_ns is None:
        lines.append("Nexus stores no time of day: stamps count from frame 0; --start TIME sets that of the first row")
    for export, damage in outcome.damage.items():
        lines += _damage_lines(export.path, damage)
    for sensor in ordered:
        serial = by_sensor[sensor]
        name = f"{sensor} ({serial})"
        seen = outcome.read.sensors[serial]
        left_out = [f"{count} {_LEFT_OUT[cause]}" for cause, count in asdict(seen.cleaner.omitted).items() if count]
        lines += [f"{name}: rows left out: {', '.join(left_out)}"] if left_out else []
        lines += [f"{name}: {line}" for line in _sensor_lines(outcome, serial, seen)]
    return lines


def _damage_lines(path: Path, damage: Damage) -> list[str]:
    where = f", the first in line {damage.first_line}" if damage.first_line else ""
    counts = {name: getattr(damage, name) for name in _DAMAGE}
    lines = [f"{path.name}: {_DAMAGE[name]}: {count}{where}" for name, count in counts.items() if count]
    if damage.cut:
        lines.append(f"{path.name}: the last line is incomplete and left out; is the file still being written?")
    return lines


def _sensor_lines(outcome: Outcome, serial: str, seen: SensorSurvey) -> list[str]:
    counts, replacement = outcome.counts[serial], outcome.replacements.get(serial)
    lines = []
    if seen.back:
        lines.append(
            f"{counted(seen.back, 'stamp does', 'stamps do')} not increase: written unchanged, rejected by replay"
        )
    if not seen.gyro:
        lines.append("no gyro in the export")
    if counts.from_high_g:
        lines.append(
            f"{counted(counts.from_high_g, 'sample has', 'samples have')} high-g values where low-g was clipped,"
            " marked by the covariance"
        )
    if counts.clipped:
        remaining = counted(counts.clipped, "sample remains", "samples remain")
        lines.append(f"{remaining} clipped: {_why(outcome, serial, replacement)}")
    if counts.clipped and counts.from_high_g:
        lines.append("replay counts the high-g samples as clipped too, because it cannot distinguish them")
    rail = seen.lower_rail_mps2(outcome.settings)
    if rail:
        lines.append(
            f"its largest value, {rail:.2f} m/s^2, repeats as in saturation: if so, --saturation-mps2 {rail - 0.05:.1f}"
        )
    largest = float(seen.top_mps2.max())
    if outcome.chosen.exports[0].kind == "Nexus" and largest > RESAMPLED_RAIL_SHARE * outcome.settings.saturation_mps2:
        lines.append(f"reaches {largest:.0f} m/s^2 after resampling by Nexus: earlier clipping cannot be detected")
    return lines


def _why(outcome: Outcome, serial: str, replacement: Replacement | None) -> str:
    if not outcome.high_g:
        return "high-g is switched off"
    if outcome.chosen.file_of(serial, "high") is None:
        return "no high-g file of this sensor"
    if replacement is None or not (replacement.replaced or any(replacement.bias_mps2)):
        return "too few valid low-g samples around them to calibrate high-g"
    return "high-g is missing, saturated, stuck or inconsistent there"
