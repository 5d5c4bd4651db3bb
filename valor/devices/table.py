"""The table ``devices`` of robot.yaml: devices of the robot, and their units with expected identities.

A unit fails separately: a motor controller, a servo, a sensor, a limb. Tables of devices on CAN are here, so that
reading robot.yaml does not load ``python-can``; the others are with their protocols, and all in ``kinds.py``.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, TableError, require_order

CanId = Annotated[int, Meta(ge=1, le=63)]
WrenchPlace = Literal["left_foot", "right_foot", "left_hand", "right_hand"]


class Device(Table, tag_field="kind"):
    """A device; its ``kind`` selects the table."""

    @property
    def kind(self) -> str:
        """Kind in the file."""
        return str(self.__struct_config__.tag)

    @property
    def units(self) -> list[str]:
        """Names of its units; empty if it is a single unit."""
        return []

    @property
    def groups(self) -> list[str]:
        """Groups of robot.yaml whose joints it moves."""
        return []

    @property
    def joints(self) -> list[str]:
        """Further joints that it moves, in its units' order."""
        return []

    @property
    def places(self) -> list[WrenchPlace]:
        """Proprioceptor's wrenches that it measures, in its units' order."""
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
        """Joints of all axes, controller after controller."""
        return [joint for controller in self.controllers for joint in controller.axes]

    @property
    def units(self) -> list[str]:
        """Numbers of the controllers."""
        return [str(controller.id) for controller in self.controllers]


class WrenchSensor(Table):
    """A force/torque sensor, and Proprioceptor's wrench that it measures."""

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
        """Wrenches of the sensors, in order."""
        return [sensor.at for sensor in self.sensors]

    @property
    def units(self) -> list[str]:
        """Numbers of the sensors."""
        return [str(sensor.id) for sensor in self.sensors]


class HdtLimb(Table):
    """An arm or a hand of HDT modules."""

    group: str  # of robot.yaml
    serial: str
    firmware: str
    every: Annotated[int, Meta(ge=1)] = 1  # cycles per exchange with it


class HdtBifrost(Device, tag="hdt_bifrost", kw_only=True):
    """HDT limbs, behind Bifrost topics, a bridge and the vendor's ROS node."""

    rate: Positive = 100.0  # of states and commands [Hz]
    limbs: Annotated[list[HdtLimb], Meta(min_length=1)]

    @property
    def groups(self) -> list[str]:
        """Groups of the limbs."""
        return [limb.group for limb in self.limbs]

    @property
    def units(self) -> list[str]:
        """Limbs, by their groups."""
        return self.groups


class Calibration(Table):
    """Zeros of the encoders, and the pose in which they are checked before motors are enabled."""

    # Joint → encoder value at the joint's zero, default 0; a larger one is another joint's, or in degrees [rad].
    offsets: dict[str, Annotated[float, Meta(ge=-0.5, le=0.5, extra={"unit": "rad"})]] = {}
    pose: dict[str, float] = {}  # joint → position of the hanging robot at power-on [rad], default nominal_posture
    tolerance: Annotated[float, Meta(gt=0, le=0.5, extra={"unit": "rad"})] = 0.05  # of each joint in that pose [rad]


class SupplyLimits(Table):
    """Limits of temperature and voltage of a unit."""

    warm: Positive = 75.0  # the robot must come to rest [°C]
    hot: Positive = 95.0  # the unit is about to switch itself off [°C]
    low: NonNegative = 42.0  # the robot must come to rest [V]
    flat: NonNegative = 36.0  # motors are about to switch themselves off [V]

    def __post_init__(self) -> None:
        require_order(self, "warm", "hot")
        require_order(self, "flat", "low")


def require_distinct(units: str, key: str, values: Sequence[object]) -> None:
    """Reject a value of a key that an earlier unit has as well."""
    for row, value in enumerate(values):
        if value in values[:row]:
            raise TableError((units, str(row), key), f"got {value!r}, which an earlier row has; expected another")
