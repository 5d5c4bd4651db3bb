"""ROBOTIS Dynamixel servos: what their control tables hold, and in which units.

The frames of protocol 2.0 are spoken by ``dynamixel-sdk`` on the driver's side and by
``valor.device_emulators.dynamixel_bus`` on the other. From the public e-manual (emanual.robotis.com, pages MX-28/64/106
(2.0), XM430, XM540, PH54, PH42): addresses, sizes, units, model numbers, error bits, default limits. From stall torques
and currents of the same pages, and so no more than an estimate: the torque per current.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Annotated, ClassVar, Literal, NamedTuple

from msgspec import Meta

from valor.common.table import Positive, Table, TableError
from valor.devices.table import Device, require_distinct


class Item(NamedTuple):
    """An entry of a control table, little-endian."""

    address: int
    size: int  # [bytes]
    signed: bool = False


@dataclass(frozen=True)
class ControlTable:
    """The items that are used here."""

    size: int
    torque_enable: Item
    hardware_error: Item
    goal_velocity: Item
    goal_position: Item
    realtime_tick: Item  # [ms], 0 … 32767
    present_current: Item
    present_velocity: Item
    present_position: Item
    present_voltage: Item  # [0.1 V]
    present_temperature: Item  # [°C]

    # At the same place in all of them; writable while the torque is off.
    model_number: ClassVar = Item(0, 2)
    firmware: ClassVar = Item(6, 1)
    id: ClassVar = Item(7, 1)
    operating_mode: ClassVar = Item(11, 1)
    temperature_limit: ClassVar = Item(31, 1)  # [°C]
    max_voltage: ClassVar = Item(32, 2)  # [0.1 V]
    min_voltage: ClassVar = Item(34, 2)  # [0.1 V]
    shutdown: ClassVar = Item(63, 1)  # HardwareError bits that switch the torque off

    @property
    def feedback(self) -> Item:
        """All that is read in every cycle: one block, from the tick to the temperature."""
        start = self.realtime_tick.address
        return Item(start, self.present_temperature.address + self.present_temperature.size - start)


X_SERIES = ControlTable(
    size=147,
    torque_enable=Item(64, 1),
    hardware_error=Item(70, 1),
    goal_velocity=Item(104, 4, signed=True),
    goal_position=Item(116, 4, signed=True),
    realtime_tick=Item(120, 2),
    present_current=Item(126, 2, signed=True),
    present_velocity=Item(128, 4, signed=True),
    present_position=Item(132, 4, signed=True),
    present_voltage=Item(144, 2),
    present_temperature=Item(146, 1),
)
"""X series, and MX series with firmware for protocol 2.0."""

P_SERIES = ControlTable(
    size=595,
    torque_enable=Item(512, 1),
    hardware_error=Item(518, 1),
    goal_velocity=Item(552, 4, signed=True),
    goal_position=Item(564, 4, signed=True),
    realtime_tick=Item(568, 2),
    present_current=Item(574, 2, signed=True),
    present_velocity=Item(576, 4, signed=True),
    present_position=Item(580, 4, signed=True),
    present_voltage=Item(592, 2),
    present_temperature=Item(594, 1),
)
"""DYNAMIXEL-P, the successors of the PRO series that moved THOR's arms."""


class OperatingMode(IntEnum):
    """Values of ``operating_mode``; it can be written while the torque is off."""

    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4


class HardwareError(IntFlag):
    """Bits of ``hardware_error`` and of ``shutdown``."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


DEFAULT_SHUTDOWN = HardwareError.OVERHEATING | HardwareError.ELECTRICAL_SHOCK | HardwareError.OVERLOAD


@dataclass(frozen=True)
class ServoModel:
    """A model's number, table and units."""

    number: int
    table: ControlTable
    turn: int  # position steps of a whole turn
    goals: tuple[int, int]  # lowest and highest position that it takes in POSITION mode [steps]
    velocity_unit: float  # [rad/s]
    current_unit: float  # [A]
    torque_constant: float  # at the horn, estimated [N·m/A]
    voltage: float  # nominal [V]
    temperature_limit: int = 80  # [°C]

    @property
    def position_unit(self) -> float:
        """[rad]."""
        return 2.0 * math.pi / self.turn


_TURN = (0, 4095)
_RPM = 2.0 * math.pi / 60.0
MODELS = {
    "MX-28": ServoModel(30, X_SERIES, 4096, _TURN, 0.229 * _RPM, 3.36e-3, 1.8, 12.0),
    "MX-64": ServoModel(311, X_SERIES, 4096, _TURN, 0.229 * _RPM, 3.36e-3, 1.5, 12.0),
    "MX-106": ServoModel(321, X_SERIES, 4096, _TURN, 0.229 * _RPM, 3.36e-3, 1.6, 12.0),
    "XM430-W350": ServoModel(1020, X_SERIES, 4096, _TURN, 0.229 * _RPM, 2.69e-3, 1.8, 12.0),
    "XM430-W210": ServoModel(1030, X_SERIES, 4096, _TURN, 0.229 * _RPM, 2.69e-3, 1.3, 12.0),
    "XM540-W270": ServoModel(1120, X_SERIES, 4096, _TURN, 0.229 * _RPM, 2.69e-3, 2.4, 12.0),
    "XM540-W150": ServoModel(1130, X_SERIES, 4096, _TURN, 0.229 * _RPM, 2.69e-3, 1.7, 12.0),
    "PH54-200-S500-R": ServoModel(2020, P_SERIES, 1003846, (-501923, 501923), 0.01 * _RPM, 1e-3, 4.8, 24.0),
    "PH54-100-S500-R": ServoModel(2010, P_SERIES, 1003846, (-501923, 501923), 0.01 * _RPM, 1e-3, 4.5, 24.0),
    "PH42-020-S300-R": ServoModel(2000, P_SERIES, 607500, (-303750, 303750), 0.01 * _RPM, 1e-3, 3.4, 24.0),
}
"""By the name that robot.yaml gives."""


class DynamixelServo(Table, kw_only=True):
    """A servo on a Dynamixel bus."""

    id: Annotated[int, Meta(ge=0, le=252)]
    joint: str
    model: str  # one of ``MODELS``
    firmware: Annotated[int, Meta(ge=0, le=0xFF)]
    zero: int  # position at which the joint is at 0 [steps]
    direction: Literal[1, -1] = 1
    spin: float | None = None  # turns for ever at this speed, whatever is commanded; absent: obeys [rad/s]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise TableError(("model",), f"expected one of {', '.join(MODELS)}, got {self.model!r}")


class Dynamixel(Device, tag="dynamixel_2", kw_only=True):
    """Servos that speak Dynamixel protocol 2.0 on one serial bus."""

    baud_rate: Annotated[int, Meta(gt=0)]
    rate: Positive = 100.0  # at which states are read and commands written [Hz]
    servos: Annotated[list[DynamixelServo], Meta(min_length=1)]

    def __post_init__(self) -> None:
        require_distinct("servos", "id", [servo.id for servo in self.servos])

    @property
    def joints(self) -> list[str]:
        """The servos' joints, in order."""
        return [servo.joint for servo in self.servos]

    @property
    def units(self) -> list[str]:
        """The servos, by their joints."""
        return self.joints
