"""Shared by all tests: a ROS domain on localhost, hypothesis without deadlines, and the shared recordings."""

import itertools
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from biodyn_ros.base import environment

pytest_plugins = ["ordering"]

ROOT = Path(__file__).resolve().parents[1]

# `make test` has done this already; here it is done for a bare `pytest`. rclpy reads these variables on import.
assert "rclpy" not in sys.modules
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.pop(environment.HELD, None)  # the domain that is held is one, and tests run side by side
DOMAIN = environment.prepare(os.environ)
# As the command line does.
os.environ.update(environment.ONE_THREAD)

# A process in the background, or of nohup, ignores these two signals, and so would every process that a test starts.
for _number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)

# A deadline would measure the machine. Continuous integration tries the same examples each time.
settings.register_profile("biodyn", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("biodyn")


def field_data() -> Path:
    """Directory of the shared recordings, if it exists: $BIODYN_DATA, or next to the checkout."""
    return Path(os.environ.get("BIODYN_DATA") or ROOT.parent / "shared" / "data")


@pytest.fixture(scope="session", autouse=True)
def _compiled_kernels() -> None:
    """Kernels are compiled in a process of tests, also where a command that leaves them uncompiled comes first."""
    import biodyn_core.kernels  # noqa: F401


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The recordings next to the checkout; they are too large for it."""
    directory = field_data()
    if not directory.is_dir():
        pytest.skip(f"the shared recordings are neither in {directory} nor where BIODYN_DATA says")
    return directory


@pytest.fixture
def graph() -> Iterator[Any]:
    """A ROS graph of the test's own."""
    from ros import ros_graph  # rclpy, once the environment is prepared

    with ros_graph() as made:
        yield made


@pytest.fixture
def no_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The independent simulation shakes from the first moment."""
    _rests(monkeypatch, 0.0, 0.0)


@pytest.fixture
def brief_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The independent simulation rests just long enough for gravity to be found."""
    _rests(monkeypatch, 1.0, 0.2)


def _rests(monkeypatch: pytest.MonkeyPatch, before_s: float, after_s: float) -> None:
    from world.effects import event, moving  # needed by few tests

    for module in (event, moving):
        monkeypatch.setattr(module, "REST_S", (before_s, after_s))


@pytest.fixture(scope="module")
def cluster(request: pytest.FixtureRequest) -> Iterator[str]:
    """The address of a Dask cluster on this machine with two workers, or as many as the module says."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=getattr(request.module, "CLUSTER_WORKERS", 2),
        threads_per_worker=1,
        host="127.0.0.1",
        protocol="tcp",
        dashboard_address=":0",
    ) as local:
        yield local.scheduler_address


_TESTS = itertools.count()


@pytest.fixture(autouse=True)
def _state_of_its_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """No live node of a test continues the exposure of another test or of the user.

    The directory is named and not made: few tests need one, and a tmp_path for each of them takes seconds.
    """
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / f"state_{next(_TESTS)}"))
