"""The sections of robot.yaml that the Motion Manager reads alone: weights, gains and thresholds of its controllers.

Tools may import this module, to check and to show; it knows nothing of those controllers.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, require_order
from valor.robot.size import Length, PerArea, Rate, Sole, Speed, SquaredRate, Time


class FallDetection(Table):
    """When the robot is lost."""

    tilt: Annotated[float, Meta(gt=0, lt=1.57)] = 0.6  # of the pelvis from upright [rad]
    height: Annotated[float, Meta(ge=0.2, lt=1)] = 0.75  # of the pelvis above the lower sole, share of the nominal one
    # Of the DCM outside the support polygon: what ESCHER survives keeps it 1 cm inside; 3 cm outside it is lost [m].
    dcm_margin: Length[Annotated[float, Meta(gt=0, le=0.3)]] = 0.03
    # Likewise of that after the step that is being taken: the next may save it [m].
    dcm_margin_stepping: Length[Annotated[float, Meta(gt=0, le=0.5)]] = 0.1
    dcm_duration: Time[Annotated[float, Meta(ge=0, le=0.5)]] = 0.02  # for which it must be outside by more [s]


class WholeBody(Table):
    """Weights and gains of the Whole-Body Controller: data, so that another robot can have its own."""

    friction: Positive = 0.6  # coefficient assumed
    contact_inset: Length[NonNegative] = 0.005  # contact points pulled in from the sole's edges [m]
    dcm_gain: Rate[Positive] = 5.0  # k_ξ
    dcm_push_gain: Rate[NonNegative] = 15.0  # more, of what is beyond …
    dcm_push_error: Length[NonNegative] = 0.02  # … this error: then the CoP is at the sole's edge at once [m]
    com_weight: Positive = 300.0
    angular_momentum_weight: NonNegative = 0.003
    angular_momentum_gain: Rate[NonNegative] = 1.0
    orientation_weight: Positive = 3.0
    orientation_stiffness: SquaredRate[Positive] = 120.0
    orientation_damping: Rate[Positive] = 22.0
    foot_weight: Positive = 200.0
    foot_damping: Rate[Positive] = 10.0
    stance_stiffness: SquaredRate[NonNegative] = 100.0  # of the feet to each other, against creep [1/s²]
    arm_posture_weight: Positive = 2.0
    waist_posture_weight: Positive = 0.1
    leg_posture_weight: Positive = 0.02
    posture_stiffness: SquaredRate[Positive] = 60.0
    posture_damping: Rate[Positive] = 14.0
    dcm_integral_gain: Rate[NonNegative] = 1.0  # [1/s]
    dcm_integral_limit: Length[NonNegative] = 0.1  # [m]
    dcm_integral_error: Length[Positive] = 0.01  # of the DCM error, integrated at most: a push is no model error [m]
    com_shift_limit: Length[NonNegative] = 0.05  # of the CoM's reference with the arms; 0: thesis behaviour [m]
    com_shift_bandwidth: Rate[Positive] = 20.0  # [rad/s]
    support_bandwidth: Rate[Positive] = 2.0  # at which the CoM's reference follows the soles [rad/s]
    blend_duration: Time[Positive] = 2.0  # from the state at the start to the nominal stance [s]
    limit_approach: Rate[Positive] = 10.0  # velocity allowed per distance to a joint's stop [1/s]
    limit_response: Rate[Positive] = 50.0  # deceleration per velocity above what is allowed [1/s]


class Disturbance(Table):
    """How steps give way to pushes, and when a robot that stands takes some."""

    adjust_steps: bool = True  # footholds and times of steps
    plan_reach: Length[NonNegative] = 0.05  # that a plan's foothold may be moved by, either way along each axis [m]
    foothold_weight: PerArea[Positive] = 1.0  # of a foothold's shift [1/m²]
    time_weight: SquaredRate[Positive] = 0.3  # of a step's time [1/s²]
    offset_weight: PerArea[Positive] = 30.0  # of the DCM error that is left to the next step [1/m²]
    cop_weight: PerArea[Positive] = 0.02  # of the CoP's shift [1/m²]
    cop_share: Positive = 0.7  # of the CoP's reach within the stance sole, that is counted on
    threshold: Length[Positive] = 0.025  # of the DCM error, below which a step is left alone [m]
    final: Time[Positive] = 0.06  # before touchdown, in which nothing is changed any more [s]
    shortest_swing: Time[Positive] = 0.25  # [s]
    longest_delay: Time[NonNegative] = 0.15  # of a touchdown [s]
    foot_speed: Speed[Positive] = 3.0  # of a swinging foot, at most [m/s]
    clearance: Length[NonNegative] = 0.01  # between the feet, besides the robot's least width [m]
    max_width: Length[Positive] = 0.6  # of an adjusted step [m]
    max_backward: Length[Positive] = 0.5  # likewise [m]
    diagonal_width: Length[Positive] = 0.3  # |forward| + width is at most this beyond the longest step [m]
    giving: Length[NonNegative] = 0.04  # of the VRP over a stance sole, for the DCM as the last step left it [m]
    step_when_standing: bool = True  # when the feet alone cannot hold the robot
    edge_margin: Sole[float] = 0.03  # of the DCM inside the support polygon, below which it steps [m]
    edge_time: Time[NonNegative] = 0.006  # for which it is that near the edge [s]
    calm: Length[Positive] = 0.04  # of the DCM error, from which on it may step again [m]
    recovery_transfer_duration: Time[Positive] = 0.05  # of weight, of such steps [s]
    recovery_swing_duration: Time[Positive] = 0.3  # [s]
    recovery_swing_height: Length[Positive] = 0.04  # [m]


class GainLimits(Table):
    """Between which factors of their servo gains the joints driven by impedance may have others."""

    min_stiffness: NonNegative = 0.1
    max_stiffness: Positive = 1.5
    min_damping: NonNegative = 0.5
    max_damping: Positive = 1.25

    def __post_init__(self) -> None:
        require_order(self, "min_stiffness", "max_stiffness")
        require_order(self, "min_damping", "max_damping")


class HandMotion(Table):
    """How fast the hands go to Cartesian goals."""

    max_speed: Speed[Positive] = 0.25  # [m/s]
    max_turn_rate: Rate[Positive] = 0.8  # [rad/s]
    joint_speed: Positive = 0.5  # most of a joint's velocity limit


class ArmServos(Table):
    """What is done about arms whose servos leave weight, friction and play."""

    compensation: bool = True  # False: thesis behaviour


class Estimator(Table):
    """How far the floating-base estimator trusts what it is told."""

    attitude_time_constant: Positive = 0.1  # from the gyroscope to the IMU's attitude [s]
    heading_time_constant: Positive = 1.0  # from the IMU's heading to the standing feet's [s]
    attitude_deviation: NonNegative = 0.0005  # of the estimated attitude, besides its level and heading [rad]
    heading_walk: NonNegative = 0.0003  # of the IMU's heading, while the feet do not hold it [rad/√s]
    joint_velocity_bandwidth: Positive = 50.0  # of the low-pass on measured joint velocities [Hz]
    acceleration_deviation: Positive = 0.3  # of the accelerometer in odom, per sample [m/s²]
    start_velocity_deviation: Positive = 0.05  # of the pelvis at rest, when the estimate begins [m/s]
    bias_deviation: Positive = 0.05  # of the accelerometer's error: 0.05 m/s² are 5 mrad of tilt [m/s²]
    bias_walk: Positive = 0.001  # of it [m/s²/√s]
    leg_position_deviation: Positive = 0.002  # of leg odometry, per sample [m]
    leg_velocity_deviation: Positive = 0.02  # [m/s]
    foothold_deviation: Positive = 0.001  # of where a foot comes to stand [m]
    settling_time: Positive = 0.1  # that a foot takes to come to rest once it touches the ground [s]
    foothold_heading_deviation: NonNegative = 0.0003  # of a foot that has come to stand [rad]
    creep: Positive = 0.0001  # of a foot that stands beside the other [m/√s]
    creep_alone: Positive = 0.0016  # of one that stands alone, while the robot walks over it [m/√s]
    slip: Positive = 0.05  # of one that surely does not stand, though it touches the ground [m/√s]
    surprise_gate: Positive = 2.0  # squared deviation of a leg's measurement that is still that of a standing foot
    hang_time_constant: Positive = 0.3  # in which velocity fades without contact [s]
    contact_on: Positive = 0.08  # of the robot's weight: a foot in contact from here
    contact_off: Positive = 0.04  # until here

    def __post_init__(self) -> None:
        require_order(self, "contact_off", "contact_on")


class Tuning(Table, kw_only=True):
    """Those sections, by their keys; read by ``RobotDescription.read``."""

    fall: FallDetection = FallDetection()
    whole_body: WholeBody = WholeBody()
    disturbance: Disturbance = Disturbance()
    gains: GainLimits = GainLimits()
    arm_servos: ArmServos = ArmServos()
    hand_goals: HandMotion = HandMotion()
    estimator: Estimator = Estimator()
