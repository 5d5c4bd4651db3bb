"""The table ``devices`` of robot.yaml: which devices the robot has, which units each has, and who they must be.

Where their ports are is the instance's business (``ports.py``). A unit is what can be found, be asked who it is, and
fail by itself: a motor controller, a servo, a sensor, a limb. Tables of kinds on CAN stand here, as everybody who reads
robot.yaml would have to load ``python-can`` with their frames; the others beside the numbers of their protocols.
``kinds.py`` has them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, TableError, require_order

CanId = Annotated[int, Meta(ge=1, le=63)]
WrenchPlace = Literal["left_foot", "right_foot", "left_hand", "right_hand"]


class Device(Table, tag_field="kind"):
    """A device; its ``kind`` says which table it has, with what it has to say of joints, wrenches and units."""

    @property
    def kind(self) -> str:
        """As in the file."""
        return str(self.__struct_config__.tag)

    @property
    def units(self) -> list[str]:
        """What its units are called; none: it is one itself."""
        return []

    @property
    def groups(self) -> list[str]:
        """Of robot.yaml, whose joints it moves."""
        return []

    @property
    def joints(self) -> list[str]:
        """That it moves besides, in its units' order."""
        return []

    @property
    def places(self) -> list[WrenchPlace]:
        """Of Proprioceptor's wrenches, those that it gives, in its units' order."""
        return []


class MotorController(Table):
    """A motor controller of series-elastic actuators, two axes each."""

    id: CanId
    serial: str
    firmware: str
    axes: Annotated[list[str], Meta(min_length=1, max_length=2)]  # joints, in the controller's order


class SeaCanFd(Device, tag="sea_can_fd"):
    """Series-elastic actuators behind motor controllers on a CAN FD bus."""

    bus: Annotated[int, Meta(ge=0)]
    controllers: Annotated[list[MotorController], Meta(min_length=1)]

    def __post_init__(self) -> None:
        require_distinct("controllers", "id", [controller.id for controller in self.controllers])

    @property
    def joints(self) -> list[str]:
        """All axes' joints, controller after controller."""
        return [joint for controller in self.controllers for joint in controller.axes]

    @property
    def units(self) -> list[str]:
        """The controllers' numbers."""
        return [str(controller.id) for controller in self.controllers]


class WrenchSensor(Table):
    """A force/torque sensor, and which of Proprioceptor's wrenches it gives."""

    id: CanId
    at: WrenchPlace
    serial: str
    firmware: str


class FtCan(Device, tag="ft_can"):
    """Force/torque sensors on a CAN bus."""

    bus: Annotated[int, Meta(ge=0)]
    sensors: Annotated[list[WrenchSensor], Meta(min_length=1)]

    def __post_init__(self) -> None:
        require_distinct("sensors", "id", [sensor.id for sensor in self.sensors])
        require_distinct("sensors", "at", [sensor.at for sensor in self.sensors])

    @property
    def places(self) -> list[WrenchPlace]:
        """The sensors', in order."""
        return [sensor.at for sensor in self.sensors]

    @property
    def units(self) -> list[str]:
        """The sensors' numbers."""
        return [str(sensor.id) for sensor in self.sensors]


class HdtLimb(Table):
    """An arm or a hand of HDT modules, and the joints that the vendor's driver moves."""

    group: str  # of robot.yaml
    serial: str
    firmware: str
    every: Annotated[int, Meta(ge=1)] = 1  # of the cycles, in which it is spoken to


class HdtBifrost(Device, tag="hdt_bifrost", kw_only=True):
    """HDT limbs: their driver is a ROS node, behind Bifrost topics and a bridge."""

    rate: Positive = 100.0  # of states and commands [Hz]
    bus: Annotated[int, Meta(ge=0)] = 2  # CAN, between the driver and the modules
    limbs: Annotated[list[HdtLimb], Meta(min_length=1)]

    @property
    def groups(self) -> list[str]:
        """The limbs'."""
        return [limb.group for limb in self.limbs]

    @property
    def units(self) -> list[str]:
        """The limbs, by their groups."""
        return self.groups


class Calibration(Table):
    """Where the encoders' zeros are, and the pose in which that is checked before motors are enabled."""

    offsets: dict[str, float] = {}  # what a joint's encoder says at the joint's zero [rad]; not named: 0
    pose: dict[str, float] = {}  # in which the robot hangs when it is switched on [rad]; not named: nominal_posture
    tolerance: Positive = 0.05  # of each joint there [rad]


class SupplyLimits(Table):
    """From which temperatures and voltages on a unit is not to be relied on."""

    warm: Positive = 75.0  # the robot shall come to rest [°C]
    hot: Positive = 95.0  # the unit is about to switch itself off [°C]
    low: NonNegative = 42.0  # the robot shall come to rest [V]
    flat: NonNegative = 36.0  # motors are about to switch themselves off [V]

    def __post_init__(self) -> None:
        require_order(self, "warm", "hot")
        require_order(self, "flat", "low")


def require_distinct(units: str, key: str, values: Sequence[object]) -> None:
    """Refuse a value of a key that one of the units before has, too."""
    for place, value in enumerate(values):
        if value in values[:place]:
            raise TableError((units, str(place), key), f"got {value!r}, which stands before, too; expected another")
