"""`python -m blind levels FOLDER`: what louder motion lifts in the records of a finished run of the blind study.

Each record of a condition is recorded again: the same body, background, effect, sensors and events, with the motion of
the seat multiplied. Both are answered by the model of the package, and by the ceiling's as if the catalogue had the
true law. All records of the condition take part, also those that are named without it, so no selection favours the
second recording.

Known limit: the answers to the record as it was are those of the run. There the refit without the effect starts from a
fit, here from the true theta, and the noise of the sensors is drawn anew.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from world.effects import sitting
from world.effects.draw import SCORING
from world.effects.sitting import TOGETHER, Sitting

from biodyn_core.tracing import louder as published
from biodyn_core.tracing.evidence import Evidence
from biodyn_core.tracing.findings import LouderRecordings
from biodyn_core.tracing.louder import louder_text
from biodyn_core.tracing.probability import LearnedModel, packaged, probabilities
from biodyn_ros.work.executors import as_done, executor_of, result_of
from blind.requirements import has_recordings
from blind.tracing.__main__ import commit
from blind.tracing.ceiling import decision_with_true_laws
from blind.tracing.ledger import answer_lines
from blind.tracing.outcome import Answer, Cause, Outcome, Score
from blind.tracing.records import causes, sittings
from blind.tracing.rows import CONDITIONS, DRAWINGS, SURE, Drawing
from blind.tracing.shares import share_text
from blind.tracing.study import PLAN, PROCESSES, SCORES, BrokenSeal
from blind.training.draw import is_used
from blind.training.traced import traced

PUBLISHED: Final = Path(published.__file__).with_name(published.FILE)
WITH_CEILINGS: Final = tuple(one.name for one in CONDITIONS if any(rule.what == "class" for rule in one.rules))


@dataclass(frozen=True)
class Louder:
    """The louder record: its row and number, the true mechanism, and its ratio, None where it has no answer.

    named, in_set: whether the model of the package names the mechanism, and has it in its 90 % set; by_ceiling: the
    same of the ceiling. before: these four of the record as it was.
    """

    row: str
    number: int
    mechanism: str
    ratio: float | None
    named: bool
    in_set: bool
    named_by_ceiling: bool
    in_set_by_ceiling: bool
    before: tuple[bool, bool, bool, bool]

    @property
    def after(self) -> tuple[bool, bool, bool, bool]:
        """The four results of the louder record."""
        return self.named, self.in_set, self.named_by_ceiling, self.in_set_by_ceiling


def outcomes(folder: Path) -> list[Outcome]:
    """The answers of a run with their scores."""
    answers = {(one.row, one.number): one for one in map(Answer.of, answer_lines(folder))}
    lines = (folder / SCORES).read_text(encoding="utf-8").splitlines()
    return [Outcome(answers[one.row, one.number], one) for one in map(Score.of, lines)]


def louder(one: Sitting, road: float, shocks: float) -> Sitting:
    """A sitting with so many times the motion of the seat on roads and in shocks, not yet simulated.

    It has the events that the verdict of the study comes from, without those that only report.
    """
    events = tuple(
        dataclasses.replace(each, event=each.event.at_level(road if each.event.case == "road" else shocks))
        for each in filter(is_used, one.events)
    )
    return dataclasses.replace(one, events=events)


def results(drawing: Drawing, before: Sequence[Outcome], seed: int, road: float, shocks: float) -> list[Louder]:
    """The louder records of some outcomes of one row."""
    drawn = sittings(drawing, [one.answer.number for one in before], seed, SCORING)
    again = sitting.together([louder(one, road, shocks) for one in drawn])
    return [_result(was, one) for was, one in zip(before, again, strict=True)]


def _result(was: Outcome, one: Sitting) -> Louder:
    (cause,) = causes(one.effects)
    found = traced(one, cause)
    evidence = (found.evidence, found.with_true_law) if found else (None, None)
    models = (packaged(), decision_with_true_laws())
    after = [result for each, model in zip(evidence, models, strict=True) for result in _named(each, model, cause)]
    before = (was.class_right, was.in_set, was.named_with_true_law(SURE), was.in_set_with_true_law)
    ratio = found.ratio if found else None
    return Louder(was.answer.row, was.answer.number, cause.mechanism, ratio, *after, before=tuple(map(bool, before)))


def _named(evidence: Evidence | None, model: LearnedModel, cause: Cause) -> tuple[bool, bool]:
    """Whether a model names the mechanism of a cause, and whether it is in its 90 % set; neither without evidence."""
    if evidence is None:
        return False, False
    found = probabilities(evidence, model)
    best, p = next(iter(found.of_answers.items()))
    return best == cause.mechanism and p >= SURE, cause.mechanism in found.likely


def by_mechanism(found: Sequence[Louder], level: float) -> list[LouderRecordings]:
    """The counts of each mechanism."""
    mine = {name: [one for one in found if one.mechanism == name] for name in sorted({one.mechanism for one in found})}
    return [
        LouderRecordings(
            name, level, len(some),
            named=sum(one.before[0] for one in some), named_louder=sum(one.named for one in some),
            with_true_law=sum(one.before[2] for one in some),
            with_true_law_louder=sum(one.named_by_ceiling for one in some),
        )
        for name, some in mine.items()
    ]  # fmt: skip


def table(found: Sequence[Louder]) -> str:
    """The shares of both recordings, of all records and by mechanism."""
    lines = ["| | as it was | louder |", "| --- | --- | --- |"]
    for column, words in enumerate(("named", "in the 90 % set", "named by the ceiling", "in its 90 % set")):
        counts = (sum(of[column] for of in side) for side in ([o.before for o in found], [o.after for o in found]))
        lines.append(f"| {words} | {' | '.join(share_text(count, len(found)) for count in counts)} |")
    for name in sorted({one.mechanism for one in found}):
        mine = [one for one in found if one.mechanism == name]
        was, now = (sum(side) for side in ([o.before[2] for o in mine], [o.named_by_ceiling for o in mine]))
        lines.append(f"| {name}: named by the ceiling | {was} of {len(mine)} | {now} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each record as it is ready, then the table."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.publish and options.road != options.shocks:
        parser.error("--publish needs one level for roads and shocks")
    if not (options.folder / PLAN).is_file():
        parser.error(f"{options.folder} is no folder of a run: it has no {PLAN}")
    if not has_recordings():
        return 2
    seed = json.loads((options.folder / PLAN).read_text(encoding="utf-8"))["seed"]
    (condition,) = (one for one in CONDITIONS if one.name == options.condition)
    about = json.dumps({"run": seed, "condition": condition.name, "road": options.road, "shocks": options.shocks})
    try:
        done = list(_stored(options.out, about))
    except BrokenSeal as error:
        parser.error(str(error))
    known = {(one.row, one.number) for one in done}
    chosen = [
        one for one in condition.chosen(outcomes(options.folder)) if (one.answer.row, one.answer.number) not in known
    ]
    calls = [
        (results, (drawing, some, seed, options.road, options.shocks))
        for drawing in DRAWINGS
        for some in _groups([one for one in chosen if one.answer.row == drawing.name])
    ]
    with executor_of(f"processes:{PROCESSES}") as executor:
        for number, future in as_done(executor, calls):
            found = result_of(future, f"group {number}")
            done += found
            lines = "".join(json.dumps(asdict(one)) + "\n" for one in found)
            print(lines, end="", flush=True)
            _store(options.out, about, lines)
    print(table(done))
    if options.publish:
        today = dt.datetime.now(dt.timezone.utc).date().isoformat()
        origin = {"run": seed, "condition": condition.name, "date": today, "commit": commit()}
        PUBLISHED.write_text(louder_text(by_mechanism(done, options.road), options.road, origin), encoding="utf-8")
    return 0


def _groups(found: Sequence[Outcome]) -> Iterator[list[Outcome]]:
    """Records whose numbers are close to each other, because all between are drawn."""
    group: list[Outcome] = []
    for one in sorted(found, key=lambda outcome: outcome.answer.number):
        if group and one.answer.number - group[0].answer.number >= TOGETHER:
            yield group
            group = []
        group.append(one)
    if group:
        yield group


def _stored(path: Path | None, about: str) -> Iterator[Louder]:
    """Results of an interrupted command; raises BrokenSeal for those of another one."""
    if path is None or not path.exists():
        return
    first, *lines = path.read_text(encoding="utf-8").splitlines()
    if first != about:
        raise BrokenSeal(f"{path} has the results of {first}, not of {about}; take another file")
    for line in lines:
        data: Mapping[str, Any] = json.loads(line)
        yield Louder(**{**data, "before": tuple(data["before"])})


def _store(path: Path | None, about: str, lines: str) -> None:
    if path is not None:
        begin = "" if path.exists() else f"{about}\n"
        with path.open("a", encoding="utf-8") as file:
            file.write(begin + lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m blind levels", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of a finished run")
    parser.add_argument(
        "--condition", choices=WITH_CEILINGS, default="with background, ratio 0.4 to 0.8",
        help="row of the marks (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--road", type=float, default=1.5, help="multiple of the motion on roads (default: 1.5)")
    parser.add_argument("--shocks", type=float, default=1.5, help="multiple of the motion of shocks (default: 1.5)")
    parser.add_argument("--out", type=Path, help="file of results, continued if it exists")
    parser.add_argument("--publish", action="store_true", help="write the counts by mechanism into the package")
    return parser
