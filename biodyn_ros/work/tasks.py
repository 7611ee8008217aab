"""Tasks on an executor: every result is stored at once, and progress is reported."""

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
    """The executor of tasks and the checkpoint file of their results.

    monitor(stage) receives the progress of each stage as effort done of total effort. Results do not depend on the
    executor.
    """

    executor: Executor | None = None
    checkpoint: Path | None = None
    resume: bool = False
    monitor: Monitor = Progress

    def run(self, problem: str) -> Run:
        """A function that runs tasks of this problem; raises InputError as `Checkpoint`."""
        checkpoint = Checkpoint(self.checkpoint, problem, self.resume) if self.checkpoint else None
        done: dict[str, Any] = dict(checkpoint.done) if checkpoint else {}

        def run(tasks: Sequence[Task]) -> list[Any]:
            self._run_waiting(tasks, done, checkpoint)
            return [done[task.name] for task in tasks]

        return run

    def finish(self) -> None:
        """Remove the checkpoint, once the results are written elsewhere."""
        if self.checkpoint:
            self.checkpoint.unlink(missing_ok=True)

    def _run_waiting(self, tasks: Sequence[Task], done: dict[str, Any], checkpoint: Checkpoint | None) -> None:
        """Run the tasks that are not in `done`, and add and store their results."""
        by_name = {task.name: task for task in tasks}
        waiting = [task for task in by_name.values() if task.name not in done]
        if not waiting:
            return
        # One stage per call: a refinement takes much longer than a search.
        with self.monitor(waiting[0].name.split()[0]) as progress:
            effort = _Effort(progress, by_name, done)
            calls = [(task.function, task.arguments) for task in waiting]
            for number, future in as_done(self.executor, calls):
                name = waiting[number].name
                done[name] = result_of(future, name)
                if checkpoint:
                    checkpoint.add(name, done[name])
                effort.report(done)


class _Effort:
    """Reports the effort of finished tasks; that of a task is its number of cases, its first argument."""

    def __init__(self, progress: OnProgress, tasks: Mapping[str, Task], done: Mapping[str, Any]) -> None:
        self._progress = progress
        self._effort = {name: len(task.arguments[0]) for name, task in tasks.items()}
        self.report(done)

    def report(self, done: Mapping[str, Any]) -> None:
        self._progress(sum(n for name, n in self._effort.items() if name in done), sum(self._effort.values()))
