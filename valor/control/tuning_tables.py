"""Sections of robot.yaml that only the Motion Manager reads: weights, gains and thresholds of its controllers."""

from collections.abc import Iterator
from typing import Annotated, Literal

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, TableError, require_order
from valor.robot.description import RobotDescription
from valor.robot.size import Length, PerArea, Rate, Sole, Speed, SquaredRate, Time


class FallDetection(Table):
    """Thresholds of fall detection."""

    tilt: Annotated[float, Meta(gt=0, lt=1.57)] = 0.6  # of the pelvis from upright [rad]
    # Of the pelvis above the lower sole, fraction of the nominal one.
    height: Annotated[float, Meta(ge=0.2, lt=1)] = 0.75
    # DCM outside the support polygon: ESCHER survives up to 1 cm inside; 3 cm outside it is lost [m].
    dcm_margin: Length[Annotated[float, Meta(gt=0, le=0.3)]] = 0.03
    # DCM outside the polygon after the step under way: the next step may save it [m].
    dcm_margin_stepping: Length[Annotated[float, Meta(gt=0, le=0.5)]] = 0.18
    dcm_duration: Time[Annotated[float, Meta(ge=0, le=0.5)]] = 0.02  # duration of a larger excess [s]


class WholeBody(Table):
    """Weights and gains of the Whole-Body Controller."""

    # ω of the DCM while the robot steps: of the nominal CoM height, or varying with a CoM planned with the least jerk.
    natural_frequency: Literal["constant", "varying"] = "constant"
    friction: Positive = 0.6  # assumed coefficient
    contact_inset: Length[NonNegative] = 0.002  # contact points pulled in from the sole's edges [m]
    dcm_gain: Rate[Positive] = 5.0  # k_ξ
    dcm_push_gain: Rate[NonNegative] = 15.0  # k_p, for the error above dcm_push_error
    dcm_push_error: Length[NonNegative] = 0.02  # above it the CoP reaches the sole's edge at once [m]
    com_weight: Positive = 300.0
    angular_momentum_weight: NonNegative = 0.003
    angular_momentum_gain: Rate[NonNegative] = 1.0
    orientation_weight: Positive = 3.0
    orientation_stiffness: SquaredRate[Positive] = 120.0
    orientation_damping: Rate[Positive] = 22.0
    foot_weight: Positive = 200.0
    foot_damping: Rate[Positive] = 10.0
    # Of the CoM's and the feet's weights while the robot may not step: its trunk sways for its balance.
    fixed_feet_factor: Positive = 5.0
    stance_stiffness: SquaredRate[NonNegative] = 100.0  # of the stance of both feet, against creep [1/s²]
    arm_posture_weight: Positive = 2.0
    arm_swing_factor: Positive = 0.25  # of that weight while a foot is in the air: arms give way to balance
    waist_posture_weight: Positive = 0.1
    leg_posture_weight: Positive = 0.02
    posture_stiffness: SquaredRate[Positive] = 60.0
    posture_damping: Rate[Positive] = 14.0
    dcm_integral_gain: Rate[NonNegative] = 1.0  # [1/s]
    dcm_integral_limit: Length[NonNegative] = 0.1  # [m]
    dcm_integral_error: Length[Positive] = 0.01  # largest integrated DCM error: a push is no model error [m]
    com_shift_limit: Length[NonNegative] = 0.05  # of the CoM's reference with the arms; 0: thesis behaviour [m]
    com_shift_bandwidth: Rate[Positive] = 20.0  # [rad/s]
    support_bandwidth: Rate[Positive] = 2.0  # at which the CoM's reference follows the soles [rad/s]
    blend_duration: Time[Positive] = 2.0  # from the state at the start to the nominal stance [s]
    limit_approach: Rate[Positive] = 10.0  # velocity allowed per distance to a joint's stop [1/s]
    limit_response: Rate[Positive] = 50.0  # deceleration per velocity above what is allowed [1/s]


class Disturbance(Table):
    """Adjustment of steps to pushes, and automatic steps of a standing robot."""

    adjust_steps: bool = True  # whether footholds and times follow the DCM
    plan_reach: Length[NonNegative] = 0.05  # largest shift of a plan's foothold along each axis [m]
    foothold_weight: PerArea[Positive] = 1.0  # of a foothold's shift [1/m²]
    time_weight: SquaredRate[Positive] = 0.3  # of a step's time [1/s²]
    offset_weight: PerArea[Positive] = 30.0  # of the DCM error left to the next step [1/m²]
    cop_weight: PerArea[Positive] = 0.02  # of the CoP's shift [1/m²]
    cop_share: Positive = 0.7  # usable fraction of the CoP's reach in the stance sole
    threshold: Length[Positive] = 0.025  # DCM error below which a step stays as planned [m]
    final: Time[Positive] = 0.06  # time before touchdown without changes [s]
    shortest_swing: Time[Positive] = 0.22  # [s]
    longest_delay: Time[NonNegative] = 0.15  # of touchdown [s]
    foot_speed: Speed[Positive] = 4.0  # largest of a swinging foot [m/s]
    clearance: Length[NonNegative] = 0.01  # between the feet, added to the least width [m]
    max_width: Length[Positive] = 0.8  # of an adjusted step [m]
    max_backward: Length[Positive] = 0.6  # likewise [m]
    diagonal_width: Length[Positive] = 0.3  # |forward| + width is at most this plus the longest step [m]
    giving: Length[NonNegative] = 0.04  # shift of the VRP over a stance sole for the DCM error of the last step [m]
    step_when_standing: bool = True  # whether to step if fixed feet cannot hold the robot
    edge_margin: Sole[float] = 0.03  # DCM inside the support polygon, below which it steps [m]
    edge_time: Time[NonNegative] = 0.006  # duration that near the edge [s]
    look_ahead: Time[NonNegative] = 0.1  # over which the DCM is taken to go on at its velocity [s]
    edge_ahead: Length[NonNegative] = 0.05  # largest distance outside the polygon where it then is, without a step [m]
    pushed_speed: Speed[Positive] = 0.6  # of the DCM, slowest that counts: a push, no noise [m/s]
    speed_time: Time[Positive] = 0.004  # over which it is measured; less than edge_time: a jump is no push [s]
    calm: Length[Positive] = 0.04  # DCM error below which it may step again [m]
    recovery_transfer_duration: Time[Positive] = 0.02  # of weight, of such steps [s]
    recovery_swing_duration: Time[Positive] = 0.3  # [s]
    recovery_swing_height: Length[Positive] = 0.04  # [m]
    away_cost: Positive = 3.0  # factor of the cost of steps that begin with the foot away from which the DCM goes
    recovery_foot_weight: Positive = 60.0  # of the swinging foot's task
    recovered: Length[Positive] = 0.05  # largest DCM error with which such steps end [m]


class GainLimits(Table):
    """Limits of impedance gains, as factors of the servo gains."""

    min_stiffness: NonNegative = 0.1
    max_stiffness: Positive = 1.5
    min_damping: NonNegative = 0.5
    max_damping: Positive = 1.25

    def __post_init__(self) -> None:
        require_order(self, "min_stiffness", "max_stiffness")
        require_order(self, "min_damping", "max_damping")


class HandMotion(Table):
    """Speed limits of hands towards Cartesian goals."""

    max_speed: Speed[Positive] = 0.25  # [m/s]
    max_turn_rate: Rate[Positive] = 0.8  # [rad/s]
    joint_speed: Positive = 0.5  # largest fraction of a joint's velocity limit


class ArmServos(Table):
    """Compensation of the arms' servos for weight, friction and play."""

    compensation: bool = True  # false: thesis behaviour


class Estimator(Table):
    """Noise model of the floating-base estimator."""

    attitude_time_constant: Positive = 0.1  # from the gyroscope to the IMU's attitude [s]
    heading_time_constant: Positive = 1.0  # from the IMU's heading to the standing feet's [s]
    attitude_deviation: NonNegative = 0.0005  # of the estimated attitude, added to its level and heading [rad]
    heading_walk: NonNegative = 0.0003  # of the IMU's heading while the feet do not correct it [rad/√s]
    joint_velocity_bandwidth: Positive = 50.0  # of the low-pass on measured joint velocities [Hz]
    acceleration_deviation: Positive = 0.3  # of the accelerometer in odom, per sample [m/s²]
    start_velocity_deviation: Positive = 0.05  # of the pelvis at the start [m/s]
    bias_deviation: Positive = 0.05  # of the accelerometer's error: 0.05 m/s² are 5 mrad of tilt [m/s²]
    bias_walk: Positive = 0.001  # of the bias [m/s²/√s]
    leg_position_deviation: Positive = 0.002  # of leg odometry, per sample [m]
    leg_velocity_deviation: Positive = 0.02  # [m/s]
    foothold_deviation: Positive = 0.001  # of a new foothold [m]
    settling_time: Positive = 0.1  # of a foot after touchdown [s]
    foothold_heading_deviation: NonNegative = 0.0003  # of a new foothold [rad]
    creep: Positive = 0.0001  # of a foot in double support [m/√s]
    creep_alone: Positive = 0.0016  # of a foot in single support [m/√s]
    slip: Positive = 0.05  # of a foot that touches the ground but does not stand [m/√s]
    surprise_gate: Positive = 2.0  # largest squared deviation of a standing foot's measurement
    hang_time_constant: Positive = 0.3  # of velocity without contact [s]
    contact_on: Positive = 0.08  # fraction of the weight: contact starts above
    contact_off: Positive = 0.04  # contact ends below

    def __post_init__(self) -> None:
        require_order(self, "contact_off", "contact_on")


class Tuning(Table, kw_only=True):
    """The sections by their keys, for ``RobotDescription.read``."""

    fall: FallDetection = FallDetection()
    whole_body: WholeBody = WholeBody()
    disturbance: Disturbance = Disturbance()
    gains: GainLimits = GainLimits()
    arm_servos: ArmServos = ArmServos()
    hand_goals: HandMotion = HandMotion()
    estimator: Estimator = Estimator()


def margins_fit_the_soles(robot: RobotDescription) -> Iterator[TableError]:
    """Raise ``ConfigurationError`` unless distances kept inside a sole's edge are less than its half width."""
    tuning, feet = robot.read(Tuning), robot.tables.feet
    limit = min(feet.left.half_width, feet.right.half_width)
    for key, margin in (
        ("disturbance.edge_margin", tuning.disturbance.edge_margin),
        ("pelvis.com_margin", robot.tables.pelvis.com_margin),
        ("whole_body.contact_inset", tuning.whole_body.contact_inset),
    ):
        if margin >= limit:
            yield TableError(key.split("."), f"got {margin:g}; expected less than a sole's half width, {limit:g}")
