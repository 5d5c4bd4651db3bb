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


class PushRequest(Message):
    """Push the chest of the simulated robot."""

    impulse_in_world: Float64Array  # (3,) [N·s]
    duration: float  # [s]


class PushReply(Message):
    """Whether the push began, and when [robot time, ns]."""

    accepted: bool
    time: int
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
