"""The Behavior FSM: every request in every behavior, and anything that may happen in any order."""

from __future__ import annotations

from collections import deque
from itertools import product

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from harness.examples import examples
from valor.common.behaviors import INTERNAL_STATES, OPERATIONAL, Behavior, Manipulation
from valor.motion_manager.states.behavior_fsm import GUARDS, BehaviorFsm, Conditions, TransitionError
from valor.motion_manager.states.transitions import BEHAVIOR_TRANSITIONS

FINE = Conditions()
BAD = Conditions("stand_prep has 1.0 s to go", "the left foot carries 0 N", "the pelvis is tilted")


def path_to(target: Behavior) -> list[Behavior]:
    """The shortest way from Idle."""
    paths = deque([[Behavior.IDLE]])
    while paths[0][-1] is not target:
        path = paths.popleft()
        paths += [[*path, there] for there in BEHAVIOR_TRANSITIONS[path[-1]] if there not in path]
    return paths[0]


def machine_in(behavior: Behavior) -> BehaviorFsm:
    fsm = BehaviorFsm()
    for step in path_to(behavior)[1:]:
        fsm.go(step, "test")
    assert fsm.behavior is behavior
    return fsm


@pytest.mark.parametrize(("here", "there"), list(product(Behavior, Behavior)))
def test_every_request_in_every_behavior_(here: Behavior, there: Behavior) -> None:
    fsm = machine_in(here)
    before = fsm.reason, fsm.changes
    verdict = fsm.request(there, FINE, "somebody")
    by_itself = (here, there) == (Behavior.GET_UP, Behavior.STAND_PREP)
    if by_itself:
        assert (verdict.accepted, verdict.reason) == (False, "the robot has not finished getting up")
        return
    allowed = there is here or there in BEHAVIOR_TRANSITIONS[here]
    assert verdict.accepted == allowed
    assert fsm.behavior is (there if allowed else here)
    assert (fsm.locomotion, fsm.manipulation, fsm.attention) == INTERNAL_STATES[fsm.behavior]
    if there is here:
        assert "already" in verdict.reason
        assert (fsm.reason, fsm.changes) == before
    elif allowed:
        assert fsm.reason == "requested by somebody"
        assert fsm.changes == before[1] + 1
    else:
        assert f"no transition from {here} to {there}" in verdict.reason
        assert (fsm.reason, fsm.changes) == before


@pytest.mark.parametrize("flaw", ["not_prepared", "not_loaded", "not_upright"])
def test_stand_is_refused_from_stand_prep_for_each_flaw(flaw: str) -> None:
    fsm = machine_in(Behavior.STAND_PREP)
    verdict = fsm.request(Behavior.STAND, Conditions(**{flaw: "because of the test"}), "somebody")
    assert (verdict.accepted, verdict.reason) == (False, "because of the test")
    assert fsm.behavior is Behavior.STAND_PREP
    assert fsm.request(Behavior.STAND, FINE, "somebody").accepted


def test_no_operational_behavior_is_entered_from_outside_without_a_guard() -> None:
    for here, row in BEHAVIOR_TRANSITIONS.items():
        for there in row:
            if there in OPERATIONAL and here not in OPERATIONAL and here is not Behavior.SOFT_STOP:
                assert GUARDS[here, there]


def test_an_edge_that_is_not_there_is_an_error_and_changes_nothing() -> None:
    fsm = BehaviorFsm()
    with pytest.raises(TransitionError, match="no transition from idle to walk"):
        fsm.go(Behavior.WALK, "test")
    assert fsm.behavior is Behavior.IDLE
    assert fsm.changes == 0


class AnythingMayHappen(RuleBasedStateMachine):
    """Requests of every kind, falls and internal changes in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.fsm = BehaviorFsm()
        self.trace = [Behavior.IDLE]

    def _moved(self, before: Behavior) -> None:
        if self.fsm.behavior is not before:
            self.trace.append(self.fsm.behavior)

    @rule(there=st.sampled_from(Behavior), fine=st.booleans())
    def request(self, there: Behavior, fine: bool) -> None:
        before = self.fsm.behavior
        verdict = self.fsm.request(there, FINE if fine else BAD, "somebody")
        assert verdict.accepted == (self.fsm.behavior is there)
        assert verdict.accepted or verdict.reason
        if not verdict.accepted:
            assert self.fsm.behavior is before
        self._moved(before)

    @rule(there=st.sampled_from([Behavior.FALL, Behavior.SOFT_STOP, Behavior.STAND_PREP]))
    def changed_by_itself(self, there: Behavior) -> None:
        before = self.fsm.behavior
        if self.fsm.may_go(there):
            self.fsm.go(there, "something happened")
            assert self.fsm.reason == "something happened"
        elif there is not before:
            with pytest.raises(TransitionError):
                self.fsm.go(there, "something happened")
            assert self.fsm.behavior is before
        self._moved(before)

    @invariant()
    def internal_states_are_those_of_the_table(self) -> None:
        fsm = self.fsm
        assert (fsm.locomotion, fsm.manipulation, fsm.attention) == INTERNAL_STATES[fsm.behavior]

    @invariant()
    def every_step_is_an_edge(self) -> None:
        for here, there in zip(self.trace, self.trace[1:], strict=False):
            assert there in BEHAVIOR_TRANSITIONS[here]
        assert len(self.trace) == self.fsm.changes + 1

    @invariant()
    def arms_are_open_only_after_their_base(self) -> None:
        if self.fsm.manipulation is Manipulation.TELEOP:
            assert self.trace[-2] is Behavior(self.trace[-1].removesuffix("_manipulate"))


TestAnythingMayHappen = AnythingMayHappen.TestCase
TestAnythingMayHappen.settings = settings(examples(60), stateful_step_count=40)
