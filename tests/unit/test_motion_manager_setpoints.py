"""Joint set-points from outside: followed whole or refused whole, and nothing broken ever moves a joint."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bifrost import Received
from harness.examples import examples
from harness.places import ROBOTS
from tests.unit.test_motion_manager_limiter import Watch
from valor.common.arrays import FloatArray
from valor.common.behaviors import Attention, Behavior, Manipulation
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.handlers.handler import STALE, RejectionCounter
from valor.motion_manager.handlers.joint_setpoints import AHEAD, JointSetpointsHandler
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.upper_body import DWELL, SILENCE, UpperBody
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
N = len(ROBOT.joints)
PERIOD = round(1e9 * ROBOT.control_period)
ARM = ROBOT.tables.groups["right_arm"]
PATH = {
    Behavior.STAND: (Behavior.STAND_PREP, Behavior.STAND),
    Behavior.STAND_MANIPULATE: (Behavior.STAND_PREP, Behavior.STAND, Behavior.STAND_MANIPULATE),
    Behavior.SOFT_STOP: (Behavior.STAND_PREP, Behavior.STAND, Behavior.SOFT_STOP),
    Behavior.FALL: (Behavior.STAND_PREP, Behavior.STAND, Behavior.FALL),
    Behavior.FREEZE: (Behavior.FREEZE,),
    Behavior.STAND_PREP: (Behavior.STAND_PREP,),
    Behavior.IDLE: (),
}


class Bench:
    """The handler with all that is behind it, and robot time."""

    def __init__(self, behavior: Behavior) -> None:
        self.now = 10_000_000_000
        self.fsm = BehaviorFsm()
        self.reference = JointReference(ROBOT)
        self.reference.take_up(np.ones(N, dtype=bool), ROBOT.nominal_posture)
        self.upper_body = UpperBody(ROBOT, self.reference)
        self.rejections = RejectionCounter()
        components: Any = SimpleNamespace(
            robot=ROBOT, fsm=self.fsm, upper_body=self.upper_body, rejections=self.rejections,
            hand_goals=SimpleNamespace(moves=lambda side, now: False),
            authority=SimpleNamespace(since=5_000_000_000),
        )  # fmt: skip
        self.handler = JointSetpointsHandler(components)
        self.watch = Watch(ROBOT.nominal_posture)
        for step in PATH[behavior]:
            self.go(step)

    def go(self, behavior: Behavior) -> None:
        self.fsm.go(behavior, "test")
        self.upper_body.enter(self.fsm.manipulation, self.fsm.attention, self.now * 1e-9)

    def send(self, message: JointSetpoints) -> bool:
        return self.handler.handle(Received(message, 0, 1, "somebody"), self.now)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / ROBOT.control_period)):
            self.now += PERIOD
            self.upper_body.update(self.reference.position, self.now * 1e-9)
            self.reference.advance(self.now * 1e-9, ROBOT.control_period)
            self.watch.step(self.reference.position, self.reference.velocity)

    def message(self, names: list[str], position: object, velocity: object = None, age: float = 0.0) -> JointSetpoints:
        zeros = np.zeros(len(names))
        return JointSetpoints(
            time=self.now - round(age * 1e9), names=names, position=np.asarray(position, dtype=float),
            velocity=zeros if velocity is None else np.asarray(velocity, dtype=float), acceleration=zeros,
        )  # fmt: skip

    def refused(self, message: JointSetpoints) -> str:
        """Send a message that must be refused; returns the reason that is published."""
        before, count = self.reference.position, self.rejections.count(JOINT_SETPOINTS.name)
        assert not self.send(message) and self.rejections.count(JOINT_SETPOINTS.name) == count + 1
        (rejection,) = self.rejections.take()
        assert (rejection.topic, rejection.origin) == (JOINT_SETPOINTS.name, "somebody")
        assert "\n" not in rejection.reason
        self.run(0.1)
        assert np.array_equal(self.reference.position, before)
        return rejection.reason


@pytest.fixture
def manipulating() -> Bench:
    return Bench(Behavior.STAND_MANIPULATE)


@pytest.mark.parametrize("group", ["left_arm", "right_arm", "left_hand", "right_hand", "torso", "neck", "lidar"])
def test_every_group_that_is_open_in_stand_manipulate_moves_and_no_other(manipulating: Bench, group: str) -> None:
    names, places = ROBOT.tables.groups[group], ROBOT.group_indices(group)
    for _ in range(200):
        assert manipulating.send(manipulating.message(names, ROBOT.nominal_posture[places] + 0.05))
        manipulating.run(0.004)
    moved = manipulating.reference.position - ROBOT.nominal_posture
    assert np.allclose(moved[places], 0.05) and not np.delete(moved, places).any()


@pytest.mark.parametrize("behavior", PATH)
@pytest.mark.parametrize(("group", "machine"), [("right_arm", Manipulation), ("neck", Attention), ("left_leg", None)])
def test_joints_are_open_exactly_where_the_tables_say(behavior: Behavior, group: str, machine: type | None) -> None:
    bench = Bench(behavior)
    names = ROBOT.tables.groups[group]
    message = bench.message(names, ROBOT.nominal_posture[ROBOT.group_indices(group)] + 0.05)
    open_here = (machine is Manipulation and bench.fsm.manipulation is Manipulation.TELEOP) or (
        machine is Attention and bench.fsm.attention is Attention.LOOK
    )
    if open_here:
        assert bench.send(message)
    else:
        reason = bench.refused(message)
        assert repr(names[0]) in reason and behavior in reason


def test_a_message_with_one_closed_joint_is_refused_whole() -> None:
    bench = Bench(Behavior.STAND)
    reason = bench.refused(bench.message(["neck_yaw", "r_elbow_pitch"], [0.1, 0.9]))
    assert "joint 'r_elbow_pitch' is closed to set-points in behavior stand: manipulation is slave" in reason


BROKEN = {
    "unknown joint": (["r_elbow_pitch", "tail"], [0.1, 0.1], [0, 0], "unknown joint 'tail'"),
    "twice": (["r_elbow_pitch", "r_elbow_pitch"], [0.1, 0.1], [0, 0], "'r_elbow_pitch' is named twice"),
    "no joint": ([], [], [], "names no joint"),
    "short position": (ARM, [0.1] * 6, [0] * 7, "position has 6 numbers for 7 joints"),
    "long velocity": (ARM, [0.1] * 7, [0] * 8, "velocity has 8 numbers for 7 joints"),
    "nan": (ARM, [0.1] * 6 + [np.nan], [0] * 7, "position of joint 'r_wrist_yaw' is nan"),
    "infinite velocity": (ARM, [0.1] * 7, [np.inf] + [0] * 6, "velocity of joint 'r_shoulder_pitch' is inf"),
    "acceleration": (["neck_yaw"], [0.1], [0], "acceleration of joint 'neck_yaw' is nan"),
    "a very long name": (["x" * 100_000], [0.1], [0], "unknown joint 'xxx"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_message_is_refused_with_its_reason_and_moves_nothing(manipulating: Bench, what: str) -> None:
    names, position, velocity, expected = BROKEN[what]
    message = manipulating.message(names, position, velocity)
    message.acceleration = np.full(len(names), np.nan if what == "acceleration" else 0.0)
    reason = manipulating.refused(message)
    assert expected in reason and len(reason) < 300


def test_stale_messages_and_those_of_another_world_are_refused(manipulating: Bench) -> None:
    assert manipulating.send(manipulating.message(["neck_yaw"], [0.0], age=STALE - 0.01))
    assert "stale" in manipulating.refused(manipulating.message(["neck_yaw"], [0.1], age=STALE + 0.01))
    assert "ahead" in manipulating.refused(manipulating.message(["neck_yaw"], [0.1], age=-AHEAD - 0.01))
    manipulating.now = 5_100_000_000  # taken over at 5 s
    manipulating.watch = Watch(manipulating.reference.position)
    assert "took the robot over" in manipulating.refused(manipulating.message(["neck_yaw"], [0.1], age=0.15))


def test_set_points_beyond_the_limits_are_brought_within_them(manipulating: Bench) -> None:
    places = ROBOT.group_indices("right_arm")
    for _ in range(1500):
        assert manipulating.send(manipulating.message(ARM, [1e300] * 7, [1e6] * 7))
        manipulating.run(0.004)
    assert np.allclose(manipulating.reference.position[places], ROBOT.upper[places])


def test_arms_hold_when_set_points_fall_silent(manipulating: Bench) -> None:
    places = ROBOT.group_indices("right_arm")
    for _ in range(50):
        assert manipulating.send(manipulating.message(ARM, ROBOT.nominal_posture[places] - 1.0))
        manipulating.run(0.004)
    assert np.abs(manipulating.reference.velocity[places]).min() > 0.1
    manipulating.run(SILENCE + 0.3)
    held = manipulating.reference.position.copy()
    assert not manipulating.reference.velocity.any()
    assert not np.allclose(held[places], np.clip(ROBOT.nominal_posture - 1.0, ROBOT.lower, ROBOT.upper)[places])
    manipulating.run(0.5)
    assert np.array_equal(manipulating.reference.position, held)


def displaced() -> tuple[Bench, FloatArray]:
    bench = Bench(Behavior.STAND_MANIPULATE)
    places = ROBOT.group_indices("right_arm")
    for _ in range(300):
        bench.send(bench.message(ARM, ROBOT.nominal_posture[places] - 0.4))
        bench.run(0.004)
    return bench, bench.reference.position.copy()


def test_leaving_manipulate_the_arms_wait_and_then_go_home_slowly() -> None:
    bench, away = displaced()
    bench.go(Behavior.STAND)
    bench.run(DWELL - 0.01)
    assert np.array_equal(bench.reference.position, away)
    fastest = 0.0
    for _ in range(2000):
        bench.run(0.002)
        fastest = max(fastest, float(np.abs(bench.reference.velocity).max()))
    assert np.allclose(bench.reference.position, ROBOT.nominal_posture)
    assert 0.2 < fastest < 0.65


def test_the_two_commands_of_a_mode_change_leave_the_arms_where_they_are() -> None:
    bench, away = displaced()
    bench.go(Behavior.STAND)
    bench.run(0.5 * DWELL)
    bench.go(Behavior.STAND_MANIPULATE)
    bench.run(2.0)
    assert np.array_equal(bench.reference.position, away)


def test_soft_stop_holds_arms_that_are_on_their_way() -> None:
    bench, _ = displaced()
    bench.go(Behavior.STAND)
    bench.run(1.0)
    assert bench.reference.velocity.any()
    bench.go(Behavior.SOFT_STOP)
    bench.run(0.5)
    held = bench.reference.position.copy()
    bench.run(1.0)
    assert np.array_equal(bench.reference.position, held) and not np.allclose(held, ROBOT.nominal_posture)


def test_the_same_refusal_is_counted_always_and_published_seldom(manipulating: Bench) -> None:
    for _ in range(1000):
        assert not manipulating.send(manipulating.message(["tail"], [0.1]))
    assert manipulating.rejections.count(JOINT_SETPOINTS.name) == 1000
    published = manipulating.rejections.take()
    assert 1 <= len(published) <= 10 and published[0].count == 1


numbers = st.one_of(st.floats(), st.floats(-4, 4), st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e154, 0.0]))
names = st.one_of(st.sampled_from([*ROBOT.joints]), st.text(max_size=5))


@examples(60)
@given(
    st.lists(
        st.tuples(
            st.lists(names, max_size=12), st.lists(numbers, max_size=12), st.lists(numbers, max_size=12),
            st.booleans(), st.integers(-(2**40), 2**40), st.integers(0, 20),
        ),
        max_size=6,
    )
)  # fmt: skip
def test_no_broken_message_makes_a_jump(
    messages: list[tuple[list[str], list[float], list[float], bool, int, int]],
) -> None:
    bench = Bench(Behavior.STAND_MANIPULATE)
    for joints, position, velocity, fit, time, periods in messages:
        p, v = (np.resize(np.array(x or [0.0]), len(joints)) if fit else np.array(x) for x in (position, velocity))
        bench.send(JointSetpoints(bench.now if fit else time, joints, p, v, np.array(v)))
        bench.run(periods * ROBOT.control_period)
    legs = np.concatenate((ROBOT.group_indices("left_leg"), ROBOT.group_indices("right_leg")))
    assert np.array_equal(bench.reference.position[legs], ROBOT.nominal_posture[legs])
