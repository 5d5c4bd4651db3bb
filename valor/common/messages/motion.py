"""What the Motion Manager says, and what it is told."""

from __future__ import annotations

from bifrost import Float64Array, Message, Uint8Array


class MotionState(Message):
    """What the Motion Manager is doing and what it believes, every control period."""

    time: int
    proprioceptor_sequence: int
    setpoint_sequence: int  # of the JointSetpoints followed last, as its sender counts; 0: none since start
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
    joint_setpoint: Float64Array  # (n,) wanted [rad]: none of what makes up for servos in it; measured if by force
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
    state: str  # idle, moving, reached, out_of_reach, resisted: let go, for what it pressed on did not give
    reason: str
    position_error: float  # of the hand as it is estimated [m]
    orientation_error: float  # [rad]


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
    orientation: Float64Array  # (4,) w, x, y, z


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
    obstacle: str  # as ``Obstacle`` names it


class ControllerCycle(Message):
    """The Valor ROS Controller has done a cycle and sent its set-points: a world in lockstep waits for it."""

    time: int  # of the Proprioceptor that it was run for
    proprioceptor_sequence: int
    every: int  # a cycle is due at every so many Proprioceptors


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
