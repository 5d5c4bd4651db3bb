"""Messages between Comms Manager, Motion Manager and the devices."""

from enum import IntEnum

from bifrost import Float64Array, Message, Uint8Array


class JointMode(IntEnum):
    """Control mode of a motor (``Motor.mode``)."""

    OFF = 0
    POSITION = 1  # the device's own servo on position and velocity; effort is feed-forward
    IMPEDANCE = 2  # effort + stiffness·(position error) + damping·(velocity error)
    FORCE = 3  # effort alone, with damping against the measured velocity


class Proprioceptor(Message):
    """Measurements of all devices in one control period."""

    time: int
    sequence: int
    motor_sequence: int  # of the latest Motor that acted before the measurement; 0: none yet
    joint_position: Float64Array  # [rad]
    joint_velocity: Float64Array  # [rad/s]
    joint_effort: Float64Array  # [N·m]
    imu_orientation: Float64Array  # (4,) pelvis IMU in world; heading drifts on hardware
    imu_angular_velocity: Float64Array  # (3,) in IMU [rad/s]
    imu_linear_acceleration: Float64Array  # (3,) in IMU, specific force [m/s²]
    kvh_angular_velocity: Float64Array  # (3,) in the second IMU [rad/s]; (0,): no sample
    kvh_linear_acceleration: Float64Array  # (3,) in the second IMU, specific force [m/s²]; (0,): no sample
    left_foot_wrench: Float64Array  # (6,) in sole
    right_foot_wrench: Float64Array  # (6,) in sole
    left_hand_wrench: Float64Array  # (6,) in hand
    right_hand_wrench: Float64Array  # (6,) in hand
    battery_voltage: float  # [V]
    motor_behavior: str  # behavior of the latest Motor since `up`, or REFLEX; empty: none yet


class Motor(Message):
    """One command for all motors, in reply to the Proprioceptor ``proprioceptor_sequence``.

    A restarted Motion Manager continues from the behavior of the last Motor, at rest.
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
    writer: int  # start of the Motion Manager, monotonic [ns]; Motors of an older one are rejected


class ClockStatus(Message):
    """Progress of robot time against wall time."""

    mode: str  # lockstep, realtime, or hardware
    time: int
    real_time_factor: float  # over the last second
    slip: float  # robot time lost against wall time since the first Motor [s]
    waits_timed_out: int  # lockstep: periods without their Motor within the timeout
    holding: bool  # no Motor arrives: the joints are held, or remain limp


class DeviceStatus(Message):
    """State of the devices' units, in robot.yaml's order, and batteries; published every second and on change."""

    time: int
    units: list[str]  # device/unit: legs/1, neck/neck_yaw, imu
    states: list[str]  # ok, silent, faulty, unplugged, disabled; overdue, unread: delays of the computer
    details: list[str]  # human-readable faults; empty: none
    rate: Float64Array  # states received, over the last second [Hz]
    latency: Float64Array  # from command or request to the state in reply, mean over the last second [s]
    age: Float64Array  # of the latest state [s]
    temperature: Float64Array  # of the unit's hottest part [°C]; NaN: not reported
    voltage: Float64Array  # of its supply [V]; NaN: not reported
    errors: Float64Array  # frames rejected since start: checksum, length, order, content
    reaction: str  # required of the Motion System: keep_balance, soft_stop, hold, limp
    reason: str  # most severe fault, with its unit; empty: none


class BatteryStatus(Message):
    """Estimated state of all battery packs together; published every second, of robots that have some."""

    time: int
    voltage: float  # of the supply, under load [V]
    current: float  # that the robot draws [A]
    charge: float  # left [Ah]


class HdtCommand(Message):
    """Joint impedance of one HDT limb, in the order of robot.yaml's group (``Motor`` for an arm or hand)."""

    time: int
    sequence: int
    motor_sequence: int  # of its Motor; 0: none, the limb holds its position
    mode: Uint8Array  # JointMode
    position: Float64Array  # [rad]
    velocity: Float64Array  # [rad/s]
    effort: Float64Array  # [N·m]
    stiffness: Float64Array  # [N·m/rad]
    damping: Float64Array  # [N·m·s/rad]


class HdtState(Message):
    """State of one HDT limb from its driver, in the order of robot.yaml's group."""

    time: int  # of the driver's clock
    sequence: int
    command_sequence: int  # of the latest HdtCommand that acted before the measurement; 0: none yet
    position: Float64Array  # at the motors [rad], without backlash
    velocity: Float64Array  # [rad/s]
    effort: Float64Array  # [N·m]
    temperature: Float64Array  # [°C]
    voltage: float  # of the limb's supply [V]
    fault: Uint8Array  # bits: 1 over-temperature, 2 under-voltage, 4 encoder, 8 no reply; 0: none
