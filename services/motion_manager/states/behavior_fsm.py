"""Walks the tables of ``behaviors``: who may go where, why not, and what the internal machines do meanwhile.

No input or output here: facts about the robot come in as data, verdicts go out as data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

from valor.common.behaviors import (
    INTERNAL_STATES,
    Attention,
    Behavior,
    Locomotion,
    Manipulation,
    Obstacle,
    requested_by,
)
from valor.common.errors import ValorError
from valor.motion_manager.states.transitions import (
    ATTENTION_TRANSITIONS,
    BEHAVIOR_TRANSITIONS,
    LOCOMOTION_TRANSITIONS,
    MANIPULATION_TRANSITIONS,
)

S = TypeVar("S", bound=StrEnum)


class TransitionError(ValorError):
    """A state machine was told to go where its table has no edge: an error of ours, never of a client."""


class StateMachine(Generic[S]):
    """A state and the table of where it may go."""

    def __init__(self, transitions: Mapping[S, Mapping[S, str]], initial: S) -> None:
        self._transitions = transitions
        self.state = initial

    def check(self, state: S) -> None:
        """Whether the table leads from here to a state; staying is always allowed.

        Raises:
            TransitionError: the table has no such edge.
        """
        if state is not self.state and state not in self._transitions[self.state]:
            raise TransitionError(f"{type(state).__name__}: no transition from {self.state} to {state}")


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the robot's condition has against a transition; an empty text: nothing."""

    not_prepared: str = ""  # Stand Prep has not finished
    not_loaded: str = ""  # the feet do not both carry weight
    not_upright: str = ""  # the pelvis is tilted
    stepping: str = ""  # a step has not come to rest yet
    cannot_get_up: str = ""  # the robot has no way up from where it lies
    nothing_to_lead: str = ""  # it has neither arms nor hands nor a waist


Guard = Callable[[Conditions], str]
"""Gives the reason against an edge, or an empty text."""

GUARDS: Mapping[tuple[Behavior, Behavior], tuple[tuple[Obstacle, Guard], ...]] = {
    (Behavior.STAND_PREP, Behavior.STAND): (
        (Obstacle.WAIT, lambda conditions: conditions.not_prepared),
        (Obstacle.CONDITION, lambda conditions: conditions.not_upright),
        (Obstacle.CONDITION, lambda conditions: conditions.not_loaded),
    ),
    (Behavior.STAND, Behavior.STAND_PREP): ((Obstacle.WAIT, lambda conditions: conditions.stepping),),
    (Behavior.STAND, Behavior.FREEZE): ((Obstacle.WAIT, lambda conditions: conditions.stepping),),
    (Behavior.STAND, Behavior.STAND_MANIPULATE): ((Obstacle.CONDITION, lambda conditions: conditions.nothing_to_lead),),
    (Behavior.STEP, Behavior.STEP_MANIPULATE): ((Obstacle.CONDITION, lambda conditions: conditions.nothing_to_lead),),
    (Behavior.WALK, Behavior.WALK_MANIPULATE): ((Obstacle.CONDITION, lambda conditions: conditions.nothing_to_lead),),
    (Behavior.STAND_MANIPULATE, Behavior.FREEZE): ((Obstacle.WAIT, lambda conditions: conditions.stepping),),
    (Behavior.SOFT_STOP, Behavior.FREEZE): ((Obstacle.WAIT, lambda conditions: conditions.stepping),),
    (Behavior.FALL, Behavior.GET_UP): ((Obstacle.CONDITION, lambda conditions: conditions.cannot_get_up),),
    # On its way up the robot stands only by its own word.
    (Behavior.GET_UP, Behavior.STAND_PREP): ((Obstacle.WAIT, lambda _: "the robot has not finished getting up"),),
}
"""What must hold for an edge to be taken on request, and whether what is against it passes by itself."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to a request, or to the question what it would be."""

    accepted: bool
    reason: str
    obstacle: Obstacle = Obstacle.NONE


class BehaviorFsm:
    """The Behavior FSM, and the three internal FSMs that follow it.

    Attributes:
        behavior: the present one.
        reason: of the last change, or what was remarked since.
        changes: how often it changed.
    """

    def __init__(self) -> None:
        self._behavior = StateMachine(BEHAVIOR_TRANSITIONS, Behavior.IDLE)
        locomotion, manipulation, attention = INTERNAL_STATES[Behavior.IDLE]
        self._locomotion = StateMachine(LOCOMOTION_TRANSITIONS, locomotion)
        self._manipulation = StateMachine(MANIPULATION_TRANSITIONS, manipulation)
        self._attention = StateMachine(ATTENTION_TRANSITIONS, attention)
        self.reason = "started"
        self.changes = 0

    @property
    def behavior(self) -> Behavior:
        """State of the Behavior FSM."""
        return self._behavior.state

    @property
    def locomotion(self) -> Locomotion:
        """State of the Locomotion FSM."""
        return self._locomotion.state

    @property
    def manipulation(self) -> Manipulation:
        """State of the Manipulation FSM."""
        return self._manipulation.state

    @property
    def attention(self) -> Attention:
        """State of the Attention FSM."""
        return self._attention.state

    def verdict(self, target: Behavior, conditions: Conditions) -> Verdict:
        """What a request for a behavior would be answered now."""
        here = self.behavior
        if target is here:
            return Verdict(True, f"already in {target}")
        if target not in BEHAVIOR_TRANSITIONS[here]:
            allowed = ", ".join(sorted(self.reachable)) or "none"
            return Verdict(False, f"no transition from {here} to {target}; from here: {allowed}", Obstacle.TRANSITION)
        for obstacle, guard in GUARDS.get((here, target), ()):
            if reason := guard(conditions):
                return Verdict(False, reason, obstacle)
        return Verdict(True, "")

    @property
    def reachable(self) -> list[Behavior]:
        """Behaviors that one transition leads to."""
        return list(BEHAVIOR_TRANSITIONS[self.behavior])

    def request(self, target: Behavior, conditions: Conditions, origin: str) -> Verdict:
        """Somebody asks for a behavior: go there, or say why not. Asking for the present one is accepted."""
        verdict = self.verdict(target, conditions)
        if verdict.accepted and target is not self.behavior:
            self.go(target, requested_by(origin))
        return verdict

    def go(self, target: Behavior, reason: str) -> None:
        """The Motion Manager itself changes the behavior, and the internal machines with it.

        Raises:
            TransitionError: one of the tables has no such edge; nothing has changed.
        """
        if target is self.behavior:
            return
        locomotion, manipulation, attention = INTERNAL_STATES[target]
        self._behavior.check(target)
        self._locomotion.check(locomotion)
        self._manipulation.check(manipulation)
        self._attention.check(attention)
        self._behavior.state = target
        self._locomotion.state = locomotion
        self._manipulation.state = manipulation
        self._attention.state = attention
        self.reason = reason
        self.changes += 1

    def remark(self, reason: str) -> None:
        """Something of note within the present behavior: its reason now."""
        self.reason = reason

    def may_go(self, target: Behavior) -> bool:
        """Whether the table has the edge from here."""
        return target in BEHAVIOR_TRANSITIONS[self.behavior]
