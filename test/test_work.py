"""Long work is safe: it can be done anywhere, be interrupted and taken up, and no file makes it go wrong."""

import contextlib
import dataclasses
import io
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from functools import cache
from pathlib import Path
from unittest import mock

import chores
import fitting
import numpy as np
import pytest
from expecting import refusal, until
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from biodyn_core.base.errors import InputError
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import LOWER, UPPER
from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.identify import Task, fingerprint, identify
from biodyn_core.identification.phase1 import Search, SwarmSettings
from biodyn_core.identification.phase2 import Refined
from biodyn_core.identification.settings import FitSettings
from biodyn_core.tracing import rounds
from biodyn_core.tracing.screen import all_candidates
from biodyn_core.tracing.settings import BASE, FloorSettings, TraceSettings
from biodyn_core.tracing.surface import HAT
from biodyn_core.tracing.trace import trace
from biodyn_ros.base.environment import ONE_THREAD
from biodyn_ros.base.json_files import MAX_BYTES
from biodyn_ros.base.progress import Progress
from biodyn_ros.trace.document import trace_document
from biodyn_ros.trace.report import Report
from biodyn_ros.work import executors
from biodyn_ros.work.checkpoint import Checkpoint, decoded, encoded
from biodyn_ros.work.executor_map import parallel_map
from biodyn_ros.work.executors import as_done, executor_of, result_of
from biodyn_ros.work.tasks import Work

QUICK = FitSettings(swarm=SwarmSettings(particles=8, iterations=6, starts=2), evaluations=40, refined_starts=1)
CLUSTER_WORKERS = 1
SUBJECT = fitting.drawn(1, "segment")


@cache
def cases():
    """Two noisy ones to fit, and three of the same conditions to hold out."""
    rng, found = np.random.default_rng(7), []
    for number, name in enumerate(("road", "pothole", "road", "road", "pothole")):
        seat = fitting.seat_motion(name, 3.2, number)
        accel = Chain.of(SUBJECT).simulate(seat, fitting.RATE_HZ).accel_mps2
        case = fitting.ready(seat, accel + 0.1 * rng.standard_normal(accel.shape), name)
        found.append(dataclasses.replace(case, name=f"{name} {number}"))
    return tuple(found)


def identified(run):
    """A small identification, and everything in it that is a number."""
    found = identify(cases()[:2], SUBJECT, 5, QUICK, run)
    refined = [fit.refined for fit in (*found.fits, found.joint, found.other)] + [r.refined for r in found.refiners]
    return [encoded(result) for result in (*found.searches, *refined)]


@pytest.fixture(scope="module")
def reference():
    """The results of all tasks in this process, in sequence."""
    return identified(Work().run("-"))


@pytest.fixture(scope="module")
def processes():
    """Two processes for all tests that need some."""
    with executor_of("processes:2") as executor:
        yield executor


# --- where it is done ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["none", "threads:2"])
def test_numbers_are_the_same_for_every_executor(reference, text: str) -> None:
    with executor_of(text) as executor:
        assert identified(Work(executor).run("-")) == reference


def test_numbers_are_the_same_on_two_processes(reference, processes) -> None:
    assert identified(Work(processes).run("-")) == reference
    for name, value in ONE_THREAD.items():
        assert processes.submit(os.getenv, name).result() == value


def test_numbers_are_the_same_on_a_cluster(reference, cluster: str) -> None:
    with executor_of(cluster) as executor:
        assert identified(Work(executor).run("-")) == reference
        with pytest.raises(InputError, match=r"^x: not this one$"):
            Work(executor).run("-")([Task("search x", chores.refuse, (["x"],))])


def test_an_incompatible_cluster_is_one_line(cluster: str, monkeypatch) -> None:
    monkeypatch.setattr(executors, "__version__", "99.0")
    with pytest.raises(InputError, match=r"^tcp://.*: worker tcp://.* has biodyn .*, here is 99.0; make them equal$"):
        enter(cluster)


def test_an_unreachable_cluster_is_one_line(monkeypatch) -> None:
    pytest.importorskip("distributed")
    text = "tcp://127.0.0.1:9"
    monkeypatch.setattr(executors, "CLUSTER_TIMEOUT_S", 0.3)
    with pytest.raises(InputError, match="no Dask scheduler responds there") as caught:
        enter(text)
    assert str(caught.value).startswith(f"{text}: ") and "\n" not in str(caught.value)


def test_missing_dask_is_one_line(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"Dask is not installed; pip install 'biodyn_ros\[cluster\]'"):
        enter("tcp://127.0.0.1:8786")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "process",
        "None",
        "none:2",
        "processes:",
        "processes:0",
        "processes:-1",
        "threads:2000",
        "processes:²",
        "tcp:",
        "tcp://host",
        "tcp://:1",
        "tcp://host:x",
        "tls://host:65536",
        "http://host:80",
    ],
)
def test_an_unknown_executor_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"^executor '.*': expected"):
        enter(text)


def enter(text: str) -> None:
    """Begin and end with an executor."""
    with executor_of(text):
        pass


def test_an_input_error_of_a_worker_is_raised_unchanged(processes, tmp_path: Path) -> None:
    kept = tmp_path / "kept.json"
    tasks = [*chores.searches(tmp_path), Task("search x", chores.refuse, (["x"],))]
    with pytest.raises(InputError, match=r"^x: not this one$"):
        Work(processes, kept).run(chores.PROBLEM)(tasks)
    assert set(Checkpoint(kept, chores.PROBLEM, resume=True).done) <= set(chores.NAMES)


def test_a_killed_worker_affects_no_other_task(processes, tmp_path: Path) -> None:
    calls = [(chores.die, (["x"],)), *((task.function, task.arguments) for task in chores.searches(tmp_path))]
    done = dict(as_done(processes, calls))
    assert len(done) == len(calls) and [n for n, future in done.items() if future.exception()] == [0]
    assert result_of(done[4], "search d").evaluations == 3
    with pytest.raises(InputError, match=r"^search x: its worker process died, killed or out of memory"):
        result_of(done[0], "search x")


def test_a_lost_worker_is_said_with_its_task() -> None:
    with pytest.raises(InputError, match=r"^search x: its worker process died, killed or out of memory"):
        Work().run("-")([Task("search x", chores.lose, (["x"],))])


# --- the parallel map ------------------------------------------------------------------------------------------------

SMALL = TraceSettings(
    replicates=20, refined=2, generalised=1, most_effects=1,
    floor=FloorSettings(road_s=1.0, shocks=0, hard_shocks=0),
    base=dataclasses.replace(BASE, swarm=SwarmSettings(particles=6, iterations=4, starts=2), evaluations=20),
)  # fmt: skip


def tried(subject, cases):
    """Candidates of a sensor, a joint and the seat."""
    chosen = (("gain", "neck"), ("cubic", "pelvis"), ("lift_off", "pelvis"))
    return [one for one in all_candidates(subject, cases) if one.key in chosen]


def traced(executor) -> str:
    """The document of a small trace, all digits, without its duration."""
    with parallel_map(executor) as parallel, mock.patch.object(rounds, "all_candidates", tried):
        found = trace(cases()[:2], cases()[2:], SUBJECT, SMALL, 1, parallel=parallel)
    return json.dumps(trace_document(Report(found, seconds=0.0)), sort_keys=True)


def test_a_trace_has_the_same_digits_on_two_processes(processes) -> None:
    reference = traced(None)
    assert json.loads(reference)["candidates"]
    assert traced(processes) == reference


@pytest.mark.parametrize("text", ["none", "threads:2", "processes:1", "cluster"])
def test_a_shared_value_is_sent_once_to_each_worker(text: str, request: pytest.FixtureRequest) -> None:
    address = request.getfixturevalue("cluster") if text == "cluster" else text
    letters, first, second = ["a", "b", "c", "d"], ["x"], ["y"]
    with executor_of(address) as executor, parallel_map(executor) as parallel:
        seen = [list(parallel("search", chores.counted, shared, letters)) for shared in (first, second, first)]
    assert [[letter for letter, _ in each] for each in seen] == [letters] * 3
    most = [max(count for _, count in each) for each in seen]
    assert most[0] > 4 and most[1] > 4
    assert most[2] > 8, "the first value was sent again"


def test_a_killed_worker_names_the_stage_of_a_map(processes) -> None:
    with parallel_map(processes) as parallel:
        found = parallel("screening", chores.die_at_c, "x", ["a", "b", "c", "d"])
        assert [next(found), next(found)] == ["xa", "xb"]
        with pytest.raises(InputError, match=r"^screening: its worker process died, killed or out of memory"):
            next(found)
        assert list(parallel("screening", chores.die_at_c, "y", ["a", "b"])) == ["ya", "yb"]


def test_an_effect_of_the_catalogue_is_one_object_in_every_process() -> None:
    assert all(copied(effect) is effect for effect in CATALOGUE.values())
    assert copied(HAT) == HAT


def copied(value):
    """The value as another process receives it."""
    return pickle.loads(pickle.dumps(value))  # noqa: S301 - written here


# --- interrupted -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_interrupted_work_ends_at_once_and_is_resumed(tmp_path: Path, how: signal.Signals) -> None:
    """Ctrl-C reaches all processes of a terminal; a kill the first one alone. One of the workers is busy for long."""
    (tmp_path / "stuck").touch()
    command = [sys.executable, chores.__file__, str(tmp_path)]
    with subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True) as child:
        until(lambda: (tmp_path / "pid").exists() and len(journal(tmp_path)) == 3)
        until(lambda: len(json.loads((tmp_path / "checkpoint.json").read_text())["done"]) == 3)
        (os.killpg if how == signal.SIGINT else os.kill)(child.pid, how)
        code, errors = child.wait(20), child.stderr.read()
    assert (code, errors) == ((130, "") if how == signal.SIGINT else (-how, errors))
    until(lambda: not running(int((tmp_path / "pid").read_text())))

    (tmp_path / "stuck").unlink()
    with pytest.raises(InputError, match="belongs to an interrupted fit; give --resume to continue it, or remove it"):
        Work(None, tmp_path / "checkpoint.json").run(chores.PROBLEM)
    work = Work(None, tmp_path / "checkpoint.json", resume=True)
    results = work.run(chores.PROBLEM)(chores.searches(tmp_path))
    assert [encoded(result) for result in results] == [encoded(chores.found(n)) for n in (0, 1, 2, 3, 0)]
    assert sorted(journal(tmp_path)) == list(chores.NAMES)
    work.finish()
    assert not (tmp_path / "checkpoint.json").exists()


def journal(directory: Path) -> list[str]:
    """The tasks that were done."""
    path = directory / "done"
    return path.read_text().splitlines() if path.exists() else []


def running(pid: int) -> bool:
    """Whether there is such a process, and it has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("after", [1, 5, 8])
def test_a_resumed_fit_equals_an_uninterrupted_one(reference, tmp_path: Path, after: int) -> None:
    path, heard = tmp_path / "kept.json", []
    problem = fingerprint(cases()[:2], SUBJECT, 5, QUICK)
    with pytest.raises(KeyboardInterrupt):
        identified(Work(None, path, monitor=listener([], after)).run(problem))
    before = len(Checkpoint(path, problem, resume=True).done)
    assert 0 < before <= after
    assert identified(Work(None, path, resume=True, monitor=listener(heard)).run(problem)) == reference
    # Both stages report progress from the checkpoint to the end, in cases: 4 searches of one; 2 of one, 2 of both and 2
    # of one refined. A finished stage is not reported; each of the others is, before its first task.
    left = 4 + 6 - before
    assert len(heard) == left + len({what for what, _, _ in heard})
    assert heard[-1] == ("refine", 8, 8)


def listener(heard: list, most: float = np.inf):
    """A monitor that records its calls, and interrupts after `most` of them."""

    @contextlib.contextmanager
    def watch(what: str):
        def tell(done: int, total: int) -> None:
            heard.append((what, done, total))
            if len(heard) > most:
                raise KeyboardInterrupt

        yield tell

    return watch


# --- checkpoint ------------------------------------------------------------------------------------------------------

COUNTS = st.integers(0, 2**63 - 1)
PENALTIES = st.dictionaries(st.text(), COUNTS, max_size=3).map(Counter)
COSTS = arrays(np.float64, st.integers(1, 4), elements=st.floats(allow_nan=False, allow_infinity=False))


def thetas(shape):
    """Parameters inside Table 1."""
    width = shape[-1]
    low, wide = LOWER[:width], (UPPER - LOWER)[:width]
    return arrays(np.float64, shape, elements=st.floats(0.0, 1.0)).map(lambda share: low + wide * share)


SEARCHES = COSTS.flatmap(
    lambda costs: st.builds(Search, thetas((len(costs), 13)), st.just(costs), COUNTS, PENALTIES)
)  # fmt: skip
REFINED = st.builds(
    Refined, thetas((15,)), thetas((15,)), st.floats(allow_nan=False, allow_infinity=False), COSTS, COUNTS, PENALTIES
)


@settings(max_examples=15)
@given(SEARCHES | REFINED)
def test_results_are_read_back_to_the_bit(result) -> None:
    again = decoded(json.loads(json.dumps(encoded(result), allow_nan=False)), "x")
    assert type(again) is type(result)
    for item in dataclasses.fields(result):
        one, other = getattr(result, item.name), getattr(again, item.name)
        assert type(one) is type(other)
        if isinstance(one, np.ndarray):
            assert one.shape == other.shape and one.dtype == other.dtype and one.tobytes() == other.tobytes()
        else:
            assert repr(one) == repr(other)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)


@given(st.sampled_from([encoded(chores.found(1))]), st.data())
def test_any_stored_value_is_read_or_refused(good, data) -> None:
    key = data.draw(st.sampled_from(list(good)))
    bad = good | {key: data.draw(JSON)}
    with contextlib.suppress(InputError):
        decoded(data.draw(JSON | st.just(bad)), "x")


def kept(path: Path) -> dict:
    """A checkpoint with two results, and its document."""
    checkpoint = Checkpoint(path, "p")
    checkpoint.add("search a", chores.found(1))
    theta = chores.found(2).theta[0].tolist()
    theta = np.array([*theta, 3000.0, 1.0])
    theta = np.clip(theta, LOWER, UPPER)
    checkpoint.add("refine a", Refined(theta, theta, 0.1, np.array([0.1]), 7, Counter()))
    return json.loads(path.read_text())


@pytest.mark.parametrize(
    ("where", "value", "fault"),
    [
        (("schema",), 2, "schema is 2, this version reads 1"),
        (("more",), 2, "the file: has the keys done, more, problem, schema, version, expected done, problem"),
        (("version",), [7], r"is of biodyn \[7\], this is .*; continue with that version, or remove it to start anew$"),
        (("done",), [], "done: expected keys and values, got list"),
        (("done", "search a"), 3, "search a: is no result, a kind is Search or Refined"),
        (("done", "search a", "kind"), "Counter", "search a: is no result, a kind is Search or Refined"),
        (("done", "search a", "kind"), "Refined", "search a: has the keys costs, "),
        (("done", "search a", "kind"), [], "search a: is no result"),
        (("done", "search a", "theta"), "x", "search a: theta: expected lists of numbers"),
        (("done", "search a", "theta"), [[1.0, 2.0], [1.0]], "search a: theta: expected rows of one length"),
        (("done", "search a", "theta"), [[1.0]], r"search a: theta: has the shape \(1, 1\)"),
        (("done", "search a", "theta"), [[]], r"search a: theta: has the shape \(1, 0\)"),
        (("done", "search a", "costs"), [], r"search a: costs: has the shape \(0,\)"),
        (("done", "search a", "costs"), [0.1], "search a: 2 starts and 1 costs"),
        (("done", "search a", "costs"), [0.1, float("nan")], "search a: costs: .* not finite"),
        (("done", "search a", "costs"), [0.1, True], "search a: costs: expected lists of numbers"),
        (("done", "search a", "costs"), [0.1, 10**400], "search a: costs: expected rows of one length and numbers a"),
        (("done", "search a", "evaluations"), -1, "search a: evaluations: is -1, expected a count"),
        (("done", "search a", "evaluations"), 2.5, "search a: evaluations: is 2.5, expected a count"),
        (("done", "search a", "penalties"), {"infinite": "x"}, "search a: penalties: infinite: is x, expected a count"),
        (("done", "search a", "penalties"), None, "search a: penalties: expected keys and values, got NoneType"),
        (("done", "refine a", "theta"), [1e3] * 15, "refine a: parameters out of Table 1"),
        (("done", "refine a", "reference"), [-1.0] * 15, "refine a: parameters out of Table 1"),
        (("done", "refine a", "objective"), None, "refine a: objective: expected a number"),
        (("done", "refine a", "objective"), float("inf"), "refine a: objective: .* not finite"),
        (("problem",), "q", "is of another problem: other recordings, subject, seed or settings; give the same again"),
    ],
)
def test_a_damaged_or_foreign_checkpoint_is_refused_and_not_changed(tmp_path: Path, where, value, fault: str) -> None:
    path = tmp_path / "kept.json"
    document = part = kept(path)
    for key in where[:-1]:
        part = part[key]
    part[where[-1]] = value
    path.write_text(json.dumps(document))
    refused(path, fault)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\xfe", b"[" * 10**5, b'{"schema": 1' + b"0" * 5000 + b"}"])
def test_other_files_are_refused_as_checkpoint_and_not_changed(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "kept.json"
    path.write_bytes(content)
    refused(path, "is damaged: not valid JSON; remove it to start anew|the file: expected keys and values, got list")


def test_a_truncated_or_endless_checkpoint_is_refused_and_not_changed(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    kept(path)
    content = path.read_bytes()
    for length in (1, len(content) // 2, len(content) - 3):
        path.write_bytes(content[:length])
        refused(path, "is damaged")
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(InputError, match="is larger than 64 MiB, so biodyn did not write it"):
        Checkpoint(path, "p", resume=True)


def refused(path: Path, fault: str) -> None:
    """Assert that a checkpoint is refused for a reason, and is left alone."""
    before = path.read_bytes()
    assert re.search(fault, refusal(lambda path: Checkpoint(path, "p", resume=True), path))
    assert path.read_bytes() == before


def test_an_unwritable_checkpoint_is_reported_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file: the directory cannot be created"):
        Work(None, tmp_path / "file" / "kept.json").run("p")
    (tmp_path / "kept.json").mkdir()
    with pytest.raises(InputError, match=r"kept\.json: cannot be read"):
        Work(None, tmp_path / "kept.json", resume=True).run("p")


def test_resume_without_a_checkpoint_starts_the_work(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    Work(None, path, resume=True).run("p")(chores.searches(tmp_path))
    assert set(Checkpoint(path, "p", resume=True).done) == set(chores.NAMES)
    assert [entry.name for entry in tmp_path.iterdir() if entry.name.startswith(".")] == []


# --- progress --------------------------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    """A stream of a terminal."""

    def isatty(self) -> bool:
        """Yes."""
        return True


def test_progress_is_not_printed_without_a_terminal(monkeypatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with Progress("fitting") as progress:
        progress(1, 2)
    assert stream.getvalue() == ""


def test_progress_shows_percent_and_the_time_of_completion(monkeypatch) -> None:
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "time", lambda: now[0])
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with Progress("fitting") as progress:
        # Half of it was done before, which does not count for the remaining time.
        for seconds, done in ((0.0, 50), (10.0, 60), (0.1, 60), (2.0, 60), (28.0, 100), (5.0, 100)):
            now[0] += seconds
            progress(done, 100)
    at = [time.strftime("%H:%M:%S", time.localtime(when)) for when in (1010.0 + 40.0, 1012.1 + 4.0 * 12.1)]
    lines = ["fitting:  50 %", f"fitting:  60 %, ETA {at[0]}", f"fitting:  60 %, ETA {at[1]}", "fitting: 100 %"]
    assert stream.getvalue() == "".join(f"\r{line}\x1b[K" for line in lines) + "\n"


def test_progress_of_days_names_the_day(monkeypatch) -> None:
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "time", lambda: now[0])
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with Progress("fitting") as progress:
        progress(0, 100)
        now[0] += 86400.0
        progress(1, 100)
    day = time.strftime("%a %d %b %H:%M", time.localtime(1000.0 + 100 * 86400.0))
    assert stream.getvalue().endswith(f"fitting:   1 %, ETA {day}\x1b[K\n")


def test_progress_ends_its_line_when_it_is_interrupted(monkeypatch) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)

    def work() -> None:
        with Progress("fitting") as progress:
            progress(1, 2)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert stream.getvalue() == "\rfitting:  50 %\x1b[K\n"
