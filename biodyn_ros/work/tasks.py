"""Long work made safe: tasks done wherever an executor does them, each result kept at once, progress with an ETA."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from biodyn_core.identification.identify import Run, Task
from biodyn_ros.base.progress import OnProgress, Progress
from biodyn_ros.work.checkpoint import Checkpoint
from biodyn_ros.work.executors import as_done, result_of

Monitor = Callable[[str], AbstractContextManager[OnProgress]]


@dataclass(frozen=True)
class Work:
    """Where tasks are done, and the file that keeps their results.

    watch(what) is shown how far each stage is, in effort done of effort in all. Numbers do not depend on the executor.
    """

    executor: Executor | None = None
    checkpoint: Path | None = None
    resume: bool = False
    watch: Monitor = Progress

    def run(self, problem: str) -> Run:
        """What does the tasks of this problem; raises InputError as `Checkpoint`."""
        kept = Checkpoint(self.checkpoint, problem, self.resume) if self.checkpoint else None
        done: dict[str, Any] = dict(kept.done) if kept else {}

        def run(tasks: Sequence[Task]) -> list[Any]:
            self._do(tasks, done, kept)
            return [done[task.name] for task in tasks]

        return run

    def finish(self) -> None:
        """Remove the checkpoint, once the results are written elsewhere."""
        if self.checkpoint:
            self.checkpoint.unlink(missing_ok=True)

    def _do(self, tasks: Sequence[Task], done: dict[str, Any], kept: Checkpoint | None) -> None:
        """Add to `done` what is not there, and keep it."""
        by_name = {task.name: task for task in tasks}
        waiting = [task for task in by_name.values() if task.name not in done]
        if not waiting:
            return
        # A stage of its own for each call: a refinement takes longer than a search by far.
        with self.watch(waiting[0].name.split()[0]) as progress:
            told = _Told(progress, by_name, done)
            calls = [(task.function, task.arguments) for task in waiting]
            for number, future in as_done(self.executor, calls):
                name = waiting[number].name
                done[name] = result_of(future, name)
                if kept:
                    kept.add(name, done[name])
                told.now(done)


class _Told:
    """Tells how much of the effort of tasks is done: that of each is its number of cases, which come first in all."""

    def __init__(self, progress: OnProgress, tasks: Mapping[str, Task], done: Mapping[str, Any]) -> None:
        self._progress = progress
        self._effort = {name: len(task.arguments[0]) for name, task in tasks.items()}
        self.now(done)

    def now(self, done: Mapping[str, Any]) -> None:
        self._progress(sum(n for name, n in self._effort.items() if name in done), sum(self._effort.values()))
