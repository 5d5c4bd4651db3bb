"""The loop: commands of the Comms Manager to the driver, states of the driver to the Comms Manager.

Nothing is kept but the newest message of each topic in each direction: on Bifrost by subscribers that hold one, on
ROS by queues of depth 1. So nobody waits for anybody, neither side notices that the other begins anew, and what a side
missed while it was away is not made up. What may move an arm is for those at the ends to decide.
"""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from valor_msgs.msg import HdtCommand as RosCommand
from valor_msgs.msg import HdtState as RosState

import bifrost
from valor.common.errors import ConfigurationError
from valor.common.messages import HdtCommand, HdtState
from valor.common.topics import STATISTICS, hdt_topics
from valor.devices.table import HdtBifrost
from valor.hdt_bridge.driver_report import DRIVER, statistics
from valor.hdt_bridge.twin import Twin
from valor.ros.node import WALL, RosSide, Untouched
from valor.ros.taking import take, uncalled, waiting
from valor.service import Context, quiet_collector

LOOK_EVERY = 0.004  # at ROS, which nobody waits for [s]

_NEWEST = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


class _Limb:
    """The two topics of a limb, on both sides."""

    def __init__(self, bifrost_node: bifrost.Node, ros_node: Any, untouched: Untouched, name: str) -> None:
        commands, states = hdt_topics(name)
        self.commands, self._states = commands.subscriber(bifrost_node), states.publisher(bifrost_node)
        self._ros_commands = ros_node.create_publisher(RosCommand, f"hdt/{name}/command", _NEWEST)
        self._ros_states = ros_node.create_subscription(
            RosState, f"hdt/{name}/state", uncalled, _NEWEST, callback_group=untouched, raw=True
        )
        self._command, self._state = Twin(HdtCommand, RosCommand), Twin(HdtState, RosState)

    def forward_command(self) -> bool:
        """To ROS, if there is a new one; whether there was."""
        received = self.commands.latest()
        if received is not None:
            self._ros_commands.publish(self._command.to_ros(received, WALL.now().nanoseconds))
        return received is not None

    def forward_state(self) -> bool:
        """To Bifrost, if there is a new one; whether there was."""
        taken = take(self._ros_states)
        if taken is not None:
            self._states.publish(self._state.from_ros(taken[0]))
        return taken is not None


class HdtBridge:
    """Bifrost ↔ ROS for all limbs, and the driver's word of itself."""

    def __init__(self, context: Context) -> None:
        self._stopping = context.stopping
        self._own = context.statistics
        devices = context.robot.tables.devices.values()
        names = [limb.group for device in devices if isinstance(device, HdtBifrost) for limb in device.limbs]
        if not names:
            raise ConfigurationError(f"{context.robot.folder / 'robot.yaml'}: devices: none of kind hdt_bifrost")
        self._side = RosSide(
            context.name, context.settings, context.instance.environment(), context.arguments, sim_time=False
        )
        node, untouched = self._side.node, Untouched()
        self._limbs = [_Limb(context.node, node, untouched, name) for name in names]
        self._diagnostics = node.create_subscription(
            DiagnosticArray, "diagnostics", uncalled, 10, callback_group=untouched
        )
        self._side.life.configured()
        self._driver = STATISTICS[DRIVER].publisher(context.node)

    def run(self) -> None:
        """Forward until told to stop."""
        quiet_collector()
        self._own.state("ready")
        self._side.life.tell(True)
        limbs = {limb.commands: limb for limb in self._limbs}
        commands = bifrost.Poller(list(limbs))
        look_at = 0.0
        while not self._stopping.is_set():
            began = time.perf_counter()
            ready = commands.look(LOOK_EVERY)
            waited = time.perf_counter() - began
            news = False
            for each in ready:
                news = limbs[each].forward_command() or news
            for limb in self._limbs:
                news = limb.forward_state() or news
            if began >= look_at:
                look_at = began + 0.1
                self._tell_of_driver()
                self._side.attend()
            if news:
                self._own.cycle(began, waited)
            else:
                self._own.idle()
        commands.close()

    def close(self) -> None:
        """Leave ROS."""
        self._side.close()

    def _tell_of_driver(self) -> None:
        for message in waiting(self._diagnostics):
            if (report := statistics(message)) is not None:
                self._driver.publish(report)
