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
from biodyn_core.conditioning.range_alignment import DELAY_TOLERANCE_S, GAIN_TOLERANCE
from biodyn_ros import __version__
from biodyn_ros.base.wording import number, table
from biodyn_ros.blue_trident.exports import ChosenExports, FoundExports
from biodyn_ros.blue_trident.high_g import LONGEST_SPAN_S, Replacement
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export, Kind
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

    bag: Path
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

    @property
    def kind(self) -> Kind:
        """The kind of all exports."""
        return self.chosen.exports[0].kind

    @property
    def take(self) -> str:
        """The takes of all exports."""
        return ", ".join(sorted({export.take for export in self.chosen.exports}))

    @property
    def serials(self) -> dict[str, str]:
        """The serial by sensor, in the order of `SENSORS`."""
        by_sensor = {sensor: serial for serial, sensor in self.chosen.sensors.items()}
        return {sensor: by_sensor[sensor] for sensor in SENSORS if sensor in by_sensor}

    @property
    def aside(self) -> list[str]:
        """The files that were not read, a line each."""
        return [*self.found.ignored, *self.found.refused]


def document_of(outcome: Outcome) -> dict[str, Any]:
    """The mapping of `biodyn import-blue-trident --json`."""
    chosen, serials = outcome.chosen, outcome.serials
    return {
        "bag": str(outcome.bag),
        "format": outcome.kind,
        "take": outcome.take,
        "start": _start(outcome),
        "files": [_file(outcome, export) for export in chosen.exports],
        "sensors": {sensor: _row(outcome, serial) for sensor, serial in serials.items()},
        "missing": [sensor for sensor in SENSORS if sensor not in serials],
        "not_mapped": [serial for serial in outcome.found.serials() if serial not in chosen.sensors],
        "aside": outcome.aside,
        "warnings": _warnings(outcome),
        "version": __version__,
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


def text_of(outcome: Outcome) -> str:
    """The outcome as text."""
    total, serials, aside = sum(one.written for one in outcome.counts.values()), outcome.serials, outcome.aside
    lines = [f"{outcome.bag}: {counted(total, 'message')} from {outcome.kind}, take {outcome.take}", ""]
    rows = [("sensor", "serial", "samples", "Hz", "seconds", "left out", "gaps", "from high-g", "clipped")]
    for sensor, serial in serials.items():
        seen, counts = outcome.read.sensors[serial], outcome.counts[serial]
        out, rate = sum(asdict(seen.cleaner.omitted).values()), seen.rate_hz()
        rows.append(
            (
                sensor, serial, str(counts.written), f"{rate:.2f}" if rate else "-", f"{seen.seconds:.1f}",
                str(out), str(seen.gaps), str(counts.from_high_g), str(counts.clipped),
            )
        )  # fmt: skip
    lines += table(rows, left=(0, 1))
    compared = {sensor: outcome.replacements.get(serial) for sensor, serial in serials.items()}
    lines += ["", *(f"{sensor}: high-g {_alignment_text(one)}" for sensor, one in compared.items() if one)]
    lines += [f"not read: {line}" for line in aside[:12]]
    if len(aside) > 12:
        lines.append(f"not read: {counted(len(aside) - 12, 'more file')}")
    return "\n".join([*lines, *(f"note: {line}" for line in _warnings(outcome))]).replace("\n\n\n", "\n\n")


def _alignment_text(replacement: Replacement) -> str:
    high = replacement.alignment
    bias = ", ".join(number(float(value)) for value in replacement.bias_mps2)
    known = zip(high.gain, high.measured, high.determined, strict=True)
    gain = ", ".join(f"{value:.3f}" if own else "1" if told else "1 (assumed)" for value, own, told in known)
    delay = f"{1e3 * high.delay_s:.2f} ms" if high.delay_measured else "0" if high.delay_determined else "0 (assumed)"
    noise = ", ".join(number(value) for value in high.noise_mps2)
    return f"bias {bias} m/s^2, gain {gain}, delay {delay}, difference {noise} m/s^2 rms"


def _start(outcome: Outcome) -> str:
    if outcome.kind == "Capture.U":
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
        "seconds": seen.seconds,
        "left_out": asdict(seen.cleaner.omitted),
        "gaps": seen.gaps,
        "gyro": seen.gyro,
        "from_high_g": counts.from_high_g,
        "clipped": counts.clipped,
        "high_g": _high(replacement) if replacement else None,
    }


def _high(replacement: Replacement) -> dict[str, Any]:
    alignment = replacement.alignment
    return {
        "taken_over": len(replacement.replaced),
        "left": len(replacement.remaining),
        "bias_mps2": [float(value) for value in replacement.bias_mps2],
        "gain": list(alignment.gain),
        "gain_measured": list(alignment.measured),
        "gain_determined": list(alignment.determined),
        "gain_error": list(alignment.gain_error),
        "delay_s": alignment.delay_s,
        "delay_measured": alignment.delay_measured,
        "delay_determined": alignment.delay_determined,
        "delay_error_s": alignment.delay_error_s,
        "noise_mps2": list(alignment.noise_mps2),
    }


def _warnings(outcome: Outcome) -> list[str]:
    serials = outcome.serials
    lines = [] if SEAT in serials else [f"{SEAT}: not mapped, needed for every prediction: --map {SEAT}=SERIAL"]
    missing = [sensor for sensor in SENSORS if sensor not in serials and sensor != SEAT]
    if missing:
        lines.append(f"not mapped: {', '.join(missing)}")
    if outcome.kind == "Nexus" and outcome.start_ns is None:
        lines.append("Nexus stores no time of day: stamps count from frame 0; --start TIME sets that of the first row")
    for export, damage in outcome.damage.items():
        lines += _damage_lines(export.path, damage)
    for sensor, serial in serials.items():
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
    if damage.section:
        lines.append(f"{path.name}: what follows {damage.section} is another section and left out")
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
    if replacement and (assumed := _assumed(replacement)):
        lines.append(f"the motion does not determine high-g {assumed}: the covariance contains these errors")
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
    if outcome.kind == "Nexus" and largest > RESAMPLED_RAIL_SHARE * outcome.settings.saturation_mps2:
        lines.append(f"reaches {largest:.0f} m/s^2 after resampling by Nexus: earlier clipping cannot be detected")
    return lines


def _assumed(replacement: Replacement) -> str:
    """Gains and delay that high-g values depend on and that are not determined, with what is assumed, or nothing."""
    alignment, axes = replacement.alignment, replacement.axes
    unknown = [letter for axis, letter in enumerate("xyz") if axis in axes and not alignment.determined[axis]]
    found = [f"gain of {', '.join(unknown)} (1 within {100.0 * GAIN_TOLERANCE:g} % assumed)"] if unknown else []
    if axes and not alignment.delay_determined:
        found.append(f"delay (0 within {1e3 * DELAY_TOLERANCE_S:g} ms assumed)")
    return " and ".join(found)


def _why(outcome: Outcome, serial: str, replacement: Replacement | None) -> str:
    if not outcome.high_g:
        return "high-g is switched off"
    if outcome.chosen.file_of(serial, "high") is None:
        return "no high-g file of this sensor"
    stuck = f"at the end of the range for over {LONGEST_SPAN_S:g} s at a time, a fault that high-g does not replace"
    remaining = () if replacement is None else replacement.remaining
    long = [span for span in remaining if span.end_s - span.begin_s > LONGEST_SPAN_S]
    if long and len(long) == len(remaining):
        return stuck
    known = replacement is not None and (replacement.replaced or any(replacement.bias_mps2))
    cause = (
        "high-g is missing, saturated, stuck or inconsistent there"
        if known
        else "too few valid low-g samples around them to calibrate high-g"
    )
    return f"{cause}, or they are {stuck}" if long else cause
