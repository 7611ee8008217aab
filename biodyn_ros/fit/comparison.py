"""The deviations of two subjects, as the mapping of `biodyn compare --json` and as text."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

from biodyn_core.body.subject import Subject
from biodyn_core.identification.compare import Deviation, SubjectComparison, body_effects
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
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
"""Title of a quantity, its printed unit, and the factor from SI to that unit."""

_NOTES: Final = (
    "note: stiffness is proportional to the body mass, without mass scale",
    "note: strain stiffening is the stiffening scale times a shape of all subjects: its rows are not independent",
    "note: a deviation does not include the uncertainty of either value",
)


def comparison_document(comparison: SubjectComparison) -> dict[str, Any]:
    """The mapping of `biodyn compare --json`; a deviation from zero, which is infinite, is None."""
    return {
        "a": _person(comparison.a),
        "b": _person(comparison.b),
        "threshold_percent": comparison.threshold_percent,
        "convergent": [_row(deviation) for deviation in comparison.convergent],
        "divergent": [_row(deviation) for deviation in comparison.divergent],
        "version": __version__,
    }


def text_of(comparison: SubjectComparison) -> str:
    """The comparison as text for the terminal."""
    a, b, threshold = comparison.a, comparison.b, comparison.threshold_percent
    lines = [
        f"A: {a.name}, {a.body_mass_kg:g} kg",
        f"B: {b.name}, {b.body_mass_kg:g} kg",
        "deviation: |B - A| / A",
        *_section(f"convergent, below {threshold:g} %", comparison.convergent),
        *_section(f"divergent, {threshold:g} % and more", comparison.divergent),
        "",
        *([] if comparison.has_same_effects else [_effects_note(comparison)]),
        *_NOTES,
    ]
    return "\n".join(lines)


def _person(subject: Subject) -> dict[str, Any]:
    return {
        "name": subject.name,
        "body_mass_kg": subject.body_mass_kg,
        "mass_matrix": subject.mass_matrix,
        "effects": [applied.to_dict() for applied in body_effects(subject)],
    }


def _effects_note(comparison: SubjectComparison) -> str:
    """A warning where the parameters are those of different models."""
    a, b = (_named_effects(subject) for subject in (comparison.a, comparison.b))
    values = ", with other values" if a == b else ""
    return f"warning: parameters of different models, because of the effects: A has {a}, B has {b}{values}"


def _named_effects(subject: Subject) -> str:
    """The effects with their sites."""
    sites: dict[str, list[str]] = {}
    for applied in body_effects(subject):
        sites.setdefault(applied.effect.name, []).append(words(applied.site))
    return " and ".join(f"{name} ({', '.join(at)})" for name, at in sorted(sites.items())) or "none"


def _row(deviation: Deviation) -> dict[str, Any]:
    return dataclasses.asdict(deviation) | {"percent": finite(deviation.percent)}


def _section(title: str, rows: Sequence[Deviation]) -> list[str]:
    lines = ["", f"{title}: {len(rows)}"]
    if rows:
        cells = [("", "", "A", "B", "", "deviation"), *(_cells(row) for row in rows)]
        lines += [f"  {line}" for line in table(cells, left=(0, 1, 4))]
    return lines


def _cells(row: Deviation) -> tuple[str, ...]:
    name, unit, size = _SHOWN[row.quantity]
    percent = f"{row.percent:.2f} %" if math.isfinite(row.percent) else "from zero"
    return name, words(row.segment or ""), _digits(size * row.a), _digits(size * row.b), unit, percent


def _digits(value: float) -> str:
    """Four significant digits, as in the paper's tables."""
    return f"{value:#.4g}".rstrip(".")
