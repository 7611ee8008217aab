"""The environment of a ROS process, independent of the machine: cleared variables, localhost, a domain of its own.

Standard library only. `python -m biodyn_ros.base.environment -- COMMAND ARGUMENT...` runs a command in it.
"""

from __future__ import annotations

import fcntl
import os
import random
import signal
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

SEARCH_PATHS: Final = (
    "PYTHONPATH",
    "PYTHONHOME",
    "LD_LIBRARY_PATH",
    "AMENT_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    # States that LD_LIBRARY_PATH is already set for the ROS wheels; inherited without that path, rclpy does not load.
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)
"""Where a new process finds Python and ROS: cleared before its start, without effect afterwards."""

MIDDLEWARE: Final = (
    "RMW_IMPLEMENTATION",
    "ROS_DOMAIN_ID",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_SECURITY_ENABLE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "RCUTILS_LOGGING_USE_STDOUT",
)
"""Peers and logging of a node: read when rclpy starts."""

CLEARED: Final = SEARCH_PATHS + MIDDLEWARE

DOMAINS: Final = range(1, 102)
"""Above 101 the ports of a domain overlap the ephemeral ports of Linux; 0 is the default of every ROS process."""

ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Linear algebra on one thread; read when numpy loads. More threads sum in another order and change a fit's digits."""

HELD: Final = "BIODYN_HELD_DOMAIN_ID"
"""States that ROS_DOMAIN_ID is reserved by a lock, and not merely set on this machine; inherited by child processes."""


class EnvironmentFault(RuntimeError):
    """The machine lacks a resource that a run needs; the message is one line."""


@dataclass(frozen=True)
class Domain:
    """A ROS domain that no other holder on this machine has, until it is released or the last holder ends."""

    domain_id: int
    descriptor: int

    @property
    def variables(self) -> dict[str, str]:
        """The environment variables of a process that uses the domain."""
        return {"ROS_DOMAIN_ID": str(self.domain_id), HELD: str(self.domain_id)}

    def release(self) -> None:
        """Give the domain back."""
        os.close(self.descriptor)

    def __enter__(self) -> Domain:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def private_directory() -> Path:
    """This user's own directory for lock files and logs, made on first use."""
    path = Path(tempfile.gettempdir()) / f"biodyn-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise EnvironmentFault(f"no directory for locks and logs: {error}; set TMPDIR to a writable one") from error
    # Another user can create a directory of this name under /tmp first, and would then own the locks.
    if path.lstat().st_uid != os.getuid() or path.is_symlink() or not os.access(path, os.W_OK):
        raise EnvironmentFault(f"{path} is not a writable directory of user {os.getuid()}; remove it or set TMPDIR")
    return path


def clean_environment(base: Mapping[str, str]) -> dict[str, str]:
    """A copy of `base` for a new process: cleared, on localhost, with a log directory, this Python's scripts first."""
    environment = {name: value for name, value in base.items() if name not in (*CLEARED, HELD)}
    environment.update(_localhost())
    scripts = sysconfig.get_path("scripts")
    others = [entry for entry in environment.get("PATH", os.defpath).split(os.pathsep) if entry != scripts]
    environment["PATH"] = os.pathsep.join([scripts, *others])
    return environment


def prepare(environment: MutableMapping[str, str]) -> Domain | None:
    """Make the environment of a running process safe for rclpy, in place; returns the domain that it reserved, if any.

    Search paths stay: this process started with them, and a sourced ROS needs them.
    Nothing changes if a domain is already reserved for this process.
    """
    if HELD in environment and environment[HELD] == environment.get("ROS_DOMAIN_ID"):
        return None
    domain = hold_domain()
    for name in MIDDLEWARE:
        environment.pop(name, None)
    environment.update(_localhost() | domain.variables)
    return domain


def hold_domain(directory: Path | None = None) -> Domain:
    """Reserve a free domain from 1 to 101; EnvironmentFault if all are held.

    The lock belongs to the open file: it is inherited over exec, and released by the end of the last process with it.
    """
    directory = private_directory() if directory is None else directory
    # Users do not see the locks of each other: a random start makes the same choice unlikely.
    first = random.randrange(len(DOMAINS))
    for domain_id in (*DOMAINS[first:], *DOMAINS[:first]):
        descriptor = try_lock(directory / f"domain-{domain_id}.lock")
        if descriptor is not None:
            return Domain(domain_id, descriptor)
    raise EnvironmentFault(
        f"no free ROS domain: all of {DOMAINS[0]} to {DOMAINS[-1]} are held through {directory}; end other runs first"
    )


def run(command: Sequence[str]) -> None:
    """Replace this process by the command, in a clean environment with its own domain; EnvironmentFault if it fails.

    The command thus receives signals, and its exit code is that of this process.
    """
    domain = hold_domain()
    os.set_inheritable(domain.descriptor, True)
    # Python ignores SIGPIPE, and the command would inherit that.
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        os.execvpe(command[0], list(command), clean_environment(os.environ) | domain.variables)
    except OSError as error:
        domain.release()
        raise EnvironmentFault(f"cannot run {command[0]}: {error.strerror}") from error


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line: everything after `--` is the command."""
    command = list(sys.argv[1:] if arguments is None else arguments)
    if command[:1] == ["--"]:
        command = command[1:]
    if not command:
        print("usage: python -m biodyn_ros.base.environment -- COMMAND [ARGUMENT...]", file=sys.stderr)
        return 2
    try:
        run(command)
    except EnvironmentFault as fault:
        print(f"biodyn: {fault}", file=sys.stderr)
    return 2


@contextmanager
def variables_set(values: Mapping[str, str]) -> Iterator[None]:
    """Set variables of this process inside the block; the former values return at its end."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _localhost() -> dict[str, str]:
    log_directory = private_directory() / "log"
    log_directory.mkdir(exist_ok=True)
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(log_directory)}


def try_lock(path: Path) -> int | None:
    """A descriptor that holds the lock file until it is closed, None if another process holds it.

    Raises EnvironmentFault if the file cannot be opened.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise EnvironmentFault(f"cannot open the lock file {path}: {error.strerror}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


if __name__ == "__main__":
    sys.exit(main())
