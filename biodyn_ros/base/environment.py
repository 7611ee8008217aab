"""The environment in which ROS runs here, whatever the machine carries: cleared variables, localhost, an own domain.

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
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final

SEARCH_PATHS: Final = (
    "PYTHONPATH",
    "PYTHONHOME",
    "LD_LIBRARY_PATH",
    "AMENT_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    # Says that LD_LIBRARY_PATH is already right for the ROS wheels; inherited without it, rclpy does not load.
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)
"""Where a new process finds Python and ROS: cleared before its start, of no use afterwards."""

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
"""What decides with whom a node talks and where it logs: read when rclpy starts."""

CLEARED: Final = SEARCH_PATHS + MIDDLEWARE

DOMAINS: Final = range(1, 102)
"""Above 101 the ports of a domain reach into those Linux hands out freely; 0 is everybody's default."""

ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Linear algebra on one thread; read when numpy loads. More add sums up in another order, and a fit in other digits."""

HELD: Final = "BIODYN_HELD_DOMAIN_ID"
"""Tells children that ROS_DOMAIN_ID is held for them by a lock, and not merely set on this machine."""


class EnvironmentFault(RuntimeError):
    """The machine does not give what a run needs, told in one line."""


@dataclass(frozen=True)
class Domain:
    """A ROS domain that no other holder on this machine has, until it is released or the last holder ends."""

    domain_id: int
    descriptor: int

    @property
    def variables(self) -> dict[str, str]:
        """What a process must find in its environment to use the domain."""
        return {"ROS_DOMAIN_ID": str(self.domain_id), HELD: str(self.domain_id)}

    def release(self) -> None:
        """Give the domain back."""
        os.close(self.descriptor)

    def __enter__(self) -> Domain:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.release()


def private_directory() -> Path:
    """This user's own directory for lock files and logs, made on first use."""
    path = Path(tempfile.gettempdir()) / f"biodyn-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise EnvironmentFault(f"no place for locks and logs: {error}; set TMPDIR to a writable directory") from error
    # Anybody may make a directory of this name under /tmp beforehand, and would then own our locks.
    if path.lstat().st_uid != os.getuid() or path.is_symlink() or not os.access(path, os.W_OK):
        raise EnvironmentFault(f"{path} is not a writable directory of user {os.getuid()}; remove it or set TMPDIR")
    return path


def clean_environment(base: Mapping[str, str]) -> dict[str, str]:
    """A copy of `base` for a new process: cleared, on localhost, with a log directory and our own scripts first."""
    environment = {name: value for name, value in base.items() if name not in (*CLEARED, HELD)}
    environment.update(_localhost())
    scripts = sysconfig.get_path("scripts")
    others = [entry for entry in environment.get("PATH", os.defpath).split(os.pathsep) if entry != scripts]
    environment["PATH"] = os.pathsep.join([scripts, *others])
    return environment


def settle(environment: MutableMapping[str, str]) -> Domain | None:
    """Make the environment of a process that already runs safe for rclpy, in place; the domain now held, if any.

    Search paths stay: this process started with them, and a sourced ROS needs them.
    Nothing is changed where a domain is already held for this process.
    """
    if HELD in environment and environment[HELD] == environment.get("ROS_DOMAIN_ID"):
        return None
    domain = hold_domain()
    for name in MIDDLEWARE:
        environment.pop(name, None)
    environment.update(_localhost() | domain.variables)
    return domain


def hold_domain(directory: Path | None = None) -> Domain:
    """Take a domain from 1 to 101 that nobody holds; EnvironmentFault when there is none.

    The lock belongs to the open file: it is inherited over exec, and released by the end of the last process with it.
    """
    directory = private_directory() if directory is None else directory
    # A random start keeps users apart who do not see one another's locks.
    first = random.randrange(len(DOMAINS))
    for domain_id in (*DOMAINS[first:], *DOMAINS[:first]):
        descriptor = try_lock(directory / f"domain-{domain_id}.lock")
        if descriptor is not None:
            return Domain(domain_id, descriptor)
    raise EnvironmentFault(
        f"no free ROS domain: all of {DOMAINS[0]} to {DOMAINS[-1]} are held through {directory}; end other runs first"
    )


def run(command: Sequence[str]) -> None:
    """Become the command, in a clean environment with an own domain; returns only by an EnvironmentFault.

    Becoming it, rather than waiting for it, hands on signals and exit code without a line of code.
    """
    domain = hold_domain()
    os.set_inheritable(domain.descriptor, True)
    # Python ignores SIGPIPE, and what is ignored stays so in the command.
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        os.execvpe(command[0], list(command), clean_environment(os.environ) | domain.variables)
    except OSError as error:
        domain.release()
        raise EnvironmentFault(f"cannot run {command[0]}: {error.strerror}") from error


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line: everything after `--` is the command."""
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


def _localhost() -> dict[str, str]:
    log_directory = private_directory() / "log"
    log_directory.mkdir(exist_ok=True)
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(log_directory)}


def try_lock(path: Path) -> int | None:
    """A descriptor that holds the lock file until it is closed, None where somebody else does.

    Raises EnvironmentFault where the file cannot be opened.
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
