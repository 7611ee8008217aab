"""The mapping of people.json: a subject beside published groups of people."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.origin import origin_of
from biodyn_core.population.beside import BesidePeople
from biodyn_core.population.references import references
from biodyn_ros import __version__


def people_document(found: BesidePeople) -> dict[str, Any]:
    """The mapping of people.json."""
    of, band, known = found.curves, found.band, references()
    modulus, phase = found.share_within(1.0)
    head_hz, head = of.head_peak
    return {
        "subject": found.subject.name,
        "origin": origin_of(found.subject),
        "mass_matrix": found.subject.mass_matrix,
        "magnitude_mps2": of.magnitude_mps2,
        "frequency_hz": _rounded(of.frequency_hz),
        "apparent_mass": {
            "normalised_at_hz": known.apparent_mass.normalised_at_hz,
            "modulus": _rounded(np.abs(of.apparent_mass)),
            "phase_deg": _rounded(np.degrees(np.angle(of.apparent_mass))),
            "resonance_hz": of.resonance_hz,
            "share_within_one_deviation": {"modulus": modulus, "phase": phase},
        },
        "group": {
            **{name: _rounded(getattr(band, name)) for name in ("modulus", "modulus_sd", "phase_deg", "phase_sd_deg")},
            "people": known.apparent_mass.people,
            "source": known.apparent_mass.source,
            "spread": known.apparent_mass.assumed_spread.reason,
        },
        "outside": [dataclasses.asdict(one) for one in found.outside],
        "head": {
            "modulus": _rounded(np.abs(of.head)),
            "peak_hz": head_hz,
            "peak": head,
            "group_peak_hz": known.head.peak_hz,
        },
        "softening": [
            {
                "source": one.published.source,
                "magnitudes_mps2": list(one.published.magnitudes_mps2),
                "group_resonances_hz": list(one.published.resonances_hz),
                "resonances_hz": list(one.resonances_hz),
                "group_exponent": one.published.exponent,
                "exponent": one.exponent,
                "agrees": one.agrees,
            }
            for one in found.softened
        ],
        "not_confirmed": list(known.not_confirmed),
        "version": __version__,
    }


def _rounded(values: Floats) -> list[float]:
    return [float(value) for value in np.round(values, 4)]
