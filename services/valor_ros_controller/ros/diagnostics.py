"""``/diagnostics``: how the VRC and what it hears of fare, once a second, for people and their tools.

One status of the Motion System, one of the VRC, one of every process by its own word (rates, drops, ages), and on
hardware one of every unit of a device.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

import bifrost
from valor.common.behaviors import FALLEN
from valor.common.messages import DeviceStatus, Statistics
from valor.common.topics import DEVICES, STATISTICS
from valor.ros.node import STEADY, WALL
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer

PERIOD = 1.0  # [s]
_SILENT = 3.0  # a process whose statistics are older than this has stopped [s]
_SLOW = 0.9  # a rate below this fraction of the nominal one is worth a warning


@dataclass(frozen=True)
class Snapshot:
    """What the update thread hands over.

    Attributes:
        silent: name of the process that is; empty: none.
        behavior: of the Motion System.
        behavior_reason: of its last change.
        control_mode: the present one.
        cycles: since start.
        late: those of them that came late in robot time.
        longest_gap: between two cycles of the last seconds, in robot time [s].
        motion_system: what else is said of the Motion System.
        controller: and of the VRC.
    """

    silent: str
    behavior: str
    behavior_reason: str
    control_mode: str
    cycles: int
    late: int
    longest_gap: float
    motion_system: Mapping[str, object]
    controller: Mapping[str, object]


class ProcessDiagnostics:
    """One process, by the statistics that it publishes."""

    def __init__(self, name: str, node: bifrost.Node) -> None:
        self._name = name
        self._subscriber = STATISTICS[name].subscriber(node)
        self._newest: Statistics | None = None
        self._heard = 0.0  # [time.monotonic(), s]
        self._drops = 0

    def status(self) -> DiagnosticStatus:
        """Its present one."""
        name = f"valor: process {self._name}"
        if (received := self._subscriber.latest()) is not None:
            self._newest, self._heard = received.message, time.monotonic()
        newest = self._newest
        if newest is None:
            return _status(DiagnosticStatus.STALE, name, "not heard of", {})
        age, lost = time.monotonic() - self._heard, newest.drops - self._drops
        self._drops = newest.drops
        if age > _SILENT:
            level, text = DiagnosticStatus.ERROR, f"silent for {age:.0f} s"
        elif newest.state != "ready":
            level, text = DiagnosticStatus.WARN, f"{newest.state}: {newest.detail}"
        elif lost > 0:
            level, text = DiagnosticStatus.WARN, f"{lost} messages dropped since the last report"
        else:
            level, text = DiagnosticStatus.OK, ": ".join(filter(None, (newest.state, newest.detail)))
        values = {
            "age [s]": f"{age:.1f}",
            "rate [Hz]": f"{1.0 / newest.period_mean:.0f}" if newest.period_mean > 0.0 else "",
            "longest period [ms]": f"{1e3 * newest.period_max:.1f}",
            "longest cycle [ms]": f"{1e3 * newest.cycle_time_max:.1f}",
            "overruns": newest.overruns,
            "drops": newest.drops,
            "rejected": newest.rejected,
            "CPU [%]": f"{newest.cpu_percent:.0f}",
            "memory [MiB]": f"{newest.memory_mib:.0f}",
        }
        return _status(level, name, text, values)


class DeviceDiagnostics:
    """The units of all devices, by the Comms Manager's word."""

    _LEVELS: ClassVar[dict[str, bytes]] = {
        "ok": DiagnosticStatus.OK,
        "faulty": DiagnosticStatus.WARN,
        "overdue": DiagnosticStatus.WARN,
    }

    def __init__(self, node: bifrost.Node) -> None:
        self._subscriber = DEVICES.subscriber(node)
        self._newest: DeviceStatus | None = None

    def statuses(self) -> list[DiagnosticStatus]:
        """One a unit; none before the first word, and so none in a simulation."""
        if (received := self._subscriber.latest()) is not None:
            self._newest = received.message
        devices = self._newest
        if devices is None:
            return []
        return [self._unit(devices, place) for place in range(len(devices.units))]

    def _unit(self, devices: DeviceStatus, place: int) -> DiagnosticStatus:
        state = devices.states[place]
        values = {
            "rate [Hz]": f"{devices.rate[place]:.0f}",
            "latency [ms]": f"{1e3 * devices.latency[place]:.2f}",
            "age [ms]": f"{1e3 * devices.age[place]:.1f}",
            "temperature [°C]": f"{devices.temperature[place]:.0f}",
            "supply [V]": f"{devices.voltage[place]:.1f}",
            "frames refused": f"{devices.errors[place]:.0f}",
        }
        level = self._LEVELS.get(state, DiagnosticStatus.ERROR)
        return _status(level, f"valor: device {devices.units[place]}", devices.details[place] or state, values)


class Diagnostics:
    """Turns snapshots and statistics into diagnostics; a timer of the ROS thread."""

    def __init__(
        self,
        node: Node,
        bifrost_node: bifrost.Node,
        snapshots: RealTimeBuffer[Snapshot],
        rate: float,
        processes: Collection[str],
    ) -> None:
        """Begin.

        Args:
            node: the ROS node.
            bifrost_node: to the Bifrost network.
            snapshots: from the update thread.
            rate: nominal, of the update loop [Hz].
            processes: names of those to be told of.
        """
        self._snapshots = snapshots
        self._robot = node.get_namespace().strip("/") or "valor"
        self._rate = rate
        self._cycles = self._late = 0
        self._processes = [ProcessDiagnostics(name, bifrost_node) for name in STATISTICS if name in processes]
        self._devices = DeviceDiagnostics(bifrost_node)
        self._publisher = node.create_publisher(DiagnosticArray, "diagnostics", 1)
        node.create_timer(PERIOD, self._publish, clock=STEADY)  # robot time may stand

    def _publish(self) -> None:
        snapshot = self._snapshots.newest
        if snapshot is None:
            return
        processes = [process.status() for process in self._processes]
        own = [self._motion_system(snapshot), self._controller(snapshot)]
        message = DiagnosticArray(status=[*own, *processes, *self._devices.statuses()])
        for status in message.status:
            status.hardware_id = self._robot
        message.header.stamp = WALL.now().to_msg()
        self._publisher.publish(message)

    @staticmethod
    def _motion_system(snapshot: Snapshot) -> DiagnosticStatus:
        if snapshot.silent:
            level, text = DiagnosticStatus.ERROR, f"{snapshot.silent} is silent"
        elif snapshot.behavior in FALLEN:
            level, text = DiagnosticStatus.ERROR, f"{snapshot.behavior}: {snapshot.behavior_reason}"
        else:
            level, text = DiagnosticStatus.OK, snapshot.behavior
        values = {
            "behavior": snapshot.behavior,
            "reason of the last change": snapshot.behavior_reason,
            **snapshot.motion_system,
        }
        return _status(level, "valor: motion system", text, values)

    def _controller(self, snapshot: Snapshot) -> DiagnosticStatus:
        rate = (snapshot.cycles - self._cycles) / PERIOD
        self._cycles = snapshot.cycles
        late = snapshot.late - self._late
        self._late = snapshot.late
        gap = f"{1e3 * snapshot.longest_gap:.1f}"
        wrong = []
        if not snapshot.silent and rate < _SLOW * self._rate:
            wrong.append(f"{rate:.0f} Hz, expected {self._rate:.0f} Hz")
        if late > 0:
            expected = f"{1e3 / self._rate:.1f}"
            wrong.append(
                f"late: {late} cycles since the last report, {gap} ms apart in robot time, expected {expected}"
            )
        level = DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK
        text = "; ".join(wrong) or snapshot.control_mode
        values = {
            "control mode": snapshot.control_mode,
            "rate [Hz]": f"{rate:.0f}",
            "late cycles": snapshot.late,
            "longest gap [ms]": gap,
            **snapshot.controller,
        }
        return _status(level, "valor: valor_ros_controller", text, values)


def _status(level: bytes, name: str, text: str, values: Mapping[str, object]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=text, values=pairs)
