"""The file that keeps the long parts of a trace: an interrupted one goes on from there, a repeated one is quick."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any, Final

from biodyn_core.errors import InputError
from biodyn_ros import __version__
from biodyn_ros.files import make_directory
from biodyn_ros.json_files import keys_of, read_json, write_json

SCHEMA: Final = 1
MOST: Final = 24
"""Parts that are kept, the latest: a trace has one for theta and one for each round, half a megabyte each."""


class Kept(MutableMapping[str, Any]):
    """Parts by a key that tells their problem from any other, on disk after each one.

    Parts of another version are not taken up. Raises InputError for a file that is damaged or cannot be written.
    """

    def __init__(self, path: Path, fresh: bool = False) -> None:
        self._path = path
        self._parts: dict[str, Any] = {}
        if path.exists() and not fresh:
            self._parts = _parts(path)
        make_directory(path.parent)
        self._write()  # whether it can be written is better known before the work than after it

    def __getitem__(self, key: str) -> Any:
        return self._parts[key]

    def __setitem__(self, key: str, part: Any) -> None:
        self._parts[key] = part
        for old in list(self._parts)[:-MOST]:
            del self._parts[old]
        self._write()

    def __delitem__(self, key: str) -> None:
        del self._parts[key]
        self._write()

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def _write(self) -> None:
        write_json(self._path, {"schema": SCHEMA, "version": __version__, "parts": self._parts})


def _parts(path: Path) -> dict[str, Any]:
    try:
        document = keys_of(read_json(path), "the file", ("schema", "version", "parts"))
        if (document["schema"], document["version"]) != (SCHEMA, __version__):
            return {}
        return keys_of(document["parts"], "parts")
    except InputError as error:
        raise InputError(f"{path}: {error}; --fresh starts anew") from None
