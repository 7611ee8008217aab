"""`python -m blind prior`: fit simulated people to few data and to many, with and without prior, write its page.

The exit code is 1 for a missed mark. People that are stored in the folder are not fitted again.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import functools
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from blind.prior.fits import FitPair, Score, pairs
from blind.prior.page import marks, rendered
from blind.prior.people import people
from blind.requirements import has_recordings, publish
from blind.training.collect import in_chunks

ROOT: Final = Path(__file__).resolve().parents[2]
PAGE: Final = ROOT / "docs" / "prior_study.md"
FOLDER: Final = ROOT / "blind-out" / "prior"
TOGETHER: Final = 5
"""People that are simulated at once."""


def stored(folder: Path) -> list[FitPair]:
    """The stored fits, by person."""
    lines = [line for path in sorted(folder.glob("*.jsonl")) for line in path.read_text(encoding="utf-8").splitlines()]
    return [_read(json.loads(line)) for line in lines]


def _read(facts: dict[str, object]) -> FitPair:
    scores = {name: Score(**facts[name]) for name in ("without", "with_prior")}  # type: ignore[arg-type]
    return FitPair(**facts | scores)  # type: ignore[arg-type]


def _store(numbers: Sequence[int], _seed: int, folder: Path) -> list[int]:
    for person in people(numbers):
        lines = [json.dumps(dataclasses.asdict(pair)) + "\n" for pair in pairs(person)]
        (folder / f"{person.number:04d}.jsonl").write_text("".join(lines), encoding="utf-8")
    return list(numbers)


def collect(count: int, folder: Path, processes: int) -> None:
    """Store the fits of people that the folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [number for number in range(count) if not (folder / f"{number:04d}.jsonl").exists()]
    begin, done = time.perf_counter(), 0
    for numbers in in_chunks(functools.partial(_store, folder=folder), missing, TOGETHER, 0, processes):
        done += len(numbers)
        elapsed_s = time.perf_counter() - begin
        print(f"blind: {elapsed_s:5.0f} s: {done} of {len(missing)} people", file=sys.stderr, flush=True)


def main(arguments: Sequence[str]) -> int:
    """Run the whole study."""
    parser = argparse.ArgumentParser(prog="python -m blind prior")
    parser.add_argument("--people", type=int, default=20, metavar="N", help="people to fit (default 20)")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where fits are stored (default blind-out)")
    parser.add_argument("--processes", type=int, default=2, metavar="N", help="processes (default 2)")
    options = parser.parse_args(arguments)
    if not has_recordings():
        return 2
    collect(options.people, options.folder, options.processes)
    found = stored(options.folder)
    today = dt.datetime.now(tz=dt.timezone.utc).date().isoformat()
    return publish(PAGE, rendered(found, today), marks(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
