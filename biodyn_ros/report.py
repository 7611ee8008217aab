"""Reports: one HTML file with its drawings inside; here that of a replay.

jinja2 and matplotlib come late: whoever wants no report needs neither.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

from biodyn_core.errors import InputError, one_line
from biodyn_core.judgement import HORIZONTAL_FACTOR
from biodyn_core.segments import SEAT, SEGMENTS, SENSORS
from biodyn_ros.dose_drawings import VDV_LABEL, Pair, doses
from biodyn_ros.drawings import PALETTE, envelopes, overlay
from biodyn_ros.files import write_text
from biodyn_ros.frequency_drawings import powers, residual_channels, transmissibility, waterfall
from biodyn_ros.resources import package_directory
from biodyn_ros.traces import Traces
from biodyn_ros.validation_findings import LEAST_COHERENCE
from biodyn_ros.verdict import judge
from biodyn_ros.wording import ZONE, bound, duration, number, sentence, shocks, words


def write_replay_report(path: Path, document: dict[str, Any], traces: Traces) -> None:
    """Write the page of a replay from the mapping of `exposure.json` and the traces of its frames.

    Raises InputError where jinja2 or matplotlib is missing, or the file cannot be written; then nothing is left of it.
    """
    check_reports()
    event, predicted, measured, origin_ns = traces.event(), traces.predicted(), traces.measured(), traces.first_ns
    html = render(
        "replay.html.j2",
        document=document,
        verdict=judge(document),
        zones=ZONE,
        flagged=_flagged(document["seat"]),
        segments=[name for name in SEGMENTS if name in document["predicted"]],
        sensors=[name for name in SENSORS if name in document["sensors"]],
        worst=_worst_residual(document),
        seat_axes=_seat_axes(document["seat"]),
        event=event,
        event_s=1e-9 * (event.peak_ns - origin_ns) if event else None,
        bin_s=1e-9 * max(predicted.width_ns, measured.width_ns),
        overlay_svg=overlay(event, origin_ns, document) if event else None,
        envelope_svg=envelopes(predicted, measured, event, origin_ns) if measured.begins_ns.size else None,
        **frequency_parts(document, traces, origin_ns),
    )
    write_page(path, html)


def frequency_parts(document: dict[str, Any], traces: Traces, origin_ns: int) -> dict[str, Any]:
    """What the page shows over frequency, and the doses; None for a drawing that nothing was gathered for."""
    spectra, found, worst = traces.spectra.spectra(), traces.spectra.waterfall(), _worst_residual(document)
    return {
        "bandwidth_hz": spectra["spectra"]["bandwidth_hz"] if spectra else None,
        "transmissibility_svg": transmissibility(spectra, LEAST_COHERENCE) if spectra else None,
        "powers_svg": powers(spectra) if spectra else None,
        "width_ns": found.width_ns if found else None,
        "waterfall_svg": waterfall(found, residual_channels(worst[0]), origin_ns) if found and worst else None,
        "doses_svg": doses(_doses(document), VDV_LABEL) if document["predicted"] else None,
    }


def check_reports() -> None:
    """Raise InputError where a report could not be drawn, so that a long replay can say so before it begins."""
    for name in ("jinja2", "matplotlib"):
        if importlib.util.find_spec(name) is None:
            raise InputError(
                f"reports need {name}: pip install 'biodyn_ros[reports]', or leave them out with --no-report"
            )


def _flagged(seat: dict[str, Any] | None) -> bool:
    """Whether a ratio of ISO 2631-1 asks for additional evaluation."""
    return seat is not None and any(r["exceeded"] for r in seat["shock_ratios"].values() if isinstance(r, dict))


def _seat_axes(seat: dict[str, Any] | None) -> list[tuple[str, float, float, float]]:
    """Axis, factor k, aw and VDV without it, for every axis known."""
    if seat is None:
        return []
    aw, vdv = seat["aw_weighted_mps2"], seat["vdv_weighted_mps175"]
    return [(axis, 1.0 if axis == "z" else HORIZONTAL_FACTOR, aw[axis], vdv[axis]) for axis in aw]


def _worst_residual(document: dict[str, Any]) -> tuple[str, float] | None:
    shares = {name: residual["nrmse_rms_percent"] for name, residual in document["residual"].items()}
    known = {name: share for name, share in shares.items() if share is not None}
    worst = max(known, key=lambda name: known[name], default=None)
    return (worst, known[worst]) if worst else None


def _doses(document: dict[str, Any]) -> list[Pair]:
    """VDV from the head down, predicted and measured after the low-pass; the seat beneath."""
    rows = []
    for name in (*reversed(SEGMENTS), SEAT):
        sides = [document[of].get(name) for of in ("measured_low_passed", "predicted")]
        values = [side["vdv_mps175"] if side else None for side in sides]
        bounds = [bool(side and side["lower_bound"]) for side in sides]
        rows.append(Pair(words(name), *values, *bounds, "" if sides[0] else ", not measured"))
    return rows


# --- page ------------------------------------------------------------------------------------------------------------


def render(template: str, **values: Any) -> str:
    """The page that a template makes of values; what comes from outside is text and nothing else."""
    import jinja2

    # Autoescape by name would miss templates that end in .j2.
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(package_directory("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters.update(number=number, bound=bound, duration=duration, words=words, sentence=sentence, shocks=shocks)
    page.filters["value"] = lambda stated: number(None) if stated is None else f"{stated:g}"
    return page.get_template(template).render(palette=PALETTE, **values)


def write_drawn(path: Path, draw: Callable[[], str]) -> None:
    """Write a page whose results are written already; where it cannot be, no older one is left beside them."""
    try:
        write_page(path, draw())
    except InputError:
        path.unlink(missing_ok=True)
        raise
    except Exception as error:  # a fault of ours in a drawing must not cost the results of hours
        path.unlink(missing_ok=True)
        raise InputError(
            f"{path}: cannot be drawn ({one_line(error)}); all other results are there, --no-report leaves it out"
        ) from error


def write_page(path: Path, text: str) -> None:
    """Write a page; a file name that is not UTF-8 comes as lone surrogates, which it shows as escapes."""
    write_text(path, text, errors="backslashreplace")
