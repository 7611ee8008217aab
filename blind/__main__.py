"""`python -m blind [recovery | STUDY OPTION...]`: a study; STUDIES lists them.

Without a name recovery and tracing run. The exit code is 1 for a missed mark, 2 for a wrong command, 130 after an
interruption. A study that stores its work continues with the same command and seed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Final

from blind import levels
from blind.population import __main__ as population
from blind.predictions import __main__ as predictions
from blind.prior import __main__ as prior
from blind.recovery import __main__ as recovery
from blind.sessions import __main__ as sessions
from blind.tracing import __main__ as tracing
from blind.tracing import laws
from blind.training import __main__ as training

STUDIES: Final[dict[str, Callable[[Sequence[str]], int]]] = {
    "sessions": sessions.main,
    "predictions": predictions.main,
    "population": population.main,
    "prior": prior.main,
    "tracing": tracing.main,
    "laws": laws.main,
    "levels": levels.main,
    "train": training.main,
}
"""The studies that take options, by name."""


EXIT_INTERRUPTED: Final = 130


def main(arguments: Sequence[str]) -> int:
    """Run the named study with its options, or both; return the larger exit code."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        print("blind: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _run(arguments: Sequence[str]) -> int:
    if not arguments:
        return max(recovery.main(), tracing.main([]))
    name, *rest = arguments
    if name == "recovery" and not rest:
        return recovery.main()
    if name in STUDIES:
        return STUDIES[name](rest)
    print(
        f"blind: {' '.join(arguments)!r} is no study; known are recovery, and with options {', '.join(STUDIES)}",
        file=sys.stderr,
    )
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
