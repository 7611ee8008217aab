"""Findings of a validation, one line each: disagreements and undecided criteria, and their verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from biodyn_core.base.segments import HEAD, SEAT, SEGMENTS
from biodyn_core.identification.settings import CaseSettings
from biodyn_core.validation.exposures import Exposures
from biodyn_core.validation.validation import HeadPeaks, Validation
from biodyn_ros.base.wording import number, words
from biodyn_ros.reading.provenance import Role
from biodyn_ros.validate.settings import ValidationSettings

LEAST_COMPARED_S: Final = CaseSettings().least_compared_s
"""A segment compared for less time is undecided; a fit excludes it too."""


FEW_AVERAGES: Final = 2.0
"""With fewer, only a coherence above 0.95 exceeds chance."""


class Finding(NamedTuple):
    """A finding: status is disagrees or undecided, what the criterion, segment None if it concerns all."""

    status: str
    what: str
    segment: str | None
    text: str


def findings(found: Validation, role: Role | None, limits: ValidationSettings) -> Iterator[Finding]:
    """All disagreements and undecided criteria."""
    if role == "fitted":
        text = "the subject was fitted to this recording, so this is no validation: use another recording"
        yield Finding("undecided", "fitted_to", None, text)
    yield from head_findings(found.head, float(found.measured.averages[SEGMENTS.index(HEAD)]), limits)
    for name, error in found.errors.items():
        if error is None or error.nrmse_rms_percent is None:
            yield Finding("undecided", "not_measured", name, f"{words(name)}: not measured in this event")
        elif error.compared_s < LEAST_COMPARED_S:
            text = f"{words(name)}: compared for {number(error.compared_s)} s, less than {LEAST_COMPARED_S:g} s"
            yield Finding("undecided", "too_short", name, text)
        elif error.nrmse_rms_percent > limits.nrmse_percent:
            percent = number(error.nrmse_rms_percent)
            text = f"{words(name)}: error {percent} % of its rms, above {limits.nrmse_percent:g} %"
            yield Finding("disagrees", "nrmse", name, text)
    yield from _left_out(found.exposures, limits)
    for name in SEGMENTS:
        measured, predicted, read = found.exposures.compared[name]
        if min(measured.seconds, read.seconds) >= LEAST_COMPARED_S and measured.vdv_mps175 > 0.0:
            ratio = read.vdv_mps175 / measured.vdv_mps175
            if not 1.0 / limits.dose_ratio <= ratio <= limits.dose_ratio:
                is_own = read.vdv_mps175 == predicted.vdv_mps175
                which = "predicted VDV" if is_own else "predicted VDV, as its sensor would read it,"
                text = f"{words(name)}: {which} is {number(ratio)} times the measured one"
                yield Finding("disagrees", "vdv", name, text + _allowed(limits.dose_ratio))


def _left_out(found: Exposures, limits: ValidationSettings) -> Iterator[Finding]:
    """Segments that are compared, but not in the strongest motion of the seat."""
    for name, compared in found.compared.items():
        of_all, of_compared = found.seat_with_suspect.vdv_mps175, found.seat_compared_mps175[name]
        if compared.measured.seconds >= LEAST_COMPARED_S and of_all > limits.dose_ratio * of_compared:
            up_to = "up to " if found.suspect_s[SEAT] > 0.0 else ""
            text = (
                f"{words(name)}: not compared in the strongest motion: the VDV of the seat is {up_to}{number(of_all)}"
                f" m/s^1.75, and {number(of_compared)} m/s^1.75 where the {words(name)} is compared"
            )
            yield Finding("undecided", "left_out", name, text + _allowed(limits.dose_ratio))


def head_findings(head: HeadPeaks, averages: float, limits: ValidationSettings) -> Iterator[Finding]:
    """Findings of seat-to-head transmissibility, from so many independent averages."""
    what = "seat-to-head transmissibility"
    ratio, predicted, measured = head.ratio, head.predicted, head.measured
    if ratio is None or ratio.magnitude is None or predicted is None or measured is None:
        text = f"{what}: the measured coherence ({averages:.1f} independent averages) is too low at all frequencies"
        if averages < FEW_AVERAGES:
            text = f"{what}: {averages:.1f} independent averages are too few: record more shocks, or a road"
        yield Finding("undecided", "stht", HEAD, text)
        return
    # Two standard errors, as a factor; the prediction has none.
    allowed, off, margin = math.log(limits.stht_ratio), abs(math.log(ratio.magnitude)), 2.0 * ratio.relative_error
    heights = (
        f"predicted peak {number(predicted.magnitude)}, measured {number(measured.magnitude)},"
        f" ratio {number(ratio.magnitude)} +- {number(100.0 * margin)} %"
    )
    if off - margin > allowed or (off > allowed and margin <= allowed):
        yield Finding("disagrees", "stht", HEAD, f"{what}: {heights}{_allowed(limits.stht_ratio)}")
    elif margin > allowed:
        yield Finding("undecided", "stht", HEAD, f"{what}: too uncertain: {heights}")
    if not 1.0 / limits.frequency_ratio <= ratio.frequency <= limits.frequency_ratio:
        at_hz, measured_hz = number(predicted.frequency_hz), number(measured.frequency_hz)
        text = f"{what}: its peaks differ in frequency, predicted at {at_hz} Hz, measured at {measured_hz} Hz"
        if ratio.is_distinct:
            yield Finding("disagrees", "stht_frequency", HEAD, text + _allowed(limits.frequency_ratio))
        else:
            text += ", but within its errors the measurement is as high at the predicted one"
            yield Finding("undecided", "stht_frequency", HEAD, text)
    hidden = head.predicted_anywhere
    if hidden and hidden.magnitude > limits.stht_ratio * predicted.magnitude:
        text = (
            f"{what}: the predicted peak, {number(hidden.magnitude)} at {number(hidden.frequency_hz)} Hz,"
            " lies at a frequency of low measured coherence"
        )
        yield Finding("undecided", "stht_peak_hidden", HEAD, text)


def _allowed(factor: float) -> str:
    return f"; a factor of {factor:g} is allowed"


def verdict(findings: Sequence[Finding]) -> str:
    """The worst status of all findings: disagrees, undecided, or agrees without findings."""
    found = {finding.status for finding in findings}
    return next((status for status in ("disagrees", "undecided") if status in found), "agrees")
