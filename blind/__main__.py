"""`python -m blind [recovery | tracing ...]`: one of the blind studies, or both; exit code 1 if a mark is missed."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from blind.recovery import __main__ as recovery
from blind.tracing import __main__ as tracing


def main(arguments: Sequence[str]) -> int:
    """Run the named study with its options, or both; the larger exit code."""
    if not arguments:
        return max(recovery.main(), tracing.main([]))
    name, *rest = arguments
    if name == "recovery" and not rest:
        return recovery.main()
    if name == "tracing":
        return tracing.main(rest)
    print(
        f"blind: {' '.join(arguments)!r} is no study; known are recovery, and tracing with its options", file=sys.stderr
    )
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
