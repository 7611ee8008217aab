"""`python -m conformance`: measures every row, writes docs/conformance.md; exit code 1 if a row fails."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from conformance import recordings
from conformance.page import CHAPTERS, failures, rendered

PAGE: Final = Path(__file__).resolve().parents[1] / "docs" / "conformance.md"


def main() -> int:
    """Run all chapters, a minute or two."""
    if not recordings.data().is_dir():
        print(
            f"conformance: the recordings are not in {recordings.data()}: set BIODYN_DATA to their directory",
            file=sys.stderr,
        )
        return 2
    chapters = {}
    for name, sections in CHAPTERS.items():
        print(f"conformance: {name}", file=sys.stderr, flush=True)
        chapters[name] = sections()
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(rendered(chapters), encoding="utf-8")
    failed = [row for sections in chapters.values() for row in failures(sections)]
    for row in failed:
        print(row.line())
    print(f"{PAGE}: {len(failed)} failures")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
