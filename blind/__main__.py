"""`python -m blind [recovery | sessions ... | predictions ... | tracing ... | laws ... | train ...]`: a study.

Without a name recovery and tracing run. The exit code is 1 for a missed mark.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from blind.predictions import __main__ as predictions
from blind.recovery import __main__ as recovery
from blind.sessions import __main__ as sessions
from blind.tracing import __main__ as tracing
from blind.tracing import laws
from blind.training import __main__ as training


def main(arguments: Sequence[str]) -> int:
    """Run the named study with its options, or both; the larger exit code."""
    if not arguments:
        return max(recovery.main(), tracing.main([]))
    name, *rest = arguments
    if name == "recovery" and not rest:
        return recovery.main()
    if name == "tracing":
        return tracing.main(rest)
    if name == "sessions":
        return sessions.main(rest)
    if name == "predictions":
        return predictions.main(rest)
    if name == "laws":
        return laws.main(rest)
    if name == "train":
        return training.main(rest)
    print(
        f"blind: {' '.join(arguments)!r} is no study; known are recovery, and with options sessions, predictions,"
        " tracing, laws, train",
        file=sys.stderr,
    )
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
