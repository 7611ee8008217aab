"""The summary of a recording for the terminal, from the mapping of `exposure.json`."""

from __future__ import annotations

from typing import Any

from biodyn_ros.base.wording import HORIZONTAL, ZONE, bound, duration, number, sentence, shocks, span, time_left


def summary(document: dict[str, Any]) -> str:
    """Summary: the seat against its limits, exposure by sensor, prediction and residual, warnings."""
    lines = [
        f"{document['bag']}  subject {document['subject']} ({document['mass_matrix']})",
        f"{document['seconds']:.1f} s, {document['uncounted_s']:.2f} s of it uncounted, until gravity was known",
        "",
        *_seat_lines(document),
        *_dri_lines(document),
        *_mark_lines(document),
        "",
        f"{'':14s}{'aw':>9s}{'VDV':>11s}{'predicted':>12s}{'VDV':>11s}{'residual rms':>15s}{'NRMSE':>9s}",
        f"{'':14s}{'m/s^2':>9s}{'m/s^1.75':>11s}{'aw m/s^2':>12s}{'m/s^1.75':>11s}{'m/s^2':>15s}{'%':>9s}",
    ]
    names = dict.fromkeys([*document["sensors"], *document["predicted"]])
    lines += [_row(name, document) for name in names]
    lines += ["", "aw and VDV: Wk, vertical, before the low-pass. Predictions are a model's: not validated."]
    lines += [f"note: {text}" for text in (*document["warnings"], document.get("bag_made_by_model")) if text]
    return "\n".join(lines)


def _mark_lines(document: dict[str, Any]) -> list[str]:
    marks = ", ".join(f"{mark['name']} at {mark['time_s']:.3f} s" for mark in document["marks"])
    return [f"marked: {marks}"] if marks else []


def _row(name: str, document: dict[str, Any]) -> str:
    measured, predicted = document["sensors"].get(name), document["predicted"].get(name)
    residual = document["residual"].get(name)
    cells = [
        f"{_aw(measured):>9s}{_vdv(measured):>11s}" if measured else f"{'–':>9s}{'–':>11s}",
        f"{_aw(predicted):>12s}{_vdv(predicted):>11s}" if predicted else f"{'–':>12s}{'–':>11s}",
        f"{number(residual['rms_mps2']):>15s}{number(residual['nrmse_rms_percent']):>9s}"
        if residual
        else f"{'–':>15s}{'–':>9s}",
    ]
    return f"{name:14s}" + "".join(cells)


def _aw(figures: dict[str, Any]) -> str:
    return bound(figures["aw_mps2"], figures["aw_lower_bound"])


def _vdv(figures: dict[str, Any]) -> str:
    return bound(figures["vdv_mps175"], figures["lower_bound"])


def _seat_lines(document: dict[str, Any]) -> list[str]:
    seat, limits = document["seat"], document["limits"]
    if seat is None:
        return ["seat: nothing counted"]
    lower = seat["lower_bound"]
    a8 = f"{bound(seat['a8_so_far_mps2'], lower)} m/s^2 of {_pair(limits, 'a8_mps2')}"
    vdv = f"{bound(seat['vdv_so_far_mps175'], lower)} m/s^1.75 of {_pair(limits, 'vdv_mps175')}"
    return [
        f"SEAT: {ZONE[seat['zone']].upper()}",
        sentence(seat["zone_reason"]),
        f"seat A(8) so far {a8}, VDV so far {vdv} ({limits['source']})",
        *_projected(seat),
        *(time_left(kind, seat) for kind in ("action", "limit")),
        f"Governed by {seat['governing']}, axis {seat['axis']}. {HORIZONTAL[seat['horizontal']]}",
        shocks(seat),
        *(f"beside, {each['source']}: {ZONE[each['zone']].lower()}" for each in document["limits_beside"]),
    ]


def _pair(limits: dict[str, Any], measure: str) -> str:
    action, limit = limits[f"action_{measure}"], limits[f"limit_{measure}"]
    return "no value stated" if action is None else f"{action:g} / {limit:g}"


def _projected(seat: dict[str, Any]) -> list[str]:
    if seat["projected_from_s"] is None:
        return []
    lower = seat["projected_lower_bound"]
    a8, vdv = (bound(seat[name], lower) for name in ("a8_projected_8h_mps2", "vdv_projected_8h_mps175"))
    return [f"projected to 8 h from {duration(seat['projected_from_s'])} counted: A(8) {a8} m/s^2, VDV {vdv} m/s^1.75"]


def _dri_lines(document: dict[str, Any]) -> list[str]:
    dri, hic = document["dri"], document["hic15"]
    lines = []
    if dri:
        lines.append(
            f"DRI {bound(dri['compression'], dri['lower_bound'])} (compression, band {dri['class']}; "
            f"as printed {number(dri['as_printed'])}); "
            "a criterion for a single upward pulse, not a dose"
        )
    if hic:
        lines.append(
            f"HIC15 of the head {bound(hic['resultant'], hic['lower_bound'])} resultant{_window(hic)}, "
            f"{number(hic['vertical'])} vertical, {number(hic['as_printed'])} with 1 g as printed"
        )
    return lines


def _window(hic: dict[str, Any]) -> str:
    window = hic["windows_s"]["resultant"]
    return f" ({span(window)} s after counting began)" if window else ""
