"""Provenance: how a bag was made, and to which bags, by content, a subject was fitted or compared."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from biodyn_ros.bag import BagReader, open_bag
from biodyn_ros.reading.parts import Bag, part_of

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


@dataclass(frozen=True)
class Source:
    """A recording by content: the SHA-256 of its bag, and its part in seconds after the seat's first sample."""

    sha256: str
    begin_s: float = 0.0
    end_s: float = math.inf

    def overlaps(self, other: Source) -> bool:
        """Whether both have samples in common."""
        return self.sha256 == other.sha256 and min(self.end_s, other.end_s) > max(self.begin_s, other.begin_s)

    def to_dict(self) -> dict[str, Any]:
        """The fields of a file; a whole bag has no part."""
        part = {"begin_s": self.begin_s, "end_s": self.end_s} if (self.begin_s, self.end_s) != (0.0, math.inf) else {}
        return {"sha256": self.sha256} | {name: value for name, value in part.items() if value != math.inf}

    @classmethod
    def of_dict(cls, origin: object) -> Source | None:
        """From the fields of a file; None for another content."""
        if not isinstance(origin, Mapping) or not isinstance(origin.get("sha256"), str):
            return None
        begin_s, end_s = origin.get("begin_s", 0.0), origin.get("end_s", math.inf)
        if not all(isinstance(time_s, int | float) for time_s in (begin_s, end_s)):
            return None
        return cls(origin["sha256"], float(begin_s), float(end_s))


def source_of(bag: Bag) -> Source:
    """The content of a bag, or of a part."""
    part = part_of(bag)
    return Source(bag_sha256(part.path), part.begin_s, part.end_s)


def bag_sha256(path: str | Path) -> str:
    """SHA-256 of a bag's storage files, one after the other; independent of the name of the bag."""
    with open_bag(path) as reader:
        files = reader.files
    states = [file.stat() for file in files]
    return _sha256_of(tuple(files), tuple((one.st_size, one.st_mtime_ns) for one in states))


@functools.lru_cache(maxsize=64)
def _sha256_of(files: tuple[Path, ...], _states: tuple[tuple[int, int], ...]) -> str:
    """Once for all parts of a bag; _states: size and time of change, so that a changed bag is read again."""
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


def effect_recordings(subject: Subject, excluded: Collection[Source]) -> list[Any]:
    """The recordings, as in its file, to which a subject's effects were fitted, without those that overlap these."""
    earlier = origins_of(subject, "fitted") if subject.effects else []
    return [origin for origin, source in earlier if not any(source.overlaps(one) for one in excluded)]


def role_of(subject: Subject, source: Source) -> Role | None:
    """The role of a recording for this subject: `fitted`, `held_out`, or None where its file lists no part of it."""
    for role in ROLES:
        if any(known.overlaps(source) for _, known in origins_of(subject, role)):
            return role
    return None


def origins_of(subject: Subject, role: Role) -> list[tuple[Mapping[str, Any], Source]]:
    """The recordings of a role in a subject's file, as they are there, with their content."""
    listed = subject.provenance.get(role)
    each = [(origin, Source.of_dict(origin)) for origin in (listed if isinstance(listed, list) else [])]
    return [(origin, source) for origin, source in each if source is not None]
