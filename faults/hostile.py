"""Hostile input: valid files with random changes, and the response of every reader."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from biodyn_core.base.errors import InputError
from faults.readers import READERS, as_file

MAX_S: Final = 5.0
MAX_BYTES: Final = 300 * 2**20
"""Limits of time and memory for reading one changed file of a few kilobytes."""

NUMBERS: Final = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1, 10**9)
WORDS: Final = (
    b"null", b"-1", b"1e999", b"nan", b".inf", b"[]", b"{}", b'""', b"&a [*a]", b"!!python/object:os.system",
    b"\xff\xfe", b"[" * 300, b"9" * 400, b"\0", b"true", b"<<",
)  # fmt: skip


@dataclass(frozen=True)
class Read:
    """One read of changed bytes: error message or empty text, seconds, growth of memory in bytes."""

    message: str
    seconds: float
    grown_bytes: int


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes after one to four random changes."""
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            return data
        at, to = sorted(int(v) for v in rng.integers(0, len(data) + 1, 2))
        kind = int(rng.integers(0, 6))
        if kind == 0:
            data = data[:at]
        elif kind == 1:
            number = NUMBERS[int(rng.integers(len(NUMBERS)))]
            width = int(rng.choice([1, 2, 4, 8]))
            data = data[:at] + (number % 2 ** (8 * width)).to_bytes(width, "little") + data[at + width :]
        elif kind == 2:
            data = data[:at] + WORDS[int(rng.integers(len(WORDS)))] + data[to if to - at < 40 else at :]
        elif kind == 3:
            data = data[:at] + data[to:]
        elif kind == 4:
            data = data[:to] + data[at:to] + data[to:]
        else:
            bit = int(rng.integers(0, 8))
            data = data[:at] + bytes([data[at] ^ (1 << bit)]) + data[at + 1 :] if at < len(data) else data
    return data


def attacked(name: str, count: int, seed: int) -> Iterator[Read]:
    """Read `count` changed files of a reader's corpus; an error other than InputError is raised with the seed."""
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as directory, as_file(reader) as read:
        corpus = reader.good(Path(directory))
        for number in range(count):
            data = mutated(corpus[number % len(corpus)], np.random.default_rng([seed, number]))
            begin, before = time.process_time(), peak_bytes(reset=True)
            message = ""
            try:
                read(data)
            except InputError as error:
                message = str(error)
            except Exception as error:
                raise AssertionError(
                    f"{name}, seed {seed}, number {number}: {type(error).__name__}: {error}"
                ) from error
            yield Read(message, time.process_time() - begin, peak_bytes() - before)


def peak_bytes(reset: bool = False) -> int:
    """The peak memory of this process; reset: restart the measurement (on Linux only)."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if reset:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    line = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024
