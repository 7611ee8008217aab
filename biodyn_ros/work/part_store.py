"""A file of finished parts of a trace, so that an interrupted trace continues and a repeated one is quick."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_ros import __version__
from biodyn_ros.base.files import check_directory, make_directory
from biodyn_ros.base.json_files import keys_of, read_json, write_json

SCHEMA: Final = 2
MAX_PARTS: Final = 24
"""The most parts in the file, the latest: a trace has one for theta and one per round, half a megabyte each."""


class PartStore(MutableMapping[str, Any]):
    """Parts by a key that identifies their problem, written to disk after each one.

    Parts of another version are ignored. Raises InputError for a file that is damaged or cannot be written.
    """

    def __init__(self, path: Path, fresh: bool = False) -> None:
        self.path = path
        check_directory(path.parent)  # an unwritable file must fail before the work
        if path.is_dir():
            raise InputError(f"{path}: is a directory, a file of this name is needed: name another directory")
        self._parts = _parts(path) if path.exists() and not fresh else {}

    def __getitem__(self, key: str) -> Any:
        return self._parts[key]

    def __setitem__(self, key: str, part: Any) -> None:
        self._parts[key] = part
        for old in list(self._parts)[:-MAX_PARTS]:
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
        make_directory(self.path.parent)
        write_json(self.path, {"schema": SCHEMA, "version": __version__, "parts": self._parts})


def _parts(path: Path) -> dict[str, Any]:
    try:
        document = keys_of(read_json(path), "the file", ("schema", "version", "parts"))
        if (document["schema"], document["version"]) != (SCHEMA, __version__):
            return {}
        return keys_of(document["parts"], "parts")
    except InputError as error:
        raise InputError(f"{path}: {error}; --fresh starts anew") from None
