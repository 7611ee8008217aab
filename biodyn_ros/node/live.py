"""The live node: parameters to settings, messages to arrays, results to messages; no mathematics.

One lifecycle node named `biodyn`. It receives by `subscriptions`, drives the `Pipeline`, and publishes by
`publications`. Exposure runs on data time, watchdogs on a steady clock.
"""

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
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
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.exposure.limits import EU_LIMITS, load_limits
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_core.pipeline.fit_monitor import sensor_effects
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.base import topics
from biodyn_ros.base.resources import subject_file
from biodyn_ros.base.shutdown import Shutdown
from biodyn_ros.base.wording import compared_without
from biodyn_ros.dashboard.child import PageChild
from biodyn_ros.dashboard.settings import ServingSettings, check_page, port_is_free
from biodyn_ros.node import params
from biodyn_ros.node.callbacks import guarded, make_executor, spin
from biodyn_ros.node.exposure_store import ExposureStore, StateFile, identity_of, state_path
from biodyn_ros.node.health import HealthMonitor, Status, page_status, sending_status, storage_status
from biodyn_ros.node.publications import Publications
from biodyn_ros.node.settings import SETTINGS, LiveSettings
from biodyn_ros.node.snapshot_builder import SnapshotBuilder
from biodyn_ros.node.subscriptions import Subscriptions
from biodyn_ros.node.warmup import warm_up

DRAIN_RATE_HZ: Final = 30.0
"""One of the six sensors is served at each tick, so that a drain delays the seat only briefly."""

QUEUED_PER_S: Final = 2 * 1129.3
"""With a short queue the ticks follow faster, so that a queue is at most half full at the nominal rate."""

REFRESH_RATE_HZ: Final = 20.0
"""How often topics are checked for subscribers.

Without a subscriber to samples, blocks have this rate, because longer blocks cost less.
"""

DIAGNOSTICS_RATE_HZ: Final = 2.0
SNAPSHOT_RATE_HZ: Final = 4.0
STORE_RATE_HZ: Final = 0.5
"""How often exposure is stored: a node that is killed loses the time since, and reports it as missing."""

TRANSPORT_RATE_HZ: Final = 1.0
"""How often publishers are checked, and one of the six clocks, which takes a millisecond or two."""


class BiodynNode(LifecycleNode):
    """The pipeline as a lifecycle node: configured with a subject, active while it receives and publishes.

    failure: reason of the last transition that failed. pipeline: None while the node is not configured.
    """

    _sensors: Subscriptions | None = None  # before rclpy's own start asks for the subscriptions

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(topics.NODE_NAME, **kwargs)
        samples = (
            *topics.PREDICTED.values(), *topics.MEASURED.values(), topics.PREDICTED_BLOCK, topics.MEASURED_BLOCK
        )  # fmt: skip
        qos = params.qos_overrides(self, topics.INPUT.values(), "subscription")
        params.declare(self, SETTINGS, qos | params.qos_overrides(self, samples, "publisher"))
        self.failure: str | None = None
        self.pipeline: Pipeline | None = None
        self._exposure: ContinuedExposure | None = None
        self._store: ExposureStore | None = None
        self._waiting: list[tuple[str, Integers, Floats]] = []
        self._page: PageChild | None = None
        self._statuses: list[Status] = []
        self._node_timers: list[Any] = []
        self.add_on_set_parameters_callback(self._on_parameters)

    # --- lifecycle ---------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read subject and settings, compile the kernels, create publishers and services."""
        return self._transition("configure", self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the sensors and start the timers."""
        return self._transition("activate", self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop receiving; exposure stays as it is."""
        return self._transition("deactivate", self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop subject and filters; exposure stays in its file."""
        return self._transition("clean up", self._cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop receiving, in any state."""
        return self._transition("shut down", self._deactivate)

    def _transition(self, name: str, step: Callable[[], None]) -> TransitionCallbackReturn:
        """Run one transition, and log an exception in one line, because rclpy drops it."""
        try:
            step()
        except Exception as error:  # noqa: BLE001 - the state machine must go on, and the cause is logged
            self.failure = one_line(error)
            self.get_logger().error(f"cannot {name}: {self.failure}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        """Prepare everything; a failure leaves no publisher and no service of a node that is not configured."""
        publishers, services = set(self.publishers), set(self.services)
        try:
            self._prepare()
        except Exception:
            for publisher in set(self.publishers) - publishers:
                self.destroy_publisher(publisher)
            for service in set(self.services) - services:
                self.destroy_service(service)
            self._sensors = self._exposure = self._store = None
            raise

    def _prepare(self) -> None:
        self.settings, self._serving = params.read(self, LiveSettings), params.read(self, ServingSettings)
        if self.settings.dashboard:
            check_page()
        subject = load_subject(subject_file(self.settings.subject_file))
        given = self.settings.limits_file
        limits = load_limits(Path(given).expanduser()) if given else EU_LIMITS
        conditioning, settings = params.read(self, ConditioningSettings), params.read(self, PipelineSettings)
        self._warn_of_slow_kernels(warm_up(subject))
        pipeline = Pipeline(subject, conditioning, settings, limits)
        for name, effects in sensor_effects(subject).items():
            self.get_logger().warning(f"{name}: {compared_without(effects)}")
        self._exposure, self._store, self._waiting = ContinuedExposure(pipeline), self._new_store(subject), []
        self._snapshots = SnapshotBuilder(self.settings.shock_mps2)
        self._sensors = Subscriptions(
            self, self.settings.queue_depth, settings.window_s, self._push, lambda: pipeline.overdue,
            singly=not self.settings.block_ms,
        )  # fmt: skip
        self._health, self._statuses = HealthMonitor(pipeline, self._sensors.health), []
        forces_known = subject.mass_matrix == "segment"
        self._publications = Publications(self, self.settings.publish_measured, forces_known)
        self._node_services = [
            self.create_service(Trigger, topics.RESET, self._on_reset),
            self.create_service(Trigger, topics.MARK, self._on_mark),
        ]
        self.pipeline = pipeline  # last: with it the node is configured

    def _activate(self) -> None:
        """Start everything; a failure stops what has started, or a second attempt would receive each sample twice."""
        try:
            self._start()
        except Exception:
            self._deactivate()
            raise

    def _start(self) -> None:
        self._sensors.open()
        self._publications.update_subscribers()
        block_ms = self.settings.block_ms
        self._start_timers(
            [
                (1e3 / block_ms if block_ms else REFRESH_RATE_HZ, self._take_block),
                (max(DRAIN_RATE_HZ, len(SENSORS) * QUEUED_PER_S / self.settings.queue_depth), self._sensors.drain),
                (REFRESH_RATE_HZ, self._update_subscribers),
            ]
        )
        self._start_timers(
            [
                (self.settings.exposure_rate_hz, lambda: self._publications.exposure(self.pipeline, self._statuses)),
                (DIAGNOSTICS_RATE_HZ, self._publish_diagnostics),
                (SNAPSHOT_RATE_HZ, self._publish_snapshot),
                (TRANSPORT_RATE_HZ, self._sensors.check_transport),
                (STORE_RATE_HZ, self._store_exposure),
            ]
        )
        if self.settings.dashboard:
            self._start_page()
        self.get_logger().info(f"predicting for {self.pipeline.subject.name}, listening to {len(SENSORS)} sensors")

    def _start_page(self) -> None:
        is_free = port_is_free(self._serving)
        self._page = PageChild(self.get_fully_qualified_name(), self.context.get_domain_id(), self._serving)
        if is_free:
            self.get_logger().info(f"the page: {self._page.link}")
        else:  # the link would open the page of another node
            self.get_logger().error(f"the page cannot be served at {self._page.address}: set another page_port")

    def _start_timers(self, rates: list[tuple[float, Callable[[], None]]]) -> None:
        """Start timers on a steady clock of their own: rcl warns of more than seven on one clock."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for rate_hz, callback in rates:
            run = guarded(partial(self._on_timer, callback), self._log_timer_error)
            self._node_timers.append(self.create_timer(1.0 / rate_hz, run, clock=steady))

    def _on_timer(self, callback: Callable[[], None]) -> None:
        """Run a timer's callback; after the end of the timers the executor may still call one that was due before."""
        if self._node_timers:
            callback()

    def _deactivate(self) -> None:
        if self._sensors is not None:
            self._sensors.close()
        for timer in self._node_timers:
            self.destroy_timer(timer)
        self._node_timers = []
        self._end_page()

    def _cleanup(self) -> None:
        self._deactivate()  # without a pipeline a timer would raise at every tick
        self._close_store()
        self._publications.close()
        for service in self._node_services:
            self.destroy_service(service)
        self._sensors = self.pipeline = self._exposure = None

    def shutdown_steps(self) -> tuple[tuple[str, Callable[[], None]], ...]:
        """The steps of a shutdown, by name: exposure first, because later ones may hang; the page ends in parallel."""
        return (
            ("the exposure file", self._close_store),
            ("asking the page", self._ask_page),
            ("the node", super().destroy_node),
            ("the page", self._end_page),
        )

    def destroy_node(self) -> None:
        """End everything; the exposure file remains."""
        for _, run in self.shutdown_steps():
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
        """Refuse a change after configure, where parameters are read: it would have no effect."""
        ours = [change.name for change in changes if change.name in params.names(SETTINGS)]
        if ours and self.pipeline is not None:
            return SetParametersResult(successful=False, reason=f"{ours[0]} is read on configure: clean up first")
        return SetParametersResult(successful=True)

    # --- samples in, results out -------------------------------------------------------------------------------------

    def _push(self, sensor: str, stamps_ns: Integers, accel_mps2: Floats) -> None:
        """Process samples; they wait while the stored exposure awaits the stamps that decide whether it continues."""
        samples = sensor, stamps_ns, accel_mps2
        if self._store is None or not self._store.pending or not stamps_ns.any():  # stamps of zero decide nothing
            self._process(*samples)
            return
        self._waiting.append(samples)
        if message := self._store.begin(self._exposure, sensor, stamps_ns):
            self.get_logger().warning(message)
            self._process_waiting()

    def _process_waiting(self) -> None:
        """Process the samples that wait."""
        waiting, self._waiting = self._waiting, []
        for samples in waiting:
            guarded(self._process, self._log_sample_error)(*samples)

    def _process(self, sensor: str, stamps_ns: Integers, accel_mps2: Floats) -> None:
        frames = self._exposure.push(sensor, stamps_ns, accel_mps2)
        self._publications.frames(frames)
        self._snapshots.add(frames)
        if not self.settings.block_ms:
            self._publications.blocks()

    def _take_block(self) -> None:
        if self.settings.block_ms:
            self._sensors.take_seat()
            self._publications.blocks()

    def _update_subscribers(self) -> None:
        """Check which topics have subscribers; the timer of the blocks runs while one with samples has."""
        self._publications.update_subscribers()
        timer = self._node_timers[0]
        if not self._publications.has_sample_subscriber:
            timer.cancel()
            self._take_block()
        elif timer.is_canceled():
            timer.reset()

    @property
    def subscriptions(self) -> Iterator[Any]:
        """The subscriptions that an executor serves; the others are read in blocks."""
        drained = [] if self._sensors is None else self._sensors.drained
        return (one for one in super().subscriptions if one not in drained)

    def _publish_diagnostics(self) -> None:
        for mark in self._health.misfit_marks():
            self.get_logger().warning(str(mark))
            self._publications.mark(mark)
        self._statuses = self._health.check(compare_clocks=not self.get_clock().ros_time_is_active)
        budget = self._publications.budget
        self._statuses.append(sending_status(budget.paused, budget.unsent))
        if self._store is not None:
            self._statuses.append(storage_status(self._store))
        if self._page is not None:
            self._statuses.append(page_status(self._page.address, self._page.failure))
        self._publications.diagnostics(self._statuses)

    def _publish_snapshot(self) -> None:
        """Publish the page's content where it is subscribed to; shocks are found in any case."""
        self._snapshots.update()
        if self._statuses and self._publications.has_snapshot_subscriber:
            snapshot = self._snapshots.snapshot(self.pipeline, self._statuses, self._health.marks)
            self._publications.snapshot(json.dumps(snapshot, allow_nan=False))

    def _log_timer_error(self, error: str) -> None:
        self.get_logger().error(f"timer: {error}", throttle_duration_sec=1.0)

    def _log_sample_error(self, error: str) -> None:
        self.get_logger().error(f"first samples: {error}", throttle_duration_sec=1.0)

    # --- exposure across restarts ------------------------------------------------------------------------------------

    def _new_store(self, subject: Subject) -> ExposureStore | None:
        """The store of the exposure file; a default path that cannot be written does not stop the node."""
        mapping = {sensor: self.resolve_topic_name(topic) for sensor, topic in topics.INPUT.items()}
        identity, s = identity_of(subject, mapping), self.settings
        try:
            path = state_path(s.state_file, self.get_fully_qualified_name(), self.context.get_domain_id())
            return path and ExposureStore(StateFile(path), identity, s.exposure_max_age_h, s.kept_exposure)
        except InputError as error:
            if s.state_file:
                raise
            self.get_logger().warning(f"exposure is not stored across restarts: {error}")
            return None

    def _store_exposure(self) -> None:
        if self._store is not None:
            self._store.save(self._exposure)

    def _close_store(self) -> None:
        store, self._store = self._store, None
        if store is not None and self._exposure is not None:
            guarded(store.close, self.get_logger().error)(self._exposure)

    # --- services ----------------------------------------------------------------------------------------------------

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        stored = self._store.reset() if self._store is not None else ""
        if self._sensors is not None:
            self._sensors.take_all()  # they came before the reset, and so did those that wait
        self._process_waiting()
        self._exposure.reset()
        return self._done(response, f"exposure since reset is set to zero{stored and f'; {stored}'}")

    def _on_mark(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        mark = self._health.mark(1e-9 * self.get_clock().now().nanoseconds)
        self._publications.mark(mark)
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
        except RCLError as error:  # unreadable arguments; ", at /" begins a place in ROS's own source
            print(f"biodyn live: {str(error).partition(', at /')[0]}", file=sys.stderr)
            return 2
        try:
            return _run(shutdown)
        except InputError as error:
            print(f"biodyn live: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:  # before the node was up
            return 0
        finally:
            shutdown.run_stages([("the ROS context", rclpy.try_shutdown)])


def _run(shutdown: Shutdown) -> int:
    """Start the node, spin until a signal comes, and end it; return the exit code."""
    shutdown.stage = "the start"
    node = BiodynNode()
    executor = make_executor()
    store, ask_page, destroy, page = node.shutdown_steps()
    stages = (store, ("the executor", executor.shutdown), ask_page, destroy, page)
    try:
        executor.add_node(node)
        if params.read(node, LiveSettings).autostart:
            node.trigger_configure()
            if node.failure is None:
                node.trigger_activate()
            if node.failure is not None:
                return 2
        # The objects of now live as long as the process: excluded from garbage collection, they cost no milliseconds.
        gc.collect()
        gc.freeze()
        ended = Future()
        shutdown.interrupts, shutdown.stage = False, "a callback"
        shutdown.on_request(lambda: ended.set_result(None))
        spin(executor, ended)
    except KeyboardInterrupt:  # in the middle of a call of rclpy, whose node may be incomplete and is not destroyed
        stages = (store, ask_page, page)
    finally:
        shutdown.interrupts = False
        shutdown.run_stages(stages)
    return 0
