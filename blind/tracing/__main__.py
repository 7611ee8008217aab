"""`python -m blind tracing`: the blind study of tracing; exit code 1 if a mark is missed, 2 if it cannot run."""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import secrets
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, get_args

from world.effects.draw import SCORING, Split

from bench.machine import machine
from biodyn_core.base.errors import InputError
from blind.requirements import has_recordings
from blind.tracing import streams
from blind.tracing.answer import decision
from blind.tracing.marks import Mark, marks
from blind.tracing.outcome import Outcome
from blind.tracing.rows import CONDITIONS, DRAWINGS, MEASURED, drawings
from blind.tracing.study import SEAL, BrokenSeal, Run, in_processes, run, seals
from blind.tracing.table import RUNS, About, append, publish

ROOT: Final = Path(__file__).resolve().parents[2]
OUT: Final = Path("blind-out")
OF_EACH: Final = 30
"""Records of each row in a short run."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, or continue it, and publish a run of all rows."""
    options = _parser().parse_args(arguments)
    if not has_recordings():
        return 2
    try:
        return _run(options)
    except (BrokenSeal, InputError, ValueError) as error:
        print(f"blind: {error}", file=sys.stderr)
        return 2


def _run(options: argparse.Namespace) -> int:
    begin = time.perf_counter()

    def report(text: str) -> None:
        print(f"blind: {time.perf_counter() - begin:6.0f} s: {text}", file=sys.stderr, flush=True)

    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    partial = bool(options.rows or options.count is not None or options.split != SCORING)
    if options.short and partial:
        raise ValueError("--short draws its own records of all rows: omit --rows, --count and --split")
    kind = ", a partial run that is not published" if partial else ", a short run" if options.short else ""
    print(f"blind: seed {seed}{kind}", flush=True)
    study = Run(
        seed,
        tuple(drawings(options.rows, OF_EACH if options.short else options.count)),
        _folder(options.out, seed, partial),
        options.split,
        commit(),
        () if partial or options.short else CONDITIONS,
    )
    outcomes = run(study, in_processes, report=report)
    sealed = len(outcomes)
    if not partial:
        outcomes += streams.outcomes(seed)
    required = CONDITIONS if partial else (*CONDITIONS, *MEASURED)
    found = marks(outcomes, [dataclasses.replace(one, least=0) for one in required] if options.short else required)
    if not partial:
        _publish(study, OF_EACH if options.short else None, outcomes, found, sealed)
    _print(found, outcomes, partial)
    return 0 if all(mark.met for mark in found) else 1


def _publish(study: Run, of_each: int | None, outcomes: Sequence[Outcome], found: Sequence[Mark], sealed: int) -> None:
    """Publish a run of all rows: a short one, with `of_each` records of each, in the table of runs alone.

    sealed: the number of records whose answers are sealed; the others are of measured streams.
    """
    if commit() != study.commit:
        raise BrokenSeal("the commit has changed since the run began, so it is not published")
    today = dt.datetime.now(dt.timezone.utc).date().isoformat()
    about = About(
        today, study.commit, study.seed, decision(), seals(study)[-1], sealed, machine(), of_each=of_each,
        measured=len(outcomes) - sealed,
    )  # fmt: skip
    if of_each is None:
        publish(ROOT, about, outcomes, found)
    else:
        append(ROOT / RUNS, about, found)


def commit() -> str:
    """The commit of the checkout, with a plus if tracked files other than pages have changed."""
    head = _git("rev-parse", "--short=12", "HEAD")
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
    return f"{head or 'unknown'}{'+' if changed else ''}"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    return answer.stdout.strip()


def _folder(out: Path, seed: int, partial: bool) -> Path:
    """The folder of a run; raises ValueError for a seed whose truths a partial run has used."""
    spent = out / f"{seed}-partial"
    if not partial and (spent / SEAL).exists():
        raise ValueError(f"seed {seed}: a partial run has used its truths ({spent}); take another")
    return spent if partial else out / str(seed)


def _print(found: Sequence[Mark], outcomes: Sequence[Outcome], partial: bool) -> None:
    for mark in found:
        print(f"{'met   ' if mark.met else 'MISSED'} {mark.row}: {mark.what} {mark.text} ({mark.required})")
    if partial:
        print(f"partial: {len(outcomes)} records; rows with too few records cannot meet their marks")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m blind tracing", description=__doc__)
    parser.add_argument("--seed", type=int, help="continue or repeat a run (default: a new seed, which is printed)")
    names = ", ".join(one.name for one in DRAWINGS)
    parser.add_argument("--rows", nargs="+", default=[], metavar="ROW", help=f"only these rows (partial): {names}")
    parser.add_argument("--count", type=int, help="records of each row (partial)")
    parser.add_argument(
        "--short", action="store_true", help=f"{OF_EACH} records of each row, published in the table of runs alone"
    )
    parser.add_argument(
        "--split",
        choices=get_args(Split),
        default=SCORING,
        help=f"forms of the hidden effects; others than {SCORING} are partial",
    )
    parser.add_argument("--out", type=Path, default=OUT, help="directory of verdicts and scores")
    return parser


if __name__ == "__main__":
    sys.exit(main())
