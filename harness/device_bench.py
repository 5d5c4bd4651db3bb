"""One device on a test bench: its driver at work, its emulator in a simulated robot, and a port between."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from harness.waiting import PATIENCE, wait_until
from valor.common.instance import Instance, Settings
from valor.comms_manager.hardware.device import (
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    UnitFault,
    UnitRecord,
    make_device,
)
from valor.device_emulators.emulator import EmulatedFault, Emulator, make_emulator
from valor.device_emulators.robot import SimulatedRobot
from valor.robot.description import RobotDescription
from valor.valorctl.instance.ros_domain import reserve_for

UNSOUND = (EmulatedFault.SILENT, EmulatedFault.GARBAGE, EmulatedFault.BAD_CHECKSUM, EmulatedFault.LATE)
"""Faults in which nothing of a unit may be believed."""


class Bench:
    """The emulator's side runs as long as the bench; the driver's side is the test's to start."""

    def __init__(self, robot: RobotDescription, device: str, home: Path, *, moves: bool = False) -> None:
        """``moves``: the robot leaves its gantry once the driver's motors are on; before, limp joints would sag."""
        self._moves = moves
        self.instance = Instance("bench", home)
        self.instance.ports.mkdir(parents=True)
        self._domain = reserve_for(self.instance)  # for CAN buses of the bench's own
        self.settings = Settings(
            robot=robot.folder, ros_domain_id=self._domain.domain, variant="hardware", actuators="ideal"
        )
        self.description = robot
        self.device = device
        self.robot = SimulatedRobot(robot, self.settings)
        self.emulator: Emulator = make_emulator(device, self.instance, self.settings, robot)
        self.lock = threading.Lock()  # around the robot and the emulator
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def pause(self) -> None:
        """The emulator's side runs no more by itself: whoever steps the emulator says what time it is."""
        self._stop.set()
        self._thread.join()

    @contextmanager
    def serving(self) -> Iterator[None]:
        """It does, for a while."""
        self._stop.clear()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        try:
            yield
        finally:
            self.pause()

    def _serve(self) -> None:
        while not self._stop.wait(0.001):
            with self.lock:
                self.robot.advance(1)
                self.emulator.step(time.monotonic(), self.robot)

    def let_go(self) -> None:
        """Start the simulated world; the robot stands on the servos of its legs, so that only the device moves."""
        groups = self.description.tables.groups
        names = [joint for group in ("left_leg", "right_leg", "torso") for joint in groups[group]]
        legs = np.array([self.description.index[name] for name in names], dtype=np.intp)
        with self.lock:
            self.robot.power(legs, True)
            self.robot.hold(legs)
        assert self.robot.released

    def inject(self, unit: str, fault: EmulatedFault) -> None:
        """Let a unit fail until ``heal``."""
        with self.lock:
            self.emulator.faults.inject(unit, fault)

    def heal(self) -> None:
        """End all faults."""
        with self.lock:
            self.emulator.faults.clear()

    def driver(self, robot: RobotDescription | None = None) -> Device:
        """A driver that has found nothing yet; it may expect another robot."""
        return make_device(self.device, DeviceContext(self.instance, self.settings, robot or self.description))

    def _started(self) -> Device:
        """A driver whose motors are on. A start is refused where the computer gives the emulator no turn for long."""
        until = time.monotonic() + PATIENCE
        while True:
            driver = self.driver()
            try:
                driver.find()
                driver.enable()
            except DeviceError:
                driver.close()
                if time.monotonic() > until:
                    raise
            else:
                if self._moves and not self.robot.released:
                    self.let_go()
                return driver

    @contextmanager
    def running(self) -> Iterator[Device]:
        """A driver at work."""
        driver = self._started()
        with at_work(driver):
            yield driver

    def close(self) -> None:
        """End the emulator's side."""
        self._stop.set()
        self._thread.join()
        self.emulator.close()
        self._domain.close()


@contextmanager
def at_work(driver: Device) -> Iterator[None]:
    """A driver's thread, and a main loop; in the end it is closed."""
    stopping = threading.Event()

    def loop() -> None:
        while not stopping.wait(0.002):
            driver.request_states()
            driver.gather()

    threads = threading.Thread(target=driver.run, args=(stopping,)), threading.Thread(target=loop)
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stopping.set()
        for thread in threads:
            thread.join(1.0)
        driver.close()
        assert not any(thread.is_alive() for thread in threads)


def reported_fault(driver: Device, unit: str, fault: Fault) -> UnitFault:
    """The fault that a unit is told to have, within some seconds."""

    def told() -> UnitFault | None:
        return next((each for each in driver.unit_faults if (each.unit, each.fault) == (unit, fault)), None)

    unit_fault = wait_until(told, 10, f"{driver.name}/{unit} {fault}")
    assert unit_fault is not None
    return unit_fault


def sound(driver: Device, row: int = 0, states: int = 5) -> None:
    """Nothing ails the device any more, and states come."""
    wait_until(lambda: not driver.unit_faults, 10, f"{driver.name} well again")
    before = driver.records[row].states
    wait_until(lambda: driver.records[row].states >= before + states, 10, f"states of {driver.name}")


class StillDevice(Device):
    """A device of robot.yaml whose units report what a test sets."""

    def __init__(self, name: str, robot: RobotDescription) -> None:
        settings = Settings(robot=robot.folder, ros_domain_id=1)
        super().__init__(name, DeviceContext(Instance("x", Path()), settings, robot))
        self.records = tuple(UnitRecord(unit) for unit in robot.tables.devices[name].units or [name])

    def find(self) -> None:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError
