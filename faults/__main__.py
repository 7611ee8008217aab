"""`python -m faults [stamps] [dds]`: the fault bench, a row for each fault; 1 where anything is wrong.

`python -m faults fuzz [SECONDS]`: every reader under a coverage-guided fuzzer, so long each (60 s).
`python -m faults ends [COUNT]`: the live node ended so many times (50) on a busy machine; 1 where an end is not clean.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import chain

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_ros.base.wording import number
from faults.judged import judged
from faults.stamps import EVERY, OTHERS


def main(asked: list[str]) -> int:
    """Print the tables asked for, both without a name."""
    if asked[:1] == ["fuzz"]:
        from faults import fuzz  # an extra of its own

        return fuzz.every(int(asked[1]) if len(asked) > 1 else 60)
    if asked[:1] == ["ends"]:
        from faults import ends  # rclpy

        return ends.every(int(asked[1]) if len(asked) > 1 else 50)
    unknown = [name for name in asked if name not in ("stamps", "dds")]
    if unknown:
        print(f"faults: {', '.join(unknown)} is unknown, known are stamps, dds, fuzz, ends", file=sys.stderr)
        return 2
    tables = [table for name, table in (("stamps", _stamps), ("dds", _dds)) if name in asked or not asked]
    wrong = 0
    for fault, recovered_s, missing, said, faults in chain.from_iterable(table() for table in tables):
        wrong += bool(faults)
        print(
            f"{fault:52s} {recovered_s:>6s} {missing:>8s}  {'WRONG: ' + '; '.join(faults) if faults else said}",
            flush=True,
        )
    print(f"{wrong} wrong")
    return 1 if wrong else 0


Line = tuple[str, str, str, str, tuple[str, ...]]


def _stamps() -> Iterator[Line]:
    yield ("fault", "after s", "missing s", "said", ())
    for fault, sensors in [*((one, SENSORS) for one in EVERY), *((one, (SEAT, "head")) for one in OTHERS)]:
        for sensor in sensors:
            row = judged(fault, sensor)
            yield f"{sensor}: {row.fault}", number(row.recovered_s), number(row.missing_s), row.said, row.wrong


def _dds() -> Iterator[Line]:
    from faults import over_dds  # rclpy

    for run in (*(one.run for one in over_dds.STREAMED), *over_dds.OTHERS.values()):
        row = run()
        yield row.fault, number(row.recovered_s), "", row.said, row.wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
