"""Result files: each is written under a temporary name and renamed, so that no incomplete file has the final name."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Final

from biodyn_core.base.errors import InputError

OWNER_ONLY: Final = 0o600
"""Permissions of personal data and of tokens."""

_FILE_NAME: Final = re.compile(r"[^\W_][\w .+-]{0,99}")


def write_text(path: Path, text: str, errors: str = "strict", mode: int = 0o666) -> None:
    """Write a text file and synchronise it before it gets its name; raises InputError if that fails.

    errors: as in `open`; mode: its permissions, reduced by the user's mask.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)  # a leftover file would keep its permissions
        with open(part, "w", encoding="utf-8", errors=errors, opener=partial(os.open, mode=mode)) as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException as error:  # an interruption too leaves no file
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def check_file_name(name: str, where: str) -> None:
    """Raise InputError for a name that is no plain name of a file, such as one with a separator."""
    if not _FILE_NAME.fullmatch(name):
        raise InputError(f"{where}: {name!r} cannot be a file's; give a name of letters, digits and . - + _")


def keep_copy(path: Path) -> Path:
    """Copy a file to a free name beside it, such as `events.earlier.yaml`; raises InputError if that fails."""
    numbers = itertools.chain([""], (f"_{number}" for number in itertools.count(2)))
    names = (f"{path.stem}.earlier{number}{path.suffix}" for number in numbers)
    copy = next(free for name in names if not exists(free := path.with_name(name)))
    part = copy.with_name(f".{copy.name}.part")
    try:
        shutil.copyfile(path, part)
        part.replace(copy)
    except BaseException as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise InputError(f"{copy}: the earlier {path.name} cannot be kept ({error.strerror})") from None
    return copy


def exists(path: Path) -> bool:
    """Whether the file or directory exists; False for an impossible name."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def state_directory() -> Path:
    """The user's directory for state; raises RuntimeError for a user without a home directory."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "biodyn"


def remove(path: Path) -> None:
    """Remove a result of an earlier run, which does not belong to the new results; raises InputError if that fails."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: result of an earlier run, cannot be removed ({error.strerror})") from None


def make_directory(path: Path) -> None:
    """Make a directory and its parents; raises InputError if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: the directory cannot be created ({error.strerror})") from None


def check_keeps_inputs(result: Path, inputs: Iterable[Path]) -> None:
    """Raise InputError for a result that would replace or remove one of the inputs, before the work starts."""
    for one in inputs:
        if exists(result) and exists(one) and result.samefile(one):
            raise InputError(f"{one}: is an input, and a result would replace it: give another place for the results")


def check_directory(directory: Path) -> None:
    """Raise InputError for a directory in which results cannot be written, before the work starts."""
    there = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is a file; the results need a directory: give another path")
    if not os.access(there, os.W_OK):
        raise InputError(f"{there}: cannot be written to")
