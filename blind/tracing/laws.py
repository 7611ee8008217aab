"""`python -m blind laws`: the gap that each law of the catalogue closes with the true class and site known.

The gap is the sum of squares before the effect less that of the same record without the effect, both after a refit of
theta, on held-out events. It tests laws and optimiser, not the search: each record has sensor noise alone.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from world.effects.draw import Split

from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.fit import fit_joint
from biodyn_core.tracing.settings import TraceSettings
from biodyn_ros.work.executors import as_done, executor_of, result_of
from blind.requirements import has_recordings
from blind.tracing.answer import TRACE_SEED
from blind.tracing.outcome import site_distance
from blind.tracing.records import causes, record, sittings
from blind.tracing.refits import STARTS, refitted, starts, tries
from blind.tracing.rows import Drawing
from blind.tracing.score import ratio, sum_of_squares

PROCESSES: Final = 2
RATIO: Final = (0.8, 8.0)
MORE_STARTS: Final = 6
"""Starts of the long refit that shows how much of the gap the usual one leaves."""


@dataclass(frozen=True)
class Closure:
    """One record: its class, form and site; its ratio; and the share of the gap that each refit closes."""

    kind: str
    form: str
    site: str
    ratio: float
    textbook: float
    general: float
    longest: float
    """From `MORE_STARTS` starts instead of `STARTS`; nan if that was not computed."""


def closures(kind: str, count: int, seed: int, split: Split, is_long: bool = False) -> list[Closure]:
    """The closed shares of some records of a class."""
    drawing = Drawing(f"laws-{kind}", count, level=0.0, ratio=RATIO, kinds=(kind,))
    found = []
    for one in sittings(drawing, range(count), seed, split):
        cause, effect = causes(one.effects)[0], CATALOGUE[kind]
        hidden, plain = (record(one, with_effects=with_effects) for with_effects in (True, False))
        fits = [fit_joint(known.train, known.subject, TRACE_SEED, TraceSettings().base) for known in (hidden, plain)]
        before, floor = (
            sum_of_squares(fit.subject, known.held_out) for fit, known in zip(fits, (hidden, plain), strict=True)
        )
        sites = [site for site in effect.sites if cause.site and not site_distance(kind, site, cause.site)]
        ranked = starts(fits[0], hidden.train, tries(fits[0].subject, effect, sites or effect.sites, hidden.train))
        applied = [each.applied for each in ranked]
        refits = [refitted(fits[0], hidden.train, applied[:STARTS], textbook) for textbook in (True, False)]
        if is_long:
            refits.append(refitted(fits[0], hidden.train, applied[:MORE_STARTS]))
        closed = [(before - sum_of_squares(end.subject, hidden.held_out)) / (before - floor) for end in refits]
        found.append(
            Closure(
                kind, type(one.effects[0]).__name__, cause.site,
                ratio(fits[0].subject, hidden.cases, fits[1].subject, plain.cases), *closed,
                *([] if is_long else [float("nan")]),
            )
        )  # fmt: skip
    return found


def table(found: Sequence[Closure]) -> str:
    """A row for each class: records, and the median and least share of the gap that each refit closes."""
    lines = [
        "| class | records | textbook law, median | general law, median | least |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for kind in sorted({one.kind for one in found}):
        mine = [one for one in found if one.kind == kind]
        textbook, general = ([getattr(one, name) for one in mine] for name in ("textbook", "general"))
        lines.append(
            f"| {kind} | {len(mine)} | {np.median(textbook):.2f} | {np.median(general):.2f} | {min(general):.2f} |"
        )
    textbook, general = ([getattr(one, name) for one in found] for name in ("textbook", "general"))
    lines.append(f"| all | {len(found)} | {np.median(textbook):.2f} | {np.median(general):.2f} | {min(general):.2f} |")
    longer = [one for one in found if np.isfinite(one.longest)]
    if longer:
        left = sum(one.longest - one.general > 0.05 for one in longer)
        lines.append(f"\nMore starts close 5 % more of the gap in {left} of {len(longer)} records.")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each record as it is ready, then the table."""
    options = _parser().parse_args(arguments)
    if not has_recordings():
        return 2
    done = _stored(options.out)
    left = [kind for kind in options.kinds if not any(one.kind == kind for one in done)]
    calls = [(closures, (kind, options.count, options.seed, options.split, options.long)) for kind in left]
    with executor_of(f"processes:{PROCESSES}") as executor:
        for number, future in as_done(executor, calls):
            found = result_of(future, left[number])
            done += found
            lines = "".join(json.dumps(asdict(one)) + "\n" for one in found)
            print(lines, end="", flush=True)
            if options.out:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(lines)
    print(table(done))
    return 0


def _stored(path: Path | None) -> list[Closure]:
    """Results of an interrupted run."""
    if path is None or not path.exists():
        return []
    return [Closure(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m blind laws", description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=sorted(CATALOGUE), default=sorted(CATALOGUE), metavar="CLASS")
    parser.add_argument("--count", type=int, default=2, help="records of each class (default: 2)")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument(
        "--split", choices=("development", "second", "earlier"), default="second", help="forms (default: second)"
    )
    parser.add_argument("--long", action="store_true", help=f"also refit from {MORE_STARTS} starts")
    parser.add_argument("--out", type=Path, help="file of results, continued if it exists")
    return parser
