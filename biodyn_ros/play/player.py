"""Plays a bag onto its topics: paced by log time, stamps shifted to the present unless kept.

Serialized messages are published unchanged except for the header stamp, which is shifted or set to log time. The
publishers are RELIABLE, which matches both kinds of subscriber. The player waits until they are matched, because
earlier messages are lost. It also waits at the end: best-effort subscribers acknowledge no message, and messages not
yet received are lost when the publisher is destroyed. Topics that were latched, as a robot's description, are again.
"""

from __future__ import annotations

import importlib
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal

import rclpy
from builtin_interfaces.msg import Time
from rclpy.clock import ROSClock
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from biodyn_core.base.errors import InputError
from biodyn_ros.bag import BagReader, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, restamp, shift_stamp, stamp_of
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.base.shutdown import Shutdown
from biodyn_ros.base.wording import listed
from biodyn_ros.play.outputs import CLOCK, recorded_outputs
from biodyn_ros.play.playback import Lap, Played, in_order, played_on
from biodyn_ros.play.player_settings import PlayerSettings
from biodyn_ros.reading.stamps import SensorClock, choose_times, clock_warnings

CLOCK_STEP_NS: Final = 10_000_000
PROGRESS_STEP_NS: Final = 100_000_000
POLL_S: Final = 0.05
ACKNOWLEDGE_TIMEOUT_S: Final = 20.0
SETTLING_S: Final = 0.5


class Player(Node):
    """A node that publishes a bag's topics: `wait_for_subscribers`, then `play`.

    `progress` is called with (milliseconds played, total milliseconds) ten times per second of the bag, unless it
    loops. mapping: the bag's topic by sensor, if not found by name; time: "header" or "log", the stamps to publish.
    With "header", an Imu topic whose header stamps are zero or do not change is published with log times.
    """

    def __init__(
        self,
        bag: str | Path,
        settings: PlayerSettings | None = None,
        progress: OnProgress = ignore_progress,
        mapping: dict[str, str] | None = None,
        time: Literal["header", "log"] = "header",
        **kwargs: Any,
    ) -> None:
        super().__init__("biodyn_player", **kwargs)
        self._progress = ignore_progress if settings and settings.loop else progress
        self.settings = settings or PlayerSettings()
        self.bag = Path(bag)
        self._warnings: list[str] = []
        with open_bag(bag) as reader:
            self._warn(*reader.warnings)
            types = self._choose_topics(reader, mapping or {})
            self._latched = {topic.name: topic.latched for topic in reader.topics if topic.latched}
            self._by_log = self._choose_by_log(reader, types, time)
        self._outputs = self._create_outputs(types)
        if not self._outputs:
            raise InputError(f"{bag}: no topic of the bag can be played")
        self._sent = dict.fromkeys(self._outputs, 0)
        self._began_s: float | None = None
        self._next_clock_ns = 0
        self._lap = Lap(frozenset(name for name, kind in types.items() if kind == IMU_TYPE))
        self._stamped = {name for name, output in self._outputs.items() if _has_header(output.msg_type)}
        self._clock_output = self.create_publisher(Clock, CLOCK, 10) if self.settings.clock else None

    def wait_for_subscribers(self) -> list[str]:
        """Wait, `wait_s` at most, until every topic has a subscriber; return the topics without one."""
        deadline = time.monotonic() + self.settings.wait_s
        unmatched = list(self._outputs)
        while unmatched and time.monotonic() < deadline:
            time.sleep(POLL_S)
            unmatched = [name for name in self._outputs if self._outputs[name].get_subscription_count() == 0]
        if len(unmatched) < len(self._outputs):
            time.sleep(SETTLING_S)  # a subscriber discovers its publisher slightly later than the publisher it
        return [self._names[name] for name in unmatched]

    def play(self, running: Callable[[], bool] = lambda: True) -> Played:
        """Publish all messages in order of log time while `running()`; laps follow each other without a gap."""
        rebase_ns, past_ns = 0, 0
        while running():
            with open_bag(self.bag) as reader:
                if self._began_s is None:
                    now_ns = ROSClock().now().nanoseconds
                    rebase_ns = 0 if self.settings.keep_stamps else now_ns - (reader.start_ns or 0)
                    self._began_s = time.monotonic()
                if self.settings.keep_stamps:
                    self._next_clock_ns = 0  # the clock jumps back with the stamps
                moved_ns = 0 if self.settings.keep_stamps else past_ns
                try:
                    self._play_once(reader, running, past_ns, rebase_ns + moved_ns)
                finally:
                    self._warn(*reader.warnings)  # a damaged chunk is found when it is read
            if not self.settings.loop or not running() or not any(self._sent.values()):
                break
            past_ns += self._lap.length_ns()
        return self.played()

    def played(self) -> Played:
        """The messages published so far, also after an interruption."""
        seconds = 0.0 if self._began_s is None else time.monotonic() - self._began_s
        return Played({self._names[name]: count for name, count in self._sent.items()}, seconds, tuple(self._warnings))

    def flush(self) -> None:
        """Wait until reliable subscribers have acknowledged all messages, and briefly for others; warn on a timeout."""
        deadline = time.monotonic() + ACKNOWLEDGE_TIMEOUT_S
        for name, output in self._outputs.items():
            # In short steps, because a signal is handled between two calls only.
            while not (acknowledged := output.wait_for_all_acked(Duration(seconds=POLL_S))):
                if time.monotonic() > deadline:
                    break
            if not acknowledged:
                self.get_logger().warning(
                    f"{self._names[name]}: not all messages acknowledged within {ACKNOWLEDGE_TIMEOUT_S:g} s"
                )
        time.sleep(SETTLING_S)

    def _warn(self, *texts: str) -> None:
        """Log warnings about the bag, each once; `played` returns them."""
        for text in texts:
            if text not in self._warnings:
                self._warnings.append(text)
                self.get_logger().warning(text)

    def _choose_topics(self, reader: BagReader, mapping: dict[str, str]) -> dict[str, str]:
        """Choose the topics to play, and return their types; raises InputError for an empty bag."""
        types = {topic.name: topic.type for topic in reader.topics if topic.messages}
        if not types:
            raise InputError(f"{self.bag}: the bag is empty: nothing to play")
        left_out = recorded_outputs(reader, self.settings.clock)
        self._names = played_on(reader, mapping, left_out)
        if left_out:
            text = "not played: the live node and the player publish these topics themselves"
            self._warn(f"{listed(left_out)}: {text}")
        for name in types.keys() - self._names.keys() - set(left_out):
            self._warn(f"{name}: not played: another topic is mapped to its sensor")
        return {name: types[name] for name in self._names}

    def _choose_by_log(self, reader: BagReader, types: dict[str, str], time: str) -> set[str]:
        """The topics whose stamps are the recorder's times: all with time "log", else those whose driver sets none."""
        if time == "log":
            return set(types)
        if self.settings.keep_stamps:
            return set()  # the user wants the recorded stamps, also those that are zero
        imus = [name for name, kind in types.items() if kind == IMU_TYPE]
        choices = choose_times(reader, imus, time)
        self._warn(*clock_warnings({name: SensorClock(choice, None) for name, choice in choices.items()}, 0.0))
        return {name for name, choice in choices.items() if choice.time == "log"}

    def _create_outputs(self, types: dict[str, str]) -> dict[str, Any]:
        """The publisher of each topic of the bag; a topic that cannot be published gives a warning."""
        outputs = {}
        for name, kind in types.items():
            cls = message_class(kind)
            if cls is None:
                why = f"no Python class for {kind} is installed" if kind else "the bag does not state its type"
                self._warn(f"{name}: not played: {why}")
                continue
            try:
                outputs[name] = self.create_publisher(cls, self._names[name], self._qos(name))
            except (InvalidTopicNameException, ValueError) as error:  # ValueError: an unknown {substitution}
                why = str(error).splitlines()[0].removeprefix("Invalid topic name: ").rstrip(":")
                self._warn(f"{name}: not played: ROS refuses its name: {why}")
        return outputs

    def _qos(self, topic: str) -> QoSProfile:
        """As recorded where it was latched: a late subscriber gets what that publisher kept, and no more."""
        latched = topic in self._latched
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self._latched.get(topic, self.settings.depth),
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def _play_once(self, reader: BagReader, running: Callable[[], bool], past_ns: int, rebase_ns: int) -> None:
        """Publish the bag once; past_ns: the length of all earlier laps."""
        assert self._began_s is not None
        start_ns = reader.start_ns or 0
        total_ms = ((reader.end_ns or 0) - start_ns) // 10**6
        next_progress_ns = 0
        for log_ns, name, message in in_order(reader, list(self._outputs)):
            elapsed_ns = log_ns - start_ns
            if elapsed_ns >= next_progress_ns:
                self._progress(elapsed_ns // 10**6, total_ms)
                next_progress_ns = elapsed_ns + PROGRESS_STEP_NS
            due_s = self._began_s + (past_ns + elapsed_ns) * 1e-9 / self.settings.rate
            if due_s > time.monotonic() + 0.0005:
                time.sleep(max(0.0, due_s - time.monotonic()))
                if not running():
                    return
            if self._clock_output and log_ns + rebase_ns >= self._next_clock_ns:
                self._publish_clock(log_ns + rebase_ns)
            self._outputs[name].publish(self._stamp(name, message, log_ns, rebase_ns))
            self._sent[name] += 1
            if self.settings.loop and past_ns == 0:
                self._lap.note(name, log_ns, self._stamp_ns(name, message, log_ns))
        self._progress(total_ms, total_ms)

    def _stamp_ns(self, name: str, message: bytes, log_ns: int) -> int:
        """The stamp to publish, before it is shifted."""
        return log_ns if name in self._by_log or name not in self._stamped else stamp_of(message)

    def _stamp(self, name: str, message: bytes, log_ns: int, rebase_ns: int) -> bytes:
        if name not in self._stamped:
            return message
        if name in self._by_log:
            return restamp(message, log_ns + rebase_ns)
        return shift_stamp(message, rebase_ns) if rebase_ns else message

    def _publish_clock(self, now_ns: int) -> None:
        assert self._clock_output is not None
        self._next_clock_ns = now_ns + CLOCK_STEP_NS
        self._clock_output.publish(Clock(clock=Time(sec=now_ns // 10**9, nanosec=now_ns % 10**9)))


def message_class(kind: str) -> Any:
    """The Python class of a message type such as sensor_msgs/msg/Imu, None if there is none or for another form."""
    form = re.fullmatch(r"(\w+)/msg/([A-Z]\w*)", kind)
    if form is None:
        return None
    try:
        return getattr(importlib.import_module(f"{form[1]}.msg"), form[2])
    except (ImportError, AttributeError):
        return None


def _has_header(cls: Any) -> bool:
    fields = list(cls.get_fields_and_field_types().values())
    return bool(fields) and fields[0] == "std_msgs/Header"


def play(bag: Path, settings: PlayerSettings, progress: OnProgress = ignore_progress, **how: Any) -> Played:
    """Play a bag in its own process until its end, SIGINT or SIGTERM; how: mapping and time of the `Player`."""
    with Shutdown("biodyn play", interrupts=True) as shutdown:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        player = None
        try:
            shutdown.stage = "playing"
            player = Player(bag, settings, progress, **how)
            for topic in player.wait_for_subscribers():
                player.get_logger().warning(f"{topic} has no subscriber")
            played = player.play()
            player.flush()
        except KeyboardInterrupt:
            return player.played() if player else Played({}, 0.0)
        else:
            return played
        finally:
            shutdown.interrupts = False
            if player is not None:
                shutdown.run_stages([("the node", player.destroy_node)])
            shutdown.run_stages([("the ROS context", rclpy.try_shutdown)])
