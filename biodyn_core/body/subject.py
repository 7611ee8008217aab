"""Subject: one person's anthropometry, parameters, options and provenance; YAML in and out.

The file format is schema 1: unknown keys, wrong lengths and values out of range are errors that name them.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import yaml

from biodyn_core.base.arrays import Floats
from biodyn_core.base.digests import digest
from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import known_are
from biodyn_core.base.yaml_files import mapping_of, read_yaml, text_of
from biodyn_core.body.parameters import Parameters
from biodyn_core.effects import CATALOGUE, AppliedEffect

SCHEMA: Final = 1
MassMatrix = Literal["segment", "cascade"]
MASS_MATRICES: Final[tuple[MassMatrix, MassMatrix]] = ("segment", "cascade")
BODY_MASS_KG: Final = (30.0, 200.0)
STATURE_M: Final = (1.2, 2.3)

DIGEST: Final = "model_digest"
"""The key of a file's provenance by which a change of the model is found."""

EDITED: Final = "edited"
"""The key of the provenance of a subject whose model was changed by hand: recordings count, errors do not hold."""

ERRORS_OF_ANOTHER: Final = "its file was changed by hand, so its errors are of another model: fit it with biodyn fit"
"""Why an edited subject has no intervals."""


@dataclass(frozen=True)
class Subject:
    """A seated person in the model.

    `mass_matrix`: `segment` is Newton's M = diag(m_i); `cascade` is Eq. 7 as printed, whose inertia is three times the
    body's. There is no default: the choice changes every number. Raises InputError for values out of range.
    """

    name: str
    body_mass_kg: float
    stature_m: float
    mass_matrix: MassMatrix
    parameters: Parameters
    effects: tuple[AppliedEffect, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        text_of(self.name, "name")
        if self.mass_matrix not in MASS_MATRICES:
            raise InputError(f"mass_matrix is {self.mass_matrix!r}, allowed are {' and '.join(MASS_MATRICES)}")
        _check_range("body_mass_kg", self.body_mass_kg, BODY_MASS_KG)
        _check_range("stature_m", self.stature_m, STATURE_M)

    def to_dict(self) -> dict[str, Any]:
        """Return the subject as the mapping its YAML file holds."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "body_mass_kg": self.body_mass_kg,
            "stature_m": self.stature_m,
            "mass_matrix": self.mass_matrix,
            "parameters": _parameters_dict(self.parameters),
            "effects": [applied.to_dict() for applied in self.effects],
            "provenance": {**self.provenance, DIGEST: self.model_digest} if self.provenance else {},
        }

    @property
    def model_digest(self) -> str:
        """A hash of all that decides a prediction: mass, mass matrix, parameters and effects."""
        effects = [
            [one.effect.name, one.site, {name: float(value) for name, value in one.values.items()}]
            for one in self.effects
        ]
        return digest([self.mass_matrix, float(self.body_mass_kg), self.parameters.vector().tolist(), effects])

    def to_yaml(self) -> str:
        """Return the subject as YAML text."""
        return yaml.safe_dump(self.to_dict(), sort_keys=False, default_flow_style=None, width=100)

    @classmethod
    def from_dict(cls, data: object, unfitted: Parameters | None = None) -> Subject:
        """Read the mapping of a subject file; raises InputError naming the key.

        unfitted: parameters for a file without any, which is an error otherwise.
        """
        if unfitted is not None and isinstance(data, Mapping) and "parameters" not in data:
            return cls.from_dict({**data, "parameters": _parameters_dict(unfitted)})
        top = mapping_of(data, "subject", _TOP_REQUIRED, ("mass_matrix", "effects", "provenance"))
        if "mass_matrix" not in top:
            choice = f"one of {' and '.join(MASS_MATRICES)}, it has no default"
            raise InputError(f"subject: key 'mass_matrix' is missing: {choice}")
        schema = top["schema"]
        if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1:
            raise InputError(f"schema is {schema!r}, expected the whole number {SCHEMA}")
        if schema > SCHEMA:
            raise InputError(f"schema {schema} is newer than the {SCHEMA} this version reads: update biodyn")
        values = mapping_of(top["parameters"], "parameters", _PARAMETER_KEYS)
        provenance = {} if top.get("provenance") is None else top["provenance"]
        found = cls(
            name=text_of(top["name"], "name"),
            body_mass_kg=_number(top["body_mass_kg"], "body_mass_kg"),
            stature_m=_number(top["stature_m"], "stature_m"),
            mass_matrix=top["mass_matrix"],
            parameters=Parameters(
                natural_frequency_hz=_numbers(values["natural_frequency_hz"], "parameters.natural_frequency_hz"),
                damping_ratio=_numbers(values["damping_ratio"], "parameters.damping_ratio"),
                **{key: _number(values[key], f"parameters.{key}") for key in _WHOLE_CHAIN_KEYS},
            ),
            effects=_effects(top.get("effects")),
            provenance=mapping_of(provenance, "provenance", optional=None),
        )
        return found._with_checked_provenance()

    def _with_checked_provenance(self) -> Subject:
        """The same without the digest of its file; `EDITED` if that is of another model."""
        if DIGEST not in self.provenance:
            return self
        kept = {key: value for key, value in self.provenance.items() if key != DIGEST}
        edited = {} if self.provenance[DIGEST] == self.model_digest else {EDITED: True}
        return dataclasses.replace(self, provenance=kept | edited)


def load_subject(path: str | Path, unfitted: Parameters | None = None) -> Subject:
    """Read a subject file; raises InputError naming the file and the key. unfitted: see `Subject.from_dict`."""
    data = read_yaml(path)
    try:
        return Subject.from_dict(data, unfitted)
    except (InputError, RecursionError) as error:  # an alias may refer to itself
        raise InputError(f"{path}: {error}") from error


_TOP_REQUIRED: Final = ("schema", "name", "body_mass_kg", "stature_m", "parameters")
_WHOLE_CHAIN_KEYS: Final = ("rayleigh_rad_per_s", "stiffening_scale", "mass_scale")
_PARAMETER_KEYS: Final = ("natural_frequency_hz", "damping_ratio", *_WHOLE_CHAIN_KEYS)


def _parameters_dict(parameters: Parameters) -> dict[str, Any]:
    return {
        "natural_frequency_hz": [float(v) for v in parameters.natural_frequency_hz],
        "damping_ratio": [float(v) for v in parameters.damping_ratio],
        **{key: getattr(parameters, key) for key in _WHOLE_CHAIN_KEYS},
    }


def _effects(data: object) -> tuple[AppliedEffect, ...]:
    if data is None:
        return ()
    if not isinstance(data, list):
        raise InputError(f"effects is {data!r}, expected a list")
    effects = tuple(_effect(item, f"effects[{index}]") for index, item in enumerate(data))
    seen: set[tuple[str, str]] = set()
    for applied in effects:
        key = (applied.effect.name, applied.site)
        if key in seen:
            raise InputError(f"effects: {key[0]} at {key[1]} is given twice")
        seen.add(key)
    return effects


def _effect(data: object, where: str) -> AppliedEffect:
    item = mapping_of(data, where, ("name", "site"), ("parameters",))
    name, site = text_of(item["name"], f"{where}.name"), text_of(item["site"], f"{where}.site")
    if name not in CATALOGUE:
        raise InputError(f"{where}: unknown effect {name!r}, {known_are(name, CATALOGUE)}")
    given = mapping_of(item.get("parameters") or {}, f"{where}.parameters", optional=None)
    values = {key: _number(value, f"{where}.parameters.{key}") for key, value in given.items()}
    return AppliedEffect(CATALOGUE[name], site, values)


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{where} is {value!r}, expected a number")
    if not abs(value) <= sys.float_info.max:  # math.isfinite raises for a whole number beyond it
        raise InputError(f"{where} is {value}, expected a finite number")
    return float(value)


def _numbers(value: object, where: str) -> Floats:
    if not isinstance(value, list):
        raise InputError(f"{where} is {value!r}, expected a list of numbers")
    return np.array([_number(item, f"{where}[{index}]") for index, item in enumerate(value)])


def _check_range(name: str, value: float, allowed: tuple[float, float]) -> None:
    if not allowed[0] <= value <= allowed[1]:
        raise InputError(f"{name} is {value:g}, allowed are {allowed[0]:g} to {allowed[1]:g}")
