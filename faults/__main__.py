"""`python -m faults [stamps] [dds]`: runs the fault bench, a row for each fault; exit code 1 if a row is wrong.

`python -m faults fuzz [SECONDS]`: runs every reader under a coverage-guided fuzzer (60 s each).
`python -m faults ends [COUNT]`: ends the live node on a busy machine (50 times); exit code 1 if an end is not clean.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import chain

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_ros.base.wording import number
from faults.judged import judged
from faults.stamps import EVERY, OTHERS


def main(arguments: list[str]) -> int:
    """Print the given tables, or both."""
    if arguments[:1] == ["fuzz"]:
        from faults import fuzz  # needs the extra `fuzz`

        return fuzz.every(int(arguments[1]) if len(arguments) > 1 else 60)
    if arguments[:1] == ["ends"]:
        from faults import ends  # rclpy

        return ends.every(int(arguments[1]) if len(arguments) > 1 else 50)
    unknown = [name for name in arguments if name not in ("stamps", "dds")]
    if unknown:
        print(f"faults: unknown: {', '.join(unknown)}; allowed: stamps, dds, fuzz, ends", file=sys.stderr)
        return 2
    tables = [table for name, table in (("stamps", _stamps), ("dds", _dds)) if name in arguments or not arguments]
    wrong = 0
    for fault, recovered_s, missing, message, errors in chain.from_iterable(table() for table in tables):
        wrong += bool(errors)
        print(
            f"{fault:52s} {recovered_s:>6s} {missing:>8s}  {'WRONG: ' + '; '.join(errors) if errors else message}",
            flush=True,
        )
    print(f"{wrong} wrong")
    return 1 if wrong else 0


Line = tuple[str, str, str, str, tuple[str, ...]]


def _stamps() -> Iterator[Line]:
    yield ("fault", "after s", "missing s", "message", ())
    for fault, sensors in [*((one, SENSORS) for one in EVERY), *((one, (SEAT, "head")) for one in OTHERS)]:
        for sensor in sensors:
            row = judged(fault, sensor)
            yield f"{sensor}: {row.fault}", number(row.recovered_s), number(row.missing_s), row.message, row.wrong


def _dds() -> Iterator[Line]:
    from faults import over_dds  # rclpy

    for run in (*(one.run for one in over_dds.STREAMED), *over_dds.OTHERS.values()):
        row = run()
        yield row.fault, number(row.recovered_s), "", row.message, row.wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
