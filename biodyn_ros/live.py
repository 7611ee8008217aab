"""The live node: parameters to settings, messages to arrays, answers to messages; no mathematics.

One lifecycle node named `biodyn`. The seat's callback carries the model at once; the other sensors are drained in turn,
twenty times a second each, because only the comparison needs them. Exposure runs on data time, watchdogs on a steady
clock.
"""

from __future__ import annotations

import gc
import itertools
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import AccelStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from biodyn_core import kernels
from biodyn_core.conditioning import ConditioningSettings
from biodyn_core.errors import InputError
from biodyn_core.limits import EU_LIMITS, load_limits
from biodyn_core.pipeline import Frames, Pipeline, PipelineSettings
from biodyn_core.segments import SEAT, SENSORS
from biodyn_core.settings import check_settings, setting
from biodyn_core.subject import Subject, load_subject
from biodyn_ros import params, topics
from biodyn_ros.cdr import IMU_TYPE, AccelStampedTemplate, decode_imu, decode_imu_one
from biodyn_ros.dashboard.child import PageChild
from biodyn_ros.dashboard.settings import ServingSettings, check_page
from biodyn_ros.health import (
    Growth,
    SensorHealth,
    Status,
    keeping_status,
    page_status,
    prediction_status,
    sensor_status,
)
from biodyn_ros.resources import subject_file
from biodyn_ros.showing import Showing
from biodyn_ros.state import BELIEVED, Keeper, StateFile, belongs_to, state_path
from biodyn_ros.warmup import warm_up

NODE_NAME: Final = "biodyn"
DRAIN_RATE_HZ: Final = 100.0
"""One of the five waiting sensors is drained at each tick, so that no drain holds up the seat for long."""

REFRESH_RATE_HZ: Final = 20.0
DIAGNOSTICS_RATE_HZ: Final = 2.0
SNAPSHOT_RATE_HZ: Final = 4.0
KEEP_RATE_HZ: Final = 0.5
"""How often exposure is kept: what a node that is killed loses of it, and says is missing."""

LOOK_RATE_HZ: Final = 1.0
"""How often publishers are looked at, and one of the six clocks, which takes a millisecond or two."""

OUTPUT_DEPTH: Final = 2000


@dataclass(frozen=True)
class LiveSettings:
    """What the live node itself may be told; the pipeline's settings are parameters beside these."""

    subject_file: str = setting("subject_1", "path of a subject file, or the name of a bundled subject")
    limits_file: str = setting("", "path of a file with action and limit values; empty: those of 2002/44/EC")
    autostart: bool = setting(True, "configure and activate at start")
    queue_depth: int = setting(2000, "subscription queue of every sensor, in messages", "", 200, 10_000_000)
    publish_measured: bool = setting(False, "publish the conditioned measurements too")
    exposure_rate_hz: float = setting(2.0, "how often exposure is published", "Hz", 1.0, 10.0)
    state_file: str = setting(
        "", "file that keeps exposure across restarts; empty: in the user's state directory; none: nowhere"
    )
    kept_exposure: str = setting(
        "fitting", "which kept exposure a new start continues: a fitting one, any, or none", choices=BELIEVED
    )
    exposure_max_age_h: float = setting(
        12.0, "how old, by its stamps, a kept exposure may be to be continued", "h", 0.0, 8760.0
    )
    dashboard: bool = setting(False, "serve the live page while the node is active")
    shock_mps2: float = setting(5.0, "acceleration of the seat from which the page lists a shock", "m/s^2", 0.5, 1000.0)

    def __post_init__(self) -> None:
        check_settings(self)


_OVERRIDES: Final = QoSOverridingOptions.with_default_policies()
SETTINGS: Final = (LiveSettings, ServingSettings, ConditioningSettings, PipelineSettings)


class BiodynNode(LifecycleNode):
    """The pipeline as a lifecycle node: configured with a subject, active while it listens and answers."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(NODE_NAME, **kwargs)
        params.declare(self, SETTINGS)
        self.failure: str | None = None
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._health = {sensor: SensorHealth() for sensor in SENSORS}
        self._growth = Growth()
        self._mark = ""
        self._marks = 0
        self._pipeline: Pipeline | None = None
        self._keeper: Keeper | None = None
        self._page: PageChild | None = None
        self._statuses: list[Status] = []
        self.add_on_set_parameters_callback(self._on_parameters)

    # --- lifecycle ---------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read subject and settings, warm the kernels, make publishers and services."""
        return self._transition("configure", self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the sensors and start the timers."""
        return self._transition("activate", self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening; exposure stays as it is."""
        return self._transition("deactivate", self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget subject and filters; exposure is kept in its file."""
        return self._transition("clean up", self._cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening, whatever the state."""
        return self._transition("shut down", self._deactivate)

    def _transition(self, name: str, step: Callable[[], None]) -> TransitionCallbackReturn:
        """Run one transition; rclpy swallows exceptions, so the cause is logged here in one line."""
        try:
            step()
        except Exception as error:  # noqa: BLE001 - whatever fails, the state machine goes on and the cause is told
            known = isinstance(error, InputError)
            self.failure = str(error) if known else f"{type(error).__name__}: {error}"
            self.get_logger().error(f"cannot {name}: {self.failure}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        self.settings, self._serving = params.read(self, LiveSettings), params.read(self, ServingSettings)
        if self.settings.dashboard:
            check_page()
        subject = load_subject(subject_file(self.settings.subject_file))
        limits = load_limits(self.settings.limits_file) if self.settings.limits_file else EU_LIMITS
        conditioning, pipeline = params.read(self, ConditioningSettings), params.read(self, PipelineSettings)
        self._warn_of_slow_kernels(warm_up(subject))
        self._pipeline = Pipeline(subject, conditioning, pipeline, limits)
        self._keeper = self._new_keeper(subject)
        self._showing = Showing(self.settings.shock_mps2)
        self._publishers_of = {name: self._accel_outputs(name) for name in ("predicted", "measured")}
        self._scalars = {topic: self.create_publisher(Float64, topic, 10) for topic in topics.SCALARS}
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, 10)
        self._snapshots = self.create_publisher(String, topics.SNAPSHOT, 10)
        self._services_made = [
            self.create_service(Trigger, topics.RESET, self._on_reset),
            self.create_service(Trigger, topics.MARK, self._on_mark),
        ]

    def _activate(self) -> None:
        self._inbox: dict[str, list[bytes]] = {sensor: [] for sensor in SENSORS if sensor != SEAT}
        self._turn = itertools.cycle(self._inbox)
        self._clock_turn = itertools.cycle(SENSORS)
        self._subscriptions_made = {sensor: self._subscribe(sensor) for sensor in SENSORS}
        self._timers_made = [
            self.create_timer(1.0 / rate_hz, self._guarded(callback), clock=self._steady)
            for rate_hz, callback in (
                (DRAIN_RATE_HZ, self._drain),
                (REFRESH_RATE_HZ, self._refresh_wanted),
                (self.settings.exposure_rate_hz, self._publish_exposure),
                (DIAGNOSTICS_RATE_HZ, self._publish_diagnostics),
                (SNAPSHOT_RATE_HZ, self._publish_snapshot),
                (LOOK_RATE_HZ, self._look_around),
                (KEEP_RATE_HZ, self._keep),
            )
        ]
        self._refresh_wanted()
        if self.settings.dashboard:
            self._page = PageChild(self.get_fully_qualified_name(), self.context.get_domain_id(), self._serving)
            self.get_logger().info(f"the page: {self._page.link}")
        self.get_logger().info(f"predicting for {self._pipeline.subject.name}, listening to {len(SENSORS)} sensors")

    def _deactivate(self) -> None:
        self._end_page()
        for subscription in getattr(self, "_subscriptions_made", {}).values():
            self.destroy_subscription(subscription)
        for timer in getattr(self, "_timers_made", []):
            self.destroy_timer(timer)
        self._subscriptions_made, self._timers_made = {}, []

    def _cleanup(self) -> None:
        self._leave()
        for output in self._publishers_of.values():
            for publisher, _ in output:
                self.destroy_publisher(publisher)
        for publisher in (*self._scalars.values(), self._diagnostics, self._snapshots):
            self.destroy_publisher(publisher)
        for service in self._services_made:
            self.destroy_service(service)
        self._health = {sensor: SensorHealth() for sensor in SENSORS}
        self._growth = Growth()
        self._statuses = []
        self._pipeline = None

    def _new_keeper(self, subject: Subject) -> Keeper | None:
        """Where exposure is kept; a place that cannot be written to is told, and costs nobody the ride."""
        mapping = {sensor: self.resolve_topic_name(topic) for sensor, topic in topics.INPUT.items()}
        belongs, s = belongs_to(subject, mapping), self.settings
        try:
            path = state_path(s.state_file, self.get_fully_qualified_name())
            return None if path is None else Keeper(StateFile(path), belongs, s.exposure_max_age_h, s.kept_exposure)
        except InputError as error:
            if s.state_file:
                raise
            self.get_logger().warning(f"exposure is not kept across restarts: {error}")
            return None

    def _keep(self) -> None:
        if self._keeper is not None:
            self._keeper.keep(self._pipeline)

    def _leave(self) -> None:
        """Keep exposure for the last time."""
        keeper, self._keeper = self._keeper, None
        if keeper is not None and self._pipeline is not None:
            self._guarded(keeper.close)(self._pipeline)

    def _end_page(self) -> None:
        page, self._page = self._page, None
        if page is not None:
            page.end()

    def destroy_node(self) -> None:
        """Leave nothing behind but the exposure that is kept."""
        self._end_page()
        self._leave()
        super().destroy_node()

    def _warn_of_slow_kernels(self, rate_hz: float) -> None:
        if not kernels.COMPILED:
            self.get_logger().warning(
                f"numba is missing: kernels run uncompiled and keep up to {rate_hz:.0f} Hz per sensor"
            )

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        """Parameters are read on configure; a change that would do nothing until then is refused, not swallowed."""
        ours = [change.name for change in changes if change.name in params.names(SETTINGS)]
        if ours and self._pipeline is not None:
            return SetParametersResult(successful=False, reason=f"{ours[0]} is read on configure: clean up first")
        return SetParametersResult(successful=True)

    # --- in ----------------------------------------------------------------------------------------------------------

    def _subscribe(self, sensor: str) -> Any:
        topic = topics.INPUT[sensor]
        # Five sensors in six only wait for the next drain: nothing but the append runs per message.
        callback = self._guarded(self._on_seat, SEAT) if sensor == SEAT else self._inbox[sensor].append
        return self.create_subscription(
            Imu,
            topic,
            callback,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST,
                depth=self.settings.queue_depth,
                reliability=ReliabilityPolicy.BEST_EFFORT,
            ),
            raw=True,
            qos_overriding_options=_OVERRIDES,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=partial(self._on_lost, sensor),
                incompatible_qos=partial(self._on_incompatible_qos, sensor),
            ),
        )

    def _on_seat(self, message: bytes) -> None:
        stamp_ns, accel = decode_imu_one(message)
        if self._keeper is not None and self._keeper.waits:
            self._begin(stamp_ns)
        self._publish(self._pipeline.push(SEAT, np.array([stamp_ns]), np.array([accel])))
        self._health[SEAT].arrived()
        self._seat_stamp_ns = stamp_ns

    def _drain(self) -> None:
        """Hand the next sensor's messages to the pipeline."""
        sensor = next(self._turn)
        messages = self._inbox[sensor]
        if messages:
            taken = messages.copy()
            messages.clear()
            self._guarded(partial(self._take, sensor), sensor)(taken)

    def _take(self, sensor: str, messages: list[bytes]) -> None:
        self._health[sensor].arrived(len(messages))
        try:
            block = decode_imu(messages)
        except InputError:
            block = decode_imu([message for message in messages if self._readable(sensor, message)])
        if len(block):
            if self._keeper is not None and self._keeper.waits:
                self._begin(int(block.stamps_ns[0]))
            self._publish(self._pipeline.push(sensor, block.stamps_ns, block.accel_mps2))
            self._note_lag(sensor, int(block.stamps_ns[-1]))

    def _begin(self, stamp_ns: int) -> None:
        """Go on with an exposure that was kept, unless the stamp was never set."""
        if stamp_ns != 0:
            self.get_logger().warning(self._keeper.begin(self._pipeline, stamp_ns))

    def _readable(self, sensor: str, message: bytes) -> bool:
        """Whether a message can be decoded; one that cannot is counted and costs nothing but itself."""
        try:
            decode_imu_one(message)
        except InputError as error:
            self._refuse(sensor, str(error))
            return False
        return True

    def _refuse(self, sensor: str, text: str) -> None:
        self._health[sensor].errors += 1
        self._health[sensor].last_error = text
        self.get_logger().error(f"{sensor}: {text}", throttle_duration_sec=1.0)

    def _note_lag(self, sensor: str, stamp_ns: int) -> None:
        now_ns = self.get_clock().now().nanoseconds
        self._health[sensor].offset(1e-9 * (now_ns - stamp_ns), self._pipeline.settings.window_s)
        self._health[sensor].clock.push(np.array([stamp_ns]), np.array([now_ns]))

    def _on_lost(self, sensor: str, event: Any) -> None:
        self._health[sensor].lost += event.total_count_change

    def _on_incompatible_qos(self, sensor: str, event: Any) -> None:
        topic = self.resolve_topic_name(topics.INPUT[sensor])
        self._health[sensor].incompatible_qos = f"{topic}: a publisher offers incompatible QoS, override it or ours"
        self.get_logger().error(self._health[sensor].incompatible_qos)

    def _guarded(self, callback: Callable[..., None], sensor: str | None = None) -> Callable[..., None]:
        """A callback that raises is counted, reported and survived; EventsExecutor would end its loop."""

        def guarded(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except Exception as error:  # noqa: BLE001 - a node that judges exposure survives a bad message
                text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
                if sensor is not None:
                    self._refuse(sensor, text)
                else:
                    self.get_logger().error(f"timer: {text}", throttle_duration_sec=1.0)

        return guarded

    # --- out ---------------------------------------------------------------------------------------------------------

    def _accel_outputs(self, kind: str) -> list[tuple[Any, AccelStampedTemplate]]:
        names = topics.PREDICTED if kind == "predicted" else topics.MEASURED
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=OUTPUT_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        return [
            (
                self.create_publisher(AccelStamped, topic, qos, qos_overriding_options=_OVERRIDES),
                AccelStampedTemplate(frame_id=name),
            )
            for name, topic in names.items()
        ]

    def _refresh_wanted(self) -> None:
        """Samples are serialised only for topics somebody subscribes to."""
        kinds = ("predicted", "measured") if self.settings.publish_measured else ("predicted",)
        self._wanted = {
            kind: [
                (column, publisher.publish, template.fill)
                for column, (publisher, template) in enumerate(self._publishers_of[kind])
                if publisher.get_subscription_count() > 0
            ]
            for kind in kinds
        }

    def _publish(self, frames: Frames) -> None:
        self._showing.add(frames)
        for kind, wanted in self._wanted.items():
            frame = frames.predicted if kind == "predicted" else frames.measured
            if wanted and frame.stamps_ns.size:
                rows = zip(frame.stamps_ns.tolist(), frame.accel_mps2.tolist(), strict=True)
                for stamp_ns, row in rows:
                    for column, publish, fill in wanted:
                        value = row[column]
                        if not math.isnan(value):
                            publish(fill(stamp_ns, value))

    def _publish_exposure(self) -> None:
        since, rolling = self._pipeline.exposure(), self._pipeline.exposure(rolling=True)
        values = topics.exposure_values(since, topics.EXPOSURE) | topics.exposure_values(rolling, topics.ROLLING)
        values |= topics.residual_values(rolling) | topics.seat_values(self._pipeline.seat())
        for topic, value in values.items():
            self._scalars[topic].publish(Float64(data=value))

    def _publish_diagnostics(self) -> None:
        self._growth.look({"divergences": self._pipeline.divergences})
        for sensor, health in self._health.items():
            health.look(self._pipeline.status(sensor))
        statuses = [prediction_status(self._pipeline, self._health[SEAT], self._growth, self._mark)]
        statuses += [keeping_status(self._keeper)] if self._keeper is not None else []
        statuses += [page_status(self._page.address, self._page.failure)] if self._page is not None else []
        statuses += [sensor_status(name, self._health[name], self._pipeline, self._off_s(name)) for name in SENSORS]
        self._statuses = statuses
        message = DiagnosticArray(status=[_diagnostic(status) for status in statuses])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _publish_snapshot(self) -> None:
        """What the page shows, for whoever looks; shocks are found whether anybody does or not."""
        self._showing.gather()
        if self._statuses and self._snapshots.get_subscription_count() > 0:
            snapshot = self._showing.snapshot(self._pipeline, self._statuses, self._marks)
            self._snapshots.publish(String(data=json.dumps(snapshot, allow_nan=False)))

    def _off_s(self, sensor: str) -> float:
        """By how much a sensor's stamps lie ahead of the seat's, as far as arrivals tell; 0 while they do not.

        A simulated clock moves in steps, and stops: it times no arrival.
        """
        if self.get_clock().ros_time_is_active:
            return 0.0
        own_s, seat_s = self._health[sensor].offset_s, self._health[SEAT].offset_s
        return 0.0 if own_s is None or seat_s is None else seat_s - own_s

    def _look_around(self) -> None:
        """The event for a wrong message type does not fire across processes, so it is polled."""
        self._health[next(self._clock_turn)].compare_clock()
        if self._health[SEAT].arrived_s is not None:
            self._note_lag(SEAT, self._seat_stamp_ns)
        for sensor, health in self._health.items():
            topic = self.resolve_topic_name(topics.INPUT[sensor])
            found = self.get_publishers_info_by_topic(topic)
            wrong = [info.topic_type for info in found if info.topic_type != IMU_TYPE]
            text = f"{topic}: a publisher sends {wrong[0]}, {IMU_TYPE} is needed" if wrong else ""
            if text and text != health.wrong_type:
                self.get_logger().error(text)
            heard = [self._hears(sensor, info) for info in found if info.topic_type == IMU_TYPE]
            health.publishers, health.wrong_type = len(found), text
            if all(heard):
                health.incompatible_qos = ""  # whoever offered it has gone

    def _hears(self, sensor: str, publisher: Any) -> bool:
        """Whether a publisher's QoS is compatible with ours, as far as both are known."""
        ours = self._subscriptions_made[sensor].qos_profile
        return qos_check_compatible(publisher.qos_profile, ours)[0] != QoSCompatibility.ERROR

    # --- services ----------------------------------------------------------------------------------------------------

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._pipeline.reset()
        self.get_logger().info("exposure since reset starts anew")
        response.success, response.message = True, "exposure since reset starts anew"
        return response

    def _on_mark(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._marks += 1
        stamp = self.get_clock().now().nanoseconds
        self._mark = f"mark {self._marks} at {stamp * 1e-9:.3f} s"
        self.get_logger().info(self._mark)
        response.success, response.message = True, self._mark
        return response


def _diagnostic(status: Status) -> DiagnosticStatus:
    values = [KeyValue(key=key, value=value) for key, value in status.values.items()]
    return DiagnosticStatus(
        level=bytes([status.level]), name=status.name, message=status.message, hardware_id=NODE_NAME, values=values
    )


def make_executor(context: Any = None) -> Any:
    """EventsExecutor where rclpy has it, eight times cheaper a message; never the multi-threaded one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Any, until: Callable[[], bool]) -> None:
    """Spin a tenth of a second at a time, waiting for what never comes.

    EventsExecutor's own `spin` busy-loops in rclpy 7.1, and its `spin_once` comes back after every single message.
    """
    while not until():
        try:
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)
        except RCLError:
            if not until():  # a signal may end the context between the question and the spin
                raise


def main(args: list[str] | None = None) -> int:
    """Run the live node until SIGINT or SIGTERM; exit code 2, with one line, when it cannot start."""
    try:
        rclpy.init(args=sys.argv if args is None else ["biodyn_live", *args])
    except RCLError as error:  # arguments that ROS cannot read; behind ", at /" it says where in its own source
        print(f"biodyn live: {str(error).partition(', at /')[0]}", file=sys.stderr)
        return 2
    node = None
    try:
        node = BiodynNode()
        executor = make_executor()
        executor.add_node(node)
        if params.read(node, LiveSettings).autostart:
            node.trigger_configure()
            if node.failure is None:
                node.trigger_activate()
            if node.failure is not None:
                return 2
        # What exists now lives as long as this process: the collector need not walk it again, which takes milliseconds.
        gc.collect()
        gc.freeze()
        spin(executor, until=lambda: not rclpy.ok())
    except InputError as error:
        print(f"biodyn live: {error}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():  # otherwise a signal ended the context in the middle of a transition
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
