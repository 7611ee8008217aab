"""Rows of numbers in a text file of any length, by blocks: valid blocks with numpy, others cell by cell."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError

BLOCK_BYTES: Final = 4 << 20
HEAD_BYTES: Final = 1 << 16
"""Limit of the lines above the numbers; six sensors and a few force plates need a twentieth."""

HEADER_BYTES: Final = 1 << 10
"""With a NUL among the first bytes a file is not text, rather than damaged."""

_ENDED: Final = re.compile(rb"[A-Za-z \-]{3,}")
_UTF_16: Final = (b"\xff\xfe", b"\xfe\xff")


@dataclass
class Damage:
    """Omitted parts of a file: ragged rows, rows without a valid time, cells without a number, a cut last line.

    section: the line of words that ended the rows, with its number.
    """

    ragged: int = 0
    no_number: int = 0
    untimed: int = 0
    first_line: int | None = None
    cut: bool = False
    section: str = ""

    def at(self, line: int) -> None:
        """Note the line of the first damage."""
        self.first_line = line if self.first_line is None else min(self.first_line, line)


def head_of(path: Path) -> bytes:
    """The first bytes of a text file; raises InputError if it cannot be read or is not text of one-byte characters."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if head.startswith(_UTF_16):
        raise InputError(f"{path}: is UTF-16: save it as CSV UTF-8, or export it again")
    if b"\0" in head[:HEADER_BYTES]:
        raise InputError(f"{path}: contains NUL bytes, so it is not text: export it again")
    return head


def lines_of(head: bytes) -> list[str]:
    """The complete lines of a head as text, decoded line by line, because Excel uses its own code page."""
    return [_text(line) for line in head.removeprefix(b"\xef\xbb\xbf").split(b"\n")[:-1]]


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def number_rows(
    path: Path,
    skip_lines: int,
    columns: Sequence[int],
    width: int,
    damage: Damage,
    max_bytes: int,
    sections: bool = False,
) -> Iterator[tuple[int, Floats]]:
    """Yield (bytes read since the last block, rows (n, k)) of a file after its first lines; k of `width` columns.

    A cell that is empty or no number is NaN. A row of another width is omitted, as is a last line without an end of
    line, which may be cut within a number. The rows end with the file, after `max_bytes`, or in a file of `sections` at
    a line of words, which starts another one. `damage` counts the omitted parts. InputError for a line longer than a
    block.
    """
    line = skip_lines
    for read, block in _blocks(path, skip_lines, damage, max_bytes):
        rows, ended = _rows(block, line, columns, width, damage, sections)
        line += block.count(b"\n")
        yield read, rows
        if ended:
            return


def _blocks(path: Path, skip_lines: int, damage: Damage, max_bytes: int) -> Iterator[tuple[int, bytes]]:
    """Complete lines of a file, some megabytes at a time, with the bytes read for them."""
    try:
        with path.open("rb") as file:
            for _ in range(skip_lines):
                file.readline(HEAD_BYTES)
            read, rest, left = file.tell(), b"", max_bytes - file.tell()
            while data := file.read(min(BLOCK_BYTES, max(left, 0))):
                read, left = read + len(data), left - len(data)
                end = data.rfind(b"\n") + 1
                if not end and len(rest) + len(data) > BLOCK_BYTES:
                    raise InputError(f"{path}: not an export: a line has more than {BLOCK_BYTES >> 20} MiB")
                if end:
                    yield read, rest + data[:end]
                    read, rest = 0, data[end:]
                else:
                    rest += data
            damage.cut = bool(rest.strip())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _rows(
    block: bytes, line: int, columns: Sequence[int], width: int, damage: Damage, sections: bool
) -> tuple[Floats, bool]:
    if _is_even(block, width):
        try:
            return _fast(block, columns), False
        except ValueError:
            pass  # a cell is no number
    return _cell_by_cell(block, line, columns, width, damage, sections)


def _is_even(block: bytes, width: int) -> bool:
    """Whether all lines have the same number of cells, at least `width`, and empty ones beyond, as Excel adds them."""
    data = np.frombuffer(block, dtype=np.uint8)
    ends, commas = np.flatnonzero(data == 10), np.flatnonzero(data == 44)
    per_line = np.diff(np.searchsorted(commas, ends), prepend=0)
    if not per_line.size or per_line[0] < width - 1 or (per_line != per_line[0]).any():
        return False
    surplus = int(per_line[0]) - (width - 1)
    if not surplus:
        return True
    beyond = ends - commas.reshape(ends.size, -1)[:, width - 1] - (data[ends - 1] == 13)
    return bool((beyond == surplus).all())


def _fast(block: bytes, columns: Sequence[int]) -> Floats:
    rows = np.loadtxt(io.BytesIO(block), delimiter=",", comments=None, usecols=columns, ndmin=2)
    return rows.astype(np.float64, copy=False)


def _cell_by_cell(
    block: bytes, line: int, columns: Sequence[int], width: int, damage: Damage, sections: bool
) -> tuple[Floats, bool]:
    """The same line by line, with a count of invalid numbers; and whether another section starts."""
    rows = []
    for number, whole in enumerate(block.split(b"\n")[:-1], start=line + 1):
        text = whole.strip()
        if not text.strip(b","):
            continue
        cells = text.split(b",")
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            if sections and _ENDED.fullmatch(text.rstrip(b",")):
                damage.section = f"{_text(text.rstrip(b',')).strip()} in line {number}"
                return _table(rows, len(columns)), True
            damage.ragged += 1
            damage.at(number)
            continue
        rows.append([_number(cells[column], number, damage) for column in columns])
    return _table(rows, len(columns)), False


def _table(rows: list[list[float]], width: int) -> Floats:
    return np.array(rows, dtype=np.float64).reshape(len(rows), width)


def _number(cell: bytes, line: int, damage: Damage) -> float:
    if not cell.strip():
        return np.nan
    try:
        return float(cell if b"_" not in cell else b"")
    except ValueError:
        damage.no_number += 1
        damage.at(line)
        return np.nan
