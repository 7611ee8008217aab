"""YAML files that people write: read safely, limited in size, each key given once."""

from __future__ import annotations

import unicodedata
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean_file, known_are

try:  # compiled: 4 s for a megabyte instead of 25 s
    from yaml import CSafeLoader as SafeLoader
except ImportError:
    from yaml import SafeLoader  # type: ignore[assignment]

MAX_BYTES: Final = 2**20
"""Twenty times a campaign of a hundred subjects."""

MAX_ALIASES: Final = 32
"""Nested aliases of a few kilobytes can expand to more than the memory."""


def read_yaml(path: str | Path, max_bytes: int = MAX_BYTES) -> object:
    """The content of a YAML file; raises InputError, naming the file, where it is none, too large, or ambiguous."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(max_bytes + 1)
        if len(data) > max_bytes:
            raise InputError(f"larger than {max_bytes // 2**10} KiB, too large for such a file")
        text = data.decode("utf-8")
        _check_aliases(text)
        return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader with checks
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}){did_you_mean_file(path)}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: PyYAML's for a bad date or number
        raise InputError(f"{path}: not a YAML file ({' '.join(str(error).split())})") from error


def mapping_of(
    value: object,
    where: str,
    required: Sequence[str] = (),
    optional: Sequence[str] | None = (),
    kind: str = "key",
) -> dict[str, Any]:
    """A mapping with all required keys and no others but optional ones; optional None: any others.

    Raises InputError naming the place and the key; kind: word for its keys.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: expected keys and values, got {type(value).__name__}")
    for key in value:
        if optional is not None and key not in (*required, *optional):
            raise InputError(f"{where}: unknown {kind} {key!r}, {known_are(key, (*required, *optional))}")
    for key in required:
        if key not in value:
            raise InputError(f"{where}: {kind} {key!r} is missing")
    return dict(value)


_ENDS_LINE: Final = {"Cc", "Zl", "Zp"}
"""Unicode categories of control characters, line and paragraph separators."""


def text_of(value: object, where: str) -> str:
    """A text of one line that is not empty, without a newline at its end; raises InputError naming the place."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{where} is {value!r}, expected a text")
    value = value.rstrip("\n")  # of a block in YAML
    if any(unicodedata.category(character) in _ENDS_LINE for character in value):
        raise InputError(f"{where} is {value!r}, expected one line without control characters")
    return value


def _check_aliases(text: str) -> None:
    """Raise InputError for too many aliases, before any is expanded."""
    aliases = 0
    for event in yaml.parse(text, SafeLoader):
        aliases += isinstance(event, yaml.AliasEvent)
        if aliases > MAX_ALIASES:
            raise InputError(f"more than {MAX_ALIASES} aliases (*name): write out their content")


class _Loader(SafeLoader):
    """A repeated key is an error: in plain YAML the later one silently replaces the earlier."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; raises InputError naming a key that is given twice."""
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue  # `<<`: keys of the mapping itself override merged ones
            key = self.construct_object(key_node, deep=True)  # type: ignore[no-untyped-call]
            if not isinstance(key, Hashable):
                continue  # refused by the loader itself
            if key in seen:
                raise InputError(f"{key}: given twice")
            seen.add(key)
        return super().construct_mapping(node, deep=deep)
