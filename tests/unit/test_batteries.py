"""Batteries: charge by what the joints draw, voltage by both; low, they are reported, and at last stop the robot."""

from __future__ import annotations

import math
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from harness.device_bench import StillDevice
from harness.instance import fresh_instance
from harness.places import ROBOTS
from harness.waiting import PATIENCE, some, wait_until
from tests.integration.device_system import RobotOnDevices
from valor.common.topics import BATTERIES
from valor.comms_manager.hardware.proprioception import NOMINAL_VOLTAGE, Proprioception
from valor.robot.batteries import LOWEST
from valor.robot.description import RobotDescription
from valor.simulation.plant import Plant
from valor.simulation.sensors import SUPPLY, Sensors, Supply

ESCHER = RobotDescription.load(ROBOTS / "escher")
TABLE = some(ESCHER.tables.batteries)
STILL = np.zeros(len(ESCHER.joints))


def test_the_voltage_sags_by_the_current_and_tells_the_charge() -> None:
    rest = TABLE.voltage(0.5, 0.0)
    for power in (250.0, 1500.0):
        voltage = TABLE.voltage(0.5, power)
        current = power / voltage
        assert rest - voltage == pytest.approx(current * 12 * 0.003 / 2), "two strings of twelve cells"
        assert TABLE.share(voltage, current) == pytest.approx(0.5)
    assert 12 * LOWEST < TABLE.voltage(0.0, 0.0) < TABLE.voltage(1.0, 0.0) == pytest.approx(12 * 4.2)
    assert TABLE.voltage(0.0, 1e9) > 0.0, "a short circuit"


def test_a_joint_draws_what_it_moves_and_heats_and_returns_nothing() -> None:
    effort, velocity = STILL.copy(), STILL.copy()
    effort[0] = 100.0  # of 150 N·m
    for speed, drawn in ((0.0, 100.0**2 / 150.0), (2.0, 200.0 + 100.0**2 / 150.0), (-2.0, 100.0**2 / 150.0)):
        velocity[0] = speed
        assert TABLE.power(effort, velocity, ESCHER.effort_limit) == pytest.approx(TABLE.idle + drawn)


def test_the_simulated_packs_are_empty_when_their_charge_has_flown() -> None:
    supply = Supply(ESCHER, TABLE)
    voltages = [supply.drain(round(1e9 * second), STILL, STILL) for second in range(4 * 3600)]
    assert (np.diff(voltages) <= 1e-9).all()
    empty = next(second for second, voltage in enumerate(voltages) if voltage <= TABLE.voltage(0.0, TABLE.idle))
    drawn = sum(TABLE.idle / voltage for voltage in voltages[:empty]) / 3600.0
    assert drawn == pytest.approx(TABLE.whole, rel=1e-3)


def test_a_robot_without_batteries_has_a_supply_as_before() -> None:
    none = RobotDescription(ESCHER.folder, replace(ESCHER.tables, batteries=None))
    sensors = Sensors(none, Plant(none, "flat", "ideal", 0), none.tables.actuators["ideal"].noise, 0)
    assert {sensors.measure(k, 10**12 * k).battery_voltage for k in range(3)} == {SUPPLY}


def test_on_hardware_the_voltage_is_that_of_the_legs_and_not_of_smaller_servos() -> None:
    devices = [StillDevice(name, ESCHER) for name in ESCHER.tables.devices]
    senses = Proprioception(ESCHER, devices)
    for device in devices:
        device.records[0].voltage = {"legs": 46.0, "neck": 12.0}.get(device.name, math.nan)
    assert senses.measure(1, 1, 0, None).battery_voltage == NOMINAL_VOLTAGE
    senses.update_voltage()
    assert senses.measure(1, 1, 0, None).battery_voltage == 46.0


def test_low_batteries_are_reported_and_critical_ones_stop_the_robot_once(tmp_path: Path, home: Path) -> None:
    """A robot with packs so small that they are low after seconds of standing, and critical ten seconds later."""
    folder = tmp_path / "escher"
    shutil.copytree(ESCHER.folder, folder)
    file = folder / "robot.yaml"
    file.write_text(file.read_text().replace("capacity: 10.0", "charge: 0.24, capacity: 0.11"))
    with fresh_instance(home, robot=str(folder), real_time_factor=1.0) as running:
        for name in ("comms_manager", "motion_manager"):
            running.start(name, wait=True)
        robot = RobotOnDevices(running)
        batteries = BATTERIES.subscriber(robot.node, queue=100)
        robot.go("stand")
        wait_until(lambda: robot.unit("batteries")[0] == "faulty", PATIENCE, "low")
        assert robot.status.reaction == "keep_balance" and robot.behavior == "stand"
        assert "expected more than 20%" in robot.unit("batteries")[1]
        wait_until(lambda: robot.behavior == "soft_stop", PATIENCE, "it comes to rest")
        assert robot.state.reason.startswith("batteries: charge ") and "more than 10%" in robot.state.reason
        stopped = robot.state.time
        wait_until(lambda: robot.state.time > stopped + 3_000_000_000, PATIENCE, "three seconds more")
        assert robot.behavior == "soft_stop"
        assert running.log("motion_manager").count("soft_stop") == 1, "once"
        told = [some(batteries.receive(PATIENCE)).message for _ in range(5)]
    drawn = sum(each.current * 1e-9 * (b.time - each.time) for each, b in pairwise(told)) / 3600.0
    assert told[0].charge - told[-1].charge == pytest.approx(drawn, rel=0.3)
    assert told[-1].voltage < told[0].voltage
