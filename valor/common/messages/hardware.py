"""Between Comms Manager, Motion Manager and the devices."""

from __future__ import annotations

from enum import IntEnum

from bifrost import Float64Array, Message, Uint8Array


class JointMode(IntEnum):
    """What a motor does with its command (``Motor.mode``)."""

    OFF = 0
    POSITION = 1  # the device's own servo on position and velocity; effort is feed-forward
    IMPEDANCE = 2  # effort + stiffness·(position error) + damping·(velocity error)
    FORCE = 3  # effort alone, with damping against the measured velocity


class Proprioceptor(Message):
    """All that the robot's devices measured in one control period."""

    time: int
    sequence: int
    motor_sequence: int  # sequence of the newest Motor that acted before this was measured; 0: none yet
    joint_position: Float64Array  # [rad]
    joint_velocity: Float64Array  # [rad/s]
    joint_effort: Float64Array  # [N·m]
    imu_orientation: Float64Array  # (4,) pelvis IMU in world; heading drifts on hardware
    imu_angular_velocity: Float64Array  # (3,) in IMU [rad/s]
    imu_linear_acceleration: Float64Array  # (3,) in IMU, specific force [m/s²]
    left_foot_wrench: Float64Array  # (6,) in sole
    right_foot_wrench: Float64Array  # (6,) in sole
    left_hand_wrench: Float64Array  # (6,) in hand
    right_hand_wrench: Float64Array  # (6,) in hand
    battery_voltage: float  # [V]
    motor_behavior: str  # behavior of the newest Motor since the instance came up, or REFLEX; empty: none yet


class Motor(Message):
    """One command for every motor. ``proprioceptor_sequence`` says which Proprioceptor it answers.

    A Motor's behavior outlives the Motion Manager that made it: the next one begins from there, at rest.
    """

    time: int
    sequence: int
    proprioceptor_sequence: int
    mode: Uint8Array  # JointMode
    position: Float64Array  # [rad]
    velocity: Float64Array  # [rad/s]
    effort: Float64Array  # [N·m]
    stiffness: Float64Array  # [N·m/rad]
    damping: Float64Array  # [N·m·s/rad]
    behavior: str  # of the Behavior FSM
    writer: int  # when the Motion Manager that made it began, monotonic [ns]; that of an older one is not obeyed


class ClockStatus(Message):
    """How robot time runs against the wall's."""

    mode: str  # lockstep, realtime, or hardware
    time: int
    real_time_factor: float  # over the last second
    slip: float  # robot time lost against the wall since the first Motor [s]
    waits_timed_out: int  # lockstep: periods that went on without the Motor that answers them
    holding: bool  # Motor is silent: the joints are held, or stay limp


class DeviceStatus(Message):
    """How the devices' units fare on hardware: one entry a unit, in robot.yaml's order; every second and on change."""

    time: int
    units: list[str]  # device/unit: legs/1, neck/neck_yaw, imu
    states: list[str]  # ok, silent, faulty, unplugged, disabled; overdue, unread: the computer is late, not the unit
    details: list[str]  # what is wrong, for people; empty where nothing is
    rate: Float64Array  # states received, over the last second [Hz]
    latency: Float64Array  # from a command or request to the state that answers it, mean over the last second [s]
    age: Float64Array  # of the newest state [s]
    temperature: Float64Array  # the unit's hottest part [°C]; NaN: it does not say
    voltage: Float64Array  # of its supply [V]; NaN: it does not say
    errors: Float64Array  # frames refused since start: checksum, length, order, nonsense
    reaction: str  # what the Motion System shall do: keep_balance, soft_stop, hold, limp
    reason: str  # why: the gravest trouble, its unit named; empty: none


class HdtCommand(Message):
    """Joint impedance of one HDT limb, its joints in the order of robot.yaml's group (``Motor`` for an arm or hand)."""

    time: int
    sequence: int
    motor_sequence: int  # of the Motor that it carries; 0: none, the limb stays where it is
    mode: Uint8Array  # JointMode
    position: Float64Array  # [rad]
    velocity: Float64Array  # [rad/s]
    effort: Float64Array  # [N·m]
    stiffness: Float64Array  # [N·m/rad]
    damping: Float64Array  # [N·m·s/rad]


class HdtState(Message):
    """What the driver of one HDT limb says of it, its joints in the order of robot.yaml's group."""

    time: int  # of the driver's clock
    sequence: int
    command_sequence: int  # of the newest HdtCommand that acted before this was measured; 0: none yet
    position: Float64Array  # of the motors' side [rad]: backlash is behind it
    velocity: Float64Array  # [rad/s]
    effort: Float64Array  # [N·m]
    temperature: Float64Array  # [°C]
    voltage: float  # of the limb's supply [V]
    fault: Uint8Array  # bits: 1 over-temperature, 2 under-voltage, 4 encoder, 8 no answer; 0: none
