"""A process' node in the ROS graph: joined as settings and command line say, and left in order.

``python -m valor.X --ros-args -p update_rate:=125.0 -r __ns:=/lab`` starts one by itself: whatever the instance's
settings say of the ROS domain and the middleware holds, where the environment says nothing else.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.lifecycle import LifecycleNode
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rclpy.time_source import CLOCK_TOPIC
from rclpy.utilities import remove_ros_args

from valor.common.errors import ConfigurationError
from valor.common.instance import Settings
from valor.ros.life import Life
from valor.ros.rosout import RosOut

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Of timers that go on while robot time stands."""
WALL = Clock(clock_type=ClockType.SYSTEM_TIME)
ATTENDED = 4  # callbacks in one look of a process that does not spin


def _never() -> bool:
    return False


class Untouched(CallbackGroup):  # type: ignore[misc]  # rclpy is untyped
    """Of subscriptions that no executor takes from: the process looks into their queues itself."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


class ProcessNode(LifecycleNode):  # type: ignore[misc]  # rclpy is untyped
    """A node; where its process knows robot time by itself it does not listen to ``/clock``.

    Attributes:
        others: other computers may command: what they send must be timely.
    """

    def __init__(self, name: str, context: rclpy.Context, knows_time: bool = False, *, others: bool = False) -> None:
        """Join.

        Args:
            name: unless remapped.
            context: initialized.
            knows_time: the process calls ``tell_time``.
            others: as the attribute.
        """
        self._knows_time = knows_time
        self.others = others
        super().__init__(name, context=context)

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any) -> Any:
        """As rclpy's, but for the time source's, where the process knows better."""
        if topic == CLOCK_TOPIC and self._knows_time:
            return None
        return super().create_subscription(msg_type, topic, callback, qos_profile, **options)

    def tell_time(self, time: int) -> None:
        """Robot time [ns], which the node's clock shows under ``use_sim_time``."""
        self.get_clock().set_ros_time_override(Time(nanoseconds=time, clock_type=ClockType.ROS_TIME))


class RosSide:
    """Context, node, executor, life and ``/rosout`` of a process.

    Attributes:
        context: not the global one.
        node: with the parameter ``use_sim_time`` as the instance has it: true in simulation.
        executor: that spins the node; whose thread does is for the process to say.
        life: of the node.
    """

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
            environment: that goes with it.
            arguments: of the command line, without the program.
            node: makes it.
            sim_time: of ``use_sim_time``, unless an argument sets it; None: whether the instance is a simulation.
            pause: as of ``Life``.

        Raises:
            ConfigurationError: the arguments are not ROS arguments.
        """
        for key, value in environment.items():
            os.environ.setdefault(key, value)
        simulated = settings.variant == "simulation" if sim_time is None else sim_time
        self.context = rclpy.Context()
        try:
            # Signals are the process' own: it ends its loop first and ROS last. Of two values for a parameter the
            # later one counts, of two remappings the earlier one.
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
            raise ConfigurationError(f"arguments {others}: expected ROS arguments alone, behind --ros-args")
        self.node = node(name, self.context)
        self._rosout = RosOut(self.node)
        self.life = Life(self.node, pause, settings.ros_refusal)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def attend(self) -> None:
        """Answer what has come, without waiting; for processes that do not spin."""
        for _ in range(ATTENDED):
            # As its spin_once, which does not say that nothing has come: each look costs as much as a message.
            try:
                task, _entity, _node = self.executor.wait_for_ready_callbacks(0.0, None, _never)
            except (TimeoutException, ShutdownException):
                return
            task()
            task.result()

    def close(self) -> None:
        """The last words, then leave; nobody spins any more."""
        self.life.finish()
        self._rosout.finish()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
