"""Given bags: what a command line names as bags: bags, parts of bags, and events files."""

from __future__ import annotations

from collections.abc import Sequence

from biodyn_ros.reading.events_file import is_events_file, load_events
from biodyn_ros.reading.parts import Bag, part_of


def bags_of(given: Sequence[str]) -> list[Bag]:
    """The bags and parts that are named, those of an events file in its order; raises InputError as `load_events`."""
    found: list[Bag] = []
    for text in given:
        if is_events_file(text):
            found += load_events(text)
        else:
            part = part_of(text)
            found.append(str(part) if part.is_whole else part)
    return found
