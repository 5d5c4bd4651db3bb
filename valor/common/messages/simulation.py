"""The simulated robot, and the devices' emulators."""

from __future__ import annotations

from bifrost import Float64Array, Message, Uint8Array


class GroundTruth(Message):
    """The simulator's truth. For experiments and pictures: no controller may read it."""

    time: int
    pelvis_position_in_world: Float64Array  # (3,) [m]
    pelvis_orientation_in_world: Float64Array  # (4,)
    pelvis_linear_velocity_in_world: Float64Array  # (3,) [m/s]
    com_in_world: Float64Array  # (3,) [m]
    joint_position: Float64Array  # [rad]
    contacts: Uint8Array  # (2,) left, right foot
    fixture_position: Float64Array  # of the world's joints, in their order: a door's leaf and lever, a wheel [rad]


class PushRequest(Message):
    """Push a body of the simulated robot, at its centre of mass."""

    impulse_in_world: Float64Array  # (3,) [N·s]
    duration: float  # [s]
    body: str = ""  # of the robot's model; empty: the chest


class PushReply(Message):
    """Whether the push began, and when [robot time, ns]."""

    accepted: bool
    time: int
    reason: str


class TimeRequest(Message):
    """Let the simulated robot's time pass otherwise."""

    wanted: str  # pause, resume, step, factor; empty: nothing, how does it pass?
    value: float  # step: so many control periods, then it is paused; factor: of the wall's time, 0: as fast as it goes


class TimeReply(Message):
    """How it passes now."""

    accepted: bool
    paused: bool
    factor: float
    time: int  # robot time [ns]
    reason: str


class FaultRequest(Message):
    """Let a unit of an emulated device fail."""

    device: str  # as in robot.yaml
    unit: str  # as in DeviceStatus.units, behind the slash; the device's name where it has one unit only
    fault: str  # silent, slow, garbage, … (device_emulators/emulator.py); empty: end all of this device
    duration: float  # [s]; 0: for good


class FaultReply(Message):
    """Whether the unit fails now."""

    accepted: bool
    reason: str
