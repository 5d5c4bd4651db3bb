"""Messages of and to the Motion Manager."""

from msgspec import field

from bifrost import Float64Array, Message, Uint8Array


class MotionState(Message):
    """State and estimates of the Motion Manager, every control period."""

    time: int
    proprioceptor_sequence: int
    setpoint_sequence: int  # of the last JointSetpoints followed; 0: none since start
    behavior: str
    locomotion: str
    manipulation: str
    attention: str
    reason: str  # of the last change of behavior; ``behaviors.requester`` returns its origin
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
    pelvis_position_variance: Float64Array  # (3,) along the axes of odom [m²]; grows with the distance walked
    pelvis_orientation_variance: Float64Array  # (3,) about the axes of odom [rad²]
    pelvis_linear_velocity_variance: Float64Array  # (3,) along the axes of odom [m²/s²]
    hand_contacts: Uint8Array  # (2,) left, right hand: 1 in contact, by its force sensor
    left_arm: str  # command source: nobody, setpoints, hand_goal; or frozen
    right_arm: str
    joint_setpoint: Float64Array  # (n,) desired [rad], without servo compensation; measured for joints in force control
    pelvis_setpoint: Float64Array  # (6,) last command, as in PelvisSetpoint
    pelvis_in_support: Float64Array  # (6,) estimated, as in PelvisSetpoint
    desired_foot_forces: Float64Array  # (2,) vertical, left and right, of the QP [N]
    qp_status: int  # 0 not run, 1 optimal, 2 re-solved with torque limits, -1 infeasible (last feasible with damping)
    qp_failures: int  # since start
    torque_saturations: int  # joint commands clamped by effort limits, since start
    motor_time: float  # of this tick, from receipt of the Proprioceptor to sending of the Motor [s]
    tick_time: float  # of the previous tick, from receipt of the Proprioceptor to the end of all its work [s]


class BehaviorChange(Message):
    """Change of the Motion Manager's behavior. Without arrays, so that subscribers need no NumPy."""

    time: int
    behavior: str
    reason: str  # as in MotionState


class FrozenLimbs(Message):
    """Limbs that hold while the rest of the robot moves. Without arrays, so that subscribers need no NumPy."""

    time: int
    limbs: list[str]  # groups of robot.yaml; empty: none


class ControllerStatus(Message):
    """Controllers of the robot while it balances. Without arrays, so that subscribers need no NumPy."""

    time: int
    active: str  # in control, of the last time that the robot balanced
    pending: str  # to take over next; empty: none
    reason: str  # of the last exchange, or of the rejection of one
    stand: list[str]  # that may control the robot while it stands, the chosen one first
    walk: list[str]  # likewise while it walks


class Rejection(Message):
    """A command that the Motion System rejected."""

    topic: str
    origin: str  # sending node
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
    """Progress of a hand towards its goal."""

    time: int
    hand: int  # 0 left, 1 right
    state: str  # idle, moving, reached, out_of_reach, resisted: released, since an obstacle did not yield
    reason: str
    position_error: float  # of the estimated hand [m]
    orientation_error: float  # [rad]


class JointSetpoints(Message):
    """Set-points by joint name (the thesis' MSetpoint)."""

    time: int
    names: list[str]
    position: Float64Array  # [rad]
    velocity: Float64Array  # [rad/s]
    acceleration: Float64Array  # [rad/s²]


class JointCommands(Message):
    """Commands for the controller ``remote``: what ros2_control's command interfaces hold.

    A servo applies effort + stiffness·(position − q) + damping·(velocity − q̇) [N·m].
    """

    time: int  # of the Proprioceptor that it is computed from
    period: float  # of the sender, up to 0.02 [s]; a command that is older than three of them is rejected
    names: list[str]  # (k,) at least the joints of legs and torso; others follow their targets
    position: Float64Array  # (k,) [rad]
    velocity: Float64Array  # (k,) [rad/s]
    effort: Float64Array  # (k,) [N·m]
    stiffness: Float64Array  # (k,) [N·m/rad]
    damping: Float64Array  # (k,) [N·m·s/rad]
    computed_in: float = 0.0  # duration of the computation, for analysis [s]


class VelocityCommand(Message):
    """Walking velocity of the robot centre in heading axes; expires after ``walking.command_timeout`` (0.5 s)."""

    time: int  # of the Proprioceptor that it is based on
    linear_x: float  # forward [m/s]
    linear_y: float  # left [m/s]
    angular_z: float  # anticlockwise [rad/s]


class PelvisSetpoint(Message):
    """Desired pose of the pelvis of a standing robot: x, y, z [m], roll, pitch, yaw [rad] in the support frame.

    The support frame lies between the soles at their height, with their heading. x and y are relative to the pelvis'
    nominal position over it; z is the pelvis' height. Roll, pitch and yaw are about the fixed axes x, y, z, in order.
    """

    time: int  # of the Proprioceptor that it is based on
    position: Float64Array  # (6,) x, y, z [m], roll, pitch, yaw [rad]
    velocity: Float64Array  # (6,) their rates [m/s, rad/s]


class HandGoal(Message):
    """Desired pose of a hand, held once reached; in the manipulate behaviors."""

    time: int  # of the Proprioceptor that it is based on
    hand: int  # 0 left, 1 right
    active: bool  # False: release the hand; other fields are ignored
    frame: str  # reference frame of the pose: pelvis, odom
    position: Float64Array  # (3,) of the hand's site [m]
    orientation: Float64Array  # (4,) w, x, y, z


class JointGains(Message):
    """Stiffness and damping of joints in impedance control, while the robot balances; clamped to the limits."""

    names: list[str]
    stiffness: Float64Array  # [N·m/rad]
    damping: Float64Array  # [N·m·s/rad]


class BalanceWeights(Message):
    """Weights of the Whole-Body Controller's tasks, while the robot balances; clamped to the limits."""

    names: list[str]  # com, angular_momentum, orientation, foot, arm_posture, waist_posture, leg_posture
    weights: Float64Array


class BehaviorRequest(Message):
    """Request for a behavior, named as in ``common/behaviors.py`` (``stand``, ``stand_manipulate``, …)."""

    behavior: str
    # With freeze: exactly these groups of robot.yaml, none: release all; empty: the whole robot.
    limbs: list[str] = field(default_factory=list)


class BehaviorReply(Message):
    """Acceptance, or rejection with the reason; and the present behavior of the Motion Manager."""

    accepted: bool
    behavior: str
    reason: str
    obstacle: str  # value of ``Obstacle``


class ControllerRequest(Message):
    """Request for a controller, by its name in ``controllers`` of robot.yaml: for standing, walking, or both."""

    controller: str


class ControllerReply(Message):
    """Acceptance, or rejection with the reason. ``ControllerStatus`` tells when it takes over."""

    accepted: bool
    reason: str


class ControllerCycle(Message):
    """End of a cycle of the Valor ROS Controller, after its set-points; a simulation in lockstep waits for it."""

    time: int  # of the Proprioceptor of the cycle
    proprioceptor_sequence: int
    every: int  # number of Proprioceptors per cycle


class Footstep(Message):
    """One step of a foot."""

    step_index: int
    foot: int  # 0 left, 1 right
    position_in_odom: Float64Array  # (3,) of the sole [m]
    orientation_in_odom: Float64Array  # (4,) of the sole
    swing_height: float  # above the higher of lift-off and touch-down [m]; 0: the robot's default
    swing_duration: float  # [s]; 0: the robot's default
    transfer_duration: float  # [s]; 0: the robot's default


class FootstepPlanRequest(Message):
    """Request to execute a plan, update the running one from its first step on, or stop (no steps)."""

    steps: list[Footstep]


class FootstepPlanReply(Message):
    """Acceptance, or rejection with the reason."""

    accepted: bool
    behavior: str
    reason: str
