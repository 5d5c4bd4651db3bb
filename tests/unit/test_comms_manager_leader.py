"""Who leads a robot whose Motion Manager fell silent, and that it can be stopped meanwhile."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from harness.still_robot import ROBOT, Robot
from valor.common.behaviors import REFLEX, Behavior, Reaction
from valor.common.messages import BehaviorReply, BehaviorRequest, Motor
from valor.comms_manager.latch import BehaviorLatch
from valor.comms_manager.leader import FALL, FREEZE, SOFT_STOP, Leader, drives
from valor.whole_body.reflex import BalanceReflex

STOPS = (FALL, FREEZE, SOFT_STOP)
LIFTED: dict[str, Any] = {"left_foot_wrench": np.zeros(6)}
SOON = round(0.1 / ROBOT.control_period)  # periods


class Bench(Robot):
    """A robot that stands, its Motion Manager, and what stands between that one and the devices."""

    def __init__(self, leader: Leader) -> None:
        super().__init__()
        self.leader = leader

    def live(
        self, periods: int = 1, *, led: bool = False, demand: Reaction = Reaction.KEEP_BALANCE, **changes: Any
    ) -> Motor:
        """Periods with or without its Motion Manager; returns the Motor in force."""
        for _ in range(periods):
            motor = self.tick(motor_behavior=self.leader.behavior, **changes)
            self.leader.measured(self.proprioceptor(**changes))
            if led and self.leader.hears(motor):
                self.leader.follow(motor, "motion_manager")
            self.leader.answer(demand)
        assert self.leader.motor is not None
        return self.leader.motor

    def left_in(self, behavior: Behavior) -> None:
        """Its Motion Manager led it, and fell silent."""
        for step in (Behavior.STAND, behavior):
            self.live(500, led=True)
            assert not self.ask(step)
        self.live(2, led=True)
        assert self.leader.behavior == behavior
        self.leader.abandon("a test wants it so")

    def proposal(self, behavior: str) -> Motor:
        """A Motor that somebody could send."""
        assert self.motor is not None
        return msgspec.structs.replace(self.motor, behavior=behavior)

    def order(self, behavior: str) -> BehaviorReply:
        return self.leader.stop(BehaviorRequest(behavior), "somebody")


@pytest.fixture(scope="module")
def reflex() -> BalanceReflex:
    return BalanceReflex(ROBOT)


@pytest.fixture
def latch(tmp_path: Path) -> Iterator[BehaviorLatch]:
    latch = BehaviorLatch(tmp_path / "behavior.json", 1)
    yield latch
    latch.close()


@pytest.fixture
def bench(reflex: BalanceReflex, latch: BehaviorLatch) -> Bench:
    return Bench(Leader(reflex, latch))


@pytest.fixture
def walking(bench: Bench) -> Bench:
    """The reflex leads it, a foot in the air."""
    bench.left_in(Behavior.WALK)
    assert bench.leader.balancing
    assert bench.live(**LIFTED).behavior == REFLEX
    return bench


@pytest.fixture
def held(bench: Bench) -> Bench:
    """Its joints are held."""
    bench.left_in(Behavior.STAND)
    assert bench.leader.silent and not bench.leader.limp
    return bench


def test_nobody_is_obeyed_beside_a_motion_manager(bench: Bench) -> None:
    assert "nobody has led the robot yet" in bench.order(FREEZE).reason
    bench.live(10, led=True)
    for behavior in STOPS:
        assert "a Motion Manager leads the robot" in bench.order(behavior).reason
    assert bench.live(led=True).behavior == Behavior.STAND_PREP


@pytest.mark.parametrize("behavior", ["stand", "walk", ""])
def test_nothing_but_stops_is_obeyed(held: Bench, behavior: str) -> None:
    reply = held.order(behavior)
    assert not reply.accepted
    assert "expected one of soft_stop, freeze, fall" in reply.reason


@pytest.mark.parametrize("state", ["walking", "held"])
def test_fall_is_obeyed_at_once(state: str, request: pytest.FixtureRequest) -> None:
    bench: Bench = request.getfixturevalue(state)
    reply = bench.order(FALL)
    assert (reply.accepted, reply.behavior) == (True, FALL)
    leader = bench.leader
    assert leader.silent and leader.limp
    assert leader.motor is not None and not drives(leader.motor)
    admitted = leader.admitted
    bench.live(10)
    assert bench.order(FALL).accepted
    assert (leader.admitted, leader.behavior) == (admitted, FALL), "once is enough"


def test_fall_is_obeyed_of_a_robot_that_nobody_has_led_yet(bench: Bench) -> None:
    bench.leader.measured(bench.proprioceptor())
    assert bench.order(FALL).accepted
    assert bench.leader.silent and bench.leader.limp


def test_fall_is_obeyed_whatever_the_encoders_say(walking: Bench) -> None:
    walking.leader.measured(walking.proprioceptor(joint_position=np.full(len(ROBOT.joints), np.nan)))
    assert walking.order(FALL).accepted
    motor = walking.leader.motor
    assert motor is not None and not drives(motor)
    walking.check(motor)


def test_soft_stop_is_what_the_reflex_does(walking: Bench) -> None:
    reply = walking.order(SOFT_STOP)
    assert (reply.accepted, reply.behavior) == (True, REFLEX)
    assert walking.live().behavior == REFLEX
    walking.live(2600)
    assert walking.leader.silent and not walking.leader.limp


@pytest.mark.parametrize("order", [FALL, FREEZE])
def test_until_it_is_taken_on_no_other_motor_is_heard(held: Bench, order: str) -> None:
    assert held.order(order).accepted
    heard = {each for each in Behavior if held.leader.hears(held.proposal(each))}
    assert heard == {order, FALL}


def test_beside_the_reflex_only_stops_are_heard(walking: Bench) -> None:
    assert {each for each in Behavior if walking.leader.hears(walking.proposal(each))} == {FREEZE, FALL}


def test_freeze_waits_for_both_feet_and_for_nothing_else(walking: Bench, caplog: pytest.LogCaptureFixture) -> None:
    walking.live(10, **LIFTED)
    assert walking.order(FREEZE).accepted
    walking.live(10, **LIFTED)
    assert walking.leader.balancing
    lasts = 0
    while walking.leader.balancing:
        walking.live()
        lasts += 1
    assert "held, as is demanded" in caplog.text
    assert walking.leader.behavior == FREEZE
    assert walking.leader.silent and not walking.leader.limp


@pytest.mark.parametrize("behavior", [FREEZE, SOFT_STOP])
def test_joints_that_are_held_are_frozen(held: Bench, behavior: str) -> None:
    reply = held.order(behavior)
    assert (reply.accepted, reply.behavior) == (True, FREEZE)
    assert held.leader.silent and not held.leader.limp


def test_a_limp_robot_is_locked_by_freeze_alone(held: Bench) -> None:
    held.order(FALL)
    assert "the robot is limp" in held.order(SOFT_STOP).reason
    assert held.leader.limp
    assert held.order(FREEZE).accepted
    assert held.leader.silent and not held.leader.limp


@pytest.mark.parametrize("order", [FALL, FREEZE])
@pytest.mark.parametrize("left", [Behavior.WALK, Behavior.STAND, Behavior.FREEZE])
def test_a_motion_manager_that_was_silent_for_a_moment_follows(bench: Bench, order: str, left: Behavior) -> None:
    """It has seen no gap, and does not know; what it says until it does is not obeyed."""
    bench.left_in(left)
    was = bench.leader.motor
    assert bench.order(order).accepted
    seen = {bench.live(led=True).behavior for _ in range(2 * SOON)}
    while bench.leader.balancing:
        bench.live(led=True)
    bench.live(2 * SOON, led=True)
    assert bench.leader.motor is not was
    assert (bench.behavior, bench.leader.behavior) == (order, order)
    assert not bench.leader.silent
    assert seen <= {order, REFLEX, str(left)}
    assert not bench.ask(Behavior.FREEZE if order == FALL else Behavior.STAND_PREP), "and obeys commands again"
    bench.live(2 * SOON, led=True)
    assert bench.leader.behavior == (FREEZE if order == FALL else "stand_prep")


@pytest.mark.parametrize("order", [FALL, FREEZE])
def test_a_new_motion_manager_begins_as_was_ordered(held: Bench, order: str) -> None:
    held.order(order)
    time.sleep(1e-6)  # it began later
    another = Bench(held.leader)
    another.time, another.sequence = held.time, held.sequence
    another.live(10, led=True)
    assert another.behavior == order
    assert not held.leader.silent


def test_a_motion_manager_beside_the_reflex_has_its_stops_obeyed(walking: Bench) -> None:
    walking.live(10, led=True, **LIFTED)
    assert walking.manager.custody.aside
    assert walking.behavior is Behavior.SOFT_STOP
    assert not walking.ask(Behavior.SOFT_STOP)
    assert "brings the robot to stand" in walking.ask(Behavior.STAND)
    assert not walking.ask(Behavior.FREEZE)
    walking.live(10, led=True, **LIFTED)
    assert walking.leader.balancing, "on one foot it would fall"
    while walking.leader.balancing:
        walking.live(led=True)
    walking.live(10, led=True)
    assert (walking.behavior, walking.leader.behavior) == (FREEZE, FREEZE)


def test_a_motion_manager_beside_the_reflex_lets_the_robot_go(walking: Bench) -> None:
    walking.live(10, led=True, **LIFTED)
    assert not walking.ask(Behavior.FALL)
    motor = walking.live(led=True, **LIFTED)
    assert motor.behavior == FALL
    assert not drives(motor)
    assert not walking.leader.balancing and not walking.leader.silent


def test_a_robot_that_the_devices_let_go_stays_so_when_its_motion_manager_is_back(walking: Bench) -> None:
    walking.live(10, led=True)
    walking.live(demand=Reaction.LIMP)
    assert walking.leader.limp
    walking.live(10, led=True)
    assert walking.behavior is Behavior.FALL
