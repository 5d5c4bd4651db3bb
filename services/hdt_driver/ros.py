"""The driver's ROS node: commands in, states and diagnostics out. Nothing spins: a look at each topic in every cycle.

========================= ============================== ===================================================
``/hdt/<limb>/command``   ``valor_msgs/HdtCommand``      best effort; the newest counts
``/hdt/<limb>/state``     ``valor_msgs/HdtState``        best effort; at the driver's rate
``/diagnostics``          ``diagnostic_msgs``            once a second: the driver itself and each limb
========================= ============================== ===================================================
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from valor_msgs.msg import HdtCommand, HdtState

from valor.common.instance import Settings
from valor.devices.hdt_bus import Setpoints
from valor.hdt_driver.limb import Command, Limb
from valor.ros.fixed_layout import Layout, Stream
from valor.ros.node import WALL, RosSide, Untouched
from valor.ros.taking import take, uncalled

NEWEST = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


class DriverNode:
    """Node ``hdt_driver``."""

    def __init__(self, settings: Settings, environment: Mapping[str, str], limbs: Sequence[Limb]) -> None:
        self._side = RosSide("hdt_driver", settings, environment, sys.argv[1:], sim_time=False)
        self._node = self._side.node
        untouched = Untouched()
        self._commands = {
            limb.name: self._node.create_subscription(
                HdtCommand, f"hdt/{limb.name}/command", uncalled, NEWEST, callback_group=untouched, raw=True
            )
            for limb in limbs
        }
        self._heard = {name: Stream(HdtCommand) for name in self._commands}
        self._states = {
            limb.name: (self._node.create_publisher(HdtState, f"hdt/{limb.name}/state", NEWEST), _state(limb))
            for limb in limbs
        }
        self._diagnostics = self._node.create_publisher(DiagnosticArray, "diagnostics", 10)
        self._side.life.configured()

    def close(self) -> None:
        """Leave the graph."""
        self._side.close()

    def attend(self, ready: bool, waits_for: str) -> None:
        """Answer who asks where the driver is in its life, and publish what it has logged."""
        self._side.life.tell(ready, waits_for)
        self._side.attend()

    def command(self, limb: str) -> Command | None:
        """The newest command of a limb that was not returned before."""
        taken = take(self._commands[limb])
        if taken is None:
            return None
        numbers = self._heard[limb].received(taken[0])
        return Command(
            numbers["sequence"].item(),
            Setpoints(numbers["mode"].copy(), *(numbers[name].copy() for name in _SETPOINTS)),
        )

    def publish(self, limb: Limb, sequence: int) -> None:
        """A limb's state, as far as it is known."""
        publisher, layout = self._states[limb.name]
        numbers, now = layout.numbers, WALL.now().nanoseconds
        layout.stamp(now)
        for name, number in (("time", now), ("sequence", sequence), ("command_sequence", limb.obeyed)):
            numbers[name][0] = number
        numbers["voltage"][0] = limb.voltage
        for name in _STATE:
            numbers[name][:] = getattr(limb, name)
        publisher.publish(bytes(layout.bytes))

    def diagnose(self, rows: Iterable[tuple[str, str, bool, str, Mapping[str, object]]]) -> None:
        """Publish rows of (name, hardware id, whether all is well, message, values)."""
        message = DiagnosticArray()
        message.header.stamp = WALL.now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=DiagnosticStatus.OK if well else DiagnosticStatus.ERROR,
                name=name,
                hardware_id=hardware,
                message=text,
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
            )
            for name, hardware, well, text, values in rows
        ]
        self._diagnostics.publish(message)


_SETPOINTS = ("position", "velocity", "effort", "stiffness", "damping")
_STATE = ("position", "velocity", "effort", "temperature", "fault")


def _state(limb: Limb) -> Layout:
    """A state's, for a limb's joints."""
    message = HdtState()
    message.header.frame_id = limb.name
    for name in _STATE:
        setattr(message, name, getattr(limb, name))
    return Layout(message)
