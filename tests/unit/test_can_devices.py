"""Motor controllers and force/torque sensors: drivers and emulators on CAN FD over UDP, sound and with every fault."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from harness.device_bench import UNSOUND, Bench
from harness.places import ROBOTS
from valor.common.messages import JointMode
from valor.comms_manager.hardware.can_device import CanDevice
from valor.comms_manager.hardware.device import DeviceError, Fault, JointCommands, JointMeasurement
from valor.comms_manager.hardware.watch import DeviceWatch
from valor.device_emulators.emulator import EmulatedFault, NoSuchFaultError
from valor.robot.description import RobotDescription

ESCHER = RobotDescription.load(ROBOTS / "escher")
ROBOT = RobotDescription(ESCHER.folder, replace(ESCHER.tables, control_rate=250.0))
LEGS, SENSORS = "legs", "force_torque"
PERIOD = round(1e9 * ROBOT.control_period)  # [ns]
UNIT = {LEGS: "7", SENSORS: "3"}  # the waist's controller, the left hand's sensor


class Loop:
    """A device at work, and what the main loop does with it: it samples every period, is watched, and holds its joints.

    Without threads, so that time passes by periods alone: what a busy machine is late with is no unit's fault.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench, self.unit = bench, UNIT[bench.device]
        self.holding = True
        self._now = time.monotonic()
        bench.pause()
        device = bench.driver()
        assert isinstance(device, CanDevice)
        self.device = device
        self.watch = DeviceWatch([device])
        with bench.serving():
            device.find()
            device.enable()

    def period(self) -> None:
        device, bench = self.device, self.bench
        self._now += 1e-9 * PERIOD
        bench.robot.advance(round(1e-9 * PERIOD / bench.robot.plant.step_time))
        device.request_states()
        bench.emulator.step(self._now, bench.robot)
        device.gather()
        if device._failure:
            time.sleep(1e-9 * PERIOD)  # it is opened again by the wall's time
        self.watch.update(round(1e9 * self._now))
        if self.holding and (measured := device.joint_state) is not None:
            zero = np.zeros(measured.position.size)
            mode = np.full(zero.size, JointMode.POSITION, dtype=np.uint8)
            device.send(JointCommands(1, mode, measured.position, zero, zero, zero, zero))

    def until(self, condition: Callable[[], object], what: str, periods: int = 2000) -> None:
        for _ in range(periods):
            if condition():
                return
            self.period()
        raise AssertionError(f"not within {periods} periods: {what}: {self.watch.reactions}")

    def reactions(self) -> set[tuple[str, Fault]]:
        return {(each.unit.partition("/")[2], each.fault) for each in self.watch.reactions}

    @property
    def errors(self) -> int:
        return next(record.errors for record in self.device.records if record.unit == self.unit)

    def told(self, fault: Fault) -> str:
        """The unit is told to have a fault, alone; returns the detail."""
        self.until(lambda: (self.unit, fault) in self.reactions(), str(fault))
        assert {unit for unit, _ in self.reactions()} == {self.unit}
        return next(each.detail for each in self.watch.reactions if each.fault is fault)

    def inject(self, fault: EmulatedFault) -> None:
        self.bench.emulator.faults.inject(self.unit, fault)

    def heal(self) -> None:
        self.bench.emulator.faults.clear()
        self.until(lambda: not self.watch.reactions, "all well")


@pytest.fixture(params=[LEGS, SENSORS])
def loop(request: pytest.FixtureRequest, home: Path) -> Iterator[Loop]:
    bench = Bench(ROBOT, request.param, home)
    try:
        loop = Loop(bench)
        loop.until(lambda: loop.device.records[0].states > 5, "states")
        assert not loop.watch.reactions
        yield loop
        loop.device.close()
    finally:
        bench.close()


@pytest.fixture
def hanging(home: Path) -> Iterator[Bench]:
    """The robot hangs in its nominal posture, its legs off."""
    bench = Bench(ROBOT, LEGS, home)
    yield bench
    bench.close()


@pytest.mark.parametrize("fault", UNSOUND)
def test_nothing_of_a_sick_unit_is_accepted_and_the_others_continue(loop: Loop, fault: EmulatedFault) -> None:
    loop.inject(fault)
    loop.told(Fault.SILENT)
    assert (loop.errors > 10) is (fault is not EmulatedFault.SILENT)
    loop.heal()


@pytest.mark.parametrize(
    ("emulated", "fault", "detail"),
    [
        (EmulatedFault.SLOW, Fault.SLOW, "states a second; expected 250"),
        (EmulatedFault.OVER_TEMPERATURE, Fault.WARM, "90 °C; expected less than 75 °C"),
        (EmulatedFault.UNDER_VOLTAGE, Fault.LOW_VOLTAGE, "40.0 V; expected more than 42 V"),
    ],
)
def test_a_fault_is_told_with_value_and_limit(loop: Loop, emulated: EmulatedFault, fault: Fault, detail: str) -> None:
    if loop.bench.device == SENSORS and fault is Fault.LOW_VOLTAGE:
        with pytest.raises(NoSuchFaultError):
            loop.inject(emulated)
        return
    loop.inject(emulated)
    assert loop.told(fault).endswith(detail)
    loop.heal()


def test_a_unit_that_was_unplugged_is_used_again(loop: Loop) -> None:
    loop.inject(EmulatedFault.UNPLUGGED)
    loop.told(Fault.SILENT)
    if loop.bench.device == LEGS:
        loop.holding = False
        measured = loop.device.joint_state
        assert isinstance(measured, JointMeasurement)
        away, zero = measured.position.copy(), np.zeros(measured.position.size)
        away[-1] += 0.5
        mode = np.full(zero.size, JointMode.POSITION, dtype=np.uint8)
        loop.device.send(JointCommands(2, mode, away, zero, zero, zero, zero))
        loop.bench.emulator.faults.clear()
        assert loop.told(Fault.DISABLED) == "its motors are off: it had lost its power"
        for _ in range(100):
            loop.period()
        loop.told(Fault.DISABLED)  # as switching on would move something
        loop.holding = True
    loop.heal()


def test_a_failed_bus_is_reported_for_every_unit_and_opened_again(loop: Loop) -> None:
    """Its socket is made a pipe, so that nothing can be sent; and where the bus was, there is none for a while."""
    device, units = loop.device, {record.unit for record in loop.device.records}
    assert device._bus is not None
    bus, ports = device._bus.fileno(), loop.bench.settings.ports
    ports[f"can{device._number}"] = "socketcan:nowhere"
    end, other = os.pipe()
    os.dup2(end, bus)
    try:
        loop.until(
            lambda: {unit for unit, fault in loop.reactions() if fault is Fault.UNPLUGGED} == units, "all told", 5
        )
        assert all(each.detail.startswith(f"CAN bus {device._number}: ") for each in device.unit_faults)
    finally:
        del ports[f"can{device._number}"]
        os.close(end)
        os.close(other)
    loop.heal()
    before = [record.states for record in device.records]
    loop.until(lambda: all(r.states > b + 5 for r, b in zip(device.records, before, strict=True)), "states again", 10)


def refused(bench: Bench, robot: RobotDescription = ROBOT) -> str:
    driver = bench.driver(robot)
    with pytest.raises(DeviceError) as refusal:
        driver.find()
    driver.close()
    return str(refusal.value)


@pytest.mark.parametrize(("joint", "unit"), [("l_hip_yaw", 1), ("l_knee_pitch", 2), ("r_ankle_roll", 6)])
def test_a_robot_that_hangs_in_another_pose_is_rejected_by_joint(hanging: Bench, joint: str, unit: int) -> None:
    tables = ROBOT.tables
    expected = (tables.nominal_posture | tables.calibration.pose).get(joint, 0.0)
    with hanging.lock:
        plant, place = hanging.robot.plant, ROBOT.index[joint]
        before = plant.joint_position[place]
        address = int(plant.model.mj.joint(joint).qposadr[0])
        plant.data.qpos[address] += 2.0 * tables.calibration.tolerance
        hanging.robot._measured = None
        assert plant.joint_position[place] == pytest.approx(before + 2.0 * tables.calibration.tolerance)
    said = refused(hanging)
    assert said.startswith(f"legs/{unit}: {joint} is at {expected + 0.1:.2f}"), said
    assert f"expected {expected:.3f} ± 0.05 in the calibration pose (robot.yaml: calibration.offsets)" in said


def test_a_robot_whose_legs_are_on_may_be_anywhere(hanging: Bench) -> None:
    """Motor controllers keep their power when the Comms Manager ends: its next start finds a robot that stands."""
    with hanging.running():
        pass
    with hanging.lock:
        plant = hanging.robot.plant
        plant.data.qpos[int(plant.model.mj.joint("waist_yaw").qposadr[0])] += 0.4
        hanging.robot._measured = None
    with hanging.running() as driver:
        assert driver.joint_state is not None and abs(driver.joint_state.position[-1]) > 0.2


def test_a_unit_that_does_not_answer_is_named_with_its_bus(hanging: Bench) -> None:
    hanging.inject("4", EmulatedFault.SILENT)
    assert refused(hanging) == (
        "legs/4: no answer on CAN bus 0 within 2 s; expected serial number SEA-0104, firmware 1.4"
    )
