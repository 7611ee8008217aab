"""Work for other processes to do, in a module that imports fast there."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import Counter
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import LOWER, UPPER
from biodyn_core.identification.identify import Task
from biodyn_core.identification.phase1 import Search
from biodyn_ros.fit.campaign_file import Entry
from biodyn_ros.fit.campaign_results import SubjectFit
from biodyn_ros.fit.fitting import FitOptions
from biodyn_ros.work.executors import executor_of
from biodyn_ros.work.tasks import Work

if TYPE_CHECKING:
    from biodyn_ros.subject.people import Person  # the other work does not need all that it imports

NAMES = ("search a", "search b", "search c", "search d")
PROBLEM = "the four letters"


def found(seed: int) -> Search:
    """The result of a search."""
    share = np.random.default_rng(seed).random((2, 13))
    return Search(LOWER[:13] + (UPPER - LOWER)[:13] * share, np.array([0.1, 1.0 / 3.0]), seed, Counter(infinite=seed))


def search(cases: list[str], seed: int, journal: Path) -> Search:
    """A search that writes down that it was done, and gets stuck on "c" as long as there is a file `stuck`."""
    if cases == ["c"] and (journal / "stuck").exists():
        (journal / "pid.part").write_text(str(os.getpid()))
        (journal / "pid.part").rename(journal / "pid")
        time.sleep(600)
    with (journal / "done").open("a") as file:
        file.write(f"search {cases[0]}\n")
    return found(seed)


def searches(journal: Path) -> list[Task]:
    """Four tasks, the first of them twice."""
    tasks = [Task(name, search, ([name[-1]], number, journal)) for number, name in enumerate(NAMES)]
    return [*tasks, tasks[0]]


def refuse(cases: list[str]) -> Search:
    """A search that refuses its input."""
    raise InputError(f"{cases[0]}: not this one")


def die(cases: list[str]) -> Search:
    """A search that ends its process."""
    os._exit(3)


def lose(cases: list[str]) -> Search:
    """A search with the error of a process that has ended, without ending this one."""
    raise BrokenExecutor


def counted(shared: list[str], item: str) -> tuple[str, int]:
    """The item, and the number of items that this copy of the shared list has received."""
    shared.append(item)
    return item, len(shared)


def die_at_c(shared: str, item: str) -> str:
    """Both texts; the item "c" ends its process."""
    return os._exit(3) if item == "c" else shared + item


def fit_or_die(entry: Entry, options: FitOptions, draw: bool) -> SubjectFit:
    """The result of a fit; the fit of Ben ends its process."""
    if entry.name == "ben":
        os._exit(3)
    return fitted(entry)


def fitted(entry: Entry) -> SubjectFit:
    """The result of a fit."""
    document = {"seconds": 1.0, "cases": [{"joint": {"mean": 2.0}}]}
    return SubjectFit(f"{entry.name} 0", document, entry.subject.to_yaml(), 1.0, 2.0)


def make_or_die_once(person: Person, directory: Path, options: object) -> dict[str, object]:
    """In the place of `make_person`; the first worker of Ben is killed while it works."""
    directory.mkdir(exist_ok=True)
    mark = directory.parent / "died"
    if person.name == "ben" and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    (directory / "made").write_text(person.name)
    return {"steps": [], "uses": {}}


def main() -> int:
    """Do the four tasks in two processes, as the command line does."""
    journal = Path(sys.argv[1])
    try:
        with executor_of("processes:2") as executor:
            Work(executor, journal / "checkpoint.json").run(PROBLEM)(searches(journal))
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
