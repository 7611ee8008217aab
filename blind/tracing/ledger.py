"""`python -m blind.tracing.ledger [--pack] FOLDER...`: verifies the seals of finished runs; 2 where one is broken.

A ledger keeps the answers of a run as one compressed file. The seals are over the uncompressed lines.
"""

from __future__ import annotations

import argparse
import bisect
import lzma
import sys
from collections.abc import Sequence
from pathlib import Path

from blind.tracing.study import ANSWERS, ARCHIVE, SEAL, BrokenSeal, hash_of


def answer_lines(folder: Path) -> list[str]:
    """All answers of a run, from the plain file or from the archive; raises BrokenSeal where neither can be read."""
    plain, archive = folder / ANSWERS, folder / ARCHIVE
    try:
        data = plain.read_bytes() if plain.exists() else lzma.decompress(archive.read_bytes())
        return data.decode().splitlines()
    except (OSError, lzma.LZMAError, UnicodeError) as error:
        raise BrokenSeal(f"{folder}: the answers cannot be read ({error})") from None


def verify(folder: Path) -> list[str]:
    """The seals of a run; raises BrokenSeal where one does not fit the answers.

    Answers are appended, so each batch is the beginning of the file, and the last batch is the whole file.
    """
    path = folder / SEAL
    if not path.exists():
        raise BrokenSeal(f"{path}: does not exist, the run is not finished")
    seals = path.read_text(encoding="utf-8").split()
    found, lines = [], []
    for line in answer_lines(folder):
        bisect.insort(lines, line)
        found.append(hash_of(lines))
    at = [found.index(seal) if seal in found else -1 for seal in seals]
    if not seals or -1 in at or at != sorted(at) or at[-1] != len(found) - 1:
        raise BrokenSeal(f"{path}: the seals do not fit the answers: one of them has been changed")
    return seals


def pack(folder: Path) -> None:
    """Replace the plain answers of a finished run by the archive; raises BrokenSeal where a seal does not fit."""
    plain = folder / ANSWERS
    if plain.exists():
        verify(folder)
        (folder / ARCHIVE).write_bytes(lzma.compress(plain.read_bytes(), preset=9 | lzma.PRESET_EXTREME))
        plain.unlink()


def main(arguments: Sequence[str] | None = None) -> int:
    """Verify each folder, after packing it with `--pack`."""
    parser = argparse.ArgumentParser(prog="python -m blind.tracing.ledger", description=__doc__)
    parser.add_argument("--pack", action="store_true", help="compress the answers of each run first")
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a run")
    options = parser.parse_args(arguments)
    try:
        for folder in options.folders:
            if options.pack:
                pack(folder)
            for batch, seal in enumerate(verify(folder), 1):
                print(f"{folder}: batch {batch}: {seal}: verified")
    except BrokenSeal as error:
        print(f"blind: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
