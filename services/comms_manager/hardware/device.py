"""What every device of the robot has in common: a thread that speaks its protocol, states out, commands in.

Between the thread and the main loop stand real-time buffers of the simplest kind: one reference to the newest whole
thing, replaced, never changed. Python replaces a reference at once, so neither side ever waits for the other.

::

    device thread ── states ────► main loop      the newest of what it provides, with the time at which each came
    device thread ◄── command ─── main loop      newest slice of Motor; ``wake`` tells the thread
    device thread ── faults ────► main loop      what is wrong with which unit, besides silence
"""

from __future__ import annotations

import contextlib
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from threading import Event

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.devices.kinds import KINDS, Quantity
from valor.robot.description import RobotDescription

IntVector = npt.NDArray[np.int64]
FEET = ("left_foot", "right_foot")  # where the forces must be known
RATE_WINDOW = 1.0  # over which rates and latencies are taken [s]


class Part(StrEnum):
    """What the robot needs a unit for."""

    LEGS = "legs"  # to carry itself: joints driven by force
    UPPER_BODY = "upper_body"  # all other joints
    IMU = "imu"
    FOOT = "foot"  # forces at a foot
    HAND = "hand"  # forces at a hand


class DeviceError(ValorError):
    """A device is not there, is another one, or does not do as it must: names device and unit, and the expectation."""


class Fault(StrEnum):
    """What can be wrong with a unit. ``faults.py`` says what the robot does about it."""

    SILENT = "silent"  # no state for too long; whatever came cannot be believed
    SLOW = "slow"  # states come at less than half of the rate at which they should
    FAULTY = "faulty"  # the unit says so itself
    ENCODER = "encoder"  # its position jumped farther than a joint can move
    WARM = "warm"  # so that the robot shall come to rest
    HOT = "hot"  # so that the unit is about to switch itself off
    LOW_VOLTAGE = "low_voltage"
    FLAT = "flat"  # so little voltage that motors are about to switch themselves off
    UNPLUGGED = "unplugged"  # the port is gone, or the unit has lost its power: it must be found again
    DISABLED = "disabled"  # its motors are off, though they were switched on
    OVERDUE = "overdue"  # the computer has not read it for a moment: its fault, not the unit's
    UNREAD = "unread"  # likewise, for too long


@dataclass(frozen=True, slots=True)
class Ailment:
    """A fault of a unit."""

    unit: str
    fault: Fault
    detail: str  # one line for people


@dataclass(frozen=True, slots=True)
class JointMeasurement:
    """States of a device's joints, arrays of (m,) in the device's order."""

    stamp: IntVector  # when each came, monotonic [ns]; 0: never
    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    effort: FloatArray  # [N·m]


@dataclass(frozen=True, slots=True)
class ImuMeasurement:
    """What an inertial measurement unit says."""

    stamp: int  # when it came, monotonic [ns]
    orientation: FloatArray  # (4,) in world
    angular_velocity: FloatArray  # (3,) in IMU [rad/s]
    linear_acceleration: FloatArray  # (3,) in IMU, specific force [m/s²]


@dataclass(frozen=True, slots=True)
class WrenchMeasurement:
    """What force/torque sensors say, k of them in the device's order."""

    stamp: IntVector  # (k,) when each came, monotonic [ns]; 0: never
    wrench: FloatArray  # (k, 6) [N, N·m] in the frames of Proprioceptor's wrenches


@dataclass(frozen=True, slots=True)
class JointCommands:
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
    """What a device thread writes down about one unit; the main loop makes a row of ``DeviceStatus`` of it."""

    unit: str
    states: int = 0  # received since start
    stamp: int = 0  # of the newest state, monotonic [ns]
    latency_sum: float = 0.0  # from command or request to the state that answers it, since start [s]
    latency_count: int = 0
    temperature: float = math.nan  # [°C]
    voltage: float = math.nan  # [V]
    errors: int = 0  # frames refused since start: checksum, length, order, nonsense

    def received(self, stamp: int) -> None:
        """A sound state came at ``stamp`` [monotonic ns]."""
        self.states += 1
        self.stamp = stamp

    def answered(self, latency: float) -> None:
        """It answered a command or request after ``latency`` [s]."""
        self.latency_sum += latency
        self.latency_count += 1


@dataclass(frozen=True)
class DeviceContext:
    """What a device is made from."""

    instance: Instance
    settings: Settings
    robot: RobotDescription


class Device(ABC):
    """A device behind one port, with a thread of its own.

    The main thread calls ``find`` and ``enable`` before the thread starts, ``wake`` and ``close`` from outside;
    everything else happens in ``run``. ``find`` and ``enable`` raise ``DeviceError``; ``run`` never raises for what
    comes over the port: it tells it in ``ailments``, and goes on.

    Attributes:
        name: as in robot.yaml.
        provides: what it gives, by its kind.
        joints: (m,) places of its joints in every joint vector; none for sensors.
        places: of Proprioceptor's wrenches, those that it gives, in order.
        records: one a unit, in robot.yaml's order.
        joint_state, attitude, wrench: newest of what it provides; None before the first, and of what it does not.
            Replaced, never changed.
        ailments: what is wrong now, besides silence. Replaced, never changed; the same object while nothing changes.
        rate: at which states of each unit should come [Hz].
        silent_after: without a state for so long, a unit is silent [s].
        looks: how often its thread has had everything that its port had brought. Silence is a unit's fault only as far
            as somebody listened.
        elapsed: by a clock of its own that can be the robot's, since ``find`` [ns].
    """

    silent_after: float = 0.1
    elapsed = 0

    def __init__(self, name: str, context: DeviceContext) -> None:
        robot = context.robot
        self.name = name
        self.context = context
        self.joints: npt.NDArray[np.intp] = np.array(
            [robot.index[joint] for joint in robot.tables.device_joints(name)], dtype=np.intp
        )
        table = robot.tables.devices[name]
        self.provides = KINDS[table.kind].provides
        self.places: tuple[str, ...] = tuple(table.places)
        self.records: tuple[UnitRecord, ...] = ()
        self.joint_state: JointMeasurement | None = None
        self.attitude: ImuMeasurement | None = None
        self.wrench: WrenchMeasurement | None = None
        self.ailments: tuple[Ailment, ...] = ()
        self.command: JointCommands | None = None
        self.looks = 0
        self.rate = robot.tables.control_rate
        self.woken = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        """Readable when there is something new to do: for ``select`` beside the port."""

    @abstractmethod
    def find(self) -> None:
        """Open the port, ask every unit who it is, and get a first state with calibration applied.

        Raises:
            DeviceError: names the device, the unit, and what was expected.
        """

    def enable(self) -> None:  # noqa: B027 (sensors have no motors)
        """Switch the motors on; the joints stay where they are.

        Raises:
            DeviceError: a unit does not answer or refuses.
        """

    def part(self, unit: str) -> Part:
        """What the robot needs a unit for: the joints that its device moves, or what it feels."""
        if Quantity.JOINT_STATE in self.provides:
            return Part.LEGS if self.context.robot.tables.device_carries(self.name) else Part.UPPER_BODY
        if Quantity.WRENCH in self.provides:
            place = self.places[[record.unit for record in self.records].index(unit)]
            return Part.FOOT if place in FEET else Part.HAND
        return Part.IMU

    def request_states(self) -> None:  # noqa: B027 (most keep a pace of their own)
        """Have all units sample now (main loop)."""

    def await_states(self) -> None:  # noqa: B027
        """Wait, within bounds, until what was asked for last is there (main loop)."""

    @abstractmethod
    def run(self, stopping: Event) -> None:
        """The thread: exchange frames until ``stopping`` is set; return within 0.1 s of that."""

    def close(self) -> None:
        """Switch motors off where that is safe, close the port; called after the thread has ended."""
        os.close(self.woken)

    def send(self, command: JointCommands) -> None:
        """Hand over the newest command (main loop)."""
        self.command = command
        self.wake()

    def wake(self) -> None:
        """Have the thread look (main loop)."""
        os.eventfd_write(self.woken, 1)

    def drain_wake(self) -> None:
        """Take the waking back (device thread), before looking at what is new."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self.woken)

    def tell(self, ailments: list[Ailment]) -> None:
        """Replace what is wrong, if it is something else than before."""
        if tuple(ailments) != self.ailments:
            self.ailments = tuple(ailments)


def providers(devices: Sequence[Device], quantity: Quantity) -> list[Device]:
    """Those that provide something, in robot.yaml's order."""
    return [device for device in devices if quantity in device.provides]


@dataclass
class UnitRates:
    """Rate, latency and age of one unit as of late, from its record."""

    record: UnitRecord
    rate: float = math.nan  # [Hz]
    latency: float = math.nan  # [s]
    _since: float = math.nan
    _states: int = 0
    _latency_sum: float = 0.0
    _latency_count: int = 0

    def update(self, now: float) -> None:
        """Take rate and latency since the last call, if that is at least ``RATE_WINDOW`` of robot time ago [s]."""
        record, elapsed = self.record, now - self._since
        if elapsed < RATE_WINDOW:
            return
        if not math.isnan(elapsed):
            self.rate = (record.states - self._states) / elapsed
        answers = record.latency_count - self._latency_count
        self.latency = (record.latency_sum - self._latency_sum) / answers if answers else math.nan
        self._since, self._states = now, record.states
        self._latency_sum, self._latency_count = record.latency_sum, record.latency_count

    def age(self, now: float) -> float:
        """Of the newest state [s]; infinite before the first."""
        return now - self.record.stamp * 1e-9 if self.record.stamp else math.inf
