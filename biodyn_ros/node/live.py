"""The live node: parameters to settings, messages to arrays, answers to messages; no mathematics.

One lifecycle node named `biodyn`. It listens by `subscriptions`, drives the one `Pipeline`, and answers by
`publications`. Exposure runs on data time, watchdogs on a steady clock.
"""

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError, one_line
from biodyn_core.base.segments import SENSORS
from biodyn_core.base.settings import check_settings, setting
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.exposure.limits import EU_LIMITS, load_limits
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.base import topics
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.shutdown import Shutdown
from biodyn_ros.dashboard.child import PageChild
from biodyn_ros.dashboard.settings import ServingSettings, check_page
from biodyn_ros.node import params
from biodyn_ros.node.callbacks import guarded, make_executor, spin
from biodyn_ros.node.health import HealthMonitor, Status, keeping_status, page_status
from biodyn_ros.node.publications import Publications
from biodyn_ros.node.snapshot_builder import SnapshotBuilder
from biodyn_ros.node.state import BELIEVED, ExposureStore, StateFile, belongs_to, state_path
from biodyn_ros.node.subscriptions import Subscriptions
from biodyn_ros.node.warmup import warm_up

DRAIN_RATE_HZ: Final = 100.0
"""One of the six sensors is served at each tick, so that no drain holds up the seat for long."""

REFRESH_RATE_HZ: Final = 20.0
DIAGNOSTICS_RATE_HZ: Final = 2.0
SNAPSHOT_RATE_HZ: Final = 4.0
KEEP_RATE_HZ: Final = 0.5
"""How often exposure is kept: what a node that is killed loses of it, and says is missing."""

LOOK_RATE_HZ: Final = 1.0
"""How often publishers are looked at, and one of the six clocks, which takes a millisecond or two."""


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


SETTINGS: Final = (LiveSettings, ServingSettings, ConditioningSettings, PipelineSettings)


class BiodynNode(LifecycleNode):
    """The pipeline as a lifecycle node: configured with a subject, active while it listens and answers.

    failure: why the last transition that failed did. pipeline: None while nothing is configured.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(topics.NODE_NAME, **kwargs)
        samples = (*topics.PREDICTED.values(), *topics.MEASURED.values())
        qos = params.qos_overrides(self, topics.INPUT.values(), "subscription")
        params.declare(self, SETTINGS, qos | params.qos_overrides(self, samples, "publisher"))
        self.failure: str | None = None
        self.pipeline: Pipeline | None = None
        self._keeper: ExposureStore | None = None
        self._page: PageChild | None = None
        self._sensors: Subscriptions | None = None
        self._statuses: list[Status] = []
        self._timers_made: list[Any] = []
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
            self.failure = one_line(error)
            self.get_logger().error(f"cannot {name}: {self.failure}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        self.settings, self._serving = params.read(self, LiveSettings), params.read(self, ServingSettings)
        if self.settings.dashboard:
            check_page()
        subject = load_subject(subject_file(self.settings.subject_file))
        limits = load_limits(self.settings.limits_file) if self.settings.limits_file else EU_LIMITS
        conditioning, settings = params.read(self, ConditioningSettings), params.read(self, PipelineSettings)
        self._warn_of_slow_kernels(warm_up(subject))
        pipeline = Pipeline(subject, conditioning, settings, limits)
        self._keeper = self._new_keeper(subject)
        self._showing = SnapshotBuilder(self.settings.shock_mps2)
        self._sensors = Subscriptions(
            self, self.settings.queue_depth, settings.window_s, self._take, lambda: pipeline.overdue
        )
        self._watch, self._statuses = HealthMonitor(pipeline, self._sensors.health), []
        self._answers = Publications(self, self.settings.publish_measured)
        self._services_made = [
            self.create_service(Trigger, topics.RESET, self._on_reset),
            self.create_service(Trigger, topics.MARK, self._on_mark),
        ]
        self.pipeline = pipeline  # last: with it the node is configured

    def _activate(self) -> None:
        self._sensors.open()
        self._answers.look_who_listens()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timers_made = [
            self.create_timer(1.0 / rate_hz, guarded(callback, self._tell_of_timer), clock=steady)
            for rate_hz, callback in (
                (DRAIN_RATE_HZ, self._sensors.drain),
                (REFRESH_RATE_HZ, self._answers.look_who_listens),
                (self.settings.exposure_rate_hz, self._publish_exposure),
                (DIAGNOSTICS_RATE_HZ, self._publish_diagnostics),
                (SNAPSHOT_RATE_HZ, self._publish_snapshot),
                (LOOK_RATE_HZ, self._sensors.look_around),
                (KEEP_RATE_HZ, self._keep),
            )
        ]
        if self.settings.dashboard:
            self._page = PageChild(self.get_fully_qualified_name(), self.context.get_domain_id(), self._serving)
            self.get_logger().info(f"the page: {self._page.link}")
        self.get_logger().info(f"predicting for {self.pipeline.subject.name}, listening to {len(SENSORS)} sensors")

    def _deactivate(self) -> None:
        self._end_page()
        if self._sensors is not None:
            self._sensors.close()
        for timer in self._timers_made:
            self.destroy_timer(timer)
        self._timers_made = []

    def _cleanup(self) -> None:
        self._keep_for_the_last_time()
        self._answers.close()
        for service in self._services_made:
            self.destroy_service(service)
        self._sensors = self.pipeline = None

    def last_stages(self) -> tuple[tuple[str, Callable[[], None]], ...]:
        """What is to be done at the end, by name: exposure first, whatever hangs behind it; the page ends meanwhile."""
        return (
            ("the exposure file", self._keep_for_the_last_time),
            ("asking the page", self._ask_page),
            ("the node", super().destroy_node),
            ("the page", self._end_page),
        )

    def destroy_node(self) -> None:
        """Leave nothing behind but the exposure that is kept."""
        for _, run in self.last_stages():
            run()

    def _ask_page(self) -> None:
        if self._page is not None:
            self._page.request_end()

    def _end_page(self) -> None:
        page, self._page = self._page, None
        if page is not None:
            page.end()

    def _warn_of_slow_kernels(self, rate_hz: float) -> None:
        if not kernels.COMPILED:
            self.get_logger().warning(
                f"numba is missing or switched off: kernels run uncompiled and keep up to {rate_hz:.0f} Hz per sensor"
            )

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        """Parameters are read on configure; a change that would do nothing until then is refused, not swallowed."""
        ours = [change.name for change in changes if change.name in params.names(SETTINGS)]
        if ours and self.pipeline is not None:
            return SetParametersResult(successful=False, reason=f"{ours[0]} is read on configure: clean up first")
        return SetParametersResult(successful=True)

    # --- samples in, answers out -------------------------------------------------------------------------------------

    def _take(self, sensor: str, stamps_ns: Integers, accel_mps2: Floats) -> None:
        if self._keeper is not None and self._keeper.waits and stamps_ns[0] != 0:  # zero was never set
            self.get_logger().warning(self._keeper.begin(self.pipeline, sensor, int(stamps_ns[0])))
        frames = self.pipeline.push(sensor, stamps_ns, accel_mps2)
        self._answers.frames(frames)
        self._showing.add(frames)

    def _publish_exposure(self) -> None:
        self._answers.exposure(self.pipeline)

    def _publish_diagnostics(self) -> None:
        self._statuses = self._watch.look(arrivals_tell=not self.get_clock().ros_time_is_active)
        if self._keeper is not None:
            self._statuses.append(keeping_status(self._keeper))
        if self._page is not None:
            self._statuses.append(page_status(self._page.address, self._page.failure))
        self._answers.diagnostics(self._statuses)

    def _publish_snapshot(self) -> None:
        """What the page shows, for whoever looks; shocks are found whether anybody does or not."""
        self._showing.gather()
        if self._statuses and self._answers.snapshot_is_wanted:
            snapshot = self._showing.snapshot(self.pipeline, self._statuses, self._watch.marks)
            self._answers.snapshot(json.dumps(snapshot, allow_nan=False))

    def _tell_of_timer(self, why: str) -> None:
        self.get_logger().error(f"timer: {why}", throttle_duration_sec=1.0)

    # --- exposure across restarts ------------------------------------------------------------------------------------

    def _new_keeper(self, subject: Subject) -> ExposureStore | None:
        """Where exposure is kept; a place that cannot be written to is told, and costs nobody the ride."""
        mapping = {sensor: self.resolve_topic_name(topic) for sensor, topic in topics.INPUT.items()}
        belongs, s = belongs_to(subject, mapping), self.settings
        try:
            path = state_path(s.state_file, self.get_fully_qualified_name())
            return (
                None if path is None else ExposureStore(StateFile(path), belongs, s.exposure_max_age_h, s.kept_exposure)
            )
        except InputError as error:
            if s.state_file:
                raise
            self.get_logger().warning(f"exposure is not kept across restarts: {error}")
            return None

    def _keep(self) -> None:
        if self._keeper is not None:
            self._keeper.keep(self.pipeline)

    def _keep_for_the_last_time(self) -> None:
        keeper, self._keeper = self._keeper, None
        if keeper is not None and self.pipeline is not None:
            guarded(keeper.close, self.get_logger().error)(self.pipeline)

    # --- services ----------------------------------------------------------------------------------------------------

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.pipeline.reset()
        kept = self._keeper.reset() if self._keeper is not None else ""
        return self._done(response, f"exposure since reset starts anew{kept and f'; {kept}'}")

    def _on_mark(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        mark = self._watch.mark(1e-9 * self.get_clock().now().nanoseconds)
        self._answers.mark(mark)
        return self._done(response, str(mark))

    def _done(self, response: Trigger.Response, message: str) -> Trigger.Response:
        self.get_logger().info(message)
        response.success, response.message = True, message
        return response


def main(args: list[str] | None = None) -> int:
    """Run the live node until SIGINT or SIGTERM; exit code 2, with one line, when it cannot start."""
    with Shutdown("biodyn live", interrupts=True) as shutdown:
        try:
            given = sys.argv if args is None else ["biodyn_live", *args]
            rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
        except RCLError as error:  # arguments that ROS cannot read; behind ", at /" it says where in its own source
            print(f"biodyn live: {str(error).partition(', at /')[0]}", file=sys.stderr)
            return 2
        try:
            return _run(shutdown)
        except InputError as error:
            print(f"biodyn live: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:  # before it was up
            return 0
        finally:
            shutdown.run_stages([("the ROS context", rclpy.try_shutdown)])


def _run(shutdown: Shutdown) -> int:
    """Start the node, spin until a signal comes, and end it; the exit code."""
    shutdown.stage = "the start"
    node = BiodynNode()
    executor = make_executor()
    try:
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
        ended = Future()
        shutdown.interrupts, shutdown.stage = False, "a callback"
        shutdown.on_request(lambda: ended.set_result(None))
        spin(executor, ended)
        return 0
    finally:
        shutdown.interrupts = False
        keep, *others = node.last_stages()
        shutdown.run_stages((keep, ("the executor", executor.shutdown), *others))
