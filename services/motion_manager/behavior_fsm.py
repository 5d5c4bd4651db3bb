"""Behavior FSM: transitions by the tables of ``valor.common.behaviors``, and their guards. No input or output."""

from collections.abc import Mapping
from dataclasses import dataclass

from valor.common.behaviors import (
    BEHAVIOR_TRANSITIONS,
    INTERNAL_STATES,
    Attention,
    Behavior,
    Locomotion,
    Manipulation,
    Obstacle,
    requested_by,
)
from valor.common.errors import ValorError


class TransitionError(ValorError):
    """Transition that the table lacks: an internal error, never caused by a client."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Reasons in the robot's state against transitions; each empty without."""

    not_prepared: str = ""  # Stand Prep has not finished
    not_loaded: str = ""  # the feet do not both carry weight
    not_upright: str = ""  # the pelvis is tilted
    stepping: str = ""  # a step has not come to rest yet
    cannot_get_up: str = ""  # there is no way up from the present pose
    nothing_to_lead: str = ""  # the robot has neither arms nor hands nor a waist
    getting_up: str = "the robot has not finished getting up"


GUARDS: Mapping[tuple[Behavior, Behavior], tuple[str, ...]] = {
    (Behavior.STAND_PREP, Behavior.STAND): ("not_prepared", "not_upright", "not_loaded"),
    (Behavior.STAND, Behavior.STAND_PREP): ("stepping",),
    (Behavior.STAND, Behavior.FREEZE): ("stepping",),
    (Behavior.STAND_MANIPULATE, Behavior.FREEZE): ("stepping",),
    (Behavior.SOFT_STOP, Behavior.FREEZE): ("stepping",),
    (Behavior.STAND, Behavior.STAND_MANIPULATE): ("nothing_to_lead",),
    (Behavior.STEP, Behavior.STEP_MANIPULATE): ("nothing_to_lead",),
    (Behavior.WALK, Behavior.WALK_MANIPULATE): ("nothing_to_lead",),
    (Behavior.FALL, Behavior.GET_UP): ("cannot_get_up",),
    (Behavior.GET_UP, Behavior.STAND_PREP): ("getting_up",),  # automatic only
}
"""Transition on request → conditions against it."""

WAITS = frozenset({"not_prepared", "stepping", "getting_up"})  # conditions that end without a client


@dataclass(frozen=True, slots=True)
class Verdict:
    """Reply to a request."""

    accepted: bool
    reason: str
    obstacle: Obstacle = Obstacle.NONE


class BehaviorFsm:
    """The Behavior FSM; it determines the states of the three internal FSMs (``INTERNAL_STATES``)."""

    def __init__(self) -> None:
        self.behavior = Behavior.IDLE  # present behavior
        self.reason = "started"  # reason of the last change, or a later status note
        self.changes = 0  # number of changes

    @property
    def locomotion(self) -> Locomotion:
        """State of the Locomotion FSM."""
        return INTERNAL_STATES[self.behavior][0]

    @property
    def manipulation(self) -> Manipulation:
        """State of the Manipulation FSM."""
        return INTERNAL_STATES[self.behavior][1]

    @property
    def attention(self) -> Attention:
        """State of the Attention FSM."""
        return INTERNAL_STATES[self.behavior][2]

    def request(self, target: Behavior, conditions: Conditions, origin: str) -> Verdict:
        """Change to a behavior for the node ``origin``, or reject; a request for the present one is accepted."""
        here = self.behavior
        if target is here:
            return Verdict(True, f"already in {target}")
        if not self.may_go(target):
            allowed = ", ".join(sorted(BEHAVIOR_TRANSITIONS[here])) or "none"
            return Verdict(False, f"no transition from {here} to {target}; from here: {allowed}", Obstacle.TRANSITION)
        for guard in GUARDS.get((here, target), ()):
            if reason := getattr(conditions, guard):
                return Verdict(False, reason, Obstacle.WAIT if guard in WAITS else Obstacle.CONDITION)
        self.go(target, requested_by(origin))
        return Verdict(True, "")

    def go(self, target: Behavior, reason: str) -> None:
        """Change the behavior without guards; raises ``TransitionError``, with nothing changed, outside the table."""
        if target is self.behavior:
            return
        if not self.may_go(target):
            raise TransitionError(f"no transition from {self.behavior} to {target}")
        self.behavior, self.reason = target, reason
        self.changes += 1

    def note(self, reason: str) -> None:
        """Replace the reason by a status note."""
        self.reason = reason

    def may_go(self, target: Behavior) -> bool:
        """Return whether the table has the transition from the present behavior."""
        return target in BEHAVIOR_TRANSITIONS[self.behavior]
