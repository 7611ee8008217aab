"""A validation for the terminal, from the mapping of `validate.json`."""

from __future__ import annotations

from typing import Any

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_ros.base.wording import number, words

Document = dict[str, Any]


def text_of(document: Document) -> str:
    """The document for the terminal."""
    lines = [
        f"{document['bag']}  case {document['case']}  subject {document['subject']} ({document['mass_matrix']})",
        f"{document['seconds']:.1f} s, the first {document['warm_up_s']:g} s of each run are warm-up",
        _error_line(document["error"]),
        "",
        "segment         error/rms  error/range   aw m/s^2 measured predicted   VDV m/s^1.75 measured predicted",
        *(_row(name, document) for name in MEASURED_SEGMENTS),
        "",
        _stht_line(document["stht"]),
        _driving_line(document["driving_point"]),
        "",
        f"verdict: {document['verdict']}",
        *(f"  {finding['status']}: {finding['text']}" for finding in document["findings"]),
        *(f"warning: {line}" for line in document["warnings"]),
        *([document["bag_made_by_model"]] if "bag_made_by_model" in document else []),
    ]
    return "\n".join(lines)


def _error_line(error: Document) -> str:
    """The mean error beside that of the worst segment."""
    if error["worst_segment"] is None:
        return "error/rms: no segment was measured"
    mean, worst = number(error["mean_nrmse_rms_percent"]), number(error["worst_nrmse_rms_percent"])
    return f"error/rms: mean {mean} %, worst {words(error['worst_segment'])} {worst} %"


def _row(name: str, document: Document) -> str:
    error, doses = document["error"]["segments"][name], document["exposure"]["segments"][name]
    if error is None or doses["measured"] is None:
        return f"{words(name):<15} not measured"
    pairs = [(doses["measured"][key], doses["predicted"][key]) for key in ("aw_mps2", "vdv_mps175")]
    bound = ">= " if doses["lower_bound"] else ""
    (aw, aw_model), (vdv, vdv_model) = ((number(a), number(b)) for a, b in pairs)
    vdv, vdv_model = bound + vdv, bound + vdv_model  # a mean is no bound for want of samples
    by_rms, by_range = (number(error[f"nrmse_{kind}_percent"]) + " %" for kind in ("rms", "range"))
    return f"{words(name):<15} {by_rms:>9}  {by_range:>11}  {aw:>18} {aw_model:>9}  {vdv:>22} {vdv_model:>9}"


def _stht_line(stht: Document) -> str:
    if stht["peak_ratio"] is None:
        return "seat-to-head transmissibility: the measured coherence is too low to tell"
    measured, predicted = stht["measured"], stht["predicted"]
    return (
        f"seat-to-head transmissibility: measured {_at(measured)} (coherence {measured['coherence']:.2f}),"
        f" predicted {_at(predicted)}, ratio {number(stht['peak_ratio'])}"
    )


def _driving_line(point: Document) -> str:
    if "refused" in point:
        return f"apparent mass: {point['refused']}"
    found, how = point["predicted"], " as printed" if point["as_printed"] else ""
    if found["peak"] is None:
        return f"apparent mass, predicted{how}: the coherence is too low to tell"
    shares = (
        f"{number(found[key]['magnitude'])} by {by}"
        for key, by in (("peak_by_body_mass", "body mass"), ("peak_by_upper_body_mass", "upper-body mass"))
    )
    return f"apparent mass, predicted{how}: {_at(found['peak'], ' kg')}, {', '.join(shares)}"


def _at(peak: Document, unit: str = "") -> str:
    return f"{number(peak['magnitude'])}{unit} at {number(peak['frequency_hz'])} Hz"
