"""Who leads a robot whose Motion Manager fell silent, and that it can be stopped meanwhile."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from harness.still_robot import ROBOT, Robot
from valor.common.behaviors import REFLEX, Behavior, Reaction
from valor.common.messages import BehaviorReply, BehaviorRequest, JointMode, Motor
from valor.comms_manager.command_arbiter import FALL, FREEZE, SOFT_STOP, BehaviorLatch, CommandArbiter, drives
from valor.whole_body.reflex import BalanceReflex

STOPS = (FALL, FREEZE, SOFT_STOP)
LIFTED: dict[str, Any] = {"left_foot_wrench": np.zeros(6)}
SOON = round(0.1 / ROBOT.control_period)  # periods


class Bench(Robot):
    """A robot that stands, its Motion Manager, and what stands between that one and the devices."""

    def __init__(self, arbiter: CommandArbiter) -> None:
        super().__init__()
        self.arbiter = arbiter

    def live(
        self, periods: int = 1, *, led: bool = False, demand: Reaction = Reaction.KEEP_BALANCE, **changes: Any
    ) -> Motor:
        """Periods with or without its Motion Manager; returns the Motor in force."""
        for _ in range(periods):
            motor = self.tick(motor_behavior=self.arbiter.behavior, **changes)
            self.arbiter.measured(self.proprioceptor(**changes))
            if led and self.arbiter.accepts(motor):
                self.arbiter.follow(motor, "motion_manager")
            self.arbiter.answer(demand)
        assert self.arbiter.motor is not None
        return self.arbiter.motor

    def left_in(self, behavior: Behavior) -> None:
        for step in (Behavior.STAND, behavior):
            self.live(500, led=True)
            assert not self.ask(step)
        self.live(2, led=True)
        assert self.arbiter.behavior == behavior
        self.arbiter.abandon("a test wants it so")

    def proposal(self, behavior: str) -> Motor:
        assert self.motor is not None
        return msgspec.structs.replace(self.motor, behavior=behavior)

    def order(self, behavior: str) -> BehaviorReply:
        return self.arbiter.stop(BehaviorRequest(behavior), "somebody")


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
    return Bench(CommandArbiter(reflex, latch))


@pytest.fixture
def walking(bench: Bench) -> Bench:
    """The reflex leads it, a foot in the air."""
    bench.left_in(Behavior.WALK)
    assert bench.arbiter.balancing and bench.live(**LIFTED).behavior == REFLEX
    return bench


@pytest.fixture
def held(bench: Bench) -> Bench:
    bench.left_in(Behavior.STAND)
    assert bench.arbiter.silent and not bench.arbiter.limp
    return bench


def test_no_stop_is_executed_while_a_motion_manager_controls(bench: Bench) -> None:
    assert "no Motion Manager has controlled the robot yet" in bench.order(FREEZE).reason
    bench.live(10, led=True)
    for behavior in STOPS:
        assert "a Motion Manager controls the robot" in bench.order(behavior).reason
    assert bench.live(led=True).behavior == Behavior.STAND_PREP


def test_fall_is_executed_before_any_motor(bench: Bench) -> None:
    bench.arbiter.measured(bench.proprioceptor())
    assert bench.order(FALL).accepted and bench.arbiter.silent and bench.arbiter.limp


@pytest.mark.parametrize("behavior", ["stand", "walk", ""])
def test_nothing_but_stops_is_executed(held: Bench, behavior: str) -> None:
    reply = held.order(behavior)
    assert not reply.accepted and "expected one of soft_stop, freeze, fall" in reply.reason


def test_single_limbs_are_not_frozen(held: Bench) -> None:
    reply = held.arbiter.stop(BehaviorRequest(FREEZE, ["left_arm"]), "somebody")
    assert not reply.accepted and "limbs are frozen by a Motion Manager only" in reply.reason


@pytest.mark.parametrize("state", ["walking", "held"])
def test_fall_is_executed_at_once(state: str, request: pytest.FixtureRequest) -> None:
    bench: Bench = request.getfixturevalue(state)
    reply = bench.order(FALL)
    assert (reply.accepted, reply.behavior) == (True, FALL)
    arbiter = bench.arbiter
    assert arbiter.silent and arbiter.limp and arbiter.motor is not None and not drives(arbiter.motor)
    admitted = arbiter.admitted
    bench.live(10)
    assert bench.order(FALL).accepted
    assert (arbiter.admitted, arbiter.behavior) == (admitted, FALL), "once is enough"


def test_a_robot_that_is_abandoned_in_a_landing_is_limp(bench: Bench) -> None:
    bench.live(10, led=True)
    assert drives(landing := bench.proposal(FALL)) and bench.arbiter.follow(landing, "motion_manager")
    bench.arbiter.abandon("a test wants it so")
    assert bench.arbiter.silent and bench.arbiter.limp and bench.arbiter.behavior == FALL


def test_fall_is_executed_whatever_the_encoders_say(walking: Bench) -> None:
    walking.arbiter.measured(walking.proprioceptor(joint_position=np.full(len(ROBOT.joints), np.nan)))
    assert walking.order(FALL).accepted
    motor = walking.arbiter.motor
    assert motor is not None and not drives(motor)
    walking.check(motor)


@pytest.mark.parametrize("order", [FALL, FREEZE])
def test_until_it_is_taken_on_no_other_motor_is_received(held: Bench, order: str) -> None:
    assert held.order(order).accepted
    received = {each for each in Behavior if held.arbiter.accepts(held.proposal(each))}
    assert received == {order, FALL}


def test_beside_the_reflex_only_stops_are_received(walking: Bench) -> None:
    assert {each for each in Behavior if walking.arbiter.accepts(walking.proposal(each))} == {FREEZE, FALL}


def test_freeze_waits_for_both_feet_and_for_nothing_else(walking: Bench, caplog: pytest.LogCaptureFixture) -> None:
    walking.live(10, **LIFTED)
    assert walking.order(FREEZE).accepted
    walking.live(10, **LIFTED)
    assert walking.arbiter.balancing
    lasts = 0
    while walking.arbiter.balancing:
        walking.live()
        lasts += 1
    assert "held, as is demanded" in caplog.text
    assert walking.arbiter.behavior == FREEZE and walking.arbiter.silent and not walking.arbiter.limp


@pytest.mark.parametrize("behavior", [FREEZE, SOFT_STOP])
def test_joints_that_are_held_are_frozen(held: Bench, behavior: str) -> None:
    reply = held.order(behavior)
    assert (reply.accepted, reply.behavior) == (True, FREEZE)
    assert held.arbiter.silent and not held.arbiter.limp


def test_a_limp_robot_is_locked_by_freeze_alone(held: Bench) -> None:
    held.order(FALL)
    assert "the robot is limp" in held.order(SOFT_STOP).reason and held.arbiter.limp
    assert held.order(FREEZE).accepted and held.arbiter.silent and not held.arbiter.limp


@pytest.mark.parametrize("order", [FALL, FREEZE])
@pytest.mark.parametrize("left", [Behavior.WALK, Behavior.STAND, Behavior.FREEZE])
def test_a_motion_manager_that_was_silent_for_a_moment_follows(bench: Bench, order: str, left: Behavior) -> None:
    """It has seen no gap, and does not know; what it reports until it does is not obeyed."""
    bench.left_in(left)
    was = bench.arbiter.motor
    assert bench.order(order).accepted
    seen = {bench.live(led=True).behavior for _ in range(2 * SOON)}
    while bench.arbiter.balancing:
        bench.live(led=True)
    bench.live(2 * SOON, led=True)
    assert bench.arbiter.motor is not was and (bench.behavior, bench.arbiter.behavior) == (order, order)
    assert not bench.arbiter.silent
    assert seen <= {order, REFLEX, str(left)}
    assert not bench.ask(Behavior.FREEZE if order == FALL else Behavior.STAND_PREP), "and obeys commands again"
    bench.live(2 * SOON, led=True)
    assert bench.arbiter.behavior == (FREEZE if order == FALL else "stand_prep")


@pytest.mark.parametrize("order", [FALL, FREEZE])
def test_a_new_motion_manager_begins_as_was_ordered(held: Bench, order: str) -> None:
    held.order(order)
    time.sleep(1e-6)  # it began later
    another = Bench(held.arbiter)
    another.time, another.sequence = held.time, held.sequence
    another.live(10, led=True)
    assert another.behavior == order
    assert not held.arbiter.silent


def test_a_motion_manager_beside_the_reflex_has_its_stops_executed(walking: Bench) -> None:
    walking.live(10, led=True, **LIFTED)
    assert walking.manager.authority.yielding and walking.behavior is Behavior.SOFT_STOP
    assert not walking.ask(Behavior.SOFT_STOP)
    assert "bringing the robot to stand" in walking.ask(Behavior.STAND) and not walking.ask(Behavior.FREEZE)
    walking.live(10, led=True, **LIFTED)
    assert walking.arbiter.balancing, "on one foot it would fall"
    while walking.arbiter.balancing:
        walking.live(led=True)
    walking.live(10, led=True)
    assert (walking.behavior, walking.arbiter.behavior) == (FREEZE, FREEZE)


def test_a_motion_manager_beside_the_reflex_lets_the_robot_go(walking: Bench) -> None:
    walking.live(10, led=True, **LIFTED)
    assert not walking.ask(Behavior.FALL)
    motor = walking.live(led=True, **LIFTED)
    assert motor.behavior == FALL and not drives(motor)
    assert not walking.arbiter.balancing and not walking.arbiter.silent


def test_a_robot_that_the_devices_let_go_stays_so_when_its_motion_manager_is_back(walking: Bench) -> None:
    walking.live(10, led=True)
    walking.live(demand=Reaction.LIMP)
    assert walking.arbiter.limp
    walking.live(10, led=True)
    assert walking.behavior is Behavior.FALL


EPOCH = 123
N = 4


def test_the_behavior_outlives_the_process(tmp_path: Path) -> None:
    file = tmp_path / "behavior.json"
    latch = BehaviorLatch(file, EPOCH)
    assert latch.behavior == ""
    for behavior in ("stand_prep", "stand", "stand", "freeze"):
        latch.update(behavior)
    assert latch.behavior == "freeze"
    latch.close()
    assert BehaviorLatch(file, EPOCH).behavior == "freeze"
    assert BehaviorLatch(file, EPOCH + 1).behavior == "", "another start of the instance"


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"epoch": 123}', "null", "\x00\xff"])
def test_a_file_that_states_nothing_is_none(tmp_path: Path, text: str) -> None:
    file = tmp_path / "behavior.json"
    file.write_bytes(text.encode("latin-1"))
    assert BehaviorLatch(file, EPOCH).behavior == ""


def test_a_disk_that_takes_nothing_is_logged_and_the_robot_continues(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    latch = BehaviorLatch(tmp_path / "nowhere" / "behavior.json", EPOCH)
    latch.update("stand")
    latch.close()
    assert latch.behavior == "stand"
    assert "the behavior stand is lost at a restart" in caplog.text


def one_joint(mode: JointMode, effort: float = 0.0, stiffness: float = 0.0) -> Motor:
    modes = np.full(N, JointMode.OFF, dtype=np.uint8)
    modes[1] = mode
    efforts, stiffnesses = np.full(N, 0.0), np.full(N, 0.0)
    efforts[1], stiffnesses[1] = effort, stiffness
    return Motor(0, 1, 1, modes, np.ones(N), np.zeros(N), efforts, stiffnesses, np.ones(N), "fall", 1)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (one_joint(JointMode.OFF, effort=5.0, stiffness=5.0), False),
        (one_joint(JointMode.FORCE), False),
        (one_joint(JointMode.FORCE, stiffness=5.0), False),
        (one_joint(JointMode.FORCE, effort=-0.1), True),
        (one_joint(JointMode.IMPEDANCE), False),
        (one_joint(JointMode.IMPEDANCE, stiffness=0.1), True),
        (one_joint(JointMode.IMPEDANCE, effort=0.1), True),
        (one_joint(JointMode.POSITION), True),
    ],
)
def test_a_motor_is_limp_when_nothing_in_it_can_move_a_joint_at_rest(said: Motor, expected: bool) -> None:
    assert drives(said) is expected
