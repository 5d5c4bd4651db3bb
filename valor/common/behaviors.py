"""Behaviors and control modes: what the robot may be told to do, and by which words.

A *behavior* is the Motion Manager's. Each is a combination of states of three internal machines (thesis, table 3.1 and
figure 3.7): Locomotion (legs), Manipulation (arms, hands and waist) and Attention (neck); everything that is true of a
behavior follows from them. A *control mode* is the Valor ROS Controller's; ``control_modes.yaml`` says which behaviors
it asks for. The values are the names on Bifrost and ROS; no other module spells them.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Locomotion(StrEnum):
    """States of the Locomotion FSM: how the robot carries itself."""

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
        """It takes steps: those of a plan, or those of a velocity."""
        return self in (Locomotion.STEP, Locomotion.WALK)

    @property
    def recovering(self) -> bool:
        """A robot at rest steps by itself when its feet cannot hold it. In Soft Stop nothing begins any more."""
        return self is Locomotion.STAND or self.stepping

    @property
    def balancing(self) -> bool:
        """The Whole-Body Controller has the legs."""
        return self is Locomotion.SOFT_STOP or self.recovering


class Manipulation(StrEnum):
    """States of the Manipulation FSM: whom the arms, hands and waist follow."""

    LOCKED = "locked"  # nobody: they stay where they are
    SLAVE = "slave"  # the nominal posture
    TELEOP = "teleop"  # set-points from outside


class Attention(StrEnum):
    """States of the Attention FSM: whom the neck follows."""

    LOCKED = "locked"  # nobody: it stays where it is
    LOOK = "look"  # set-points from outside


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
        """How the robot carries itself in it."""
        return INTERNAL_STATES[self][0]

    @property
    def balancing(self) -> bool:
        """The Whole-Body Controller has the legs."""
        return self.locomotion.balancing

    @property
    def operational(self) -> bool:
        """The robot balances and takes commands."""
        return self.locomotion.recovering

    @property
    def manipulating(self) -> bool:
        """Arms, hands and waist follow set-points from outside."""
        return INTERNAL_STATES[self][1] is Manipulation.TELEOP

    @property
    def stopped(self) -> bool:
        """The robot was brought to a stop on its feet, and takes no commands but those that lead on."""
        return self in (Behavior.SOFT_STOP, Behavior.FREEZE)

    @property
    def fallen(self) -> bool:
        """The robot is limp, or on its way up from the floor."""
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
"""Table 3.1. The neck stays closed in Stand Prep, where every joint goes to the nominal posture."""

NOTHING_TO_LEAD = "this robot has neither arms nor hands nor a waist to lead"
"""Why no behavior that manipulates is for a robot of which legs and neck are all that moves."""

# For names as they come off the wire, which need not be those of a behavior: `name in FALLEN`.
BALANCING = frozenset(behavior for behavior in Behavior if behavior.balancing)
OPERATIONAL = frozenset(behavior for behavior in Behavior if behavior.operational)
STANDING = frozenset(behavior for behavior in Behavior if behavior.locomotion is Locomotion.STAND)
STEPPING = frozenset(behavior for behavior in Behavior if behavior.locomotion is Locomotion.STEP)
WALKING = frozenset(behavior for behavior in Behavior if behavior.locomotion is Locomotion.WALK)
MANIPULATING = frozenset(behavior for behavior in Behavior if behavior.manipulating)
STOPPED = frozenset(behavior for behavior in Behavior if behavior.stopped)
FALLEN = frozenset(behavior for behavior in Behavior if behavior.fallen)

REFLEX = "reflex"
"""In a behavior's place while the Comms Manager itself brings a robot to stand whose Motion Manager fell silent."""


class Reaction(StrEnum):
    """What the devices' condition demands of the Motion System (``DeviceStatus.reaction``), the mildest first."""

    KEEP_BALANCE = "keep_balance"  # go on: balance does not need the unit
    SOFT_STOP = "soft_stop"  # come to rest, keep balance, obey no commands from outside
    HOLD = "hold"  # every joint stays, on its own servo: the balance cannot be known any more
    LIMP = "limp"  # no torque: nothing holds the robot, and what would hold parts of it does harm

    @property
    def severity(self) -> int:
        """0 of the mildest."""
        return list(Reaction).index(self)


_REQUESTED_BY = "requested by "


def requested_by(origin: str) -> str:
    """The reason of a change of behavior that the node ``origin`` asked for, as ``MotionState`` and others say it."""
    return _REQUESTED_BY + origin


class Obstacle(StrEnum):
    """What a request for a behavior is refused for, as ``BehaviorReply`` says it."""

    NONE = ""  # it is not
    TRANSITION = "transition"  # the table leads there from elsewhere only
    CONDITION = "condition"  # the robot is not fit for it now
    WAIT = "wait"  # it will be, by itself: ask again


def requester(reason: str) -> str:
    """The node that asked for a change of behavior, by the change's reason; empty: nobody did, it came by itself."""
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
"""Asked for in a control mode's place: whichever stops the robot from where it is."""
