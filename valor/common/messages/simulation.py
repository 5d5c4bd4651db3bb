"""Messages of the simulated robot and the device emulators."""

from bifrost import Float64Array, Message, Uint8Array


class GroundTruth(Message):
    """True state of the simulator, for experiments and pictures; no controller may read it."""

    time: int
    pelvis_position_in_world: Float64Array  # (3,) [m]
    pelvis_orientation_in_world: Float64Array  # (4,)
    pelvis_linear_velocity_in_world: Float64Array  # (3,) [m/s]
    com_in_world: Float64Array  # (3,) [m]
    joint_position: Float64Array  # [rad]
    contacts: Uint8Array  # (2,) left, right foot
    fixture_position: Float64Array  # of the world's joints, in their order: a door's leaf and lever, a wheel [rad]


class PushRequest(Message):
    """Request to push a body of the simulated robot at its centre of mass."""

    impulse_in_world: Float64Array  # (3,) [N·s]
    duration: float  # [s]
    body: str = ""  # of the robot's model; empty: the chest


class PushReply(Message):
    """Acceptance of the push, and its start [robot time, ns]."""

    accepted: bool
    time: int
    reason: str


class TimeRequest(Message):
    """Request to pause, step or scale the simulation's time."""

    wanted: str  # pause, resume, step, factor; empty: query only
    value: float  # step: number of control periods, then pause; factor: of wall time, 0: as fast as possible


class TimeReply(Message):
    """Present progress of the simulation's time."""

    accepted: bool
    paused: bool
    factor: float
    time: int  # robot time [ns]
    reason: str


class FaultRequest(Message):
    """Request for a fault of an emulated device's unit."""

    device: str  # as in robot.yaml
    unit: str  # as in DeviceStatus.units, after the slash; the device's name if it has one unit
    fault: str  # silent, slow, garbage, … (device_emulators/emulator.py); empty: end all faults of this device
    duration: float  # [s]; 0: unlimited


class FaultReply(Message):
    """Acceptance of the fault."""

    accepted: bool
    reason: str
