"""What an import says: its document for --json and for the bag's metadata, its warnings, and a page of text."""

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
from biodyn_ros.blue_trident.cleaning import LeftOut
from biodyn_ros.blue_trident.found import Chosen, Found
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export
from biodyn_ros.blue_trident.survey import Read, Surveyed
from biodyn_ros.blue_trident.wide import Taken

MOST_RANGES: Final = 10_000
LOST_BY_NEXUS: Final = 0.5
"""From this share of the rail on a reading that Nexus resampled may hide clipped ones."""

_LEFT_OUT: Final = {
    "late_start": "of zeros before it started",
    "dropouts": "of zeros amid the recording, now gaps",
    "early_end": "of zeros after it ended",
    "faded": "that Nexus faded into zeros or into an end",
    "unreadable": "without a readable acceleration",
}


@dataclass
class Marked:
    """Samples of one sensor: those written, those with any reading of high-g, and those still at their rail."""

    written: int = 0
    from_high_g: int = 0
    clipped: int = 0


@dataclass(frozen=True, eq=False)
class Outcome:
    """All that an import came to know; marked and taken are by serial, damage, bytes and their hashes by file."""

    found: Found
    chosen: Chosen
    read: Read
    taken: Mapping[str, Taken]
    marked: Mapping[str, Marked]
    damage: Mapping[Export, Damage]
    sizes: Mapping[Export, int]
    hashes: Mapping[Export, str]
    start_ns: int | None
    settings: DualRangeSettings
    high_g: bool


def document_of(outcome: Outcome) -> dict[str, Any]:
    """The mapping of `--json` but for the bag's name and the version."""
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
        "aside": [*outcome.found.aside, *outcome.found.refused],
        "warnings": _warnings(outcome, ordered, by_sensor),
    }


def ranges(taken: Taken) -> str:
    """Which stamps carry high-g, as JSON: [first_ns, last_ns, axes] each; only their number if they are too many."""
    if len(taken.taken) > MOST_RANGES:
        return json.dumps({"ranges": len(taken.taken)})
    axes = taken.share > 0.0
    cuts = np.flatnonzero((axes[1:] != axes[:-1]).any(axis=1) | (np.diff(taken.stamps_ns) > 20_000_000)) + 1
    edges = [0, *cuts.tolist(), len(axes)]
    found = [
        [int(taken.stamps_ns[lo]), int(taken.stamps_ns[hi - 1]), "".join(np.array(["x", "y", "z"])[axes[lo]])]
        for lo, hi in pairwise(edges)
        if hi > lo
    ]
    return json.dumps(found)


def text_of(document: Mapping[str, Any]) -> str:
    """The document as a page of text."""
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
    delay = f"{1e3 * high['delay_s']:.2f} ms" if high["delay_measured"] else "none measured"
    noise = ", ".join(number(value) for value in high["noise_mps2"])
    return f"bias {bias} m/s^2, gain {gain}, delay {delay}, differs by {noise} m/s^2 rms"


def _start(outcome: Outcome) -> str:
    if outcome.chosen.exports[0].kind == "Capture.U":
        return "Unix time of the export"
    if outcome.start_ns is None:
        return "none: stamps are frame numbers over the rate"
    return datetime.fromtimestamp(1e-9 * outcome.start_ns, timezone.utc).isoformat() + " of the first row, as given"


def _file(outcome: Outcome, export: Export) -> dict[str, Any]:
    damage = outcome.damage.get(export)
    return {
        "path": str(export.path),
        "bytes": outcome.sizes[export],
        "sha256": outcome.hashes[export],
        "read": damage is not None,
        "holds": [
            {"serial": held.serial, "channel": held.channel, "accel_unit": held.accel_unit, "gyro_unit": held.gyro_unit}
            for held in export.held
        ],
        "ragged_rows": damage.ragged if damage else 0,
        "untimed_rows": damage.untimed if damage else 0,
        "cells_no_number": damage.no_number if damage else 0,
        "cut": bool(damage and damage.cut),
    }


def _row(outcome: Outcome, serial: str) -> dict[str, Any]:
    seen, marked, taken = outcome.read.sensors[serial], outcome.marked[serial], outcome.taken.get(serial)
    return {
        "serial": serial,
        "samples": marked.written,
        "rate_hz": seen.rate_hz(),
        "first_ns": seen.first_ns,
        "seconds": 1e-9 * (seen.last_ns - seen.first_ns),
        "left_out": asdict(seen.cleaner.left_out),
        "gaps": seen.gaps,
        "gyro": seen.gyro,
        "from_high_g": marked.from_high_g,
        "clipped": marked.clipped,
        "high_g": _high(taken) if taken else None,
    }


def _high(taken: Taken) -> dict[str, Any]:
    alignment: Alignment = taken.alignment
    return {
        "taken_over": len(taken.taken),
        "left": len(taken.left),
        "bias_mps2": [float(value) for value in taken.bias_mps2],
        "gain": list(alignment.gain),
        "gain_measured": list(alignment.measured),
        "delay_s": alignment.delay_s,
        "delay_measured": alignment.delay_measured,
        "noise_mps2": list(alignment.noise_mps2),
    }


def _warnings(outcome: Outcome, ordered: list[str], by_sensor: Mapping[str, str]) -> list[str]:
    lines = [] if SEAT in ordered else [f"{SEAT}: not mapped, and nothing is predicted without it: --map {SEAT}=SERIAL"]
    missing = [sensor for sensor in SENSORS if sensor not in by_sensor and sensor != SEAT]
    if missing:
        lines.append(f"not mapped: {', '.join(missing)}")
    if outcome.chosen.exports[0].kind == "Nexus" and outcome.start_ns is None:
        lines.append("Nexus keeps no time of day: stamps count from frame 0; --start TIME sets the first row's")
    for export, damage in outcome.damage.items():
        lines += _damage_lines(export.path, damage)
    for sensor in ordered:
        serial = by_sensor[sensor]
        name = f"{sensor} ({serial})"
        seen = outcome.read.sensors[serial]
        lines += [f"{name}: rows left out: {line}" for line in _left_out_lines(seen.cleaner.left_out)]
        lines += [f"{name}: {line}" for line in _sensor_lines(outcome, serial, seen)]
    return lines


def _damage_lines(path: Path, damage: Damage) -> list[str]:
    lines = []
    where = f", the first in line {damage.first_line}" if damage.first_line else ""
    if damage.ragged:
        lines.append(f"{path.name}: rows of a wrong number of cells, left out: {damage.ragged}{where}")
    if damage.untimed:
        lines.append(f"{path.name}: rows without a time that can be, left out: {damage.untimed}{where}")
    if damage.no_number:
        lines.append(f"{path.name}: cells that are no number that can be: {damage.no_number}{where}")
    if damage.cut:
        lines.append(
            f"{path.name}: the last line has no end, so it may be cut: left out; is the file still being written?"
        )
    return lines


def _left_out_lines(left_out: LeftOut) -> list[str]:
    told = [f"{count} {_LEFT_OUT[name]}" for name, count in asdict(left_out).items() if count]
    return [", ".join(told)] if told else []


def _sensor_lines(outcome: Outcome, serial: str, seen: Surveyed) -> list[str]:
    marked, taken = outcome.marked[serial], outcome.taken.get(serial)
    lines = []
    if seen.back:
        lines.append(
            f"{counted(seen.back, 'stamp is', 'stamps are')} not after the one before: written all the same,"
            " replay rejects them"
        )
    if not seen.gyro:
        lines.append("no gyro in the export")
    if marked.from_high_g:
        lines.append(
            f"{counted(marked.from_high_g, 'sample carries', 'samples carry')} high-g where low-g was at its rail;"
            " the covariance says which"
        )
    if marked.clipped:
        lines.append(
            f"{counted(marked.clipped, 'sample stays', 'samples stay')} clipped: {_why(outcome, serial, taken)}"
        )
    if marked.clipped and marked.from_high_g:
        lines.append("replay counts those from high-g as clipped too, because it cannot tell them apart")
    rail = seen.lower_rail_mps2(outcome.settings)
    if rail:
        lines.append(
            f"its largest reading, {rail:.2f} m/s^2, returns like a rail: if it is, --saturation-mps2 {rail - 0.05:.1f}"
        )
    largest = float(seen.top_mps2.max())
    if outcome.chosen.exports[0].kind == "Nexus" and largest > LOST_BY_NEXUS * outcome.settings.saturation_mps2:
        lines.append(
            f"reaches {largest:.0f} m/s^2 after Nexus resampled it: what was clipped before cannot be seen any more"
        )
    return lines


def _why(outcome: Outcome, serial: str, taken: Taken | None) -> str:
    if not outcome.high_g:
        return "high-g was not asked for"
    if outcome.chosen.file_of(serial, "high") is None:
        return "there is no high-g of this sensor"
    if taken is None or not (taken.taken or any(taken.bias_mps2)):
        return "low-g is not to be trusted long enough beside them to set high-g right"
    return "high-g is missing, at its own rail, stuck, or tells of another motion there"
