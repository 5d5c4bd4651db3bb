"""The types of the Bifrost topics (units in brackets, frames in names).

Vectors over joints have one entry a joint, in the order of ``RobotDescription.joints``. Quaternions are (w, x, y, z).
``time`` is robot time [ns]: the stamp of the Proprioceptor that a message belongs to, simulated time in simulation.
Wrenches are (fx, fy, fz, tx, ty, tz) [N, N·m]: what the world does to the robot, at the named frame's origin and in
its axes.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

from bifrost import Float64Array, Message, Uint8Array

# --- between Comms Manager and Motion Manager ---------------------------------------------------------------------


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


# --- Motion Manager out -------------------------------------------------------------------------------------------


class MotionState(Message):
    """What the Motion Manager is doing and what it believes, every control period."""

    time: int
    proprioceptor_sequence: int
    behavior: str
    locomotion: str
    manipulation: str
    attention: str
    reason: str  # of the last change of behavior; ``behaviors.requester`` gives who asked for it
    pelvis_position_in_odom: Float64Array  # (3,) [m], estimated
    pelvis_orientation_in_odom: Float64Array  # (4,), estimated
    pelvis_linear_velocity_in_odom: Float64Array  # (3,) [m/s]
    pelvis_angular_velocity_in_pelvis: Float64Array  # (3,) [rad/s]
    com_in_odom: Float64Array  # (3,) [m]
    dcm_in_odom: Float64Array  # (3,) [m]
    dcm_reference_in_odom: Float64Array  # (3,) [m]
    cop_in_odom: Float64Array  # (2,) [m], from the foot wrenches; NaN without contact
    contacts: Uint8Array  # (2,) left, right foot: 1 in contact
    contact_probability: Float64Array  # (2,) that each foot stands still, 0 to 1
    pelvis_position_variance: Float64Array  # (3,) along the axes of odom [m²]; grows with the way, as odometry's error
    pelvis_orientation_variance: Float64Array  # (3,) about the axes of odom [rad²]
    pelvis_linear_velocity_variance: Float64Array  # (3,) along the axes of odom [m²/s²]
    hand_contacts: Uint8Array  # (2,) left, right hand: 1 in contact, by the force that it feels
    left_arm: str  # who leads it: nobody, setpoints, hand_goal
    right_arm: str
    joint_setpoint: Float64Array  # (n,) positions commanded last [rad]; measured ones for joints driven by force alone
    pelvis_setpoint: Float64Array  # (6,) commanded last, as in PelvisSetpoint
    pelvis_in_support: Float64Array  # (6,) estimated, likewise
    desired_foot_forces: Float64Array  # (2,) vertical, left and right, as the QP planned them [N]
    qp_status: int  # 0 not run, 1 optimal, 2 re-solved with torque limits, -1 infeasible (last feasible with damping)
    qp_failures: int  # since start
    torque_saturations: int  # joint commands clamped by effort limits, since start
    motor_time: float  # of this tick, from Proprioceptor at the socket, not yet decoded, to Motor sent [s]
    tick_time: float  # of the tick before, from Proprioceptor at the socket to everything done that a tick does [s]


class BehaviorChange(Message):
    """The behavior that the Motion Manager went to. Without arrays: who asks for it alone waits for no NumPy."""

    time: int
    behavior: str
    reason: str  # as MotionState's


class Rejection(Message):
    """A command that the Motion System did not obey."""

    topic: str
    origin: str  # the node that sent it
    reason: str
    count: int  # rejections on this topic since start


class StepStatus(Message):
    """Progress of a footstep plan."""

    time: int
    state: str  # idle, executing, finished, failed
    reason: str
    queue_size: int
    last_performed_step_index: int  # -1: none
    executing_step_index: int  # -1: none
    first_changeable_step_index: int  # -1: none


class HandGoalStatus(Message):
    """How a hand fares on its way to a goal."""

    time: int
    hand: int  # 0 left, 1 right
    state: str  # idle, moving, reached, out_of_reach
    reason: str
    position_error: float  # of the commanded hand [m]
    orientation_error: float  # [rad]


# --- Motion Manager in --------------------------------------------------------------------------------------------


class JointSetpoints(Message):
    """Set-points by joint name (the thesis' MSetpoint)."""

    time: int
    names: list[str]
    position: Float64Array  # [rad]
    velocity: Float64Array  # [rad/s]
    acceleration: Float64Array  # [rad/s²]


class VelocityCommand(Message):
    """Walk so: the velocity of the robot's middle, in the axes of its heading. Without another in time, it stops."""

    time: int  # of the Proprioceptor that it was made for
    linear_x: float  # forward [m/s]
    linear_y: float  # left [m/s]
    angular_z: float  # anticlockwise [rad/s]


class PelvisSetpoint(Message):
    """Where the pelvis shall be while the robot stands: x, y, z [m], roll, pitch, yaw [rad] in the support frame.

    The support frame lies between the soles at their height and heads with them. x and y are from the pelvis'
    nominal place over it; z is the pelvis' height. Roll, pitch and yaw turn about the fixed axes x, y, z, in order.
    """

    time: int  # of the Proprioceptor that it was made for
    position: Float64Array  # (6,) x, y, z [m], roll, pitch, yaw [rad]
    velocity: Float64Array  # (6,) their rates [m/s, rad/s]


class HandGoal(Message):
    """A hand shall be at a pose, and stay there; in the manipulate behaviors."""

    time: int  # of the Proprioceptor that it was made for
    hand: int  # 0 left, 1 right
    active: bool  # False: let go, the rest is unread
    frame: str  # that the pose is given in: pelvis, odom
    position: Float64Array  # (3,) of the hand's site [m]
    orientation: Float64Array  # (4,)


class JointGains(Message):
    """Stiffness and damping of joints driven by impedance, while the robot balances; brought within the limits."""

    names: list[str]
    stiffness: Float64Array  # [N·m/rad]
    damping: Float64Array  # [N·m·s/rad]


class BalanceWeights(Message):
    """Weights of the Whole-Body Controller's tasks, while the robot balances; brought within the limits."""

    names: list[str]  # com, angular_momentum, orientation, foot, arm_posture, waist_posture, leg_posture
    weights: Float64Array


class BehaviorRequest(Message):
    """Go to a behavior, named as in ``common/behaviors.py`` (``stand``, ``stand_manipulate``, …)."""

    behavior: str


class BehaviorReply(Message):
    """Accepted, or refused with the reason; and the behavior the Motion Manager is in now."""

    accepted: bool
    behavior: str
    reason: str


class Footstep(Message):
    """Where one foot goes."""

    step_index: int
    foot: int  # 0 left, 1 right
    position_in_odom: Float64Array  # (3,) of the sole [m]
    orientation_in_odom: Float64Array  # (4,) of the sole
    swing_height: float  # above the higher of lift-off and touch-down [m]; 0: the robot's default
    swing_duration: float  # [s]; 0: the robot's default
    transfer_duration: float  # [s]; 0: the robot's default


class FootstepPlanRequest(Message):
    """Execute a plan, update the running one from its first step on, or stop (no steps)."""

    steps: list[Footstep]


class FootstepPlanReply(Message):
    """Accepted, or refused with the reason."""

    accepted: bool
    behavior: str
    reason: str


# --- VRC out ------------------------------------------------------------------------------------------------------


class ModeStatus(IntFlag):
    """Flags of ``vigir_humanoid_control_msgs/ControlModeStatus``."""

    NO_ERROR = 0
    MODE_ACCEPTED = 1
    MODE_REJECTED = 2
    MODE_PREEMPTED = 4
    MODE_PROCESSING = 8
    MODE_DUPLICATE = 16
    EXTERNAL_CHANGE = 32
    ERR_UNKNOWN = 256
    ERR_CONTROLLER_NOT_READY = 512
    ERR_INVALID_BEHAVIOR_MODE = 1024
    ERR_INVALID_TRANSITION = 2048
    ERR_PRIOR_COMMAND_IN_PROGRESS = 4096


class ControlModeReport(Message):
    """The VRC's control mode and how it came to it (the Bifrost twin of /flor/controller/mode)."""

    time: int
    requested_control_mode: str
    current_control_mode: str
    status: int  # ModeStatus
    behavior: str  # of the Motion System, as last reported; empty: not heard


# --- simulation ---------------------------------------------------------------------------------------------------


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


# --- bag recorder --------------------------------------------------------------------------------------------------


class SnapRequest(Message):
    """Save the last seconds, of a recorder that holds them."""


class SnapReply(Message):
    """The bag in which they are, or why not."""

    accepted: bool
    path: str
    messages: int
    seconds: float  # from the first message's coming to the last's [s]
    reason: str


# --- every service ------------------------------------------------------------------------------------------------


class Statistics(Message):
    """How a service fares: its own word, once a second and at every change of state."""

    service: str
    pid: int
    state: str  # starting, ready, degraded, stopping
    detail: str  # what it waits for while starting; what it cannot do while degraded
    cycles: int  # of its main loop since start
    cycle_time_mean: float  # spent working a cycle, over the last second [s]
    cycle_time_max: float
    period_mean: float  # between cycles, over the last second [s]
    period_max: float
    overruns: int  # cycles that took longer than the control period, since start
    cpu_percent: float  # of one core, over the last second
    memory_mib: float
    drops: int  # messages its queues dropped, since start
    rejected: int  # inputs it refused, since start
