"""Trace: from bags to the effect that a subject's model lacks.

Without bags held out by name, every second one of a loading condition is held out: an effect is not chosen by the
events that its errors are reported of.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.subject import Subject
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import CaseSettings
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.tracing.data_checks import split_held_out, usable, without_failed_sensors
from biodyn_core.tracing.settings import TraceSettings
from biodyn_ros.base.files import make_directory, remove, write_text
from biodyn_ros.base.json_files import write_json
from biodyn_ros.base.progress import OnProgress, Progress, ignore_progress
from biodyn_ros.fit.report import warnings_of
from biodyn_ros.reading.dealing import TO_TRACE, dealt, dealt_line
from biodyn_ros.reading.events import EventOptions, Prepared, check_bags, read_events
from biodyn_ros.reading.parts import Bag
from biodyn_ros.reading.provenance import role_of
from biodyn_ros.reading.recordings import RecordingOptions
from biodyn_ros.trace.document import trace_document, traced_subject, use_of
from biodyn_ros.trace.refit import refit_of
from biodyn_ros.trace.report import Report
from biodyn_ros.work.tasks import Monitor

SUBJECT: Final = "subject.yaml"
PAGE: Final = "trace.html"


@dataclass(frozen=True)
class TraceOptions:
    """How bags are read, prepared and traced.

    held_out: bags that are not fitted to; auto_held_out: they are drawn; as_given: none but these are held out, also if
    there are none; cases: the loading condition of a bag if its name does not give it.
    """

    seed: int = 0
    held_out: tuple[Bag, ...] = ()
    auto_held_out: bool = False
    as_given: bool = False
    cases: Mapping[str, str] = field(default_factory=dict)
    reading: RecordingOptions = field(default_factory=RecordingOptions)
    spectra: SpectrumSettings = field(default_factory=SpectrumSettings)
    preparing: CaseSettings = field(default_factory=CaseSettings)
    settings: TraceSettings = field(default_factory=TraceSettings)


def trace_bags(
    bags: Sequence[Bag],
    subject: Subject,
    options: TraceOptions | None = None,
    kept: MutableMapping[str, Any] | None = None,
    say: Callable[[str], None] = lambda line: None,
    parallel: ParallelMap = serial_map,
    monitor: Monitor = Progress,
) -> Report:
    """Trace bags; raises InputError, one line, for bags that cannot be read or compared.

    kept: the checkpoint of earlier traces, such as a `PartStore`. say: gets the use of each bag before the long work.
    parallel: as `trace`. monitor: of progress.
    """
    from biodyn_core.tracing.trace import trace  # late: refused bags do not need it

    o, begin = options or TraceOptions(), time.monotonic()
    check_bags(bags, o.held_out, o.cases)
    # Every further channel makes effects testable.
    reading = EventOptions(o.cases, dataclasses.replace(o.reading, channels=True), o.spectra, o.preparing)
    with monitor("reading") as progress:
        events = read_events(bags, o.held_out, reading, progress)
    prepared, how_dealt = _divided(events.prepared, o)
    fitted, spare = ([case for event, case in prepared if event.held_out is out] for out in (False, True))
    for line in _uses(fitted, spare, o):
        say(line)
    with stage_lines(monitor) as on_stage:
        found = trace(
            fitted, spare, subject,
            settings=o.settings, seed=o.seed, on_stage=on_stage, checkpoint=kept, parallel=parallel,
        )  # fmt: skip
    sources = [event.source for event, case in prepared if use_of(event, case, found) == "train"]
    return Report(
        trace=found,
        events=tuple((event, without_failed_sensors(case, o.settings.floor)[0]) for event, case in prepared),
        refit=refit_of(found, sources),
        dealt=how_dealt,
        warnings=(*events.left_out, *warnings_of(prepared), *_seen_before(subject, prepared)),
        seconds=time.monotonic() - begin,
    )


def _divided(events: Sequence[Prepared], options: TraceOptions) -> tuple[list[Prepared], str | None]:
    """The events for fitting and held-out ones, and how they were dealt, None if a user has named them."""
    if options.held_out or options.as_given:
        return list(events), None
    if options.auto_held_out:
        drawn = dealt(events, TO_TRACE, options.seed)
        return drawn, dealt_line(drawn, options.seed)
    by_turns = deal(events)
    return by_turns, _dealt(by_turns)


def deal(events: Sequence[Prepared]) -> list[Prepared]:
    """The events with every second bag of a loading condition held out, in the given order, held-out ones last."""
    bags: dict[str, dict[str, bool]] = {}
    dealt = []
    for event, case in events:
        of_case = bags.setdefault(case.case, {})
        is_held_out = of_case.setdefault(event.bag, len(of_case) % 2 == 1)
        dealt.append((dataclasses.replace(event, held_out=is_held_out), case))
    return sorted(dealt, key=lambda each: each[0].held_out)


def write_traced(traced: Report, directory: Path, report: bool = True, given_yaml: str | None = None) -> None:
    """Write subject.yaml, trace.json and trace.html; raises InputError, of the page as `write_drawn`.

    given_yaml: the file of the given subject, which is copied if nothing is added. The subject is written first, so
    that no subject of an earlier trace remains with a new verdict. Without a report an earlier one is removed.
    """
    make_directory(directory)
    as_given = None if traced.trace.adds else given_yaml
    write_text(directory / SUBJECT, as_given or traced_subject(traced).to_yaml())
    write_json(directory / "trace.json", trace_document(traced))
    if report:
        from biodyn_ros.reports.pages import write_drawn  # an extra of its own
        from biodyn_ros.trace.page import trace_page

        write_drawn(directory / PAGE, lambda: trace_page(traced))
    else:
        remove(directory / PAGE)


@contextmanager
def stage_lines(monitor: Monitor) -> Iterator[Callable[[str, float], None]]:
    """Show each stage of long work on a separate line; yields the function of a stage and the share of it done."""
    stage = ""
    progress: OnProgress = ignore_progress
    with ExitStack() as line:

        def show(name: str, share: float) -> None:
            nonlocal stage, progress
            if name != stage:
                line.close()
                stage, progress = name, line.enter_context(monitor(name))
            progress(round(1000 * share), 1000)

        yield show


def _dealt(prepared: Sequence[Prepared]) -> str:
    train, held_out = (
        list(dict.fromkeys(event.bag for event, _ in prepared if event.held_out is out)) for out in (False, True)
    )
    if not held_out:
        return "nothing is held out: no loading condition has two bags; give more bags, or --hold-out"
    names = ", ".join(Path(bag).name for bag in held_out)
    return (
        f"no bag was held out by name, so every second one of each condition is: {len(train)} to fit, held out {names}"
    )


def _uses(train: Sequence[Case], held_out: Sequence[Case], options: TraceOptions) -> Iterator[str]:
    """The recordings of each use, a line each."""
    fitted, spare, _ = usable(train, held_out)
    choose, report = split_held_out(spare)
    how = "by name" if options.held_out or options.as_given else "by default, every second bag of a condition"
    how = "drawn" if options.auto_held_out else how
    yield f"parameters are fitted to: {_names(fitted)}"
    yield f"held out ({how}), the effect is chosen by: {_names(choose)}"
    yield f"held out, errors are reported of: {_names(report)}"


def _names(cases: Sequence[Case]) -> str:
    return ", ".join(dict.fromkeys(case.name for case in cases)) or "none"


def _seen_before(subject: Subject, prepared: Sequence[Prepared]) -> list[str]:
    """A warning for each held-out bag that the given subject was fitted to."""
    seen = [event.bag for event, _ in prepared if event.held_out and role_of(subject, event.source) == "fitted"]
    return [f"{bag}: held out, but the subject that was given had been fitted to it" for bag in dict.fromkeys(seen)]
