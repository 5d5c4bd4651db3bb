"""A process' node in the ROS graph: settings, executor and life cycle. The environment overrides the settings."""

import logging
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import Log
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rclpy.time_source import CLOCK_TOPIC
from rclpy.utilities import remove_ros_args

from valor.common.errors import ConfigurationError
from valor.common.instance import Settings

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of timers that run while robot time stands still."""
WALL = Clock(clock_type=ClockType.SYSTEM_TIME)
MAX_CALLBACKS = 4  # per call of ``serve_pending``


class ProcessNode(LifecycleNode):  # type: ignore[misc]  # rclpy is untyped
    """Node of a process. With ``sets_time`` its process calls ``set_time``, and it does not subscribe to ``/clock``."""

    def __init__(self, name: str, context: rclpy.Context, sets_time: bool = False, *, others: bool = False) -> None:
        self._sets_time = sets_time
        self.others = others  # other hosts may command: their commands are checked for lateness
        super().__init__(name, context=context)

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any) -> Any:
        """Subscribe, except to ``/clock`` if the process sets the time."""
        if topic == CLOCK_TOPIC and self._sets_time:
            return None
        return super().create_subscription(msg_type, topic, callback, qos_profile, **options)

    def set_time(self, time: int) -> None:
        """Set robot time [ns], the time of the node's clock under ``use_sim_time``."""
        self.get_clock().set_ros_time_override(Time(nanoseconds=time, clock_type=ClockType.ROS_TIME))


class RosSide:
    """Context, node, executor, life cycle and ``/rosout`` of a process."""

    def __init__(
        self,
        name: str,
        settings: Settings,
        environment: Mapping[str, str],
        arguments: Sequence[str],
        *,
        node: Callable[[str, rclpy.Context], ProcessNode] = ProcessNode,
        sim_time: bool | None = None,
        pause: Callable[[], str] | None = None,
    ) -> None:
        """Join the instance's ROS domain.

        Args:
            name: of the node.
            settings: of the instance.
            environment: of the instance.
            arguments: of the command line, without the program.
            node: creates it.
            sim_time: ``use_sim_time``, unless an argument sets it; None: whether the instance is a simulation.
            pause: returns the reason against a pause now, empty if there is none; None: pauses are not supported.

        Raises:
            ConfigurationError: invalid ROS arguments.
        """
        for key, value in environment.items():
            os.environ.setdefault(key, value)
        simulated = settings.variant == "simulation" if sim_time is None else sim_time
        self.context = rclpy.Context()  # separate from the global one
        try:
            # The process handles signals: it ends its loop first and ROS last. Of two values of a parameter the later
            # one applies, of two remappings the earlier one.
            rclpy.init(
                args=[
                    *("--ros-args", "-p", f"use_sim_time:={str(simulated).lower()}", "--"),
                    *arguments,
                    *settings.ros_arguments,
                ],
                context=self.context,
                domain_id=settings.ros_domain_id,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            others = remove_ros_args(list(arguments))
        except Exception as error:
            raise ConfigurationError(f"ROS arguments {list(arguments)}: {' '.join(str(error).split())}") from None
        if others:
            self.context.try_shutdown()
            raise ConfigurationError(f"arguments {others}: expected only ROS arguments, after --ros-args")
        self.node = node(name, self.context)  # its ``use_sim_time`` is true in simulation
        self._rosout = RosOut(self.node)
        self.life = Life(self.node, pause, settings.ros_refusal)  # life cycle of the node
        self.executor = SingleThreadedExecutor(context=self.context)  # of the node; the process spins it
        self.executor.add_node(self.node)

    def serve_pending(self, most: int = MAX_CALLBACKS) -> None:
        """Run ``most`` waiting callbacks, for processes that do not spin."""
        for _ in range(most):
            # As spin_once, which does not report that nothing waits: each call costs as much as a message.
            try:
                task, _entity, _node = self.executor.wait_for_ready_callbacks(0.0, None, lambda: False)
            except (TimeoutException, ShutdownException):
                return
            task()
            task.result()

    def close(self) -> None:
        self.life.finish()
        self._rosout.finish()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


_NAMES = {Transition.TRANSITION_ACTIVATE: "activate", Transition.TRANSITION_DEACTIVATE: "deactivate"}
_log = logging.getLogger("lifecycle")


class Life:
    """Life cycle of a managed node (https://design.ros2.org/articles/node_lifecycle.html).

    The process configures the node at its start, activates it while it can work, and finalizes it at its end. Clients
    may pause it (``deactivate``, ``activate``) if the process supports that. Transitions run in the spinning thread.
    """

    def __init__(self, node: LifecycleNode, pause: Callable[[], str] | None, rejection: str) -> None:
        """``pause``: see ``RosSide``; ``rejection``: reason to reject clients' transitions, empty if there is none."""
        self._node, self._pause, self._rejection = node, pause, rejection
        self._ready, self._waits_for = False, "starting"
        self._active = False
        self.paused = False  # by a client
        self._guard = node.create_guard_condition(self._follow)
        # rclpy's callback would only move the state machine.
        node._service_change_state.callback = self._change

    def configure(self) -> None:
        """Configure the node after its interfaces are open, before it is spun."""
        self._node.trigger_configure()

    def set_ready(self, ready: bool, waits_for: str = "") -> None:
        """Set whether the process can work, or what it waits for. From any thread."""
        if (ready, waits_for) != (self._ready, self._waits_for):
            self._ready, self._waits_for = ready, waits_for
            self._guard.trigger()

    def finish(self) -> None:
        """Finalize the node after the last spin."""
        self._ready = False
        self._follow()
        self._node.trigger_shutdown()

    def _follow(self) -> None:
        active = self._ready and not self.paused
        if active != self._active:
            self._active = active
            (self._node.trigger_activate if active else self._node.trigger_deactivate)()

    def _change(self, request: Any, response: Any) -> Any:
        name = request.transition.label[:64] or _NAMES.get(request.transition.id, str(request.transition.id))
        reason = self._rejection or self._reason_against(name)
        response.success = not reason
        if reason:
            _log.warning("change_state %s rejected: %s", name, reason)
        else:
            _log.info("%sd by a client", name)
            self.paused = name == "deactivate"
            self._follow()
        return response

    def _reason_against(self, name: str) -> str:
        """Reason to reject a transition; empty if there is none."""
        if name == "deactivate":
            if self._pause is None:
                return "it is active while its inputs are available"
            return self._pause() if self._active else "it is not active"
        if name == "activate":
            if self.paused:
                return ""
            return "it is active" if self._active else f"it waits for {self._waits_for}"
        return "expected activate or deactivate; valorctl or a launch file configures the process and shuts it down"


TOPIC = "/rosout"
LEAVING = Duration(seconds=0.5)  # timeout of the last lines
_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # as rcl's


class Sieve:
    """Rate limit of lines per text, per call, and in total."""

    WINDOW = 1.0  # [s]
    ALIKE = 2  # of the same text
    OF_A_KIND = 10  # of the same call with any arguments
    IN_ALL = 50

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._started = -self.WINDOW
        self._seen: Counter[object] = Counter()
        self._passed = self._omitted = 0

    def passes(self, kind: object, text: str) -> bool:
        now = self._clock()
        if now - self._started >= self.WINDOW:
            self._started, self._passed = now, 0
            self._seen.clear()
        of_kind, alike = self._seen[kind], self._seen[(kind, text)]
        if self._passed >= self.IN_ALL or of_kind >= self.OF_A_KIND or alike >= self.ALIKE:
            self._omitted += 1
            return False
        self._passed += 1
        self._seen.update((kind, (kind, text)))
        return True

    def omitted(self) -> int:
        count, self._omitted = self._omitted, 0
        return count


class RosOut(logging.Handler):
    """Publishes log records from INFO on, on ``/rosout``, at a bounded rate, while the node is spun.

    Lines wait in a queue, so that logging never blocks; the log file has all lines.
    """

    QUEUE = 200  # lines; the oldest are dropped

    def __init__(self, node: Node) -> None:
        super().__init__(logging.INFO)
        self._name = node.get_logger().name
        self._sieve = Sieve()
        self._waiting: deque[Log] = deque(maxlen=self.QUEUE)
        self._publisher = node.create_publisher(Log, TOPIC, _QOS)
        self._guard = node.create_guard_condition(self._publish)
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a line if the rate allows it. From any thread."""
        try:
            text = record.getMessage()
            if not self._sieve.passes((record.name, record.levelno, record.msg), text):
                return
            if missing := self._sieve.omitted():
                self._queue(logging.WARNING, f"{missing} lines omitted: too many; the log file has them all")
            if record.exc_info and record.exc_info[1] is not None:
                text = f"{text}: {type(record.exc_info[1]).__name__}: {record.exc_info[1]}"
            self._queue(record.levelno, text, record)
            self._guard.trigger()
        except Exception:  # as in every handler: a failure must not end the caller
            self.handleError(record)

    def _queue(self, level: int, text: str, record: logging.LogRecord | None = None) -> None:
        line = Log(level=min(level // 10 * 10, logging.CRITICAL))  # Log uses logging's numbers
        line.stamp.sec, line.stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
        line.name, line.msg = self._name, text
        if record is not None:
            line.file, line.function, line.line = f"{record.module}.py", record.funcName or "", record.lineno
        self._waiting.append(line)

    def _publish(self) -> None:
        while self._waiting:
            self._publisher.publish(self._waiting.popleft())

    def finish(self) -> None:
        """Publish the last lines, after the last spin."""
        logging.getLogger().removeHandler(self)
        self._publish()
        self._publisher.wait_for_all_acked(LEAVING)
