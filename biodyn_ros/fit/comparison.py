"""`biodyn compare`: the deviations of two subjects as the mapping scripts read and the table people read."""

from __future__ import annotations

import math
from typing import Any, Final

from biodyn_core.body.subject import Subject
from biodyn_core.identification.compare import Deviation, SubjectComparison
from biodyn_ros import __version__
from biodyn_ros.base.wording import table, words

_SHOWN: Final = {
    "natural_frequency_hz": ("natural frequency", "Hz", 1.0),
    "damping_ratio": ("damping ratio", "", 1.0),
    "stiffness_n_per_m": ("stiffness", "kN/m", 1e-3),
    "stiffening_per_m": ("strain stiffening", "1/m", 1.0),
    "rayleigh_rad_per_s": ("Rayleigh damping", "rad/s", 1.0),
    "stiffening_scale": ("stiffening scale", "", 1.0),
    "mass_scale": ("mass scale", "", 1.0),
}
"""How a quantity is called, its unit in print, and that unit's size."""

_NOTES: Final = (
    "note: stiffness carries the body mass, without mass scale",
    "note: strain stiffening is the stiffening scale times a shape that all subjects share: its rows are one finding",
    "note: a deviation says nothing of how surely either value is known",
)


def comparison_document(comparison: SubjectComparison) -> dict[str, Any]:
    """Return the mapping of `biodyn compare --json`; a deviation from zero, which is infinite, is None."""
    return {
        "a": _person(comparison.a),
        "b": _person(comparison.b),
        "threshold_percent": comparison.threshold_percent,
        "convergent": [_row(deviation) for deviation in comparison.convergent],
        "divergent": [_row(deviation) for deviation in comparison.divergent],
        "version": __version__,
    }


def text_of(document: dict[str, Any]) -> str:
    """The document as a page of text."""
    a, b, threshold = document["a"], document["b"], document["threshold_percent"]
    lines = [
        f"A: {a['name']}, {a['body_mass_kg']:g} kg",
        f"B: {b['name']}, {b['body_mass_kg']:g} kg",
        "deviation: |B - A| / A",
    ]
    for kind, limit in (("convergent", f"below {threshold:g} %"), ("divergent", f"{threshold:g} % and more")):
        lines += ["", f"{kind}, {limit}: {len(document[kind])}", *_table(document[kind])]
    return "\n".join([*lines, "", *_NOTES])


def _person(subject: Subject) -> dict[str, Any]:
    return {"name": subject.name, "body_mass_kg": subject.body_mass_kg, "mass_matrix": subject.mass_matrix}


def _row(deviation: Deviation) -> dict[str, Any]:
    return {
        "quantity": deviation.quantity,
        "segment": deviation.segment,
        "unit": deviation.unit,
        "a": deviation.a,
        "b": deviation.b,
        "percent": deviation.percent if math.isfinite(deviation.percent) else None,
    }


def _table(rows: list[dict[str, Any]]) -> list[str]:
    if not rows:
        return []
    cells = [("", "", "A", "B", "", "deviation"), *(_cells(row) for row in rows)]
    return [f"  {line}" for line in table(cells, left=(0, 1, 4))]


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    name, unit, size = _SHOWN[row["quantity"]]
    percent = "from zero" if row["percent"] is None else f"{row['percent']:.2f} %"
    return name, words(row["segment"] or ""), _digits(size * row["a"]), _digits(size * row["b"]), unit, percent


def _digits(value: float) -> str:
    """Four significant digits, as the paper's tables have."""
    return f"{value:#.4g}".rstrip(".")
