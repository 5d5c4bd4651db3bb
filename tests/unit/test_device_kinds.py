"""The registry of device kinds: each row has a driver and an emulator, and gives what it says that it gives."""

from __future__ import annotations

import inspect

import pytest

from harness.places import ROBOTS
from valor.comms_manager.hardware.device import Device
from valor.device_emulators.emulator import Emulator
from valor.devices.kinds import KINDS, Kind, Quantity
from valor.robot.description import RobotDescription


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_kind_has_a_driver_and_an_emulator(kind: Kind) -> None:
    driver, emulator = kind.load_driver(), kind.load_emulator()
    assert issubclass(driver, Device) and not inspect.isabstract(driver)
    assert issubclass(emulator, Emulator) and not inspect.isabstract(emulator)
    assert kind.provides


@pytest.mark.parametrize("robot", ["escher", "thor"])
def test_tables_name_joints_and_places_of_kinds_that_provide_them(robot: str) -> None:
    tables = RobotDescription.load(ROBOTS / robot).tables
    for name, device in tables.devices.items():
        provides = KINDS[device.kind].provides
        assert bool(tables.device_joints(name)) is (Quantity.JOINT_STATE in provides), name
        assert bool(device.places) is (Quantity.WRENCH in provides), name
        assert (Quantity.TIME in provides) is (name == "legs")
        assert tables.device_carries(name) is (name == "legs")
