"""`python -m blind sessions`: search and fit simulated sessions, write docs/sessions_study.md.

The exit code is 1 for a missed mark.
"""

from __future__ import annotations

import argparse
import datetime as dt
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from blind.requirements import publish
from blind.sessions.finding import FindingScore, score_of
from blind.sessions.fitting import scores_of
from blind.sessions.page import marks, rendered

PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "sessions_study.md"
SEED: Final = 31_000
MINUTES: Final = 40.0


def main(arguments: Sequence[str]) -> int:
    """Run the whole study, about half an hour on one core, and 11 GB of memory."""
    parser = argparse.ArgumentParser(prog="python -m blind sessions")
    parser.add_argument("--sessions", type=int, default=10, metavar="N", help="sessions to search (default 10)")
    parser.add_argument("--people", type=int, default=4, metavar="N", help="people to fit (default 4)")
    options = parser.parse_args(arguments)
    begin = time.perf_counter()

    def report(text: str) -> None:
        print(f"blind: {time.perf_counter() - begin:5.0f} s: {text}", file=sys.stderr, flush=True)

    sessions = []
    for number in range(options.sessions):
        sessions.append(score_of(MINUTES, SEED + number))
        report(f"session {number + 1} of {options.sessions}: {sessions[-1]}")
    fits = scores_of(options.people, MINUTES, SEED, report)
    today = dt.datetime.now(tz=dt.timezone.utc).date().isoformat()
    return publish(PAGE, rendered(sessions, fits, today), marks(FindingScore.total(sessions), fits))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
