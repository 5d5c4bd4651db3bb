"""``/flor/controller/robot_status``: in one line whether the robot stands, and why not; for whoever joins late, too."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node

from valor.common.behaviors import BALANCING, FALLEN, Behavior
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

TOPIC = "flor/controller/robot_status"
_HELD = frozenset(Behavior) - BALANCING - FALLEN


class RobotStatusPublisher:
    """OK: balances; WARN: held by its joints, or closed to commands; ERROR: fallen, or out of sight. Update thread."""

    def __init__(self, node: Node, interface: ValorEscherInterface) -> None:
        self._publisher = node.create_publisher(DiagnosticStatus, TOPIC, LATCHED)
        self._interface = interface
        self._robot = node.get_namespace().strip("/") or "valor"
        self._said: tuple[str, ...] = ()

    def publish(self, control_mode: str) -> None:
        """Publish on change."""
        interface = self._interface
        now = (interface.silent, interface.behavior, interface.behavior_reason, control_mode)
        if now == self._said:
            return
        self._said = now
        silent, behavior, reason, _ = now
        if silent:
            level, text = DiagnosticStatus.ERROR, f"{silent} is silent"
        elif behavior in FALLEN:
            level, text = DiagnosticStatus.ERROR, f"{behavior}: {reason}"
        elif behavior in _HELD:
            level, text = DiagnosticStatus.WARN, f"{behavior}: the joints hold, nobody balances"
        elif behavior == Behavior.SOFT_STOP:
            level, text = DiagnosticStatus.WARN, f"{behavior}: balances, closed to commands"
        else:
            level, text = DiagnosticStatus.OK, behavior
        values = {"behavior": behavior, "reason": reason, "control_mode": control_mode, "silent": silent}
        self._publisher.publish(
            DiagnosticStatus(
                level=level,
                name="valor: robot",
                message=text,
                hardware_id=self._robot,
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
        )
