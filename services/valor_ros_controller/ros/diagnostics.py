"""``/diagnostics``: how the VRC and what it hears of fare, once a second, for people and their tools."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from valor_ros_controller.realtime_buffer import RealTimeBuffer

PERIOD = 1.0  # [s]
_SLOW = 0.9  # a rate below this fraction of the nominal one is worth a warning


@dataclass(frozen=True)
class Snapshot:
    """What the update thread hands over. Ages in seconds, counts since start."""

    silent: str  # process; empty: none
    behavior: str
    behavior_reason: str
    proprioceptor_age: float
    motion_state_age: float
    messages_rejected: int
    set_points_sent: int
    set_points_clamped: int
    cycles: int
    control_mode: str
    last_mode_refusal: str
    modes_refused: int
    joint_controllers: tuple[str, ...]
    last_trajectory_refusal: str
    trajectories_refused: int


class Diagnostics:
    """Turns snapshots into diagnostics; a timer of the ROS thread."""

    def __init__(self, node: Node, snapshots: RealTimeBuffer[Snapshot], rate: float) -> None:
        """Begin.

        Args:
            node: the ROS node.
            snapshots: from the update thread.
            rate: nominal, of the update loop [Hz].
        """
        self._node = node
        self._snapshots = snapshots
        self._rate = rate
        self._cycles = 0
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        node.create_timer(PERIOD, self._publish)

    def _publish(self) -> None:
        snapshot = self._snapshots.newest
        if snapshot is None:
            return
        message = DiagnosticArray(status=[self._motion_system(snapshot), self._controller(snapshot)])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    @staticmethod
    def _motion_system(snapshot: Snapshot) -> DiagnosticStatus:
        if snapshot.silent:
            level, text = DiagnosticStatus.ERROR, f"{snapshot.silent} is silent"
        elif snapshot.behavior in ("fall", "get_up"):
            level, text = DiagnosticStatus.ERROR, f"{snapshot.behavior}: {snapshot.behavior_reason}"
        else:
            level, text = DiagnosticStatus.OK, snapshot.behavior
        values = {
            "behavior": snapshot.behavior,
            "reason of the last change": snapshot.behavior_reason,
            "proprioceptor age [s]": f"{snapshot.proprioceptor_age:.3f}",
            "motion_state age [s]": f"{snapshot.motion_state_age:.3f}",
            "messages rejected": snapshot.messages_rejected,
        }
        return _status(level, "valor: motion system", text, values)

    def _controller(self, snapshot: Snapshot) -> DiagnosticStatus:
        rate = (snapshot.cycles - self._cycles) / PERIOD
        self._cycles = snapshot.cycles
        slow = not snapshot.silent and rate < _SLOW * self._rate
        level = DiagnosticStatus.WARN if slow else DiagnosticStatus.OK
        text = f"{rate:.0f} Hz, expected {self._rate:.0f} Hz" if slow else snapshot.control_mode
        values = {
            "control mode": snapshot.control_mode,
            "control modes refused": snapshot.modes_refused,
            "last control mode refused": snapshot.last_mode_refusal,
            "joint controllers": ", ".join(snapshot.joint_controllers),
            "trajectories refused": snapshot.trajectories_refused,
            "last trajectory refused": snapshot.last_trajectory_refusal,
            "rate [Hz]": f"{rate:.0f}",
            "set-points sent": snapshot.set_points_sent,
            "set-points clamped": snapshot.set_points_clamped,
        }
        return _status(level, "valor: valor_ros_controller", text, values)


def _status(level: bytes, name: str, text: str, values: dict[str, object]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=text, hardware_id="valor", values=pairs)
