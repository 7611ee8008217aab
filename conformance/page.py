"""The page: all chapters as Markdown, with the number of rows and failures at the top."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from conformance import clock, grid, injury, recordings, start, transients, weightings
from conformance.table import FAIL, Row, Section, cells

CHAPTERS: Final[Mapping[str, Callable[[], Sequence[Section]]]] = {
    "Frequency weightings": weightings.sections,
    "Transients": transients.sections,
    "The start of a record": start.sections,
    "Injury criteria": injury.sections,
    "Recorded pulses": recordings.sections,
    "Clocks": clock.sections,
    "Delay and interpolation": grid.sections,
}

INTROS: Final = {"Frequency weightings": weightings.INTRO}

HEAD: Final = """\
# Conformance

Made by `make conformance`, which ends with an error if a row fails. Do not edit.

Every figure below passes through the complete system: a motion becomes `sensor_msgs/Imu` messages of up to six sensors,
mounted in six ways, in a rosbag2, which `biodyn replay` reads chunk by chunk. The figure is from `exposure.json`, or,
where stated, from `biodyn info --json` or from the frames for `predicted.mcap`. References do not use the tested code:
they are the constants of ISO 8041-1, closed forms and brute force.
"""


def failures(sections: Sequence[Section]) -> list[Row]:
    """The rows that fail."""
    return [row for section in sections for row in section.rows() if not row.passes]


def rendered(chapters: Mapping[str, Sequence[Section]]) -> str:
    """The whole page."""
    every = [section for sections in chapters.values() for section in sections]
    failed = failures(every)
    total = f"**{_count(every)} comparisons, {len(failed)} failures.**"
    contents = [cells("chapter", "comparisons", "failures"), cells("---", "---:", "---:")]
    contents += [cells(name, str(_count(part)), str(len(failures(part)))) for name, part in chapters.items()]
    lines = [HEAD, total, "", *contents, "", *(f"- {FAIL} {row.what}" for row in failed), *([""] if failed else [])]
    for name, sections in chapters.items():
        lines += [f"## {name}", "", *([INTROS[name], ""] if name in INTROS else [])]
        for section in sections:
            lines += section.lines()
    return "\n".join(lines).rstrip() + "\n"


def _count(sections: Sequence[Section]) -> int:
    return sum(len(section.rows()) for section in sections)
