"""Make a subject from sessions: find events, fit, validate and trace, in this order."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import ParallelMap
from biodyn_core.body.subject import Subject, load_subject
from biodyn_ros.base.files import check_keeps_inputs, exists, keep_copy, make_directory, remove, write_text
from biodyn_ros.base.json_files import finite
from biodyn_ros.events.finding import SessionOptions, find_sessions
from biodyn_ros.fit.fitting import FitOptions, fit_bags, write_fitted
from biodyn_ros.fit.report import clock_warnings
from biodyn_ros.fit.summary import summary_of
from biodyn_ros.reading.events_file import FoundSession, load_events, write_events
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.reading.provenance import bag_sha256, sha256_of, source_of
from biodyn_ros.subject.steps import Step, StepLog, key_of
from biodyn_ros.subject.uses import UsedEvents, traced_uses, used_events
from biodyn_ros.trace.tracing import TraceOptions, trace_bags, write_traced
from biodyn_ros.trace.wording import headline
from biodyn_ros.validate.validating import ValidateOptions, validate, write_validated
from biodyn_ros.work.part_store import PartStore
from biodyn_ros.work.tasks import Monitor, Work

EVENTS: Final = "events.yaml"
FITTED: Final = "fitted.yaml"
RESULT: Final = "subject.yaml"
PAGE: Final = "index.html"
LOG: Final = "subject.json"
VALIDATED: Final = "validate"
TRACED: Final = "trace"

Bags = Sequence[str]


@dataclass(frozen=True)
class SubjectOptions:
    """Options of all steps; seed: of dealing, fit and trace; per_case: the most events of a condition that are used."""

    seed: int = 0
    per_case: int = 12
    session: SessionOptions = field(default_factory=SessionOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    validate: ValidateOptions = field(default_factory=ValidateOptions)
    trace: TraceOptions = field(default_factory=TraceOptions)
    report: bool = True


@dataclass(frozen=True)
class Helpers:
    """What the steps work with: executor and parallel map, monitor of progress, and the function for lines to say."""

    executor: Executor | None
    parallel: ParallelMap
    monitor: Monitor
    say: Callable[[str], None]


@dataclass(frozen=True, eq=False)
class MadeSubject:
    """The steps of a directory, and the uses of its events, None without events."""

    name: str
    directory: Path
    steps: Mapping[str, Step]
    used: UsedEvents | None


def make_subject(
    sessions: Bags, given: Subject, directory: Path, options: SubjectOptions, helpers: Helpers
) -> MadeSubject:
    """Run all steps into a directory; a step whose result fits is used again, and one that fails has its reason.

    Raises InputError for sessions that cannot be read, because no further step is possible.
    """
    make_directory(directory)
    steps = _Steps(StepLog(directory / LOG), directory, options, helpers)
    used = steps.events(sessions)
    fitted = steps.fit(used, given)
    steps.validate(used, fitted)
    steps.trace(used, fitted or given)
    steps.result(fitted)
    return MadeSubject(given.name, directory, steps.log.steps, used)


def check_given(directory: Path, given: Path) -> None:
    """Raise InputError for a file of the given subject that a step would replace or remove, before any work."""
    for name in (FITTED, RESULT, f"{TRACED}/{RESULT}"):
        check_keeps_inputs(directory / name, [given])


class _Steps:
    """The steps of one directory, each by the functions of its own command."""

    def __init__(self, log: StepLog, directory: Path, options: SubjectOptions, helpers: Helpers) -> None:
        self.log, self._directory, self._options, self._helpers = log, directory, options, helpers

    def events(self, sessions: Bags) -> UsedEvents:
        """Find the events, or take an edited file of an earlier run, and deal them."""
        o, path = self._options, self._directory / EVENTS
        table = o.session.table
        named = sha256_of([table]) if table is not None and exists(table) else ""
        key = key_of([bag_sha256(bag) for bag in sessions], o.session, named)

        def work() -> dict[str, Any]:
            with self._helpers.monitor("reading sessions") as progress:
                found = find_sessions(sessions, o.session, progress)
            self._keep_changed("events", [path])
            self.log.forget("events")
            write_events(found, path)
            self._page(path.with_suffix(".html"), lambda: _events_page(found))
            rests = sum(len(one.findings.rests) for one in found)
            return {"seconds": sum(one.findings.seconds for one in found), "rests": rests}

        step = self.log.run("events", key, [path], work, editable=True)
        if step.state != "done":
            raise InputError(step.reason)
        self._say(step)
        return used_events(load_events(path), o.per_case, o.seed)

    def fit(self, used: UsedEvents, given: Subject) -> Subject | None:
        """Fit the subject to the events for fitting; None where that is not possible."""
        o, path = self._options, self._directory / FITTED
        how = dataclasses.replace(o.fit, held_out=used.held_out, seed=o.seed)
        key = key_of(_sources(used), given.to_dict(), dataclasses.replace(how, held_out=()))
        checkpoint = self._directory / f"fit.{key[:12]}.checkpoint.json"

        def work() -> dict[str, Any]:
            for other in self._directory.glob("fit.*.checkpoint.json"):
                if other != checkpoint:
                    remove(other)
            work = Work(self._helpers.executor, checkpoint, resume=True, monitor=self._helpers.monitor)
            report = fit_bags(used.fit, given, how, work)
            self._keep_changed("fit", [path])
            self.log.forget("fit")
            write_fitted(report, path)
            work.finish()
            self._page(path.with_name("fitted.fit.html"), lambda: _fit_page(report))
            found = summary_of(report)
            percents = {"fitted_percent": found.fitted_percent, "held_out_percent": found.held_out_percent}
            counts: dict[str, Any] = {"fitted_events": len(found.fitted), "unstable_events": found.unstable}
            counts["clocks"] = list(clock_warnings(report.identification))
            return {name: finite(percent) for name, percent in percents.items()} | counts

        step = self.log.run("fit", key, [path], work)
        self._say(step)
        return load_subject(path) if step.state == "done" else None

    def validate(self, used: UsedEvents, fitted: Subject | None) -> None:
        """Compare the prediction with the measurement in events for reporting."""
        if fitted is None:
            self._say(self.log.skip("validate", "without a fit there is nothing to validate"))
            return
        o, directory = self._options, self._directory / VALIDATED
        key = key_of(fitted.to_dict(), _sources(used), o.validate)

        def work() -> dict[str, Any]:
            self.log.forget("validate")
            return {"events": [self._validated(part, fitted, directory) for part in used.report]}

        self._say(self.log.run("validate", key, [directory] if used.report else [], work))

    def trace(self, used: UsedEvents, subject: Subject) -> None:
        """Search for an effect that is missing in the model."""
        o, directory = self._options, self._directory / TRACED
        how = dataclasses.replace(o.trace, held_out=used.held_out, as_given=True, seed=o.seed)
        key = key_of(_sources(used), subject.to_dict(), dataclasses.replace(how, held_out=()))
        outputs = [directory / "trace.json", directory / RESULT]

        def work() -> dict[str, Any]:
            kept = PartStore(self._directory / f"{TRACED}.kept.json")
            traced = trace_bags(
                used.fit, subject, how, kept, self._helpers.say, self._helpers.parallel, self._helpers.monitor
            )
            self._keep_changed("trace", outputs)
            self.log.forget("trace")
            write_traced(traced, directory, o.report, None if traced.trace.adds else subject.to_yaml())
            return {
                "verdict": traced.trace.verdict,
                "headline": headline(traced.trace),
                "adds": traced.trace.adds,
                "uses": traced_uses(traced),
            }

        self._say(self.log.run("trace", key, outputs, work))

    def result(self, fitted: Subject | None) -> None:
        """Write the resulting subject: traced, else fitted; none without either."""
        traced = self._directory / TRACED / RESULT
        if self.log.steps["trace"].state == "done" and fitted is not None:
            write_text(self._directory / RESULT, traced.read_text(encoding="utf-8"))
        elif fitted is not None:
            write_text(self._directory / RESULT, (self._directory / FITTED).read_text(encoding="utf-8"))
        else:
            remove(self._directory / RESULT)

    def _validated(self, part: BagPart, fitted: Subject, directory: Path) -> dict[str, Any]:
        """One event; an event that cannot be compared has its reason in the place of results."""
        name = part.name or str(part)
        try:
            with self._helpers.monitor(f"validating {name}") as progress:
                found = validate(part, fitted, self._options.validate, progress)
        except InputError as error:
            return {"name": name, "verdict": "not possible", "reason": str(error), "mean_percent": None}
        write_validated(found, directory / name, self._options.report)
        percent = found.validation.mean_nrmse_rms_percent
        return {"name": name, "verdict": found.verdict, "reason": "", "mean_percent": percent}

    def _page(self, path: Path, draw: Callable[[], str]) -> None:
        if self._options.report:
            from biodyn_ros.reports.pages import write_drawn  # an extra of its own

            write_drawn(path, draw)
        else:
            remove(path)

    def _keep_changed(self, name: str, outputs: Sequence[Path]) -> None:
        """Keep a copy of files that somebody has changed since they were written, before they are written again."""
        if self.log.is_as_written(name, outputs):
            return
        for path in outputs:
            if exists(path):
                self._helpers.say(f"{name}: the earlier {path.name} is kept as {keep_copy(path).name}")

    def _say(self, step: Step) -> None:
        how = "used again" if step.again else f"{step.seconds:.0f} s"
        self._helpers.say(f"{step.name}: {step.state}, {step.reason or how}")


def _events_page(found: Sequence[FoundSession]) -> str:
    from biodyn_ros.events.page import events_page  # an extra of its own

    return events_page(found)


def _fit_page(report: Any) -> str:
    from biodyn_ros.fit.page import fit_page  # an extra of its own

    return fit_page(report)


def _sources(used: UsedEvents) -> list[tuple[str, object, str | None, object]]:
    """The events with their content, condition, rest and use, for a key."""
    return [
        (used.uses[str(part)], source_of(part), part.case, (part.rest_bag, part.corrections))
        for part in (*used.fit, *used.held_out)
    ]
