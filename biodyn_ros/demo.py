"""The demo: a new subject, the live node on the bundled bag, the replay, and the paper's subjects beside it.

One process plays the bag, another is the live node, this one prints exposure and residual.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_msgs.msg import Float64

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT
from biodyn_core.base.wording import number
from biodyn_core.body.subject import load_subject
from biodyn_core.population.population import new_subject
from biodyn_ros.base import topics
from biodyn_ros.base.files import check_directory, make_directory, write_text
from biodyn_ros.base.resources import bag_file, subject_file
from biodyn_ros.base.wording import words
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.replay.replaying import replay, replay_to_directory
from biodyn_ros.replay.text import summary
from biodyn_ros.reports.exposure_report import ExposureReport
from biodyn_ros.reports.intervals import dose_intervals
from biodyn_ros.reports.pages import check_reports

BAG: Final = "subject_1.mcap"
START_WITHIN_S: Final = 60.0
QUIET_S: Final = 3.0

PAPER: Final = ("subject_1", "subject_2")
NEW: Final = "me.yaml"

DEPTH: Final = 20_000
"""More messages than the bag has of any sensor, so that no queue drops a sample on a slow machine."""

_SHOWN: Final = (
    f"{topics.EXPOSURE}/dri",
    f"{topics.EXPOSURE}/{SEAT}/vdv",
    f"{topics.ROLLING}/{SEAT}/vdv",
    f"{topics.EXPOSURE}/predicted/head/vdv",
    f"{topics.EXPOSURE}/head/vdv",
    *topics.RESIDUAL.values(),
)


class _Observer(Node):
    """Subscribes to the topics of the live node."""

    def __init__(self) -> None:
        super().__init__("biodyn_demo")
        self.latest: dict[str, float] = {}
        self.state = ""
        for topic in _SHOWN:
            self.create_subscription(Float64, topics.absolute(topic), self._receiver(topic), 10)
        self.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, 10)

    def _receiver(self, topic: str) -> Any:
        return lambda message: self.latest.__setitem__(topic, message.data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        messages = {status.name: status.message for status in message.status}
        self.state = messages.get(topics.status_name("prediction"), self.state)

    def line(self) -> str:
        """The current values as one line."""
        get = self.latest.get
        residual = " ".join(f"{number(get(topics.RESIDUAL[segment])):>7s}" for segment in MEASURED_SEGMENTS)
        vdv, rolling = get(f"{topics.EXPOSURE}/{SEAT}/vdv"), get(f"{topics.ROLLING}/{SEAT}/vdv")
        if vdv is None or rolling is None:
            return f"  waiting: {self.state}" if self.state else "  waiting for the live node"
        head, predicted = get(f"{topics.EXPOSURE}/head/vdv", 0.0), get(f"{topics.EXPOSURE}/predicted/head/vdv", 0.0)
        dri = get(f"{topics.EXPOSURE}/dri", 0.0)
        columns = ((vdv, 9), (rolling, 9), (dri, 7), (head, 10), (predicted, 10))
        shown = "".join(f"{number(figure):>{width}}" for figure, width in columns)
        return f"{shown}   {residual}   {self.state}"


def demo(out: Path, subject_name: str | None = None) -> None:
    """Run the demo and write report, exposure and predicted bag to `out`; without a subject a new one is made there.

    Raises InputError if a process fails, or if the live node gives no value, after the offline results are written.
    """
    check_directory(out)
    check_reports()
    bag = bag_file(BAG)
    subject_path = subject_file(subject_name) if subject_name else _new_subject(out)
    subject = load_subject(subject_path)
    print(f"playing {bag.name} onto six topics; the live node predicts {subject.name}\n{MADE_BY_MODEL}\n")
    rclpy.init()
    live = _child("live", "--ros-args", *_parameters(subject_path), "--log-level", "warn")
    player = None
    try:
        observer = _Observer()
        _wait_for_subscription(observer, live)
        player = _child("play", str(bag), "--depth", str(DEPTH))
        last = _print_values(observer, live, player)
        observer.destroy_node()
    finally:
        for process in (player, live):
            if process is not None:
                _stop(process)
        rclpy.try_shutdown()
    print("\nthe same bag, processed offline by the same pipeline:\n")
    replayed = replay_to_directory(bag, subject, out)
    print(summary(replayed.report))
    print("\n".join(["", *_beside(bag, replayed.report)]))
    offline = replayed.report.sensors[SEAT].dose.vdv_mps175
    shown = "no value" if last is None else f"{last:.9f}"
    print(f"\nseat VDV live {shown}, offline {offline:.9f} m/s^1.75")
    print(
        f"report: {out / 'report.html'}   predicted bag: {out / 'predicted.mcap'}   exposure: {out / 'exposure.json'}"
    )
    if last is None:
        raise InputError("the live node gave no value: the machine may be too busy; try again later")


def _new_subject(out: Path) -> Path:
    """Make a subject of the mass and stature of the person in the bag, as `biodyn subject new` does."""
    person = load_subject(subject_file(PAPER[0]))
    make_directory(out)
    path = out / NEW
    write_text(path, new_subject(path.stem, person.body_mass_kg, person.stature_m).to_yaml())
    print(
        f"biodyn subject new --mass {person.body_mass_kg:g} --stature {person.stature_m:g} -o {path}\n"
        f"parameters of published groups of people, no recording of this person\n"
    )
    return path


def _beside(bag: Path, report: ExposureReport) -> list[str]:
    """Rows of the VDV of each segment: measured, predicted by the subject with its interval, and by the paper's."""
    papers = [replay(bag, load_subject(subject_file(name))).report for name in PAPER]
    head = f"{report.subject[:12]:>12s}{'95 % interval':>18s}" + "".join(f"{name:>12s}" for name in PAPER)
    rows = [
        "the same bag beside the paper's subjects, VDV in m/s^1.75; subject_1 is the model that made it",
        f"{'':14s}{'measured':>9s}{head}",
    ]
    for name in MEASURED_SEGMENTS:
        measured, predicted = report.measured_low_passed[name].dose, report.predicted[name].dose
        interval = dose_intervals(predicted, report.spreads.get(name)).vdv_interval_mps175
        span = " to ".join(map(number, interval)) if interval else "none"
        others = "".join(f"{number(one.predicted[name].dose.vdv_mps175):>12s}" for one in papers)
        row = f"{words(name):14s}{number(measured.vdv_mps175):>9s}{number(predicted.vdv_mps175):>12s}{span:>18s}"
        rows.append(row + others)
    return rows


def _parameters(subject_path: Path) -> list[str]:
    """The ROS arguments of the live node."""
    given = [f"subject_file:={subject_path}", "state_file:=none", f"queue_depth:={DEPTH}"]
    # Best effort loses samples if a process is delayed by 75 ms; live would then differ from the replay.
    given += [f"qos_overrides./{topic}.subscription.reliability:=reliable" for topic in topics.INPUT.values()]
    return [argument for parameter in given for argument in ("-p", parameter)]


def _child(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "biodyn_ros.commands.cli", *arguments], stdout=subprocess.DEVNULL)


def _wait_for_subscription(observer: _Observer, live: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + START_WITHIN_S
    while observer.count_subscribers(topics.INPUT[SEAT]) == 0:
        rclpy.spin_once(observer, timeout_sec=0.1)
        if live.poll() is not None:
            raise InputError(f"the live node ended at once (exit code {live.returncode}); see its message above")
        if time.monotonic() > deadline:
            raise InputError("the live node did not subscribe within a minute")


def _print_values(observer: _Observer, live: subprocess.Popen[bytes], player: subprocess.Popen[bytes]) -> float | None:
    """Print a line per second until the bag has ended and the last values are received; return the seat's VDV."""
    segments = " ".join(f"{name[:7]:>7s}" for name in MEASURED_SEGMENTS)
    print(" seat VDV   window    DRI  head VDV     model   residual rms over the window, m/s^2")
    print(f" m/s^1.75                  m/s^1.75             {segments}")
    ended, next_line = None, time.monotonic()
    while ended is None or time.monotonic() < ended + QUIET_S:
        rclpy.spin_once(observer, timeout_sec=0.05)
        if live.poll() is not None:
            raise InputError(f"the live node ended (exit code {live.returncode}); see its message above")
        if ended is None and player.poll() is not None:
            if player.returncode:
                raise InputError(f"playing the bag failed (exit code {player.returncode}); see its message above")
            ended = time.monotonic()
        if time.monotonic() >= next_line and ended is None:
            next_line += 1.0
            print(observer.line(), flush=True)
    return observer.latest.get(f"{topics.EXPOSURE}/{SEAT}/vdv")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End a child process as Ctrl-C would."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
