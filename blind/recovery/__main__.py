"""`python -m blind recovery`: draw and identify 20 people, write docs/recovery.md; exit code 1 if a mark is missed."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Final

from blind.recovery.draw import draw
from blind.recovery.identify import identify
from blind.recovery.marks import marks
from blind.recovery.page import rendered
from blind.recovery.results import compare
from blind.requirements import has_recordings

PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "recovery.md"
PEOPLE: Final = 20
SEED: Final = 2026


def main() -> int:
    """Run the whole study, about ten minutes on one core."""
    if not has_recordings():
        return 2
    begin = time.perf_counter()

    def report(text: str) -> None:
        print(f"blind: {time.perf_counter() - begin:5.0f} s: {text}", file=sys.stderr, flush=True)

    people, truths = draw(PEOPLE, SEED, report=report)
    answers = []
    for number, person in enumerate(people, 1):
        report(f"person {number} of {len(people)}")
        answers.append(identify(person))
    # Up to here the truth is not used.
    results = [compare(*one) for one in zip(people, answers, truths, strict=True)]
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(rendered(results), encoding="utf-8")
    found = marks(results)
    for mark in found:
        print(f"{'met   ' if mark.met else 'MISSED'} {mark.what}: {mark.reached} ({mark.required})")
    report(f"done, {PAGE}")
    return 0 if all(mark.met for mark in found) else 1


if __name__ == "__main__":
    sys.exit(main())
