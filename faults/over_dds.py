"""Faults of DDS, processes and the disk, over real DDS in real time; one row each."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from biodyn_ros.base import topics
from biodyn_ros.base.resources import bag_file, subject_file
from faults.rig import Rig, command, ended, rig

BEGIN_S, END_S, UNTIL_S = 3.0, 8.0, 12.0
"""Long enough for another process to start and to be discovered."""

WITHIN_S: Final = 2.5
"""Two seconds, plus half a second between two diagnostics."""

HEAD: Final = topics.INPUT["head"]
OK: Final = DiagnosticStatus.OK


@dataclass(frozen=True)
class Result:
    """One row: the fault, the diagnostic message, the recovery time, and the errors."""

    fault: str
    message: str
    recovered_s: float | None
    wrong: tuple[str, ...]


@dataclass(frozen=True)
class OverDds:
    """A fault, active in the context `during` of a ride; expected: the text required in its sensor's diagnostics."""

    name: str
    during: Callable[[Rig], AbstractContextManager[None]]
    of: str = "head"
    expected: str = ""
    parameters: tuple[str, ...] = ()

    def run(self) -> Result:
        """Send the ride with the fault."""
        with rig(*self.parameters) as one, ExitStack() as lasting:
            begin, end = (lambda one: lasting.enter_context(self.during(one)), lambda one: lasting.close())
            one.play(UNTIL_S, {BEGIN_S: begin, END_S: end})
            return Result(self.name, *_judged(one, self))


def _judged(one: Rig, fault: OverDds) -> tuple[str, float | None, tuple[str, ...]]:
    wrong = []
    statuses = [(at, *item) for at, found in one.received.statuses for item in found.items() if at > 2.0]
    own = [status.message for _, name, status in statuses if name == topics.status_name(fault.of)]
    reported = next((message for message in own if fault.expected and fault.expected in message), "")
    if fault.expected and not reported:
        wrong.append(f"no message with {fault.expected}: {sorted(set(own))}")
    others = {
        f"{name}: {status.message}"
        for _, name, status in statuses
        if name != topics.status_name(fault.of) and status.level != OK
    }
    if others:
        wrong.append(f"others are reported: {sorted(others)}")
    last = max((at for at, _, status in statuses if status.level != OK), default=0.0)
    recovered = max(0.0, last - END_S)
    if recovered > WITHIN_S:
        wrong.append(f"not normal {recovered:.1f} s after it")
    wrong += _interruptions(one)
    return reported, recovered, tuple(wrong)


def _interruptions(one: Rig) -> list[str]:
    """Predictions and diagnostics must not be interrupted."""
    found = []
    predicted = [at for at in one.received.predicted_s if at > 2.0]
    gaps = [b - a for a, b in pairwise(predicted)]
    if not predicted or max(gaps, default=9.0) > 1.0 or predicted[-1] < UNTIL_S - 1.0:
        found.append(f"predictions pause for {max(gaps, default=9.0):.1f} s")
    times = [at for at, _ in one.received.statuses]
    if not times or times[-1] < UNTIL_S - 1.5:
        found.append("diagnostics stop")
    if one.live.poll() is not None:
        found.append(f"the node ended with {one.live.returncode}")
    return found


# --- faults during a ride --------------------------------------------------------------------------------------------

OF_ANOTHER_TYPE: Final = (
    f"from std_msgs.msg import String; n = rclpy.create_node('other'); p = n.create_publisher(String, '{HEAD}', 10)"
)
LISTENER: Final = (
    "from geometry_msgs.msg import AccelStamped; n = rclpy.create_node('listener');"
    f"n.create_subscription(AccelStamped, '{topics.absolute(topics.PREDICTED['head'])}', lambda m: None, 10)"
)


@contextmanager
def _aside(code: str, stopping: signal.Signals = signal.SIGINT) -> Iterator[subprocess.Popen[bytes]]:
    """Another process in the ROS graph, in which `code` makes the node n; the ride does not wait for its end."""
    spinning = "with contextlib.suppress(KeyboardInterrupt): rclpy.spin(n)"
    words = [sys.executable, "-c", f"import contextlib, rclpy; rclpy.init(); {code}\n{spinning}"]
    process = subprocess.Popen(words)
    try:
        yield process
    finally:
        process.send_signal(stopping)
        if stopping is signal.SIGKILL:
            process.wait()


@contextmanager
def _other_type(_: Rig) -> Iterator[None]:
    with _aside(OF_ANOTHER_TYPE):
        yield


@contextmanager
def _listener(_: Rig) -> Iterator[None]:
    with _aside(LISTENER, signal.SIGKILL):
        yield


@contextmanager
def _hanging(_: Rig) -> Iterator[None]:
    """A reliable subscriber that stops receiving after two seconds without leaving."""
    with _aside(LISTENER, signal.SIGKILL) as process:
        stopping = threading.Timer(2.0, process.send_signal, (signal.SIGSTOP,))
        stopping.start()
        yield
        stopping.cancel()


def _published(kind: Any, topic: str, qos: Any = 10) -> Callable[[Rig], AbstractContextManager[None]]:
    """An additional publisher."""

    @contextmanager
    def during(one: Rig) -> Iterator[None]:
        publisher = one.node.create_publisher(kind, topic, qos)
        yield
        one.node.destroy_publisher(publisher)

    return during


@contextmanager
def _garbage(one: Rig) -> Iterator[None]:
    """Messages that are too short, or state a frame_id longer than themselves.

    Each has at least the four bytes of every ROS message: after an empty one a reliable reader of Fast DDS waits for
    seconds.
    """
    for message in (
        b"\0\1\0\0",
        b"\0\1\0\0" + b"\xff" * 40,
        b"\0\1\0\0" + b"\0" * 8 + b"\xff\xff\xff\x7f" + b"a" * 300,
    ):
        one.outputs["head"].publish(message)
    yield


def _framed(length: int) -> Callable[[Rig], AbstractContextManager[None]]:
    @contextmanager
    def during(one: Rig) -> Iterator[None]:
        before, one.frame_id = one.frame_id, "f" * length
        yield
        one.frame_id = before

    return during


@contextmanager
def _clock(one: Rig) -> Iterator[None]:
    """Simulated time that stops."""
    publisher = one.node.create_publisher(Clock, "/clock", 10)
    for second in range(5):
        message = Clock()
        message.clock.sec = 1_767_225_600 + second
        publisher.publish(message)
    yield
    one.node.destroy_publisher(publisher)


UNRELIABLE: Final = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Incompatible with the rig's node, which subscribes as reliable by an override."""

STREAMED: Final = (
    OverDds("a publisher of another type", _other_type, expected="a publisher sends std_msgs/msg/String"),
    OverDds("a publisher of incompatible QoS", _published(Imu, HEAD, UNRELIABLE), expected="incompatible QoS"),
    OverDds("two publishers on one topic", _published(Imu, HEAD), expected="2 publishers"),
    OverDds("messages that are cut, or lie about their length", _garbage, expected="messages refused"),
    OverDds("frame_id empty", _framed(0)),
    OverDds("frame_id of 4,000 characters", _framed(4000)),
    OverDds("a subscriber killed with -9", _listener),
    OverDds("a subscriber that hangs", _hanging),
    OverDds("simulated time that stops", _clock, parameters=("use_sim_time:=true",)),
)


# --- faults of another kind ------------------------------------------------------------------------------------------


def _service(one: Rig, kind: Any, name: str, request: Any) -> Any:
    client = one.node.create_client(kind, f"/biodyn/{name}")
    one.wait(client.service_is_ready, f"{name} is available", 20.0)
    future = client.call_async(request)
    one.wait(future.done, f"{name} responds", 60.0)
    return future.result()


def _transition(one: Rig, which: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=which))
    return bool(_service(one, ChangeState, "change_state", request).success)


def subject_damaged_at_run_time() -> Result:
    """The subject's file becomes invalid: the running node continues, configuring fails until the file is repaired."""
    wrong = []
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "anna.yaml"
        shutil.copy(subject_file("subject_1"), path)
        with rig(f"subject_file:={path}") as one:
            one.play(UNTIL_S, {BEGIN_S: lambda _: path.write_text("not: a subject\n")})
            wrong += _interruptions(one)
            value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=50.0)
            request = SetParameters.Request(parameters=[Parameter(name="cutoff_hz", value=value)])
            answer = _service(one, SetParameters, "set_parameters", request).results[0]
            if answer.successful or "clean up first" not in answer.reason:
                wrong.append("a parameter that is read on configure was accepted")
            steps = [
                _transition(one, which) for which in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
            ]
            if not all(steps):
                wrong.append("it cannot be deactivated and cleaned up")
            if _transition(one, Transition.TRANSITION_CONFIGURE):
                wrong.append("it was configured with an invalid subject")
            shutil.copy(subject_file("subject_1"), path)
            steps = [
                _transition(one, which) for which in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
            ]
            if not all(steps):
                wrong.append("it cannot be configured and activated with the repaired subject")
            one.wait(one.matched, "it subscribes again", 20.0)
    return Result("subject file made invalid at run time", answer.reason, 0.0, tuple(wrong))


def disk_full() -> Result:
    """A replay on a full disk: one line, exit code 2, and earlier results unchanged."""
    bag, wrong, message = str(bag_file("subject_1.mcap")), [], ""
    with tempfile.TemporaryDirectory() as directory:
        out = Path(directory) / "out"
        given = ("replay", bag, "--subject", "subject_1", "-o", str(out))
        if command(*given).returncode != 0:
            wrong.append("the replay before failed")
        before = {path.name: path.read_bytes() for path in out.iterdir()}
        for limit in (200_000, 20_000, 1_000):
            full = command(*given, file_limit=limit)
            message = full.stderr.strip().splitlines()[-1] if full.stderr.strip() else ""
            if full.returncode != 2 or "Traceback" in full.stderr:
                wrong.append(f"{limit} bytes: exit code {full.returncode}: {full.stderr[-300:]}")
            left = {path.name: path.read_bytes() for path in out.iterdir()}
            if left != before:
                wrong.append(f"{limit} bytes: earlier results have changed: {sorted(left)}")
    return Result("the disk full while a replay writes", message, None, tuple(wrong))


def looping_bag() -> Result:
    """A bag played in a loop with its own stamps: exposure continues, and the loop gives no lasting error."""
    wrong: list[str] = []
    with rig() as one:
        one.wait(one.matched, "the node subscribes")
        for output in one.outputs.values():
            one.node.destroy_publisher(output)
        words = [sys.executable, "-m", "biodyn_ros.commands.cli", "play", str(bag_file("subject_1.mcap")), "--loop"]
        player = subprocess.Popen(
            [*words, "--keep-stamps"], text=True, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        try:
            one.begin()
            one.wait(lambda: len(one.received.vdv) > 60, "half a minute of exposure", 90.0)
        finally:
            ended(player)
        values = [value for _, value in one.received.vdv]
        if any(b < a - 1e-12 for a, b in pairwise(values)) or not values[-1] > values[10] > 0.0:
            wrong.append(f"exposure does not continue: {values[:2]} ... {values[-2:]}")
        levels = [found[topics.status_name("prediction")].level for _, found in one.received.statuses]
        if levels.count(DiagnosticStatus.ERROR) > 0.2 * len(levels):
            wrong.append("predictions are an error in more than 20 % of the diagnostics")
    return Result("a looping bag", "", 0.0, tuple(wrong))


OTHERS: Final[Mapping[str, Callable[[], Result]]] = {
    "subject": subject_damaged_at_run_time,
    "disk": disk_full,
    "loop": looping_bag,
}
