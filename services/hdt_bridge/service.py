"""The bridge's loop: commands of the Comms Manager to the driver, states of the driver to the Comms Manager.

Only the latest message of each topic is forwarded: Bifrost subscribers hold one, ROS queues have depth 1. Neither side
waits for the other or notices its restart, and missed messages are not repeated. The Comms Manager and the driver
decide which commands may move an arm.
"""

import time
from typing import Any

import msgspec
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from valor_msgs.msg import HdtCommand as RosCommand
from valor_msgs.msg import HdtState as RosState

import bifrost
from valor.common.errors import ConfigurationError
from valor.common.messages import HdtState, Statistics
from valor.common.topics import STATISTICS, hdt_topics
from valor.devices.table import HdtBifrost
from valor.ros.mirror import MirrorPublisher, from_ros
from valor.ros.node import RosSide
from valor.ros.taking import polled, take, waiting
from valor.service import Context, quiet_collector

DRIVER = "hdt_driver"
POLL_EVERY = 0.004  # period of polling ROS [s]

_LATEST = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


def statistics(message: Any) -> Statistics | None:
    """Statistics of the driver from a ``DiagnosticArray``; None if it holds none, or invalid ones."""
    for status in message.status:
        if status.name == DRIVER:
            ready = status.message == "ready"
            values: dict[str, Any] = {each.key: each.value for each in status.values}
            values |= {"service": DRIVER, "drops": 0}
            values |= {"state": "ready", "detail": ""} if ready else {"state": "starting", "detail": status.message}
            try:
                return msgspec.convert(
                    [values[name] for name in Statistics.__struct_fields__], Statistics, strict=False
                )
            except (KeyError, msgspec.ValidationError):
                return None
    return None


class _Limb:
    """The two topics of a limb, on both sides."""

    def __init__(self, bifrost_node: bifrost.Node, ros_node: Any, name: str) -> None:
        commands, states = hdt_topics(name)
        self.commands, self._states = commands.subscriber(bifrost_node), states.publisher(bifrost_node)
        self._ros_commands = MirrorPublisher(ros_node, RosCommand, f"hdt/{name}/command", _LATEST)
        self._ros_states = polled(ros_node, RosState, f"hdt/{name}/state", _LATEST)

    def forward_command(self) -> bool:
        """Publish a new command, if any, to ROS; returns whether there was one."""
        received = self.commands.latest()
        if received is not None:
            self._ros_commands.publish(received)
        return received is not None

    def forward_state(self) -> bool:
        """Publish a new state, if any, to Bifrost; returns whether there was one."""
        taken = take(self._ros_states)
        if taken is not None:
            self._states.publish(from_ros(HdtState, taken[0]))
        return taken is not None


class HdtBridge:
    """Forwards messages of all limbs between Bifrost and ROS, and the driver's statistics to Bifrost."""

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
        node = self._side.node
        self._limbs = [_Limb(context.node, node, name) for name in names]
        self._diagnostics = polled(node, DiagnosticArray, "diagnostics", 10)
        self._side.life.configure()
        self._driver = STATISTICS[DRIVER].publisher(context.node)

    def run(self) -> None:
        """Forward until the service is to stop."""
        quiet_collector()
        self._own.state("ready")
        self._side.life.set_ready(True)
        limbs = {limb.commands: limb for limb in self._limbs}
        commands = bifrost.Poller(list(limbs))
        look_at = 0.0
        while not self._stopping.is_set():
            began = time.perf_counter()
            ready = commands.look(POLL_EVERY)
            waited = time.perf_counter() - began
            news = False
            for each in ready:
                news = limbs[each].forward_command() or news
            for limb in self._limbs:
                news = limb.forward_state() or news
            if began >= look_at:
                look_at = began + 0.1
                self._report_driver()
                self._side.serve_pending()
            if news:
                self._own.cycle(began, waited)
            else:
                self._own.idle()
        commands.close()

    def close(self) -> None:
        """Close the ROS node."""
        self._side.close()

    def _report_driver(self) -> None:
        for message in waiting(self._diagnostics):
            if (report := statistics(message)) is not None:
                self._driver.publish(report)
