"""The Motion Manager's state machines as tables: what may follow what, and who may move which joint.

The Behavior FSM is what other nodes ask for (thesis section 3.4.1, figure 3.8); three internal machines follow it, as
``common/behaviors.py`` says. This module holds data and one check; ``behavior_fsm`` walks the tables.

Each edge carries where it is known from: ``T`` thesis text, ``P`` public predecessors (ViGIR, Boston Dynamics, THOR),
``I`` inferred, ``I2`` needed because a control mode is always reached by two commands, a base behavior and then its
Manipulate variant.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from valor.common.behaviors import Attention, Behavior, Locomotion, Manipulation
from valor.robot.description import RobotDescription

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

RESUMED: Mapping[Behavior, Behavior] = {
    behavior: _B.IDLE if behavior is _B.IDLE else _B.FALL if behavior.fallen else _B.FREEZE for behavior in _B
}
"""Where a Motion Manager begins that takes over a robot left behind in a behavior: at rest, until a command comes.

A robot that was balancing and is not upright on both feet is let go instead: Fall.
"""


def _ways_from(start: Behavior) -> Mapping[Behavior, tuple[Behavior, ...]]:
    """Behavior → the shortest way there by edges of the table, of equally short ones the first."""
    ways: dict[Behavior, tuple[Behavior, ...]] = {start: ()}
    for here in (frontier := [start]):
        for there in BEHAVIOR_TRANSITIONS[here]:
            if there not in ways:
                ways[there] = (*ways[here], there)
                frontier.append(there)
    return ways


WAY_BACK = _ways_from(_B.IDLE)
"""From Idle, where the process begins, to a behavior, within one period: to one of ``RESUMED``, or to Soft Stop, where
it stands aside for a reflex that does just that."""

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
    """Joint name → the one internal FSM that may move it; joints of other groups have none, and stay where they are."""
    return {
        joint: machine
        for machine, groups in JOINT_ACCESS.items()
        for group in groups
        for joint in robot.tables.groups.get(group, ())
    }
