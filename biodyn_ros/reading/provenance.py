"""Provenance: how a bag was made, and to which bags, by content, a subject was fitted or compared."""

from __future__ import annotations

import hashlib
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from biodyn_ros.bag import BagReader, open_bag

if TYPE_CHECKING:
    from biodyn_core.body.subject import Subject

Role = Literal["fitted", "held_out"]
ROLES: Final[tuple[Role, Role]] = ("fitted", "held_out")

RECORD: Final = "biodyn"
"""The metadata record of a bag that states how biodyn made it."""

MADE_BY: Final = "biodyn simulate"
MADE_BY_MODEL: Final = (
    "This recording was made by the model itself, so its small residual does not show how well the model "
    "describes a person."
)


def is_made_by_model(reader: BagReader) -> bool:
    """Whether a bag states that `biodyn simulate` made it."""
    return reader.metadata(RECORD).get("made_by") == MADE_BY


def without_note(warnings: Iterable[str]) -> tuple[list[str], list[str]]:
    """The warnings about a recording made by the model, and all others."""
    notes, rest = [], []
    for line in warnings:
        (notes if line.endswith(MADE_BY_MODEL) else rest).append(line)
    return notes, rest


def bag_sha256(path: str | Path) -> str:
    """SHA-256 of a bag's storage files, one after the other; independent of the name of the bag."""
    with open_bag(path) as reader:
        files = reader.files
    return sha256_of(files)


def sha256_of(files: Iterable[Path], max_bytes: int | None = None) -> str:
    """SHA-256 of some files, one after the other, or of the first bytes of each."""
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            left = 2**62 if max_bytes is None else max_bytes
            while block := stream.read(min(1 << 20, left)):
                digest.update(block)
                left -= len(block)
    return digest.hexdigest()


def effect_recordings(subject: Subject, excluded: Container[str]) -> list[Any]:
    """The recordings, as in its file, to which a subject's effects were fitted, without those with these hashes."""
    known = subject.provenance.get("fitted") if subject.effects else None
    earlier = known if isinstance(known, list) else []
    return [each for each in earlier if isinstance(each, Mapping) and each.get("sha256") not in excluded]


def role_of(subject: Subject, sha256: str) -> Role | None:
    """The role of a bag for this subject: `fitted`, `held_out`, or None for a bag that its file does not list."""
    for role in ROLES:
        events = subject.provenance.get(role)
        for event in events if isinstance(events, list) else []:
            if isinstance(event, Mapping) and event.get("sha256") == sha256:
                return role
    return None
