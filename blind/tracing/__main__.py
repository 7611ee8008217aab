"""`python -m blind tracing`: the blind study of tracing; 1 where a mark is missed, 2 where it cannot run."""

from __future__ import annotations

import argparse
import datetime as dt
import secrets
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, get_args

from world import seats
from world.effects.draw import Split

from biodyn_core.base.errors import InputError
from blind.tracing import streams
from blind.tracing.answer import thresholds
from blind.tracing.marks import Mark, marks
from blind.tracing.outcome import Outcome
from blind.tracing.rows import CONDITIONS, DRAWINGS, MEASURED, drawings
from blind.tracing.study import SEAL, BrokenSeal, Run, in_processes, run, seals
from blind.tracing.table import About, publish

ROOT: Final = Path(__file__).resolve().parents[2]
OUT: Final = Path("blind-out")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, or go on with it, and publish it where it is whole."""
    options = _parser().parse_args(arguments)
    if not seats.data().is_dir():
        print(f"blind: the recordings are not in {seats.data()}: say where they are with BIODYN_DATA", file=sys.stderr)
        return 2
    try:
        return _studied(options)
    except (BrokenSeal, InputError, ValueError) as error:
        print(f"blind: {error}", file=sys.stderr)
        return 2


def _studied(options: argparse.Namespace) -> int:
    begin = time.perf_counter()

    def say(text: str) -> None:
        print(f"blind: {time.perf_counter() - begin:6.0f} s: {text}", file=sys.stderr, flush=True)

    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    partial = bool(options.rows or options.count is not None or options.split != "blind")
    print(f"blind: seed {seed}{', a partial run that is not published' if partial else ''}", flush=True)
    what = Run(
        seed,
        tuple(drawings(options.rows, options.count)),
        _folder(options.out, seed, partial),
        options.split,
        commit(),
        () if partial else CONDITIONS,
    )
    outcomes = run(what, in_processes, say=say)
    if not partial:
        outcomes += streams.outcomes(seed)
    found = marks(outcomes, CONDITIONS if partial else (*CONDITIONS, *MEASURED))
    if not partial:
        if commit() != what.commit:
            raise BrokenSeal("the commit has changed since the run began: nothing is published")
        today = dt.datetime.now(dt.timezone.utc).date().isoformat()
        publish(ROOT, About(today, what.commit, seed, thresholds(), seals(what)[-1], len(outcomes)), outcomes, found)
    _print(found, outcomes, partial)
    return 0 if all(mark.met for mark in found) else 1


def commit() -> str:
    """The commit of the checkout, with a plus where files that it tracks, pages left aside, have been changed."""
    head = _git("rev-parse", "--short=12", "HEAD")
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
    return f"{head or 'unknown'}{'+' if changed else ''}"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    return answer.stdout.strip()


def _folder(out: Path, seed: int, partial: bool) -> Path:
    """Where a run writes. A seed whose truths a partial run has looked at is spent: ValueError."""
    spent = out / f"{seed}-partial"
    if not partial and (spent / SEAL).exists():
        raise ValueError(f"seed {seed}: a partial run has looked at its truths ({spent}); take another")
    return spent if partial else out / str(seed)


def _print(found: Sequence[Mark], outcomes: Sequence[Outcome], partial: bool) -> None:
    for mark in found:
        print(f"{'met   ' if mark.met else 'MISSED'} {mark.row}: {mark.what} {mark.said} ({mark.asked})")
    if partial:
        print(f"partial: {len(outcomes)} records; rows with fewer than they are to have cannot meet their marks")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m blind tracing", description=__doc__)
    parser.add_argument("--seed", type=int, help="go on with a run, or repeat one; fresh and printed without it")
    names = ", ".join(one.name for one in DRAWINGS)
    parser.add_argument("--rows", nargs="+", default=[], metavar="ROW", help=f"these alone (partial): {names}")
    parser.add_argument("--count", type=int, help="so many records of each (partial)")
    parser.add_argument(
        "--split", choices=get_args(Split), default="blind", help="which forms are hidden; others are partial"
    )
    parser.add_argument("--out", type=Path, default=OUT, help="where verdicts and scores are kept")
    return parser


if __name__ == "__main__":
    sys.exit(main())
