"""The driver's loop: at its own rate, commands to the modules and their answers to ROS."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping
from types import FrameType

import psutil

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.common.priority import take_priority
from valor.common.processes import BY_NAME
from valor.devices import hdt_bus
from valor.devices.hdt_bus import Fault
from valor.devices.ports import open_can
from valor.devices.table import HdtBifrost
from valor.hdt_driver.bus import ModuleBus
from valor.hdt_driver.limb import Limb
from valor.hdt_driver.ros import DriverNode
from valor.robot.description import RobotDescription

ATTEND_EVERY = 0.1  # to who asks ROS for something else than states [s]
DIAGNOSE_EVERY = 1.0  # and at every change of state [s]

_LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_log = logging.getLogger("hdt_driver")


class HdtDriver:
    """Exchanges commands and states with every limb, hands at a fraction of the arms' rate."""

    def __init__(self, settings: Settings, environment: Mapping[str, str], robot: RobotDescription) -> None:
        tables = [device for device in robot.tables.devices.values() if isinstance(device, HdtBifrost)]
        if len(tables) != 1:
            raise ConfigurationError(f"{robot.folder / 'robot.yaml'}: devices: expected one of kind hdt_bifrost")
        table = tables[0]
        self._period = 1.0 / table.rate
        self._limbs = [Limb(robot, limb.group, self._period * limb.every) for limb in table.limbs]
        self._every = {limb.group: limb.every for limb in table.limbs}
        self._serials = {limb.group: limb.serial for limb in table.limbs}
        self._ros = DriverNode(settings, environment, self._limbs)
        try:
            bus = open_can(settings, table.bus, (hdt_bus.STATE, hdt_bus.IDENTITY), hdt_bus.KIND)
            self._bus = ModuleBus(bus, list(zip(self._limbs, table.limbs, strict=True)))
        except ConfigurationError:
            self._ros.close()
            raise
        self._process = psutil.Process()
        self._process.cpu_percent()
        self._cycles = self._overruns = 0
        self._work = self._work_max = self._period_max = 0.0
        self._window_cycles = 0
        self._told = ""
        self._ready = False
        self._tell_at = 0.0
        self._began = 0.0

    def run(self, stopping: threading.Event) -> None:
        """Until told to stop. The modules then hold by themselves."""
        due = began = self._began = time.monotonic()
        sequence, attend_at = 0, 0.0
        while not stopping.is_set():
            sequence += 1
            before, began = began, time.monotonic()
            self._period_max = max(self._period_max, began - before)
            waiting = [limb for limb in self._limbs if sequence % self._every[limb.name] == 0]
            for limb in waiting:
                if (command := self._ros.command(limb.name)) is not None:
                    limb.take(command, began)
                self._bus.ask(limb, began)
            self._bus.inquire(began)
            due += self._period
            if due < began:  # what is late by more than a cycle is not made up
                self._overruns += 1
                due = began + self._period
            asked = time.monotonic()
            work = asked - began
            while (answering := self._bus.listen(due)) is not None:
                answered = time.monotonic()
                self._ros.publish(answering, sequence)
                work += time.monotonic() - answered
            for limb in waiting:
                if self._bus.finish(limb):  # what is known of it: that it does not answer
                    self._ros.publish(limb, sequence)
            self._cycles += 1
            self._work += work
            self._work_max = max(self._work_max, work)
            self._diagnose(began)
            if began >= attend_at:
                attend_at = began + ATTEND_EVERY
                self._ros.attend(self._ready, "limbs that do not answer")

    def close(self) -> None:
        """Leave bus and ROS."""
        self._bus.close()
        self._ros.close()

    def _diagnose(self, now: float) -> None:
        """Publish how the driver and its limbs fare, if that is due or has changed.

        Raises:
            ConfigurationError: before all limbs were there for the first time: one is not the one that is expected.
        """
        wrong = self._bus.wrong()
        if not self._ready:
            for segment in self._bus.segments:
                if segment.wrong:
                    raise ConfigurationError(f"hdt/{segment.limb.name}: segment {segment.number} has {segment.wrong}")
            self._ready = not wrong
        state = "; ".join(f"{name}: {why}" for name, why in wrong.items())
        if now < self._tell_at and state == self._told:
            return
        elapsed = max(1e-3, now - self._began)
        self._tell_at, self._told = now + DIAGNOSE_EVERY, state
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
            "rejected": sum(limb.refused for limb in self._limbs),
            "errors": self._bus.errors + sum(segment.refused for segment in self._bus.segments),
        }
        self._began, self._window_cycles = now, self._cycles
        self._work = self._work_max = self._period_max = 0.0
        rows = [("hdt_driver", "", not wrong, state or "ready", values)]
        for limb in self._limbs:
            faults = [
                f"{joint}: {Fault(int(bits)).name}".lower()
                for joint, bits in zip(limb.joints, limb.fault, strict=True)
                if bits
            ]
            text = wrong.get(limb.name) or "; ".join(faults) or ("led" if limb.led else "holds")
            temperature, voltage = float(max(limb.temperature)), limb.voltage
            details = {"temperature": temperature, "voltage": voltage, "refused": limb.refused}
            rows.append((f"hdt_driver: {limb.name}", self._serials[limb.name], not faults, text, details))
        self._ros.diagnose(rows)


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
        settings = instance.settings()
        take_priority(BY_NAME["hdt_driver"].priority)
        driver = HdtDriver(settings, instance.environment(), RobotDescription.load(settings.robot))
    except ConfigurationError as error:
        _log.error("%s", error)
        return os.EX_CONFIG
    try:
        driver.run(stopping)
    except ConfigurationError as error:
        _log.error("%s", error)
        return os.EX_CONFIG
    finally:
        driver.close()
    _log.info("stopped")
    return os.EX_OK
