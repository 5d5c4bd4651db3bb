"""How a plan and a hand fare: from the robot's topics over the link to the operator's, each change once."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from valor_msgs.msg import HandGoalStatus

from harness.link_pair import Pair
from harness.places import ROBOTS
from harness.waiting import wait_until
from tests.unit.link.test_packed_steps import walk
from valor.link.emulator import Conditions
from valor.link.fields import Layout
from valor.link.state import RobotState
from valor.link_operator.progress import Progress
from valor.link_robot.obedience import Obedience
from valor.link_robot.observer import KEPT, Observer
from valor.link_robot.reporter import Reporter
from valor.robot.description import RobotDescription
from valor.ros import packed_steps
from valor.ros.progress import FEEDBACK, GOAL_STATUS, FeedbackMessage, pack_feedback
from valor.ros.relayed import Word, read
from valor.valorctl.ros_domain import reserve

ROBOT = RobotDescription.load(ROBOTS / "escher")
LATCHED = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def nodes() -> Iterator[tuple[Any, Any]]:
    """One in the robot's domain, which nobody spins, and one in the operator's."""
    with reserve("link_reporter_robot") as ours, reserve("link_reporter_operator", {ours.domain}) as theirs:
        made = []
        for domain in (ours.domain, theirs.domain):
            context = rclpy.Context()
            rclpy.init(context=context, domain_id=domain)
            made.append((rclpy.create_node("link_reporter", context=context), context))
        yield made[0][0], made[1][0]
        for node, context in made:
            node.destroy_node()
            context.try_shutdown()


def test_what_changes_is_told_once_and_comes_as_it_was(nodes: tuple[Any, Any]) -> None:
    ours, theirs = nodes
    layout = Layout(ROBOT)
    still = RobotState(joints=np.zeros(layout.joints.stop - layout.joints.start))
    link = Pair(layout, lambda: still, Conditions(bandwidth=9600.0, delay=0.1))
    observer = Observer(ours, ROBOT)
    reporter = Reporter(link.robot, observer, Obedience(ours, link.robot, ROBOT))
    progress = Progress(theirs, "odom", lambda number, feedback: None)
    plans = ours.create_publisher(FeedbackMessage, FEEDBACK, LATCHED)
    hands = ours.create_publisher(HandGoalStatus, GOAL_STATUS.format("r_hand"), LATCHED)
    heard: dict[str, list[Any]] = {"plans": [], "hands": []}
    theirs.create_subscription(FeedbackMessage, FEEDBACK, heard["plans"].append, LATCHED)
    theirs.create_subscription(HandGoalStatus, GOAL_STATUS.format("r_hand"), heard["hands"].append, LATCHED)
    sent = FeedbackMessage()
    sent.feedback.header.frame_id = sent.feedback.feedback.header.frame_id = "odom"
    sent.feedback.feedback.steps, sent.feedback.currently_executing_step_index = walk(6), 2
    status = HandGoalStatus(hand=1, state="out_of_reach", reason="too far", position_error=0.25)
    plans.publish(sent)
    hands.publish(status)
    words: list[Word] = []
    chance = random.Random(1)

    def turn() -> bool:
        observer.look()
        serialize_message(String(data="ÿ" * chance.randrange(400)))  # leaves its bytes in memory
        reporter.tell(link.robot_time)
        link.run(0.2)
        for content in link.answers:
            word, number, body = read(content)
            words.append(word)
            if word is Word.STEPS:
                progress.steps(body)
            elif word is Word.PROGRESS:
                progress.plan(number, body)
            else:
                progress.hand(number, body)
        link.answers.clear()
        executor.spin_once(timeout_sec=0.01)
        return False

    executor = SingleThreadedExecutor(context=theirs.context)
    executor.add_node(theirs)

    def steps() -> bool:
        return bool(heard["plans"] and heard["plans"][-1].feedback.feedback.steps)

    wait_until(lambda: turn() or (steps() and heard["hands"]), 60.0, "both to be told")
    came = heard["plans"][-1].feedback
    assert came.currently_executing_step_index == 2
    assert [step.step_index for step in came.feedback.steps] == [0, 1, 2, 3, 4, 5]
    assert heard["hands"][-1] == status
    for _ in range(60):
        turn()
    assert sorted(words) == [Word.STEPS, Word.PROGRESS, Word.HAND], "what has not changed is not told again"
    sent.feedback.currently_executing_step_index = 3
    plans.publish(sent)
    before = len(heard["plans"])
    wait_until(lambda: turn() or len(heard["plans"]) > before, 60.0, "the next step to be told")
    assert heard["plans"][-1].feedback.feedback.steps == came.feedback.steps
    assert words.count(Word.STEPS) == 1, "steps that have not changed travel once"
    late = Progress(theirs, "odom", lambda number, feedback: None)
    packed = packed_steps.pack(sent.feedback.feedback.steps)
    assert packed is not None
    before = len(heard["plans"])
    late.plan(0, pack_feedback(sent, packed))
    late.steps(packed)
    wait_until(lambda: turn() or len(heard["plans"]) >= before + 2, 60.0, "steps that come behind their progress")
    assert heard["plans"][-1].feedback.feedback.steps == came.feedback.steps
    reporter.begin()
    wait_until(lambda: turn() or words.count(Word.STEPS) == 2, 60.0, "another session to be told all")
    executor.shutdown()


def test_joints_and_base_of_a_state_are_of_one_moment(nodes: tuple[Any, Any]) -> None:
    ours, _ = nodes
    observer = Observer(ours, ROBOT)
    joints = ours.create_publisher(JointState, "joint_states", 10)
    base = ours.create_publisher(Odometry, "odom", 10)
    wait_until(lambda: joints.get_subscription_count() and base.get_subscription_count(), 60.0, "the observer")

    def publish(moment: int, *, with_base: bool) -> None:
        message = JointState(name=list(ROBOT.joints), position=[0.1 * moment] * len(ROBOT.joints))
        message.header.stamp.sec = moment
        joints.publish(message)
        if with_base:
            odometry = Odometry(header=message.header)
            odometry.pose.pose.position.x = float(moment)
            base.publish(odometry)

    def newest() -> tuple[float, float, float] | None:
        state = observer.state()
        return None if state is None else (state.stamp / 1e3, float(state.joints[0]), float(state.base_position[0]))

    assert newest() is None
    for moment in range(1, 5):
        publish(moment, with_base=moment == 2)
    wait_until(lambda: newest() == (2.0, pytest.approx(0.2), 2.0), 60.0, "the joints of the base's moment")
    for moment in range(5, 5 + KEPT):
        publish(moment, with_base=False)
    last = 4.0 + KEPT
    wait_until(lambda: newest() == (last, pytest.approx(0.1 * last), 2.0), 60.0, "joints that no base goes with")
