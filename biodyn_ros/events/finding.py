"""Find the events of a session: read its bag once, and name the loading conditions as requested.

Only the first minute is read twice, for gravity.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean_file
from biodyn_core.conditioning.gravity import Gravity, of_session
from biodyn_core.conditioning.tilt import Vector
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_core.sessions.cases import CaseSpan, named, unused, with_cases
from biodyn_core.sessions.findings import Findings, Rest
from biodyn_core.sessions.session import Session
from biodyn_core.sessions.settings import SessionSettings
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.base.wording import DOES_NOT_FIT, FITS_AGAIN
from biodyn_ros.events.refusals import check_sessions
from biodyn_ros.reading.events_file import FoundSession
from biodyn_ros.reading.gravity import gravity_of
from biodyn_ros.reading.marks import Mark
from biodyn_ros.reading.parts import part_of
from biodyn_ros.reading.provenance import bag_sha256
from biodyn_ros.reading.sensors import ReadingOptions, SensorReading, check_seat, open_sensors

BY_SEAT: Final = "seat"
BY_MARKS: Final = "marks"

COLUMNS: Final = ("start", "end", "case")

FIRST_S: Final = 60.0

NO_REST: Final = (
    "no rest in the session: the gravity of its events is the mean over motion, and tilts by as much as the vehicle"
    " accelerates: stand still for some seconds when you record"
)

END_MARK: Final = "end"
"""A mark of this name ends a loading condition; so does the next mark."""


@dataclass(frozen=True)
class SessionOptions(ReadingOptions):
    """Options for reading a session and finding its events.

    cases: `seat` to name loading conditions by what the seat did, `marks` by the marks of the bag, or a table's path.
    allowed: names of `REFUSALS` that do not stop the search.
    """

    vertical: str = ""
    session: SessionSettings = field(default_factory=SessionSettings)
    cases: str = BY_SEAT
    allowed: tuple[str, ...] = ()

    @property
    def table(self) -> Path | None:
        """The table that names loading conditions, None without one."""
        return None if self.cases in (BY_SEAT, BY_MARKS) else Path(self.cases)

    def verticals(self) -> dict[str, Vector]:
        """The given verticals by sensor; raises InputError for an invalid one."""
        return PipelineSettings(vertical=self.vertical).verticals()


def find_events(
    bag: str | Path, options: SessionOptions | None = None, progress: OnProgress = ignore_progress
) -> FoundSession:
    """Find the events of a session; raises InputError for a bag without a usable seat, or without events."""
    o = options or SessionOptions()
    found = _found_in(bag, o, progress)
    _check_events([found], o.session)
    return found


def _found_in(bag: str | Path, o: SessionOptions, progress: OnProgress) -> FoundSession:
    """The findings of a session, which may be at rest throughout."""
    if not part_of(bag).is_whole:
        raise InputError(f"{bag}: events are found in whole bags; their parts are named in the events file")
    spans = [] if o.table is None else read_spans(o.table)
    verticals = o.verticals()
    with open_sensors(bag, o) as sensors:
        epoch_ns, _ = sensors.first_of_seat()
        gravity = _at_begin(sensors, verticals)
        session = Session(epoch_ns, sensors.conditioning, o.session, verticals, gravity)
        try:
            for sensor, block in sensors.blocks(progress):
                session.push(sensor, block.stamps_ns, block.accel_mps2)
        except InputError as error:
            raise InputError(f"{bag}: {error}") from None
        findings, warnings, marks = session.finish(), sensors.bag_warnings(), sensors.marks()
        present = sensors.times
    check_seat(findings.statuses["seat"], str(bag))
    if o.cases == BY_MARKS and findings.events:
        spans = spans_of(marks, findings.seconds, bag)
        warnings += [
            f"the mark {mark.name!r} at {mark.time_s:.1f} s has no letter or digit: it names no condition"
            for mark in marks
            if not _case_name(mark.name)
        ]
    if o.table is not None:
        why = f"a session of {findings.seconds:.0f} s; start and end are seconds after its first sample"
        warnings += [f"{o.table}: {_row(span)} has no event in {why}" for span in unused(findings.events, spans)]
    warnings = [*warnings, *sensors.clock_warnings(findings.seconds)]
    missing = [name for name in findings.statuses if name not in present]
    shown = tuple(line for line in findings.warnings if line.partition(":")[0] not in missing)
    absent = tuple(f"{name}: not in the bag" for name in missing)
    if not findings.rests:
        absent = (*absent, NO_REST)
    findings = replace(findings, events=with_cases(findings.events, spans), warnings=(*absent, *shown))
    return FoundSession(Path(bag), bag_sha256(bag), findings, tuple(warnings), epoch_ns, mapping=o.mapping, time=o.time)


def _at_begin(sensors: SensorReading, verticals: Mapping[str, Vector]) -> dict[str, Gravity]:
    """The gravity of sensors in the first minute, so that conditioning begins with the first sample.

    Without a rest there it is the mean over motion: good enough to find events, whose own gravity is that of a rest.
    """
    found = gravity_of(sensors, verticals, FIRST_S)
    return {sensor: replace(of_session(gravity), origin="session") for sensor, gravity in found.items()}


def find_sessions(bags: Sequence[str | Path], options: SessionOptions, progress: OnProgress) -> list[FoundSession]:
    """Find the events of sessions, with a name of its own for each event.

    Raises InputError for a bag given twice, a table for several sessions, sessions without any event, and those that
    `check_sessions` refuses.
    """
    if options.table is not None and len(bags) > 1:
        raise InputError(
            f"{options.table}: its times are of one session, {len(bags)} are given: run biodyn events once per session,"
            " or name the conditions by marks (--cases marks)"
        )
    found: list[FoundSession] = []
    for number, bag in enumerate(bags):
        one = _found_in(bag, options, lambda done, total, at=number: progress(at * total + done, len(bags) * total))
        if same := next((other.bag for other in found if other.sha256 == one.sha256), None):
            raise InputError(f"{bag}: the same recording as {same}; give it once")
        found.append(one)
    _check_events(found, options.session)
    names = iter(named([event for one in found for event in one.findings.events]))
    sessions = [
        replace(
            one, findings=replace(one.findings, events=tuple(next(names) for _ in one.findings.events)),
            warnings=(*one.warnings, *_seams(one, found)), borrowed=_nearest_rest(one, found),
        )
        for one in found
    ]  # fmt: skip
    check_sessions(sessions, options.allowed)
    return sessions


def _check_events(sessions: Sequence[FoundSession], settings: SessionSettings) -> None:
    """Raise InputError for sessions without any event; one of several may give its rest alone."""
    if not any(one.findings.events for one in sessions):
        raise InputError(f"{sessions[0].bag}: {_why_none(sessions[0].findings, settings)}")


def _seams(one: FoundSession, others: Sequence[FoundSession]) -> list[str]:
    """A line for each other session that overlaps this one in time: one of the clocks is not the time of day."""
    return [
        f"its stamps overlap those of {other.bag} in time: they are taken as recordings with other clocks"
        for other in others
        if other is not one and _from(one, other.begin_ns, other.begin_ns + round(1e9 * other.findings.seconds)) == 0
    ]


def _nearest_rest(one: FoundSession, others: Sequence[FoundSession]) -> tuple[Path, Rest] | None:
    """The rest of another session that is nearest in time, for a session without rests."""
    if one.findings.rests:
        return None
    rests = [(other, rest) for other in others for rest in other.findings.rests]
    if not rests:
        return None

    def away_ns(each: tuple[FoundSession, Rest]) -> int:
        other, rest = each
        return _from(one, *(other.begin_ns + round(1e9 * at_s) for at_s in (rest.begin_s, rest.end_s)))

    other, rest = min(rests, key=away_ns)
    return other.bag, rest


def _from(one: FoundSession, begin_ns: int, end_ns: int) -> int:
    """The time from a session to a stretch, ns; 0 if they overlap."""
    return max(begin_ns - one.begin_ns - round(1e9 * one.findings.seconds), one.begin_ns - end_ns, 0)


def spans_of(marks: Sequence[Mark], seconds: float, bag: str | Path = "") -> list[CaseSpan]:
    """The loading condition from each mark to the next one; raises InputError without any mark.

    Marks that the live node has set itself, about segments that the model does not fit, name none; nor do those without
    a letter or digit.
    """
    marks = [mark for mark in marks if _case_name(mark.name) and not mark.name.endswith((DOES_NOT_FIT, FITS_AGAIN))]
    if not marks:
        raise InputError(f"{bag}: has no marks: name conditions by the seat, or with a table (--cases FILE)")
    ends_s = [*(mark.time_s for mark in marks[1:]), seconds]
    return [
        CaseSpan(mark.time_s, end_s, _case_name(mark.name))
        for mark, end_s in zip(marks, ends_s, strict=True)
        if _case_name(mark.name) != END_MARK
    ]


def read_spans(path: Path) -> list[CaseSpan]:
    """The loading conditions of a table with the columns start, end and case, seconds; raises InputError naming it."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a table ({error}){did_you_mean_file(path)}") from None
    lines = text.lstrip().splitlines()
    table = csv.DictReader(lines, skipinitialspace=True, strict=True)
    blank = len(text.splitlines()) - len(lines)
    try:
        table.fieldnames = [name.strip().lower() for name in table.fieldnames or ()]
        if twice := next((name for name in COLUMNS if table.fieldnames.count(name) > 1), None):
            raise InputError(f"{path}: the column {twice} is given twice")
        # Blank lines are no rows: the number of a line is known to the inner reader only.
        spans = [_span(row, f"{path}: line {blank + table.reader.line_num}") for row in table]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as a table ({error}): is a quote not closed?") from None
    if not spans:
        raise InputError(f"{path}: it has no rows: give {', '.join(COLUMNS)} in each, or omit --cases")
    for one, other in pairwise(sorted(spans, key=lambda span: span.begin_s)):
        if other.begin_s < one.end_s:
            raise InputError(f"{path}: {_row(one)} and {_row(other)} overlap: end the first by {other.begin_s:g} s")
    return spans


def _row(span: CaseSpan) -> str:
    return f"{span.case} from {span.begin_s:g} to {span.end_s:g} s"


def _span(row: Mapping[str | None, Any], where: str) -> CaseSpan:
    if any(cell.strip() for cell in row.get(None, ())):  # a decimal comma would make the case a number
        raise InputError(f"{where}: more cells than columns: write decimal points, and quote a case that has a comma")
    start, end, case = (row.get(name) for name in COLUMNS)
    if start is None or end is None or not case:
        raise InputError(f"{where}: the columns {', '.join(COLUMNS)} are needed, separated by commas")
    try:
        begin_s, end_s = float(start), float(end)
    except ValueError:
        raise InputError(f"{where}: start and end are seconds, not {start!r} and {end!r}") from None
    if not begin_s < end_s:
        raise InputError(f"{where}: the end, {end_s:g} s, is not after the start, {begin_s:g} s")
    if not _case_name(case):
        raise InputError(f"{where}: the case {case!r} has no letter or digit")
    return CaseSpan(begin_s, end_s, _case_name(case))


def _case_name(text: str) -> str:
    """A name as a loading condition: lower case, words joined by underscores."""
    return re.sub(r"[^\w]+", "_", text.strip().lower()).strip("_")


def _why_none(findings: Findings, settings: SessionSettings) -> str:
    """Why a session has no events, and the remedy, in one line."""
    rested_s = float(np.sum([rest.end_s - rest.begin_s for rest in findings.rests]))
    return (
        f"no event in {findings.seconds:.1f} s, {rested_s:.1f} s of them at rest: an event is a shock of"
        f" {settings.shock_g:g} g, or {settings.steady_least_s:g} s of motion with {settings.steady_level_mps2:g} m/s^2"
        " rms: record longer, or change these settings (biodyn events --help-all)"
    )
