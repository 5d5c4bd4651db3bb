"""Tables of robot.yaml for motion; those that only controllers read are in ``valor.control.tuning_tables``."""

from typing import Annotated

from msgspec import Meta

from valor.common.behaviors import Locomotion
from valor.common.table import NonNegative, Positive, Table, require_order
from valor.robot.size import Force, Length, Rate, Sole, Speed, SquaredRate, Time

WHOLE_BODY = "whole_body"
"""Name of the Whole-Body Controller, which every robot has."""
REMOTE = "remote"
"""Name of the controller that executes joint commands from outside the Motion Manager."""


class Footsteps(Table):
    """Limits of steps. Displacements are of a sole relative to the other sole, in its heading.

    ESCHER's lengths and heights are those of a public controller for it; the least width keeps the soles apart.
    Balance steps use the same limits without ``max_distance``; plan steps beyond it miss their footholds.
    """

    max_steps: Annotated[int, Meta(ge=1)] = 50  # per plan
    max_forward: Length[Positive] = 0.6  # [m]
    max_backward: Length[Positive] = 0.3  # [m]
    min_width: Sole[Positive] = 0.15  # lateral distance of the soles' origins [m]
    max_width: Length[Positive] = 0.6  # [m]
    max_distance: Length[Positive] = 0.4  # horizontal distance of the soles' origins [m]
    max_up: Length[Positive] = 0.25  # [m]
    max_down: Length[Positive] = 0.2  # [m]
    max_yaw: Positive = 0.6  # in both directions [rad]
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
    """Defaults of footstep plans, and walking by velocity."""

    swing_duration: Time[Positive] = 0.6  # at low speed, and the default of plans [s]
    transfer_duration: Time[Positive] = 0.2  # likewise, of the double support [s]
    fast_swing_duration: Time[Positive] = 0.42  # at full speed and above [s]
    fast_transfer_duration: Time[Positive] = 0.06  # [s]
    full_speed: Speed[Positive] = 0.7  # durations are linear in the way of the feet up to here [m/s]
    first_transfer_duration: Time[Positive] = 0.5  # from rest [s]
    last_transfer_duration: Time[Positive] = 0.5  # to rest [s]
    swing_height: Length[Positive] = 0.06  # apex above lift-off and touch-down, walking by velocity [m]
    plan_swing_height: Length[Positive] = 0.08  # likewise, default of plans, whose heights may be 4 cm wrong [m]
    touchdown_depth: Length[NonNegative] = 0.025  # target below the foothold, so that holes are reached in time [m]
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
    hip_height: Length[Positive] = 0.725  # of the hip above the ankle in the nominal posture [m]
    leg_reach: Length[Positive] = 0.77  # largest hip–ankle distance in long steps; above it the CoM is lowered [m]
    max_forward_speed: Speed[Positive] = 1.2  # [m/s]
    max_backward_speed: Speed[Positive] = 0.3  # [m/s]
    max_lateral_speed: Speed[Positive] = 0.4  # [m/s]
    max_turn_rate: Rate[Positive] = 0.8  # [rad/s]
    speed_change: Speed[Positive] = 0.12  # largest change from step to step [m/s]
    turn_change: Rate[Positive] = 0.2  # [rad/s]
    command_timeout: Positive = 0.5  # the robot stops after this time without a velocity command [s]


class Controllers(Table):
    """Controllers that clients may choose, by name, for a robot that stands and one that walks; the first is used."""

    stand: str | list[str] = WHOLE_BODY
    walk: str | list[str] = WHOLE_BODY

    def names(self) -> dict[Locomotion, list[str]]:
        """Return state of the Locomotion FSM → its controllers, never empty."""
        found = {Locomotion(name): getattr(self, name) for name in self.__struct_fields__}
        return {state: [each] if isinstance(each, str) else each or [WHOLE_BODY] for state, each in found.items()}


class PelvisMotion(Table):
    """Limits of pelvis motion while standing, relative to the nominal pose over the feet."""

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
    com_margin: Sole[Positive] = 0.05  # least distance of the CoM reference inside the edges of both soles [m]


class SelfCollision(Table):
    """Self-collision avoidance between pairs of bodies, each by its largest colliding geom."""

    pairs: list[tuple[str, str]] = []  # body names
    distance: Length[NonNegative] = 0.02  # least distance [m]
    near: Length[Annotated[float, Meta(gt=0, lt=0.5)]] = 0.045  # distance below which a pair is constrained [m]
    approach: Rate[Positive] = 10.0  # allowed velocity per remaining distance [1/s]
    response: Rate[Positive] = 50.0  # deceleration per excess velocity [1/s]

    def __post_init__(self) -> None:
        require_order(self, "distance", "near")
