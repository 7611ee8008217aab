"""Parts of bags: `BAG@START..END` is a part of a bag, in seconds after the first sample of its seat."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_ros.bag import LoggedImu, LogTimes
from biodyn_ros.base.files import exists

_PART: Final = re.compile(r"(?P<path>.+)@(?P<begin>\d+(?:\.\d+)?)?\.\.(?P<end>\d+(?:\.\d+)?)?")

SHORTEST_S: Final = 0.5
"""The shortest part."""

BESIDE_S: Final = 0.5
"""The other sensors of a recording are read for this time beyond the seat: alignment needs their neighbours."""

LATE_S: Final = 10.0
"""A recorder logs a sample at most so long after its stamp, without the drift of clocks."""

BEYOND_S: Final = 1.0
"""A part may end so long after its bag, whose length is known by log times only."""

CLOCK_SHARE: Final = 3e-4
"""The clock of the seat, by which parts are stated, differs by at most this share from that of the recorder."""


@dataclass(frozen=True)
class BagPart:
    """A bag, or a part of it.

    case: its loading condition, None for that of its name. rest_s: begin and end of the rest that gives gravity, None
    to search for it; rest_bag: the bag of this rest, None for the same one. name and level (rms of the seat): of the
    event in an events file. clock_ppm: drift of the clock of sensors against the seat's, from 0 s on. mapping, time:
    topic by sensor and clock with which the events of a file were found; None where that is not known.
    """

    path: Path
    begin_s: float = 0.0
    end_s: float = math.inf
    case: str | None = None
    rest_s: tuple[float, float] | None = None
    rest_bag: Path | None = None
    name: str = ""
    level_mps2: float = 0.0
    clock_ppm: Mapping[str, float] = field(default_factory=dict)
    mapping: Mapping[str, str] | None = None
    time: str | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole bag."""
        return self.begin_s == 0.0 and self.end_s == math.inf

    def shares(self, other: BagPart) -> bool:
        """Whether both are of the same file and have time in common."""
        in_time = min(self.end_s, other.end_s) > max(self.begin_s, other.begin_s)
        return in_time and self.path.resolve() == other.path.resolve()

    def beside(self, path: Path, begin_s: float = 0.0, end_s: float = math.inf) -> BagPart:
        """Another part, or a whole bag, that is read with the same topics and clock."""
        return BagPart(path, begin_s, end_s, mapping=self.mapping, time=self.time)

    @property
    def corrections(self) -> object:
        """What an events file says of the part beside its time, as a text that is the same for the same reading.

        The file can be edited between two runs.
        """
        mapping = None if self.mapping is None else sorted(self.mapping.items())
        return self.rest_s, sorted(self.clock_ppm.items()), mapping, self.time

    @property
    def label(self) -> str:
        """A name for readers: that of the event with its bag, or the reference."""
        return f"{self.name} of {self.path.name}" if self.name else str(self)

    def __str__(self) -> str:
        """The reference, as a user gives it."""
        if self.is_whole:
            return str(self.path)
        end = "" if self.end_s == math.inf else f"{self.end_s:.12g}"
        return f"{self.path}@{self.begin_s:.12g}..{end}"


Bag = str | Path | BagPart
"""A bag as functions take it: a path, a reference to a part, or a part."""


def part_of(bag: Bag) -> BagPart:
    """The part that a bag or a reference means; raises InputError for a part without length."""
    if isinstance(bag, BagPart):
        return bag
    found = None if isinstance(bag, Path) or exists(Path(bag)) else _PART.fullmatch(bag)
    if found is None:
        return BagPart(Path(bag))
    begin_s, end_s = float(found["begin"] or 0.0), float(found["end"] or math.inf)
    if not end_s - begin_s >= SHORTEST_S - 1e-6:  # times are decimal numbers
        raise InputError(f"{bag}: BAG@START..END needs an end at least {SHORTEST_S:g} s after its start")
    return BagPart(Path(found["path"]), begin_s, end_s)


def latest_end_s(length_s: float) -> float:
    """The latest end of a part of a bag of this length."""
    return length_s + max(BEYOND_S, CLOCK_SHARE * length_s)


@dataclass(frozen=True)
class Extent:
    """The samples of a part: first and last stamp, ns, by topic; log times of chunks; length and share of the bag.

    drifts: by topic, the stamp at which a clock is right, and its drift, s/s.
    """

    stamps_ns: Mapping[str, tuple[int, int]]
    within_ns: LogTimes
    seconds: float
    share: float
    drifts: Mapping[str, tuple[int, float]] = field(default_factory=dict)

    @classmethod
    def of_part(
        cls, part: BagPart, length_s: float, begins_ns: Mapping[str, int], beside_s: Mapping[str, float], log_ns: int,
        apart_s: float = 0.0,
    ) -> Extent:  # fmt: skip
        """The extent of a part of a bag of this length.

        begins_ns: the stamp at 0 s, by topic; beside_s: further time at both ends, by topic; log_ns: the log time at
        0 s; apart_s: by how much stamps and log times move apart over the bag.
        """
        begin_s, end_s = part.begin_s, min(part.end_s, latest_end_s(length_s))
        late_s = LATE_S + CLOCK_SHARE * end_s + apart_s
        stamps = {
            topic: (at + round(1e9 * (begin_s - beside_s[topic])), at + round(1e9 * (end_s + beside_s[topic])))
            for topic, at in begins_ns.items()
        }
        within = log_ns + round(1e9 * (begin_s - late_s)), log_ns + round(1e9 * (end_s + late_s))
        return cls(stamps, within, end_s - begin_s, min(1.0, (end_s - begin_s) / max(length_s, 1e-9)))

    def of(self, blocks: Iterable[tuple[str, LoggedImu]]) -> Iterator[tuple[str, LoggedImu]]:
        """The samples of blocks with these stamps."""
        for topic, read in blocks:
            block = self._corrected(topic, read)
            first_ns, last_ns = self.stamps_ns[topic]
            inside = (block.stamps_ns >= first_ns) & (block.stamps_ns <= last_ns)
            if inside.all():
                yield topic, block
            elif inside.any():
                yield topic, block.only(inside)

    def _corrected(self, topic: str, block: LoggedImu) -> LoggedImu:
        """The samples with stamps by the clock of the seat."""
        if topic not in self.drifts:
            return block
        right_ns, drift = self.drifts[topic]
        return block.stamped(block.stamps_ns - np.rint(drift * (block.stamps_ns - right_ns)).astype(np.int64))
