"""The Motion Manager's state machines as tables: what there is, what may follow what, and who may move which joint.

The Behavior FSM is what other nodes ask for (thesis section 3.4.1, figure 3.8). A behavior is nothing but a
combination of states of three internal machines (table 3.1, figure 3.7): Locomotion (legs), Manipulation (arms, hands
and waist) and Attention (neck). This module holds data and one check; ``behavior_fsm`` walks the tables.

Each edge carries where it is known from: ``T`` thesis text, ``P`` public predecessors (ViGIR, Boston Dynamics, THOR),
``I`` inferred, ``I2`` needed because a control mode is always reached by two commands, a base behavior and then its
Manipulate variant. ``docs/motion_manager.md`` gives the reasons of the inferred ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription


class Behavior(StrEnum):
    """States of the Behavior FSM; their values are the names on Bifrost."""

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


class Manipulation(StrEnum):
    """States of the Manipulation FSM: whom the arms, hands and waist follow."""

    LOCKED = "locked"  # nobody: they stay where they are
    SLAVE = "slave"  # the nominal posture
    TELEOP = "teleop"  # set-points from outside


class Attention(StrEnum):
    """States of the Attention FSM: whom the neck follows."""

    LOCKED = "locked"  # nobody: it stays where it is
    LOOK = "look"  # set-points from outside


_B, _L, _M, _A = Behavior, Locomotion, Manipulation, Attention

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
"""Figure 3.8: from → to → source. Staying is always allowed and does nothing."""

LOCOMOTION_TRANSITIONS: Mapping[Locomotion, Mapping[Locomotion, str]] = {
    _L.IDLE: {_L.STAND_PREP: "T", _L.FREEZE: "I"},
    _L.STAND_PREP: {_L.STAND: "T", _L.IDLE: "I", _L.FREEZE: "I"},
    _L.STAND: {_L.STEP: "P", _L.WALK: "P", _L.SOFT_STOP: "T", _L.FALL: "T", _L.STAND_PREP: "P", _L.FREEZE: "I"},
    _L.STEP: {_L.STAND: "P", _L.SOFT_STOP: "T", _L.FALL: "T"},
    _L.WALK: {_L.STAND: "P", _L.SOFT_STOP: "T", _L.FALL: "T"},
    _L.SOFT_STOP: {_L.STAND: "I", _L.FREEZE: "I", _L.FALL: "I"},
    _L.FREEZE: {_L.STAND_PREP: "P", _L.IDLE: "I", _L.FALL: "I"},
    _L.FALL: {_L.GET_UP: "T", _L.FREEZE: "I"},
    _L.GET_UP: {_L.STAND_PREP: "I", _L.FALL: "I"},
}  # fmt: skip
"""Figure 3.7, Locomotion."""

MANIPULATION_TRANSITIONS: Mapping[Manipulation, Mapping[Manipulation, str]] = {
    _M.LOCKED: {_M.SLAVE: "I"},
    _M.SLAVE: {_M.LOCKED: "I", _M.TELEOP: "P"},
    _M.TELEOP: {_M.SLAVE: "P", _M.LOCKED: "I"},
}
"""Figure 3.7, Manipulation: arms are given away only from where they follow the posture."""

ATTENTION_TRANSITIONS: Mapping[Attention, Mapping[Attention, str]] = {
    _A.LOCKED: {_A.LOOK: "I"},
    _A.LOOK: {_A.LOCKED: "I"},
}
"""Figure 3.7, Attention."""

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

OPERATIONAL: frozenset[Behavior] = frozenset({
    _B.STAND, _B.STAND_MANIPULATE, _B.STEP, _B.STEP_MANIPULATE, _B.WALK, _B.WALK_MANIPULATE,
})  # fmt: skip
"""The six operational behaviors: the robot balances and takes commands."""

BALANCING: frozenset[Locomotion] = frozenset({_L.STAND, _L.STEP, _L.WALK, _L.SOFT_STOP})
"""Where the Whole-Body Controller has the legs."""

RECOVERING: frozenset[Locomotion] = frozenset({_L.STAND, _L.STEP, _L.WALK})
"""Where a robot at rest steps by itself when its feet cannot hold it. In Soft Stop nothing begins any more."""

RESUMED: Mapping[Behavior, Behavior] = {
    _B.IDLE: _B.IDLE,
    _B.FALL: _B.FALL,
    _B.GET_UP: _B.FALL,
} | {behavior: _B.FREEZE for behavior in _B if behavior not in (_B.IDLE, _B.FALL, _B.GET_UP)}
"""Where a Motion Manager begins that takes over a robot left behind in a behavior: at rest, until a command comes.

A robot that was balancing and is not upright on both feet is let go instead: Fall.
"""

WAY_BACK: Mapping[Behavior, tuple[Behavior, ...]] = {
    _B.IDLE: (),
    _B.FREEZE: (_B.FREEZE,),
    _B.FALL: (_B.FREEZE, _B.FALL),
    _B.SOFT_STOP: (_B.STAND_PREP, _B.STAND, _B.SOFT_STOP),
}
"""From Idle, where the process begins, to a behavior of ``RESUMED``, by edges of the table and within one period; and
to Soft Stop, where it stands aside for a reflex that does just that."""

WAYS_TO: Mapping[Behavior, tuple[tuple[Behavior, ...], ...]] = {
    _B.FALL: ((_B.FALL,), (_B.FREEZE, _B.FALL)),
    _B.FREEZE: ((_B.FREEZE,), (_B.SOFT_STOP, _B.FREEZE), (_B.FALL, _B.FREEZE)),
}
"""What the Comms Manager obeys when no Motion Manager does, and how one follows: the first way that can be begun."""

JOINT_ACCESS: Mapping[type[StrEnum], tuple[str, ...]] = {
    Locomotion: ("left_leg", "right_leg"),
    Manipulation: ("torso", "left_arm", "right_arm", "left_hand", "right_hand"),
    Attention: ("neck", "lidar"),
}
"""Which groups of robot.yaml each internal FSM may move."""

SETPOINT_STATES: Mapping[type[StrEnum], StrEnum] = {Manipulation: _M.TELEOP, Attention: _A.LOOK}
"""The state in which an internal FSM lets joint set-points in; Locomotion never does."""


def joint_owners(robot: RobotDescription) -> dict[str, type[StrEnum]]:
    """Joint name → the one internal FSM that may move it.

    Raises:
        ConfigurationError: a joint of robot.yaml would be moved by none of them.
    """
    owners: dict[str, type[StrEnum]] = {
        joint: machine
        for machine, groups in JOINT_ACCESS.items()
        for group in groups
        for joint in robot.tables.groups.get(group, ())
    }
    if orphans := [joint for joint in robot.joints if joint not in owners]:
        expected = ", ".join(group for groups in JOINT_ACCESS.values() for group in groups)
        raise ConfigurationError(
            f"{robot.folder / 'robot.yaml'}: groups: joints {orphans} are in no group that an FSM moves; "
            f"expected one of {expected}"
        )
    return owners
