"""The driver's loop: at its own rate, commands to the modules, and their states to ROS."""

import contextlib
import logging
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from valor_msgs.msg import HdtCommand, HdtState

from valor.common.arrays import sequence
from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.common.priority import take_priority
from valor.common.processes import BY_NAME
from valor.devices.hdt_bus import MEASURED, SETPOINTS, Fault, command_layout, state_layout
from valor.devices.ports import serial_port
from valor.devices.table import HdtBifrost, HdtLimb
from valor.hdt_driver.limb import Limb, Setpoints
from valor.robot.description import RobotDescription
from valor.ros.node import WALL, RosSide
from valor.ros.taking import polled, take

MISSES = 15  # cycles without a state, after which a limb has timed out
ATTEND_EVERY = 0.1  # period of serving lifecycle requests [s]
DIAGNOSE_EVERY = 1.0  # period of diagnostics, which are also sent at every change of state [s]

_LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_log = logging.getLogger("hdt_driver")


Row = tuple[str, str, bool, str, Mapping[str, object]]
"""Diagnostics: name, hardware id, no fault, message, values."""

NEWEST = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)


class DriverNode:
    """Node ``hdt_driver``."""

    def __init__(self, settings: Settings, environment: Mapping[str, str], limbs: Sequence[Limb]) -> None:
        self._side = RosSide("hdt_driver", settings, environment, sys.argv[1:], sim_time=False)
        self._node = self._side.node
        self._commands = {
            limb.name: polled(self._node, HdtCommand, f"hdt/{limb.name}/command", NEWEST) for limb in limbs
        }
        self._states = {
            limb.name: self._node.create_publisher(HdtState, f"hdt/{limb.name}/state", NEWEST) for limb in limbs
        }
        self._diagnostics = self._node.create_publisher(DiagnosticArray, "diagnostics", 10)
        self._side.life.configure()

    def close(self) -> None:
        self._side.close()

    def attend(self, ready: bool, waits_for: str) -> None:
        """Serve lifecycle requests; ``ready``: the driver is active, or ``waits_for`` is the reason why not."""
        self._side.life.set_ready(ready, waits_for)
        self._side.serve_pending()

    def command(self, limb: str) -> Setpoints | None:
        """The latest command of a limb, once."""
        taken = take(self._commands[limb])
        if taken is None:
            return None
        command = taken[0]
        return Setpoints(command.sequence, *(np.array(getattr(command, name)) for name in ("mode", *SETPOINTS)))

    def publish(self, limb: Limb, sequence_number: int) -> None:
        now = WALL.now()
        state = HdtState(
            time=now.nanoseconds, sequence=sequence_number, command_sequence=limb.applied, voltage=limb.voltage,
            **{name: sequence(getattr(limb, name)) for name in _STATE},
        )  # fmt: skip
        state.header.stamp, state.header.frame_id = now.to_msg(), limb.name
        self._states[limb.name].publish(state)

    def diagnose(self, rows: Sequence[Row]) -> None:
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


_STATE = (*MEASURED, "fault")


@dataclass
class Modules:
    """Modules of one limb, and their exchange with the driver."""

    number: int  # of the limb on the bus
    limb: Limb
    table: HdtLimb
    frame: int = 0  # that the latest state answers
    responded: bool = False  # in this cycle
    missed: int = 0  # cycles without a state since the latest
    wrong: str = "it does not respond"  # why the limb receives no set-points; empty if its identity is as expected

    def __post_init__(self) -> None:
        count = len(self.limb.joints)
        self.command, self.state = command_layout(count), state_layout(count)

    def identify(self, state: np.void) -> None:
        self.wrong = ""
        for what, expected in (("serial", self.table.serial), ("firmware", self.table.firmware)):
            if (reported := state[what].decode("ascii", "replace")) != expected:
                self.wrong = f"{what} {reported!r}; expected {expected!r} (robot.yaml)"
                return


class ModuleBus:
    """Exchanges one command and one state with each limb in every cycle of it."""

    def __init__(self, path: Path, limbs: list[Modules]) -> None:
        self.limbs = limbs  # by number
        self.errors = 0  # number of states that were invalid, repeated or out of order, and of unsent commands
        self._path = str(path)
        self._frame = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind("")  # an abstract address, to which the modules respond

    def close(self) -> None:
        self._socket.close()

    def send(self, modules: Modules, now: float) -> None:
        """Start a cycle of a limb at ``now`` [monotonic s]: send its set-points if its identity is known."""
        self._frame += 1
        modules.responded = False
        command = np.zeros((), modules.command)
        command["limb"], command["frame"] = modules.number, self._frame
        setpoints = modules.limb.setpoints(now)
        if setpoints is not None and not modules.wrong:
            for name in ("sequence", "mode", *SETPOINTS):
                command[name] = getattr(setpoints, name)
        try:
            self._socket.sendto(command.tobytes(), self._path)
        except OSError:  # no emulator runs
            self.errors += 1

    def receive(self, until: float) -> Modules | None:
        """The next limb that responds for the first time in its cycle; None at ``until`` [monotonic s]."""
        while select.select((self._socket,), (), (), max(0.0, until - time.monotonic()))[0]:
            if (modules := self._process(self._socket.recv(4096))) is not None:
                return modules
        return None

    def finish(self, modules: Modules) -> bool:
        """End a cycle of a limb; returns whether it has timed out."""
        if not modules.responded:
            modules.missed += 1
            if modules.missed == MISSES:
                modules.wrong = "it does not respond"
                modules.limb.timed_out()
                _log.warning("%s timed out", modules.limb.name)
        return modules.missed >= MISSES

    def _process(self, data: bytes) -> Modules | None:
        modules = self.limbs[data[0]] if data and data[0] < len(self.limbs) else None
        if modules is None or len(data) != modules.state.itemsize:
            self.errors += 1
            return None
        state = np.frombuffer(data, modules.state)[0]
        if not modules.frame < state["frame"] <= self._frame:
            self.errors += 1
            return None
        modules.frame = int(state["frame"])
        modules.identify(state)
        if modules.wrong:
            return None
        modules.limb.measured(state)
        first, modules.responded, modules.missed = not modules.responded, True, 0
        return modules if first else None


class HdtDriver:
    """Exchanges commands and states with every limb; hands at a fraction of the arms' rate."""

    def __init__(self, instance: Instance) -> None:
        settings = instance.settings()
        robot = RobotDescription.load(settings.robot)
        found = [(n, table) for n, table in robot.tables.devices.items() if isinstance(table, HdtBifrost)]
        if len(found) != 1:
            raise ConfigurationError(f"{robot.folder / 'robot.yaml'}: devices: expected one of kind hdt_bifrost")
        name, table = found[0]
        self._period = 1.0 / table.rate
        limbs = [
            Modules(i, Limb(robot, limb.group, self._period * limb.every), limb) for i, limb in enumerate(table.limbs)
        ]
        self._ros = DriverNode(settings, instance.environment(), [each.limb for each in limbs])
        self._bus = ModuleBus(serial_port(instance, settings, name), limbs)
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._cycles = self._overruns = 0
        self._work = self._work_max = self._period_max = 0.0
        self._window_cycles = 0
        self._reported = ""
        self._ready = False
        self._report_at = 0.0
        self._began = 0.0

    def run(self, stopping: threading.Event) -> None:
        """Run until ``stopping`` is set; the modules then hold their position."""
        due = began = self._began = time.monotonic()
        sequence, attend_at = 0, 0.0
        while not stopping.is_set():
            sequence += 1
            before, began = began, time.monotonic()
            self._period_max = max(self._period_max, began - before)
            active = [each for each in self._bus.limbs if sequence % each.table.every == 0]
            for modules in active:
                if (command := self._ros.command(modules.limb.name)) is not None:
                    modules.limb.accept(command, began)
                self._bus.send(modules, began)
            due += self._period
            if due < began:  # delays of more than a cycle are not made up
                self._overruns += 1
                due = began + self._period
            work = time.monotonic() - began
            while (responding := self._bus.receive(due)) is not None:
                received = time.monotonic()
                self._ros.publish(responding.limb, sequence)
                work += time.monotonic() - received
            for modules in active:
                if self._bus.finish(modules):  # a state with fault NO_ANSWER
                    self._ros.publish(modules.limb, sequence)
            self._cycles += 1
            self._work += work
            self._work_max = max(self._work_max, work)
            self._diagnose(began)
            if began >= attend_at:
                attend_at = began + ATTEND_EVERY
                self._ros.attend(self._ready, "limbs that do not respond")

    def close(self) -> None:
        self._bus.close()
        self._ros.close()

    def _diagnose(self, now: float) -> None:
        """Publish the status of the driver and its limbs, if that is due or has changed.

        Raises ConfigurationError: a limb has another identity than in robot.yaml, before all limbs responded once.
        """
        wrong = {each.limb.name: each.wrong for each in self._bus.limbs if each.wrong}
        if not self._ready:
            for each in self._bus.limbs:
                if each.wrong and each.frame:
                    raise ConfigurationError(f"hdt/{each.limb.name}: {each.wrong}")
            self._ready = not wrong
        state = "; ".join(f"{name}: {why}" for name, why in wrong.items())
        if now < self._report_at and state == self._reported:
            return
        elapsed = max(1e-3, now - self._began)
        self._report_at, self._reported = now + DIAGNOSE_EVERY, state
        cycles = max(1, self._cycles - self._window_cycles)
        values = {
            "pid": os.getpid(),
            "cycles": self._cycles,
            "cycle_time_mean": self._work / cycles,
            "cycle_time_max": self._work_max,
            "period_mean": elapsed / cycles,
            "period_max": self._period_max,
            "overruns": self._overruns,
            "cpu_percent": self._process.cpu_percent(),
            "memory_mib": self._process.memory_info().rss / 2**20,
            "rejected": sum(each.limb.rejected for each in self._bus.limbs),
            "errors": self._bus.errors,
        }
        self._began, self._window_cycles = now, self._cycles
        self._work = self._work_max = self._period_max = 0.0
        self._ros.diagnose(
            [("hdt_driver", "", not wrong, state or "ready", values), *(_row(each) for each in self._bus.limbs)]
        )


def _row(modules: Modules) -> Row:
    limb = modules.limb
    faults = [
        f"{joint}: {Fault(int(bits)).name}".lower() for joint, bits in zip(limb.joints, limb.fault, strict=True) if bits
    ]
    text = modules.wrong or "; ".join(faults) or ("engaged" if limb.engaged else "holds")
    details = {"temperature": float(max(limb.temperature)), "voltage": limb.voltage, "rejected": limb.rejected}
    return f"hdt_driver: {limb.name}", modules.table.serial, not faults, text, details


def main() -> int:
    """Run until SIGTERM or SIGINT. Returns the exit status."""
    logging.basicConfig(level=logging.INFO, format=_LOG_FORMAT, stream=sys.stderr)
    stopping = threading.Event()

    def stop(signum: int, _frame: FrameType | None) -> None:
        stopping.set()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    try:
        instance = Instance.from_environment()
        take_priority(BY_NAME["hdt_driver"].priority)
        with contextlib.closing(HdtDriver(instance)) as driver:
            driver.run(stopping)
    except ConfigurationError as error:
        _log.error("%s", error)
        return os.EX_CONFIG
    _log.info("stopped")
    return os.EX_OK
