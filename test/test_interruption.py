"""An interruption before any line of the code that opens or writes a result leaves no half-written file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from streams import subject

from biodyn_ros.bag.cdr import IMU_TYPE
from biodyn_ros.bag.writer import BagWriter
from biodyn_ros.base import files
from biodyn_ros.base.resources import bag_file
from biodyn_ros.replay import replaying
from biodyn_ros.replay.replaying import replay_to_directory


@contextmanager
def interrupted_before_line(number: int, codes: tuple[CodeType, ...]) -> Iterator[None]:
    """Raise KeyboardInterrupt before the given line of those that the functions run, counted from 0."""
    left = number

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal left
        if frame.f_code not in codes:
            return None
        if event == "line":
            left -= 1
            if left == -1:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


def interruptions(run: Callable[[], Any], directory: Path, codes: tuple[CodeType, ...]) -> int:
    """Interrupt `run` before each of its lines in turn, until one run is whole; return the number of interruptions."""
    for number in range(500):
        try:
            with interrupted_before_line(number, codes):
                run()
        except KeyboardInterrupt:
            half_written = [path for path in directory.rglob("*") if path.suffix == ".part"]
            assert not half_written, f"line {number}"
        else:
            return number
    raise AssertionError("the run does not become whole")


def codes_of(*functions: Callable[..., Any]) -> tuple[CodeType, ...]:
    return tuple(function.__code__ for function in functions)


@pytest.mark.parametrize("name", ["a", "a.mcap"])
def test_a_bag(tmp_path: Path, name: str) -> None:
    def write() -> None:
        with BagWriter(tmp_path / name) as writer:
            writer.add_topic("/head", IMU_TYPE)

    opening = (BagWriter.__init__, BagWriter.__enter__, BagWriter._open, BagWriter._put, BagWriter._append)
    assert interruptions(write, tmp_path, codes_of(*opening, BagWriter.add_topic)) > 30


def test_the_bag_of_a_replay(tmp_path: Path) -> None:
    codes = codes_of(replaying._PredictedBag._begin, BagWriter.__enter__, BagWriter._open)
    bag, person = bag_file("subject_1.mcap"), subject()

    def run() -> None:
        assert not (tmp_path / "new").exists()  # the interruption before removed the new directories
        replay_to_directory(bag, person, tmp_path / "new" / "out", report=False)

    assert interruptions(run, tmp_path, codes) > 20


# The trace function may raise before the line that closes a file, where Python itself does not.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_text_file_and_a_copy(tmp_path: Path) -> None:
    path = tmp_path / "text.yaml"
    assert interruptions(lambda: files.write_text(path, "new"), tmp_path, codes_of(files.write_text)) >= 5
    assert interruptions(lambda: files.keep_copy(path), tmp_path, codes_of(files.keep_copy)) >= 5
