"""Base class of all devices: states out, commands in.

The main loop reads all ports when a period begins: a thread for each would wake it several times a period. Only what
blocks has a thread: servos that a library reads, and the search for a lost sensor. Thread and main loop exchange
references to the latest complete object, which are replaced and never changed. Replacing a reference is atomic in
Python, so neither side waits for the other.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from threading import Event
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.devices.kinds import KINDS, Quantity
from valor.robot.description import RobotDescription

IntVector = npt.NDArray[np.int64]
FEET = ("left_foot", "right_foot")  # where forces must be measured


def make_device(name: str, context: DeviceContext) -> Device:
    """The driver of a device of robot.yaml; its ports are not opened yet."""
    device: Device = KINDS[context.robot.tables.devices[name].kind].load_driver()(name, context)
    return device


class Part(StrEnum):
    """Function of a unit for the robot."""

    LEGS = "legs"  # joints that carry the robot, driven by force
    UPPER_BODY = "upper_body"  # all other joints
    IMU = "imu"
    FOOT = "foot"  # forces at a foot
    HAND = "hand"  # forces at a hand
    BATTERY = "battery"


class DeviceError(ValorError):
    """A device is missing, another one, or responds unexpectedly; the message names device, unit, expectation."""


class Fault(StrEnum):
    """Fault of a unit. ``watch.REACTIONS`` defines the robot's reaction."""

    SILENT = "silent"  # timeout of valid states
    SLOW = "slow"  # states at less than half of the nominal rate
    FAULTY = "faulty"  # reported by the unit itself
    ENCODER = "encoder"  # its position changed faster than a joint can move
    WARM = "warm"  # the robot must come to rest
    HOT = "hot"  # the unit is about to switch itself off
    LOW_VOLTAGE = "low_voltage"
    FLAT = "flat"  # motors are about to switch themselves off
    UNPLUGGED = "unplugged"  # the port is missing, or the unit has lost its power
    DISABLED = "disabled"  # its motors are off, though they were switched on
    OVERDUE = "overdue"  # the computer has not read the port for a moment
    UNREAD = "unread"  # the computer has not read the port for too long


@dataclass(frozen=True, slots=True)
class UnitFault:
    """A fault of a unit."""

    unit: str
    fault: Fault
    detail: str  # human-readable, one line


class JointMeasurement(NamedTuple):
    """States of a device's joints, (m,) in the device's order."""

    stamp: IntVector  # time of reception, monotonic [ns]; 0: never
    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    effort: FloatArray  # [N·m]


class ImuMeasurement(NamedTuple):
    """Sample of an inertial measurement unit."""

    stamp: int  # time of reception, monotonic [ns]
    orientation: FloatArray  # (4,) in world
    angular_velocity: FloatArray  # (3,) in IMU [rad/s]
    linear_acceleration: FloatArray  # (3,) in IMU, specific force [m/s²]


@dataclass(frozen=True, slots=True)
class WrenchMeasurement:
    """Samples of k force/torque sensors in the device's order."""

    stamp: IntVector  # (k,) time of reception, monotonic [ns]; 0: never
    wrench: FloatArray  # (k, 6) [N, N·m] in the frames of Proprioceptor's wrenches


class JointCommands(NamedTuple):
    """A device's slice of Motor, arrays of (m,) in the device's order; finite and within the joints' limits."""

    sequence: int  # of the Motor
    mode: npt.NDArray[np.uint8]  # JointMode
    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    effort: FloatArray  # [N·m]
    stiffness: FloatArray  # [N·m/rad]
    damping: FloatArray  # [N·m·s/rad]


@dataclass(slots=True)
class UnitRecord:
    """Statistics of one unit, written by its device; a row of ``DeviceStatus``."""

    unit: str
    states: int = 0  # received since start
    stamp: int = 0  # of the latest state, monotonic [ns]
    latency_sum: float = 0.0  # from command or request to the state that answers it, since start [s]
    latency_count: int = 0
    temperature: float = math.nan  # [°C]
    voltage: float = math.nan  # [V]
    errors: int = 0  # frames rejected since start: checksum, length, order, range

    def received(self, stamp: int) -> None:
        """Count a valid state received at ``stamp`` [monotonic ns]."""
        self.states += 1
        self.stamp = stamp

    def answered(self, latency: float) -> None:
        """Count a response to a command or request after ``latency`` [s]."""
        self.latency_sum += latency
        self.latency_count += 1


@dataclass(frozen=True)
class DeviceContext:
    """Arguments of every device's constructor."""

    instance: Instance
    settings: Settings
    robot: RobotDescription


class Watched(ABC):
    """Units that ``watch.DeviceWatch`` monitors.

    Attributes:
        name: as in robot.yaml.
        records: one per unit, in robot.yaml's order.
        unit_faults: present faults, except timeouts. Replaced, never changed; the same object without a change.
        rate: nominal rate of each unit's states [Hz].
        silent_after: timeout of states [s].
        looks: number of complete reads of the port. A timeout is a unit's fault only if the port was read.
    """

    silent_after: float = 0.1

    def __init__(self, name: str, rate: float, records: tuple[UnitRecord, ...] = ()) -> None:
        self.name, self.rate, self.records = name, rate, records
        self.unit_faults: tuple[UnitFault, ...] = ()
        self.looks = 0

    @abstractmethod
    def part(self, unit: str) -> Part:
        """Return the function of a unit."""

    def report_faults(self, unit_faults: list[UnitFault]) -> None:
        """Replace the present faults, if they changed."""
        if tuple(unit_faults) != self.unit_faults:
            self.unit_faults = tuple(unit_faults)


class Device(Watched):
    """A device behind one port.

    The main loop calls ``find`` and ``enable`` before the thread starts. ``gather`` and ``run`` never raise for
    received data: they report ``unit_faults``, and continue.

    Attributes:
        provides: quantities of its kind.
        joints: (m,) indices of its joints in the joint vectors; empty for sensors.
        places: Proprioceptor's wrenches that it measures, in order.
        joint_state, attitude, inertia, wrench: latest measurements; None before the first, and for other quantities.
            Replaced, never changed.
        elapsed: time since ``find`` by the device's clock, if that can be the robot's [ns].
    """

    elapsed = 0

    def __init__(self, name: str, context: DeviceContext) -> None:
        robot = context.robot
        super().__init__(name, robot.tables.control_rate)
        self.context = context
        self.joints: npt.NDArray[np.intp] = np.array(
            [robot.index[joint] for joint in robot.tables.device_joints(name)], dtype=np.intp
        )
        table = robot.tables.devices[name]
        self.provides = KINDS[table.kind].provides
        self.places: tuple[str, ...] = tuple(table.places)
        self.joint_state: JointMeasurement | None = None
        self.attitude: ImuMeasurement | None = None
        self.inertia: ImuMeasurement | None = None  # its orientation may be unknown
        self.wrench: WrenchMeasurement | None = None
        self.command: JointCommands | None = None

    @abstractmethod
    def find(self) -> None:
        """Open the port, check every unit's identity, and receive a first state with calibration applied.

        Raises DeviceError: names the device, the unit, and what was expected.
        """

    def enable(self) -> None:  # sensors have no motors
        """Switch the motors on; joints stay in place. Raises DeviceError: a unit is silent or rejects the request."""

    def part(self, unit: str) -> Part:
        """Function of a unit: the joints that its device moves, or what it measures."""
        if Quantity.JOINT_STATE in self.provides:
            return Part.LEGS if self.context.robot.tables.device_carries(self.name) else Part.UPPER_BODY
        if Quantity.WRENCH in self.provides:
            place = self.places[[record.unit for record in self.records].index(unit)]
            return Part.FOOT if place in FEET else Part.HAND
        return Part.IMU

    def request_states(self) -> None:  # most have their own rate
        """Let all units sample now (main loop)."""

    def gather(self) -> None:
        """Process what was received, and wait, within bounds, for the requested states (main loop)."""

    def run(self, stopping: Event) -> None:
        """The thread, for what blocks: until ``stopping`` is set; return within 0.1 s of that. Default: none."""

    @abstractmethod
    def close(self) -> None:
        """Switch motors off where that is safe, close the port; called after the thread has ended."""

    def send(self, command: JointCommands) -> None:
        """Set the latest command (main loop)."""
        self.command = command


def providers(devices: Sequence[Device], quantity: Quantity) -> list[Device]:
    """Devices that provide a quantity, in robot.yaml's order."""
    return [device for device in devices if quantity in device.provides]
