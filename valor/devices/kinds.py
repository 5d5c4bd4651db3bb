"""Every kind of device, a row of ``KINDS``: its table in robot.yaml, what it provides, its driver and its emulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Flag, auto
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Union

from valor.devices.dynamixel import Dynamixel
from valor.devices.kvh import Kvh1750
from valor.devices.mip import MicroStrainMip
from valor.devices.table import Device, FtCan, HdtBifrost, SeaCanFd


class Quantity(Flag):
    """Quantities that a device provides."""

    JOINT_STATE = auto()  # of joints that it moves by commands
    ATTITUDE = auto()  # with angular velocity and specific force, in the robot's frame of the IMU
    INERTIA = auto()  # angular velocity and specific force of the second IMU
    WRENCH = auto()  # at feet and hands
    TIME = auto()  # a clock that can be the robot's


JOINT_STATE, ATTITUDE, INERTIA = Quantity.JOINT_STATE, Quantity.ATTITUDE, Quantity.INERTIA
WRENCH, TIME = Quantity.WRENCH, Quantity.TIME


@dataclass(frozen=True)
class Kind:
    """A kind of device; driver and emulator are names, so that reading robot.yaml imports neither."""

    table: type[Device]  # in robot.yaml; the table's tag is the kind's name there
    provides: Quantity
    driver: str  # in ``valor.comms_manager.hardware``: module and class, a ``Device``
    emulator: str  # in ``valor.device_emulators``: module and class, an ``Emulator``

    @property
    def name(self) -> str:
        """Name in robot.yaml."""
        return str(self.table.__struct_config__.tag)

    def load_driver(self) -> Any:
        """Class of the driver."""
        return resolve_name(f"valor.comms_manager.hardware.{self.driver}")

    def load_emulator(self) -> Any:
        """Class of the emulator."""
        return resolve_name(f"valor.device_emulators.{self.emulator}")


# fmt: off
_ROWS = (
    Kind(SeaCanFd,       JOINT_STATE | TIME, "series_elastic:SeriesElastic", "can_devices:SeriesElasticEmulator"),
    Kind(FtCan,          WRENCH,             "can_device:ForceTorque",       "can_devices:ForceTorqueEmulator"),
    Kind(MicroStrainMip, ATTITUDE,           "microstrain:MicroStrain",      "microstrain:MicroStrainEmulator"),
    Kind(Kvh1750,        ATTITUDE | INERTIA, "kvh:Kvh",                      "kvh:KvhEmulator"),
    Kind(Dynamixel,      JOINT_STATE,        "dynamixel:DynamixelServos",    "dynamixel:DynamixelEmulator"),
    Kind(HdtBifrost,     JOINT_STATE,        "hdt:Hdt",                      "hdt_modules:HdtModules"),
)
# fmt: on

KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _ROWS}

if TYPE_CHECKING:
    DeviceTable = Device
else:
    DeviceTable = Union[tuple(kind.table for kind in _ROWS)]  # noqa: UP007 (made of the rows)
"""Table of a device in robot.yaml, selected by its kind."""
