"""Results on disk: each is written beside its place and renamed, so that none is ever half there."""

from __future__ import annotations

import contextlib
import os
from functools import partial
from pathlib import Path
from typing import Final

from biodyn_core.base.errors import InputError

OWNER_ALONE: Final = 0o600
"""Permissions of what tells of a person, or opens a door."""


def write_text(path: Path, text: str, errors: str = "strict", mode: int = 0o666) -> None:
    """Write a text file, on the disk before it has its name; raises InputError where that cannot be done.

    errors: as of `open`; mode: its permissions, of which the user's mask is taken off.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)  # one that is left over would keep its permissions
        with open(part, "w", encoding="utf-8", errors=errors, opener=partial(os.open, mode=mode)) as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def is_there(path: Path) -> bool:
    """Whether there is such a file or directory; a name that none can have is of none."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def state_directory() -> Path:
    """Where users keep state; raises RuntimeError where whoever runs this has no home."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "biodyn"


def remove(path: Path) -> None:
    """Take away what an earlier run left: beside results of another it would pass for theirs."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: is of an earlier run and cannot be removed ({error.strerror})") from None


def make_directory(path: Path) -> None:
    """Make a directory with those above it; raises InputError where that cannot be done."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a directory ({error.strerror})") from None


def check_directory(directory: Path) -> None:
    """Raise InputError for a place where the results cannot be written, before the work."""
    there = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is a file, a directory is needed for the results: name another")
    if not os.access(there, os.W_OK):
        raise InputError(f"{there}: cannot be written to")
