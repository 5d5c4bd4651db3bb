"""ROBOTIS Dynamixel servos: items of their control tables, and units; ``dynamixel-sdk`` has protocol 2.0.

Source: the public e-manual (emanual.robotis.com/docs/en/dxl: mx/mx-28-2, mx/mx-64-2, mx/mx-106-2, x/xm430-w350,
x/xm430-w210, x/xm540-w270, x/xm540-w150, p/ph54-200-s500-r, p/ph54-100-s500-r, p/ph42-020-s300-r): tables "Control
Table", units of their items, and stall torque and current. Positive positions, velocities and currents are
counter-clockwise seen on the horn. ``tests/unit/test_makers_tables.py`` has the same tables as bytes.
"""

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
    """Items of a control table that are used here."""

    size: int
    torque_enable: Item
    hardware_error: Item
    goal_velocity: Item
    goal_position: Item
    realtime_tick: Item  # [ms], 0 … 32767
    present_effort: Item  # Present Current, Present Load of models without a current sensor
    present_velocity: Item
    present_position: Item
    present_voltage: Item  # [0.1 V]
    present_temperature: Item  # [°C]

    # Equal in all tables.
    model_number: ClassVar = Item(0, 2)
    firmware: ClassVar = Item(6, 1)
    operating_mode: ClassVar = Item(11, 1)  # ``OperatingMode``, writable while the torque is off

    @property
    def feedback(self) -> Item:
        """Block that is read in every cycle, from the tick to the temperature."""
        start = self.realtime_tick.address
        return Item(start, self.present_temperature.address + self.present_temperature.size - start)


X_SERIES = ControlTable(
    size=147,
    torque_enable=Item(64, 1),
    hardware_error=Item(70, 1),
    goal_velocity=Item(104, 4, signed=True),
    goal_position=Item(116, 4, signed=True),
    realtime_tick=Item(120, 2),
    present_effort=Item(126, 2, signed=True),
    present_velocity=Item(128, 4, signed=True),
    present_position=Item(132, 4, signed=True),
    present_voltage=Item(144, 2),
    present_temperature=Item(146, 1),
)
"""X series, and MX series with firmware for protocol 2.0."""

P_SERIES = ControlTable(
    size=595,
    **{key: each._replace(address=448 + each.address) for key, each in vars(X_SERIES).items() if key != "size"},
)
"""DYNAMIXEL-P, the successors of the PRO series that moved THOR's arms: the same items at higher addresses."""


class OperatingMode(IntEnum):
    """Values of ``operating_mode``."""

    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4


class HardwareError(IntFlag):
    """Bits of ``hardware_error``."""

    INPUT_VOLTAGE = 0x01
    HALL_SENSOR = 0x02  # P series
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


# Errors that switch the torque off by default, 52; newer firmware of the P series, and the PH42's 58, differ.
DEFAULT_SHUTDOWN = HardwareError.OVERHEATING | HardwareError.ELECTRICAL_SHOCK | HardwareError.OVERLOAD


@dataclass(frozen=True)
class ServoModel:
    """A model's number, table and units."""

    number: int
    table: ControlTable
    turn: int  # position steps per turn
    goals: tuple[int, int]  # lowest and highest goal in POSITION mode by default [steps]
    velocity_unit: float  # [rad/s]
    current_unit: float | None  # of Present Current [A]; None: Present Load, 0.1 % of the largest torque
    torque: float  # at the horn with ``current``: stall torque at ``voltage``, P series continuous torque [N·m]
    current: float  # [A]
    voltage: float  # nominal [V]
    temperature_limit: int = 80  # [°C]

    @property
    def position_unit(self) -> float:
        """Angle of a position step [rad]."""
        return 2.0 * math.pi / self.turn

    @property
    def effort_unit(self) -> float:
        """Estimated torque at the horn per unit of ``present_effort``; no servo measures torque [N·m]."""
        return self.torque * (1e-3 if self.current_unit is None else self.current_unit / self.current)


_TURN = (0, 4095)
_PH54, _PH42 = (-501433, 501433), (-303454, 303454)
_RPM = 2.0 * math.pi / 60.0
_X, _P = 0.229 * _RPM, 0.01 * _RPM
# fmt: off
MODELS = {
    "MX-28":           ServoModel(30,   X_SERIES, 4096,    _TURN, _X, None,     2.5, 1.4, 12.0),
    "MX-64":           ServoModel(311,  X_SERIES, 4096,    _TURN, _X, 3.36e-3,  6.0, 4.1, 12.0),
    "MX-106":          ServoModel(321,  X_SERIES, 4096,    _TURN, _X, 3.36e-3,  8.4, 5.2, 12.0),
    "XM430-W350":      ServoModel(1020, X_SERIES, 4096,    _TURN, _X, 2.69e-3,  4.1, 2.3, 12.0),
    "XM430-W210":      ServoModel(1030, X_SERIES, 4096,    _TURN, _X, 2.69e-3,  3.0, 2.3, 12.0),
    "XM540-W270":      ServoModel(1120, X_SERIES, 4096,    _TURN, _X, 2.69e-3, 10.6, 4.4, 12.0),
    "XM540-W150":      ServoModel(1130, X_SERIES, 4096,    _TURN, _X, 2.69e-3,  7.3, 4.4, 12.0),
    "PH54-200-S500-R": ServoModel(2020, P_SERIES, 1003846, _PH54, _P, 1e-3,    44.7, 9.3, 24.0),
    "PH54-100-S500-R": ServoModel(2010, P_SERIES, 1003846, _PH54, _P, 1e-3,    25.3, 5.5, 24.0),
    "PH42-020-S300-R": ServoModel(2000, P_SERIES, 607500,  _PH42, _P, 1e-3,     5.1, 1.5, 24.0),
}
# fmt: on
"""Models by their name in robot.yaml."""


class DynamixelServo(Table, kw_only=True):
    """A servo on a Dynamixel bus."""

    id: Annotated[int, Meta(ge=0, le=252)]
    joint: str
    model: str  # one of ``MODELS``
    firmware: Annotated[int, Meta(ge=0, le=0xFF)]
    zero: int  # position at which the joint is at 0 [steps]
    direction: Literal[1, -1] = 1
    spin: float | None = None  # permanent speed, regardless of commands; None: position control [rad/s]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise TableError(("model",), f"expected one of {', '.join(MODELS)}, got {self.model!r}")


class Dynamixel(Device, tag="dynamixel_2", kw_only=True):
    """Servos with Dynamixel protocol 2.0 on one serial bus."""

    baud_rate: Annotated[int, Meta(gt=0)]
    rate: Positive = 100.0  # of reading states and writing commands [Hz]
    servos: Annotated[list[DynamixelServo], Meta(min_length=1)]

    def __post_init__(self) -> None:
        require_distinct("servos", "id", [servo.id for servo in self.servos])

    @property
    def joints(self) -> list[str]:
        """Joints of the servos, in order."""
        return [servo.joint for servo in self.servos]

    @property
    def units(self) -> list[str]:
        """Servos, by their joints."""
        return self.joints
