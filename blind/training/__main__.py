"""`python -m blind train`: collect the evidence of simulated bodies, learn the model of tracing, and write its page.

Bodies whose evidence is stored are not simulated again. The evidence depends on the tracer: after a change of its
search, remove the stored examples.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Final

from world import seats
from world.effects import mixture

from biodyn_core.tracing import probability
from biodyn_core.tracing.probability import learned_text
from biodyn_core.tracing.settings import TraceSettings
from blind.tracing.__main__ import ROOT, commit
from blind.tracing.ceiling import LEARNED
from blind.training import recordings
from blind.training.calibrate import beyond, learned
from blind.training.collect import Example, collect, examples, pack
from blind.training.ideal import IdealDecision
from blind.training.learn import labelled, labelled_with_true_law
from blind.training.report import background_lines, ceiling_lines, recordings_lines, rendered

SEED: Final = 20261124
BODIES: Final = 2000
EXAMPLES: Final = ROOT / "blind" / "training" / "examples.jsonl"
FURTHER: Final = ROOT / "blind" / "training" / "recordings"
MODEL: Final = ROOT / "biodyn_core" / "tracing" / probability.FILE
PAGE: Final = ROOT / "docs" / "tracing_learned.md"


def main(arguments: Sequence[str] | None = None) -> int:
    """Collect and learn; exit code 2 if bodies cannot be simulated."""
    options = _parser().parse_args(arguments)
    begin = time.perf_counter()

    def report(text: str) -> None:
        print(f"blind: {time.perf_counter() - begin:6.0f} s: {text}", file=sys.stderr, flush=True)

    wanted, further = range(options.bodies), range(options.recordings)
    missing = not {one.number for one in examples(options.examples)}.issuperset(wanted)
    missing_further = not {number for number, _ in recordings.stored(FURTHER)}.issuperset(further)
    if (missing or missing_further) and not seats.data().is_dir():
        report(f"the recordings are not in {seats.data()}: set BIODYN_DATA to their directory")
        return 2
    if missing:
        collect(wanted, options.seed, options.examples, options.processes, report)
        pack(options.examples)
    if missing_further:
        recordings.collect(further, options.seed + 1, FURTHER, options.processes, report)
    stored = [one for one in examples(options.examples) if one.number in wanted]
    with ProcessPoolExecutor(options.processes) as executor:
        _learn(stored, options.seed, executor, report)
    return 0


def _learn(stored: Sequence[Example], seed: int, executor: Executor, report: Callable[[str], None]) -> None:
    """Learn the model from examples, and write it with its page."""
    every = [label for one in stored for label in labelled(one)]
    ideal = [label for one in stored for label in labelled_with_true_law(one)]
    traced, named_from = len({one.number for one in every}), TraceSettings().named_from
    provenance = {
        "date": dt.datetime.now(dt.timezone.utc).date().isoformat(),
        "commit": commit(),
        "seed": seed,
        "bodies": traced,
        "bodies that cannot be traced": len(stored) - traced,
    }
    of_true_laws = executor.submit(IdealDecision.of, every, ideal)
    found = executor.submit(learned, every, ideal, provenance, named_from).result()
    report(f"learned from {traced} bodies")
    left_out = {kind: executor.submit(beyond, every, kind, found.model) for kind in mixture.KINDS}
    unlike = {kind: future.result() for kind, future in left_out.items()}
    own = of_true_laws.result()
    more = recordings.answered(recordings.stored(FURTHER), found.model, own)
    further, counts = recordings_lines(more, named_from), recordings.summary(more, named_from)
    MODEL.write_text(learned_text(dataclasses.replace(found.model, further=counts)), encoding="utf-8")
    LEARNED.write_text(learned_text(own.model(provenance, named_from)), encoding="utf-8")
    ceilings = ceiling_lines(found.found, [found.ceiling, own.cross_validated()], named_from)
    page = rendered(found, named_from, [*ceilings, *background_lines(unlike, named_from), *further])
    PAGE.write_text(page, encoding="utf-8")
    report(f"wrote {', '.join(str(one.relative_to(ROOT)) for one in (MODEL, LEARNED, PAGE))}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m blind train", description=__doc__)
    parser.add_argument("--bodies", type=int, default=BODIES, help=f"number of bodies, default {BODIES}")
    parser.add_argument("--recordings", type=int, default=0, help="bodies with further recordings, default: as stored")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the drawing, default {SEED}")
    parser.add_argument("--processes", type=int, default=2, help="that collect evidence and learn, default 2")
    parser.add_argument("--examples", type=Path, default=EXAMPLES, metavar="FILE", help="of the stored evidence")
    return parser


if __name__ == "__main__":
    sys.exit(main())
