"""The checkpoint file of a long fit: finished tasks as JSON with exact numbers, validated when read."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import LOWER, N_PARAMETERS, UPPER
from biodyn_core.identification.objectives import N_LINEAR
from biodyn_core.identification.phase1 import Search
from biodyn_core.identification.phase2 import Refined
from biodyn_ros import __version__
from biodyn_ros.base.files import make_directory
from biodyn_ros.base.json_files import keys_of, read_json, write_json

Result = Search | Refined

SCHEMA: Final = 1
KINDS: Final[dict[str, type[Result]]] = {kind.__name__: kind for kind in (Search, Refined)}
ROUNDING: Final = 1e-9
"""Logarithm and exponential may move a value out of Table 1 by this share."""

_ANY: Final = -1
_SHAPES: Final[dict[type[Result], dict[str, tuple[int, ...]]]] = {
    Search: {"theta": (_ANY, N_LINEAR), "costs": (_ANY,)},
    Refined: {"theta": (N_PARAMETERS,), "reference": (N_PARAMETERS,), "costs": (_ANY,)},
}


class Checkpoint:
    """Finished tasks by name, written to disk after each one.

    problem identifies the fit. With resume the file's tasks are loaded; without a file all tasks run. Raises
    InputError for an existing file without resume, of another problem or version, or damaged, and for one that cannot
    be written; such a file stays unchanged.
    """

    def __init__(self, path: Path, problem: str, resume: bool = False) -> None:
        self._path, self._problem = path, problem
        self._documents: dict[str, Any] = {}
        self._done: dict[str, Result] = {}
        if path.exists():
            if not resume:
                raise InputError(f"{path}: belongs to an interrupted fit; give --resume to continue it, or remove it")
            self._load()
        make_directory(path.parent)
        self._write()  # an unwritable file must fail before the work

    @property
    def done(self) -> Mapping[str, Result]:
        """Finished results by the name of the task."""
        return self._done

    def add(self, name: str, result: Result) -> None:
        """Store one more result."""
        self._documents[name] = encoded(result)
        self._done[name] = result
        self._write()

    def _write(self) -> None:
        head = {"schema": SCHEMA, "version": __version__, "problem": self._problem}
        write_json(self._path, head | {"done": self._documents})

    def _load(self) -> None:
        try:
            document = keys_of(read_json(self._path), "the file", ("schema", "version", "problem", "done"))
            if document["schema"] != SCHEMA:
                raise InputError(f"schema is {document['schema']!r}, this version reads {SCHEMA}")
            foreign = self._foreign(document)
            self._documents = {} if foreign else keys_of(document["done"], "done")
            self._done = {name: decoded(item, name) for name, item in self._documents.items()}
        except InputError as error:
            raise InputError(f"{self._path}: {error}; remove it to start anew") from None
        if foreign:
            raise InputError(f"{self._path}: {foreign}, or remove it to start anew")

    def _foreign(self, document: Mapping[str, Any]) -> str:
        """The reason why a file is not of this fit, and the remedy; empty for one that is."""
        if document["version"] != __version__:
            return f"is of biodyn {str(document['version'])[:40]}, this is {__version__}; continue with that version"
        if document["problem"] != self._problem:
            return "is of another problem: other recordings, subject, seed or settings; give the same again"
        return ""


def encoded(result: Result) -> dict[str, Any]:
    """A result as a JSON mapping; floats are restored to the last bit."""
    document: dict[str, Any] = {"kind": type(result).__name__}
    for item in dataclasses.fields(result):
        value = getattr(result, item.name)
        document[item.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return document


def decoded(document: object, where: str) -> Result:
    """The result from its JSON mapping; raises InputError naming the key and the fault."""
    kind = KINDS.get(str(document.get("kind"))) if isinstance(document, dict) else None
    if kind is None:
        raise InputError(f"{where}: is no result, a kind is {' or '.join(KINDS)}")
    fields = {item.name: item.type for item in dataclasses.fields(kind)}
    given = keys_of(document, where, ("kind", *fields))
    values: dict[str, Any] = {}
    for name, type_name in fields.items():
        at, value = f"{where}: {name}", given[name]
        if name in _SHAPES[kind]:
            values[name] = _array(value, at, _SHAPES[kind][name])
        elif type_name == "float":
            values[name] = float(_array(value, at, ()))
        elif type_name == "int":
            values[name] = _count(value, at)
        else:
            values[name] = Counter({cause: _count(n, f"{at}: {cause}") for cause, n in keys_of(value, at).items()})
    return _checked(kind(**values), where)


def _array(value: object, where: str, shape: tuple[int, ...]) -> Floats:
    """Finite numbers of a shape, where `_ANY` is any length above 0."""
    if not _numbers(value, len(shape)):
        raise InputError(f"{where}: expected {'lists of numbers' if shape else 'a number'}")
    try:
        found = np.array(value, dtype=np.float64)
    except (ValueError, OverflowError):  # ragged rows, integers beyond the range of floats
        raise InputError(f"{where}: expected rows of one length and numbers a float holds") from None
    fits = found.size > 0 and all(n in (m, _ANY) for m, n in zip(found.shape, shape, strict=True))
    if not (fits and np.isfinite(found).all()):
        raise InputError(f"{where}: has the shape {found.shape} or numbers that are not finite")
    return found


def _numbers(value: object, depth: int) -> bool:
    if depth:
        return isinstance(value, list) and all(_numbers(item, depth - 1) for item in value)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _count(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**63:
        raise InputError(f"{where}: is {str(value)[:40]}, expected a count")
    return value


def _checked(result: Result, where: str) -> Result:
    """The result, if its parameters are within Table 1; raises InputError."""
    for theta in [result.theta, *([result.reference] if isinstance(result, Refined) else [])]:
        width = theta.shape[-1]
        inside = (theta >= LOWER[:width] * (1.0 - ROUNDING)) & (theta <= UPPER[:width] * (1.0 + ROUNDING))
        if not inside.all():
            raise InputError(f"{where}: parameters out of Table 1")
    if isinstance(result, Search) and len(result.theta) != len(result.costs):
        raise InputError(f"{where}: {len(result.theta)} starts and {len(result.costs)} costs")
    return result
