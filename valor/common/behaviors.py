"""Behaviors and control modes of the robot, with their names on Bifrost and ROS; spelled nowhere else.

A *behavior* of the Motion Manager combines states of three machines (thesis, table 3.1 and figure 3.7): Locomotion
(legs), Manipulation (arms, hands and waist) and Attention (neck). A *control mode* is the Valor ROS Controller's;
``control_modes.yaml`` lists the behaviors that it requests.
"""

from collections.abc import Mapping
from enum import StrEnum


class Locomotion(StrEnum):
    """States of the Locomotion FSM, which controls the legs."""

    IDLE = "idle"
    STAND_PREP = "stand_prep"
    STAND = "stand"
    STEP = "step"
    WALK = "walk"
    SOFT_STOP = "soft_stop"
    FREEZE = "freeze"
    FALL = "fall"
    GET_UP = "get_up"

    @property
    def stepping(self) -> bool:
        """True if the robot takes steps, of a plan or of a velocity."""
        return self in (Locomotion.STEP, Locomotion.WALK)

    @property
    def recovering(self) -> bool:
        """True if the robot takes recovery steps to keep its balance; in Soft Stop it starts none."""
        return self is Locomotion.STAND or self.stepping

    @property
    def balancing(self) -> bool:
        """True if the Whole-Body Controller controls the legs."""
        return self is Locomotion.SOFT_STOP or self.recovering


class Manipulation(StrEnum):
    """States of the Manipulation FSM: command source of arms, hands and waist."""

    LOCKED = "locked"  # none: they hold their positions
    SLAVE = "slave"  # the nominal posture
    TELEOP = "teleop"  # set-points of clients


class Attention(StrEnum):
    """States of the Attention FSM: command source of the neck."""

    LOCKED = "locked"  # none: it holds its position
    LOOK = "look"  # set-points of clients


class Behavior(StrEnum):
    """States of the Behavior FSM."""

    IDLE = "idle"
    STAND_PREP = "stand_prep"
    STAND = "stand"
    STAND_MANIPULATE = "stand_manipulate"
    STEP = "step"
    STEP_MANIPULATE = "step_manipulate"
    WALK = "walk"
    WALK_MANIPULATE = "walk_manipulate"
    SOFT_STOP = "soft_stop"
    FREEZE = "freeze"
    FALL = "fall"
    GET_UP = "get_up"

    @property
    def locomotion(self) -> Locomotion:
        """State of the Locomotion FSM."""
        return INTERNAL_STATES[self][0]

    @property
    def balancing(self) -> bool:
        """True if the Whole-Body Controller controls the legs."""
        return self.locomotion.balancing

    @property
    def operational(self) -> bool:
        """True if the robot balances and accepts commands."""
        return self.locomotion.recovering

    @property
    def manipulating(self) -> bool:
        """True if arms, hands and waist follow set-points of clients."""
        return INTERNAL_STATES[self][1] is Manipulation.TELEOP

    @property
    def stopped(self) -> bool:
        """True if the robot is stopped on its feet; it then accepts only requests for other behaviors."""
        return self in (Behavior.SOFT_STOP, Behavior.FREEZE)

    @property
    def fallen(self) -> bool:
        """True if the robot is limp, or gets up from the floor."""
        return self in (Behavior.FALL, Behavior.GET_UP)


_B, _L, _M, _A = Behavior, Locomotion, Manipulation, Attention

INTERNAL_STATES: Mapping[Behavior, tuple[Locomotion, Manipulation, Attention]] = {
    _B.IDLE:             (_L.IDLE,       _M.LOCKED, _A.LOCKED),
    _B.STAND_PREP:       (_L.STAND_PREP, _M.LOCKED, _A.LOCKED),
    _B.STAND:            (_L.STAND,      _M.SLAVE,  _A.LOOK),
    _B.STAND_MANIPULATE: (_L.STAND,      _M.TELEOP, _A.LOOK),
    _B.STEP:             (_L.STEP,       _M.SLAVE,  _A.LOOK),
    _B.STEP_MANIPULATE:  (_L.STEP,       _M.TELEOP, _A.LOOK),
    _B.WALK:             (_L.WALK,       _M.SLAVE,  _A.LOOK),
    _B.WALK_MANIPULATE:  (_L.WALK,       _M.TELEOP, _A.LOOK),
    _B.SOFT_STOP:        (_L.SOFT_STOP,  _M.LOCKED, _A.LOCKED),
    _B.FREEZE:           (_L.FREEZE,     _M.LOCKED, _A.LOCKED),
    _B.FALL:             (_L.FALL,       _M.LOCKED, _A.LOCKED),
    _B.GET_UP:           (_L.GET_UP,     _M.LOCKED, _A.LOCKED),
}  # fmt: skip
"""Table 3.1. The neck is locked in Stand Prep, in which every joint moves to the nominal posture."""

BEHAVIOR_TRANSITIONS: Mapping[Behavior, Mapping[Behavior, str]] = {
    _B.IDLE: {_B.STAND_PREP: "T", _B.FREEZE: "I"},
    _B.STAND_PREP: {_B.IDLE: "I", _B.STAND: "T", _B.FREEZE: "I"},
    _B.STAND: {_B.STAND_PREP: "P", _B.STAND_MANIPULATE: "T", _B.STEP: "P", _B.WALK: "P", _B.SOFT_STOP: "T",
               _B.FREEZE: "I", _B.FALL: "T"},
    _B.STAND_MANIPULATE: {_B.STAND: "T", _B.STEP: "I2", _B.WALK: "I2", _B.SOFT_STOP: "T", _B.FREEZE: "I",
                          _B.FALL: "T"},
    _B.STEP: {_B.STAND: "P", _B.STEP_MANIPULATE: "T", _B.SOFT_STOP: "T", _B.FALL: "T"},
    _B.STEP_MANIPULATE: {_B.STAND: "I2", _B.STEP: "T", _B.SOFT_STOP: "T", _B.FALL: "T"},
    _B.WALK: {_B.STAND: "P", _B.WALK_MANIPULATE: "T", _B.SOFT_STOP: "T", _B.FALL: "T"},
    _B.WALK_MANIPULATE: {_B.STAND: "I2", _B.WALK: "T", _B.SOFT_STOP: "T", _B.FALL: "T"},
    _B.SOFT_STOP: {_B.STAND: "I", _B.FREEZE: "I", _B.FALL: "I"},
    _B.FREEZE: {_B.IDLE: "I", _B.STAND_PREP: "P", _B.FALL: "I"},
    _B.FALL: {_B.FREEZE: "I", _B.GET_UP: "T"},
    _B.GET_UP: {_B.STAND_PREP: "I", _B.FALL: "I"},
}  # fmt: skip
"""Figure 3.8: from → to → source. The internal machines follow the behavior.

Sources: ``T`` thesis text, ``P`` public predecessors (ViGIR, Boston Dynamics, THOR), ``I`` inferred, ``I2`` needed
because a control mode is always reached by two commands, a base behavior and then its Manipulate variant.
"""

LEGS = ("left_leg", "right_leg")
LIMBS = ("torso", "left_arm", "right_arm", "left_hand", "right_hand", "neck")
"""Groups of robot.yaml that can be frozen while the rest of the robot moves."""
NO_LIMB = "none"  # requested instead of limbs: releases all

NOTHING_TO_LEAD = "this robot has no arms, hands or waist to control"
"""Rejection of behaviors with manipulation for a robot with legs and neck only."""

# For received names, which may be no behavior: `name in FALLEN`.
BALANCING = frozenset(behavior for behavior in Behavior if behavior.balancing)
OPERATIONAL = frozenset(behavior for behavior in Behavior if behavior.operational)
STANDING = frozenset(behavior for behavior in Behavior if behavior.locomotion is Locomotion.STAND)
STEPPING = frozenset(behavior for behavior in Behavior if behavior.locomotion is Locomotion.STEP)
WALKING = frozenset(behavior for behavior in Behavior if behavior.locomotion is Locomotion.WALK)
MANIPULATING = frozenset(behavior for behavior in Behavior if behavior.manipulating)
STOPPED = frozenset(behavior for behavior in Behavior if behavior.stopped)
FALLEN = frozenset(behavior for behavior in Behavior if behavior.fallen)

REFLEX = "reflex"
"""Replaces a behavior's name while the Comms Manager stops the robot after a timeout of the Motion Manager."""


class Reaction(StrEnum):
    """Required reaction of the Motion System to device faults (``DeviceStatus.reaction``), the mildest first."""

    KEEP_BALANCE = "keep_balance"  # continue: the unit is not needed for balance
    SOFT_STOP = "soft_stop"  # come to rest, keep balance, reject commands
    HOLD = "hold"  # hold all joints by their servos: the balance is unknown
    LIMP = "limp"  # no torque: nothing can hold the robot, and holding parts of it would do harm

    @property
    def severity(self) -> int:
        """Rank, 0 for the mildest."""
        return list(Reaction).index(self)


_REQUESTED_BY = "requested by "


def requested_by(origin: str) -> str:
    """Reason of a behavior change that the node ``origin`` requested, as in ``MotionState``."""
    return _REQUESTED_BY + origin


class Obstacle(StrEnum):
    """Cause of the rejection of a behavior request, as in ``BehaviorReply``."""

    NONE = ""  # accepted
    TRANSITION = "transition"  # no such transition in the table
    CONDITION = "condition"  # the robot's state does not allow it
    WAIT = "wait"  # temporary: repeat the request later


def requester(reason: str) -> str:
    """The node that requested a behavior change, from the reason; empty: automatic change."""
    return reason.removeprefix(_REQUESTED_BY) if reason.startswith(_REQUESTED_BY) else ""


class ControlMode(StrEnum):
    """The VRC's control modes, the rows of ``control_modes.yaml`` (thesis, figure 4.3)."""

    NONE = "none"
    STOP = "stop"
    FREEZE = "freeze"
    STAND_PREP = "stand_prep"
    STAND = "stand"
    STAND_MANIPULATE = "stand_manipulate"
    MANIPULATE = "manipulate"
    STEP = "step"
    STEP_MANIPULATE = "step_manipulate"
    WALK = "walk"
    WALK_MANIPULATE = "walk_manipulate"
    SOFT_STOP = "soft_stop"


STEPPING_MODES = frozenset((ControlMode.STEP, ControlMode.STEP_MANIPULATE))
WALKING_MODES = frozenset((ControlMode.WALK, ControlMode.WALK_MANIPULATE))

EMERGENCY_STOP = "emergency_stop"
"""Requested instead of a control mode: the mode that stops the robot from its present state."""
