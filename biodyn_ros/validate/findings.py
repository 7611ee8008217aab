"""What disagrees in a validation, and what cannot be told: findings, one line each, and the verdict they make."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

from biodyn_core.base.segments import HEAD
from biodyn_core.identification.settings import CaseSettings
from biodyn_ros.base.wording import number, words
from biodyn_ros.validate.settings import ValidationSettings

Document = dict[str, Any]

LEAST_COMPARED_S: Final = CaseSettings().least_compared_s
"""A segment that was compared for less has no say, in validation as in a fit."""


def findings(document: Document, limits: ValidationSettings) -> Iterator[Document]:
    """Every disagreement, and everything that cannot be told, one line each."""
    if document["role"] == "fitted":
        text = "the subject was fitted to this recording, so it validates nothing: take one that was not"
        yield _finding("undecided", "fitted_to", None, text)
    yield from _stht_findings(document["stht"], document["spectra"], limits)
    for name, error in document["error"]["segments"].items():
        if error is None or error["nrmse_rms_percent"] is None:
            yield _finding("undecided", "not_measured", name, f"{words(name)}: not measured in this event")
        elif error["compared_s"] < LEAST_COMPARED_S:
            text = f"{words(name)}: compared for {number(error['compared_s'])} s only, {LEAST_COMPARED_S:g} s can tell"
            yield _finding("undecided", "too_short", name, text)
        elif error["nrmse_rms_percent"] > limits.nrmse_percent:
            percent = number(error["nrmse_rms_percent"])
            text = f"{words(name)}: error {percent} % of its rms, above {limits.nrmse_percent:g} %"
            yield _finding("disagrees", "nrmse", name, text)
    for name, doses in document["exposure"]["segments"].items():
        measured, predicted = doses["measured"], doses["predicted"]
        if measured and predicted and measured["vdv_mps175"] > 0.0:
            ratio = predicted["vdv_mps175"] / measured["vdv_mps175"]
            if not 1.0 / limits.dose_ratio <= ratio <= limits.dose_ratio:
                text = f"{words(name)}: predicted VDV is {number(ratio)} times the measured one"
                yield _finding("disagrees", "vdv", name, text + _allowed(limits.dose_ratio))


def _stht_findings(stht: Document, spectra: Document, limits: ValidationSettings) -> Iterator[Document]:
    what = "seat-to-head transmissibility"
    ratio, error = stht["peak_ratio"], stht["peak_ratio_relative_error"]
    if ratio is None:
        averages = spectra["averages"][HEAD]
        text = f"{what}: the measured coherence ({averages:.1f} independent averages) is nowhere high enough to tell"
        yield _finding("undecided", "stht", HEAD, text)
        return
    # Two standard errors, as a factor; the prediction has none.
    allowed, off, margin = math.log(limits.stht_ratio), abs(math.log(ratio)), 2.0 * error
    predicted, measured = stht["predicted"], stht["measured"]
    heights = (
        f"predicted peak {number(predicted['magnitude'])}, measured {number(measured['magnitude'])},"
        f" ratio {number(ratio)} +- {number(100.0 * margin)} %"
    )
    if off - margin > allowed or (off > allowed and margin <= allowed):
        yield _finding("disagrees", "stht", HEAD, f"{what}: {heights}{_allowed(limits.stht_ratio)}")
    elif margin > allowed:
        yield _finding("undecided", "stht", HEAD, f"{what}: too uncertain to tell: {heights}")
    if not 1.0 / limits.frequency_ratio <= stht["frequency_ratio"] <= limits.frequency_ratio:
        at_hz, measured_hz = (number(peak["frequency_hz"]) for peak in (predicted, measured))
        text = f"{what}: its peaks lie apart, predicted at {at_hz} Hz, measured at {measured_hz} Hz"
        yield _finding("disagrees", "stht_frequency", HEAD, text + _allowed(limits.frequency_ratio))
    hidden = stht["predicted_anywhere"]
    if hidden and hidden["magnitude"] > limits.stht_ratio * stht["predicted"]["magnitude"]:
        text = (
            f"{what}: the predicted peak, {number(hidden['magnitude'])} at {number(hidden['frequency_hz'])} Hz,"
            " lies where the measured coherence is too low to tell"
        )
        yield _finding("undecided", "stht_peak_hidden", HEAD, text)


def _allowed(factor: float) -> str:
    return f"; a factor of {factor:g} is allowed"


def _finding(status: str, what: str, segment: str | None, text: str) -> Document:
    return {"status": status, "what": what, "segment": segment, "text": text}


def verdict(findings: Sequence[Document]) -> str:
    """The worst of all findings: disagrees, undecided, or agrees where there is none."""
    found = {finding["status"] for finding in findings}
    return next((status for status in ("disagrees", "undecided") if status in found), "agrees")
