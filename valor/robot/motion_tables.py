"""What a robot may be asked to do, as the tables of robot.yaml say: footsteps, walking, pelvis, distances to itself.

What a controller wants tuned, and reads alone, stands beside it (``valor.whole_body.tuning_tables``).
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, require_order
from valor.robot.size import Force, Length, Rate, Sole, Speed, SquaredRate, Time


class Footsteps(Table):
    """Which steps a plan may hold. Displacements are of a sole seen from the other foot's, heading only.

    ESCHER's lengths and heights are those of a public controller for it; the smallest width keeps the soles apart.
    Steps that keep the balance reach as far; those of a plan no farther than ``max_distance``, beyond which they come
    down beside their place.
    """

    max_steps: Annotated[int, Meta(ge=1)] = 50  # of a plan
    max_forward: Length[Positive] = 0.6  # [m]
    max_backward: Length[Positive] = 0.3  # [m]
    min_width: Sole[Positive] = 0.15  # lateral distance of the soles' origins [m]
    max_width: Length[Positive] = 0.6  # [m]
    max_distance: Length[Positive] = 0.4  # of the soles' origins, seen from above: a long step is not a wide one [m]
    max_up: Length[Positive] = 0.25  # [m]
    max_down: Length[Positive] = 0.2  # [m]
    max_yaw: Positive = 0.6  # either way [rad]
    max_tilt: Positive = 0.35  # of the sole from level [rad]
    max_swing_height: Length[Positive] = 0.2  # [m]
    min_swing_duration: Time[Positive] = 0.4  # [s]
    max_swing_duration: Time[Positive] = 3.0  # [s]
    min_transfer_duration: Time[Positive] = 0.1  # [s]
    max_transfer_duration: Time[Positive] = 3.0  # [s]

    def __post_init__(self) -> None:
        for what in ("width", "swing_duration", "transfer_duration"):
            require_order(self, f"min_{what}", f"max_{what}")


class Walking(Table):
    """How the robot steps: what a plan leaves to the robot, and how it walks by velocity."""

    swing_duration: Time[Positive] = 0.6  # at little speed, and of plans that do not say [s]
    transfer_duration: Time[Positive] = 0.2  # likewise, of weight from foot to foot [s]
    fast_swing_duration: Time[Positive] = 0.42  # at full speed and beyond [s]
    fast_transfer_duration: Time[Positive] = 0.06  # [s]
    full_speed: Speed[Positive] = 0.7  # the durations go linearly from zero to here [m/s]
    first_transfer_duration: Time[Positive] = 1.0  # from rest [s]
    last_transfer_duration: Time[Positive] = 1.0  # to rest [s]
    swing_height: Length[Positive] = 0.06  # of the apex above lift-off and touch-down, by velocity [m]
    plan_swing_height: Length[Positive] = 0.08  # likewise, of plans that do not say: they may be 4 cm wrong [m]
    touchdown_depth: Length[NonNegative] = 0.025  # below the foothold, that a foot is led to: holes are met in time [m]
    touchdown_force: Force[Positive] = 30.0  # vertical, at which a swinging foot has touched down [N]
    earliest_touchdown: Positive = 0.6  # of the swing's duration
    descent: Speed[Positive] = 0.2  # of a foot as it comes down [m/s]
    late_descent: Speed[Positive] = 0.4  # and on, when it finds no ground [m/s]
    latest_touchdown: Time[Positive] = 0.3  # after the swing's end, whatever the foot feels [s]
    loading_duration: Time[Positive] = 0.05  # in which a foot gets and gives the right to push [s]
    foot_weight: Positive = 20.0  # of the swinging foot's task
    foot_stiffness: SquaredRate[Positive] = 300.0  # [1/s²]
    foot_damping: Rate[Positive] = 34.0  # [1/s]
    step_width: Length[Positive] = 0.2  # between the soles' origins, walking by velocity [m]
    hip_height: Length[Positive] = 0.725  # above the ankle in the nominal posture [m]
    leg_reach: Length[Positive] = 0.77  # hip to ankle, that long steps stretch a leg to; beyond, the CoM is lowered [m]
    max_forward_speed: Speed[Positive] = 1.2  # [m/s]
    max_backward_speed: Speed[Positive] = 0.3  # [m/s]
    max_lateral_speed: Speed[Positive] = 0.125  # [m/s]
    max_turn_rate: Rate[Positive] = 0.4  # [rad/s]
    speed_change: Speed[Positive] = 0.12  # from one step to the next, at most [m/s]
    turn_change: Rate[Positive] = 0.2  # [rad/s]
    command_timeout: Positive = 0.5  # without a velocity for so long, the robot stops [s]


class PelvisMotion(Table):
    """How far and how fast the standing robot's pelvis may be led from its nominal place over the feet."""

    max_shift: Length[NonNegative] = 0.05  # forward, backward and to each side [m]
    max_up: Length[NonNegative] = 0.03  # above nominal_base_height [m]
    max_down: Length[NonNegative] = 0.13  # below it [m]
    max_roll: NonNegative = 0.15  # [rad]
    max_pitch: NonNegative = 0.25  # [rad]
    max_yaw: NonNegative = 0.25  # [rad]
    max_speed: Speed[Positive] = 0.15  # [m/s]
    max_acceleration: Positive = 0.5  # [m/s²]
    max_turn_rate: Rate[Positive] = 0.4  # [rad/s]
    max_turn_acceleration: SquaredRate[Positive] = 1.5  # [rad/s²]
    com_margin: Sole[Positive] = 0.05  # the CoM's reference stays so far inside both soles' edges [m]


class SelfCollision(Table):
    """Which parts of the robot are kept apart, and how. Shapes are the largest that collide, of each body."""

    pairs: list[tuple[str, str]] = []  # of bodies
    distance: Length[NonNegative] = 0.02  # kept [m]
    near: Length[Annotated[float, Meta(gt=0, lt=0.5)]] = 0.045  # from where on a pair is looked after [m]
    approach: Rate[Positive] = 10.0  # velocity allowed per distance left [1/s]
    response: Rate[Positive] = 50.0  # deceleration per velocity above what is allowed [1/s]

    def __post_init__(self) -> None:
        require_order(self, "distance", "near")
