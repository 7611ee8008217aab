"""`python -m blind predictions`: fit and drive simulated people, write docs/predictions_study.md.

The exit code is 1 for a missed mark. Drives that are stored in the folder are not made again.
"""

from __future__ import annotations

import argparse
import datetime as dt
import functools
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from biodyn_core.base.errors import InputError
from blind.predictions.calibrate import calibrated
from blind.predictions.driven import Drive, driven
from blind.predictions.page import marks, rendered
from blind.predictions.people import CALIBRATION, TEST, people
from blind.requirements import has_recordings, publish
from blind.training.collect import in_chunks

ROOT: Final = Path(__file__).resolve().parents[2]
PAGE: Final = ROOT / "docs" / "predictions_study.md"
FOLDER: Final = ROOT / "blind-out" / "predictions"
TOGETHER: Final = 6
"""People that are simulated at once, in about 1 GB of memory."""

POPULATIONS: Final = {one.seed: one for one in (CALIBRATION, TEST)}


def stored(folder: Path) -> list[Drive]:
    """The stored drives, by number."""
    return [Drive.of_line(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]


def collect(count: int, seed: int, folder: Path, processes: int) -> None:
    """Store the drives of people that the folder lacks; a file `.done` marks those that were tried."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [number for number in range(count) if not path_of(folder, number).with_suffix(".done").exists()]
    begin, done = time.perf_counter(), 0
    for numbers in in_chunks(functools.partial(_store, folder=folder), missing, TOGETHER, seed, processes):
        done += len(numbers)
        print(
            f"blind: {time.perf_counter() - begin:5.0f} s: {done} of {len(missing)} people", file=sys.stderr, flush=True
        )


def path_of(folder: Path, number: int) -> Path:
    """The file of one drive."""
    return folder / f"{number:04d}.json"


def _store(numbers: Sequence[int], seed: int, folder: Path) -> list[int]:
    for person in people(numbers, POPULATIONS[seed]):
        path = path_of(folder, person.number)
        if not path.with_suffix(".done").exists():
            try:
                drive = driven(person)
            except InputError as error:
                print(f"blind: person {person.number}: {error}", file=sys.stderr, flush=True)
                drive = None
            if drive is not None:
                path.write_text(drive.line(), encoding="utf-8")
            path.with_suffix(".done").touch()
    for number in numbers:
        path_of(folder, number).with_suffix(".done").touch()
    return list(numbers)


def main(arguments: Sequence[str]) -> int:
    """Run the whole study."""
    parser = argparse.ArgumentParser(prog="python -m blind predictions")
    parser.add_argument("--people", type=int, default=84, metavar="N", help="people to test on (default 84)")
    parser.add_argument("--calibration", type=int, default=30, metavar="N", help="people to calibrate on (default 30)")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where drives are stored (default blind-out)")
    parser.add_argument("--processes", type=int, default=2, metavar="N", help="processes (default 2)")
    options = parser.parse_args(arguments)
    if not has_recordings():
        return 2
    for population, count in ((CALIBRATION, options.calibration), (TEST, options.people)):
        collect(count, population.seed, options.folder / str(population.seed), options.processes)
    training, drives = (stored(options.folder / str(one.seed)) for one in (CALIBRATION, TEST))
    today = dt.datetime.now(tz=dt.timezone.utc).date().isoformat()
    return publish(PAGE, rendered(drives, calibrated(training), today), marks(drives))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
