"""Where a fitted subject comes from: which bags, by their content, it was fitted to and tried on."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, Literal

from biodyn_core.subject import Subject
from biodyn_ros.bag import open_bag

Role = Literal["fitted", "held_out"]
ROLES: Final[tuple[Role, Role]] = ("fitted", "held_out")


def bag_sha256(path: str | Path) -> str:
    """SHA-256 of a bag's storage files, one after the other; the same bag by another name has the same."""
    with open_bag(path) as reader:
        files = reader.files
    return sha256_of(files)


def sha256_of(files: Iterable[Path], most_bytes: int | None = None) -> str:
    """SHA-256 of some files, one after the other, or of so many bytes of each."""
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            left = 2**62 if most_bytes is None else most_bytes
            while block := stream.read(min(1 << 20, left)):
                digest.update(block)
                left -= len(block)
    return digest.hexdigest()


def role_of(subject: Subject, sha256: str) -> Role | None:
    """What a bag was to this subject: `fitted`, `held_out`, or None for a bag that its file does not name."""
    for role in ROLES:
        events = subject.provenance.get(role)
        for event in events if isinstance(events, list) else []:
            if isinstance(event, Mapping) and event.get("sha256") == sha256:
                return role
    return None
