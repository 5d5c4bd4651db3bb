"""State topics of the Motion System, published in the update thread, and ``/diagnostics``."""

import time
from collections.abc import Collection, Mapping
from math import nan

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Bool
from valor_msgs.msg import MotionState as RosMotionState

import bifrost
from bifrost import Received
from valor.common.behaviors import BALANCING, FALLEN, Behavior
from valor.common.messages import DeviceStatus, MotionState, Statistics
from valor.common.topics import DEVICES, STATISTICS
from valor.robot.tables import Hands
from valor.ros.limbs import FEET, HANDS, LAST_MODE_REJECTED, LAST_TRAJECTORY_REJECTED
from valor.ros.mirror import MirrorPublisher
from valor.ros.node import STEADY, WALL
from valor.ros.transforms import ODOM
from valor.valor_ros_controller.core import Core
from valor.valor_ros_controller.ros.controller_bypass import RejectionPublisher
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

POINT_RATE = 25.0  # [Hz]
STATE_RATE = 10.0  # of the motion state [Hz]
POINTS = ("com", "dcm", "dcm_reference", "cop")
LIMBS = FEET + HANDS
ROBOT_STATUS = "flor/controller/robot_status"
_HELD = frozenset(Behavior) - BALANCING - FALLEN


class MotionStatePublisher:
    """Publishes points in odom, contacts on change, and the motion state periodically and when the behavior changes."""

    def __init__(self, node: Node, hands: Hands, stamp: Time, rate: float, frame: str = ODOM) -> None:
        """``stamp``: robot time, updated by its owner; ``rate``: of the update loop [Hz]; ``frame``: tf frame odom."""
        self._every = max(1, round(rate / POINT_RATE))
        self._state_every = max(1, round(rate / STATE_RATE))
        self._cycle = 0
        self._points = []
        for name in POINTS:
            message = PointStamped()
            message.header.stamp, message.header.frame_id = stamp, frame
            self._points.append((node.create_publisher(PointStamped, f"flor/state/{name}", 5), message))
        available = (True, True, hands.left is not None, hands.right is not None)
        self._contacts = [
            node.create_publisher(Bool, f"flor/{limb}/contact", LATCHED) if has else None
            for limb, has in zip(LIMBS, available, strict=True)
        ]
        self._touching: list[int | None] = [None] * len(LIMBS)
        self._state = MirrorPublisher(node, RosMotionState, "flor/controller/motion_state", LATCHED)
        self._behavior = ""

    def publish(self, received: Received[MotionState] | None) -> None:
        if received is None:
            return
        motion = received.message
        touching = motion.contacts.tolist() + motion.hand_contacts.tolist()
        if touching != self._touching:
            for publisher, before, now in zip(self._contacts, self._touching, touching, strict=True):
                if publisher and before != now:
                    publisher.publish(Bool(data=bool(now)))
            self._touching = touching
        self._cycle += 1
        if self._cycle % self._state_every == 0 or motion.behavior != self._behavior:
            self._behavior = motion.behavior
            self._state.publish(received)
        if self._cycle % self._every:
            return
        cop = np.append(motion.cop_in_odom, 0.0)
        points = (motion.com_in_odom, motion.dcm_in_odom, motion.dcm_reference_in_odom, cop)
        for (publisher, message), point in zip(self._points, points, strict=True):
            message.point.x, message.point.y, message.point.z = map(float, point)
            publisher.publish(message)


class RobotStatusPublisher:
    """``/flor/controller/robot_status``, on change.

    OK: balances; WARN: held by its joints, accepts no commands, or low batteries; ERROR: fallen, or a process silent.
    """

    def __init__(self, node: Node, interface: ValorEscherInterface, hw: ValorEscherHWInterface) -> None:
        self._publisher = node.create_publisher(DiagnosticStatus, ROBOT_STATUS, LATCHED)
        self._interface, self._hw = interface, hw
        self._robot = node.get_namespace().strip("/") or "valor"
        self._published: tuple[str, ...] = ()

    def publish(self, control_mode: str) -> None:
        interface = self._interface
        silent, behavior, reason, low, _ = now = (
            interface.silent, interface.behavior, interface.behavior_reason, self._hw.low_battery, control_mode,
        )  # fmt: skip
        if now == self._published:
            return
        self._published = now
        if silent:
            level, text = DiagnosticStatus.ERROR, f"{silent} is silent"
        elif behavior in FALLEN:
            level, text = DiagnosticStatus.ERROR, f"{behavior}: {reason}"
        elif behavior in _HELD:
            level, text = DiagnosticStatus.WARN, f"{behavior}: held by the joints, not balancing"
        elif behavior == Behavior.SOFT_STOP:
            level, text = DiagnosticStatus.WARN, f"{behavior}: balances, accepts no commands"
        else:
            level, text = DiagnosticStatus.OK, behavior
        if low and level != DiagnosticStatus.ERROR:
            level, text = DiagnosticStatus.WARN, f"{text}; {low}"
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


PERIOD = 1.0  # [s]
_SILENT = 3.0  # age of the last statistics of a stopped process [s]
_SLOW = 0.9  # fraction of the nominal rate below which a warning is given
_UNITS = {"ok": DiagnosticStatus.OK, "faulty": DiagnosticStatus.WARN, "overdue": DiagnosticStatus.WARN}


class ProcessDiagnostics:
    """Status of one process, from its statistics."""

    def __init__(self, name: str, node: bifrost.Node) -> None:
        self._name = name
        self._subscriber = STATISTICS[name].subscriber(node)
        self._latest: Statistics | None = None
        self._received_at = 0.0  # [time.monotonic(), s]
        self._drops = 0

    def status(self) -> DiagnosticStatus:
        name = f"valor: process {self._name}"
        if (received := self._subscriber.latest()) is not None:
            self._latest, self._received_at = received.message, time.monotonic()
        latest = self._latest
        if latest is None:
            return _status(DiagnosticStatus.STALE, name, "no statistics received", {})
        age, lost = time.monotonic() - self._received_at, latest.drops - self._drops
        self._drops = latest.drops
        if age > _SILENT:
            level, text = DiagnosticStatus.ERROR, f"silent for {age:.0f} s"
        elif latest.state != "ready":
            level, text = DiagnosticStatus.WARN, f"{latest.state}: {latest.detail}"
        elif lost > 0:
            level, text = DiagnosticStatus.WARN, f"{lost} messages dropped since the last report"
        else:
            level, text = DiagnosticStatus.OK, ": ".join(filter(None, (latest.state, latest.detail)))
        values = {
            "age [s]": f"{age:.1f}",
            "rate [Hz]": f"{1.0 / latest.period_mean:.0f}" if latest.period_mean > 0.0 else "",
            "longest period [ms]": f"{1e3 * latest.period_max:.1f}",
            "longest cycle [ms]": f"{1e3 * latest.cycle_time_max:.1f}",
            "overruns": latest.overruns,
            "drops": latest.drops,
            "rejected": latest.rejected,
            "CPU [%]": f"{latest.cpu_percent:.0f}",
            "memory [MiB]": f"{latest.memory_mib:.0f}",
        }
        return _status(level, name, text, values)


class Diagnostics:
    """Publishes in a timer of the ROS thread; reads the core without locks, as its values need not be of one cycle."""

    def __init__(
        self,
        node: Node,
        bifrost_node: bifrost.Node,
        core: Core,
        rejections: RejectionPublisher,
        *,
        rate: float,
        processes: Collection[str],
    ) -> None:
        """``rate``: nominal, of the update loop [Hz]; ``processes``: names of those to report."""
        self._core, self._rejections, self._rate = core, rejections, rate
        self._robot = node.get_namespace().strip("/") or "valor"
        self._cycles = self._late = 0
        self._processes = [ProcessDiagnostics(name, bifrost_node) for name in STATISTICS if name in processes]
        self._devices = DEVICES.subscriber(bifrost_node)
        self._latest_devices: DeviceStatus | None = None  # none in simulation without batteries
        self._publisher = node.create_publisher(DiagnosticArray, "diagnostics", 1)
        node.create_timer(PERIOD, self._publish, clock=STEADY)  # robot time may stand still

    def _publish(self) -> None:
        if (received := self._devices.latest()) is not None:
            self._latest_devices = received.message
        message = DiagnosticArray(
            status=[
                self._motion_system(),
                self._controller(),
                *(process.status() for process in self._processes),
                *(_units(self._latest_devices) if self._latest_devices else ()),
            ]
        )
        for status in message.status:
            status.hardware_id = self._robot
        message.header.stamp = WALL.now().to_msg()
        self._publisher.publish(message)

    def _motion_system(self) -> DiagnosticStatus:
        interface, measured = self._core.interface, self._core.hw.measured
        behavior, reason = interface.behavior, interface.behavior_reason
        if silent := interface.silent:
            level, text = DiagnosticStatus.ERROR, f"{silent} is silent"
        elif behavior in FALLEN:
            level, text = DiagnosticStatus.ERROR, f"{behavior}: {reason}"
        else:
            level, text = DiagnosticStatus.OK, behavior
        values = {
            "behavior": behavior,
            "reason of the last change": reason,
            "frozen": ", ".join(self._core.hw.frozen),
            "proprioceptor age [s]": f"{interface.proprioceptor_age:.3f}",
            "motion_state age [s]": f"{interface.motion_state_age:.3f}",
            "messages rejected": interface.rejected,
            "battery [V]": f"{measured.battery_voltage if measured else nan:.1f}",
            "commands rejected": self._rejections.count,
            "last command rejected": self._rejections.last,
        }
        return _status(level, "valor: motion system", text, values)

    def _controller(self) -> DiagnosticStatus:
        core, interface, modes = self._core, self._core.interface, self._core.mode_controller
        rejections = [each.rejections for each in core.trajectories.values()]
        cycles, late = core.cycles - self._cycles, interface.late - self._late
        self._cycles, self._late = core.cycles, interface.late
        rate, gap = cycles / PERIOD, f"{1e3 * interface.longest_gap * core.hw.robot.control_period:.1f}"
        interface.longest_gap = 0
        warnings = []
        if not interface.silent and rate < _SLOW * self._rate:
            warnings.append(f"{rate:.0f} Hz, expected {self._rate:.0f} Hz")
        if late > 0:
            expected = f"{1e3 / self._rate:.1f}"
            warnings.append(
                f"late: {late} cycles since the last report, {gap} ms apart in robot time, expected {expected}"
            )
        level = DiagnosticStatus.WARN if warnings else DiagnosticStatus.OK
        values = {
            "control mode": modes.current,
            "rate [Hz]": f"{rate:.0f}",
            "late cycles": self._late,
            "longest gap [ms]": gap,
            "control modes rejected": modes.rejections.count,
            LAST_MODE_REJECTED: modes.rejections.last,
            "joint controllers": ", ".join(core.joints.active),
            "trajectories rejected": sum(each.count for each in rejections),
            LAST_TRAJECTORY_REJECTED: "; ".join(each.last for each in rejections if each.last),
            "set-points sent": interface.set_points_sent,
            "set-points clamped": core.hw.clamped,
        }
        return _status(level, "valor: valor_ros_controller", "; ".join(warnings) or modes.current, values)


def _units(devices: DeviceStatus) -> list[DiagnosticStatus]:
    statuses = []
    for i, unit in enumerate(devices.units):
        state = devices.states[i]
        values = {
            "rate [Hz]": f"{devices.rate[i]:.0f}",
            "latency [ms]": f"{1e3 * devices.latency[i]:.2f}",
            "age [ms]": f"{1e3 * devices.age[i]:.1f}",
            "temperature [°C]": f"{devices.temperature[i]:.0f}",
            "supply [V]": f"{devices.voltage[i]:.1f}",
            "frames refused": f"{devices.errors[i]:.0f}",
        }
        level = _UNITS.get(state, DiagnosticStatus.ERROR)
        statuses.append(_status(level, f"valor: device {unit}", devices.details[i] or state, values))
    return statuses


def _status(level: bytes, name: str, text: str, values: Mapping[str, object]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=text, values=pairs)
