"""Ends the live node repeatedly on a busy machine, with a page client, a looping player and two subscribers."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from typing import Final

from biodyn_ros.base.environment import prepare
from biodyn_ros.base.resources import bag_file
from faults.over_dds import LISTENER
from faults.rig import START_WITHIN_S

BUSY: Final = 4
LONGEST_WAIT_S: Final = 3.0
TIMEOUT_S: Final = 30.0
BUSY_CODE: Final = "while True: pass"
LISTENING_CODE: Final = f"import rclpy; rclpy.init(); {LISTENER}\nrclpy.spin(n)"


@dataclass(frozen=True)
class End:
    """One end: the signal, the time until the process ended, its exit code, and its standard error."""

    signal: str
    seconds: float
    code: int | None
    errors: str


def every(count: int) -> int:
    """End a node `count` times and print each end; returns 1 if an exit code is not 0."""
    domain = prepare(os.environ)
    found = []
    try:
        with ExitStack() as stack:
            for words in (
                *[("-c", BUSY_CODE)] * BUSY,
                *[("-c", LISTENING_CODE)] * 2,
                ("-m", "biodyn_ros.commands.cli", "play", str(bag_file("subject_1.mcap")), "--loop", "--wait-s", "0"),
            ):
                stack.enter_context(_running(words))
            for number in range(count):
                found.append(_ended(signal.SIGTERM if number % 2 else signal.SIGINT))
                print(f"{number + 1:3d} {vars(found[-1])}", flush=True)
    finally:
        if domain:
            domain.release()
    print(_summary(found))
    return 1 if any(end.code != 0 for end in found) else 0


def _ended(by: signal.Signals) -> End:
    """Start a node with its page and a client, and end it at a random time."""
    port = _free_port()
    parameters = ("state_file:=none", "dashboard:=true", f"page_port:={port}")
    given = [word for one in parameters for word in ("-p", one)]
    live = subprocess.Popen(
        [sys.executable, "-m", "biodyn_ros.commands.cli", "live", "--ros-args", "--log-level", "error", *given],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        client = _connected(port)
        time.sleep(random.uniform(0.0, LONGEST_WAIT_S))
        begin_s = time.monotonic()
        live.send_signal(by)
        try:
            _, errors = live.communicate(timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            live.kill()
            return End(by.name, TIMEOUT_S, None, live.communicate()[1])
        seconds = time.monotonic() - begin_s
        client.close()
        return End(by.name, seconds, live.returncode, errors)
    finally:
        if live.poll() is None:
            live.kill()
            live.wait()


def _connected(port: int) -> HTTPConnection:
    """A client with an open stream of events, when the page is served."""
    deadline = time.monotonic() + START_WITHIN_S
    while True:
        client = HTTPConnection("127.0.0.1", port, timeout=5.0)
        try:
            client.request("GET", "/events")
            client.getresponse().readline()
        except (OSError, HTTPException):
            client.close()
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)
        else:
            return client


@contextmanager
def _running(words: Sequence[str]) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def _summary(found: list[End]) -> str:
    seconds = sorted(end.seconds for end in found)
    codes = sorted({str(end.code) for end in found})
    quarters = ", ".join(f"{seconds[round(share * (len(seconds) - 1))]:.2f}" for share in (0.0, 0.25, 0.5, 0.75, 1.0))
    return f"{len(found)} ends, exit codes {' '.join(codes)}; minimum, quartiles and maximum: {quarters} s"
