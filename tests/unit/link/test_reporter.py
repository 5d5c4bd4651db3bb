"""How a plan and a hand fare: from the robot's topics over the link to the operator's, each change once."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
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
from valor_msgs.msg import ControllerStatus, HandGoalStatus

from harness.emulated_channel import Conditions
from harness.link_pair import Pair
from harness.places import ROBOTS
from harness.waiting import some, wait_until
from tests.unit.link.test_packed_steps import walk
from valor.link.fields import Layout
from valor.link.state import RobotState
from valor.link_operator.republisher import Progress
from valor.link_robot.command_executor import CommandExecutor, Reporter
from valor.link_robot.observer import JOINT_MESSAGES, Observer
from valor.robot.description import RobotDescription
from valor.ros import packed_steps
from valor.ros.controllers import STATUS
from valor.ros.link_messages import LinkMessageType, MessageCodec, unpack_message
from valor.ros.progress import FEEDBACK, GOAL_STATUS, FeedbackMessage, pack_feedback
from valor.valorctl.instance.ros_domain import reserve

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


class Relay:
    """The reporter of a robot, the link, and what is published on the operator's side."""

    def __init__(self, ours: Any, theirs: Any) -> None:
        layout = Layout(ROBOT)
        still = RobotState(joints=np.zeros(layout.joints.stop - layout.joints.start))
        self.link = Pair(layout, lambda: still, Conditions(bandwidth=9600.0, delay=0.1))
        self.observer = Observer(ours, ROBOT)
        self.reporter = Reporter(self.link.robot, self.observer, CommandExecutor(ours, self.link.robot, ROBOT))
        self.progress = Progress(theirs, "odom", lambda number, feedback: None)
        self.plans: list[Any] = []
        self.hands: list[Any] = []
        self.controllers: list[Any] = []
        self.words: list[LinkMessageType] = []
        theirs.create_subscription(FeedbackMessage, FEEDBACK, self.plans.append, LATCHED)
        theirs.create_subscription(HandGoalStatus, GOAL_STATUS.format("r_hand"), self.hands.append, LATCHED)
        self._chance = random.Random(1)
        self.executor = SingleThreadedExecutor(context=theirs.context)
        self.executor.add_node(theirs)

    def turn(self) -> bool:
        """Run both sides for 0.2 s of the link; returns false."""
        self.observer.take()
        serialize_message(String(data="ÿ" * self._chance.randrange(400)))  # leaves its bytes in memory
        self.reporter.turn(self.link.robot_time)
        self.link.run(0.2)
        for content in self.link.answers:
            word, number, body = unpack_message(content)
            self.words.append(word)
            if word is LinkMessageType.STEPS:
                self.progress.steps(body)
            elif word is LinkMessageType.PROGRESS:
                self.progress.plan(number, body)
            elif word is LinkMessageType.CONTROLLERS:
                self.controllers.append(MessageCodec(ROBOT).unpack(body, ControllerStatus))
            else:
                self.progress.hand(number, body)
        self.link.answers.clear()
        self.executor.spin_once(timeout_sec=0.01)
        return False

    def wait(self, condition: Callable[[], object], what: str) -> None:
        wait_until(lambda: self.turn() or condition(), 60.0, what)


def test_what_changes_is_reported_once_and_arrives_unchanged(nodes: tuple[Any, Any]) -> None:
    ours, theirs = nodes
    relay = Relay(ours, theirs)
    plans = ours.create_publisher(FeedbackMessage, FEEDBACK, LATCHED)
    hands = ours.create_publisher(HandGoalStatus, GOAL_STATUS.format("r_hand"), LATCHED)
    sent = FeedbackMessage()
    sent.feedback.header.frame_id = sent.feedback.feedback.header.frame_id = "odom"
    sent.feedback.feedback.steps, sent.feedback.currently_executing_step_index = walk(6), 2
    status = HandGoalStatus(hand=1, state="out_of_reach", reason="too far", position_error=0.25)
    plans.publish(sent)
    hands.publish(status)
    controllers = ControllerStatus(active="statue", reason="statue after whole_body", stand=["statue"], walk=["statue"])
    ours.create_publisher(ControllerStatus, STATUS, LATCHED).publish(controllers)
    relay.wait(
        lambda: relay.controllers and relay.hands and relay.plans and relay.plans[-1].feedback.feedback.steps,
        "all are reported",
    )
    came = relay.plans[-1].feedback
    assert came.currently_executing_step_index == 2
    assert [step.step_index for step in came.feedback.steps] == [0, 1, 2, 3, 4, 5]
    assert relay.hands[-1] == status and relay.controllers == [controllers]
    for _ in range(60):
        relay.turn()
    once = ["STEPS", "PROGRESS", "HAND", "CONTROLLERS"]
    assert [word.name for word in sorted(relay.words)] == once, "values without a change are not sent again"
    sent.feedback.currently_executing_step_index = 3
    plans.publish(sent)
    before = len(relay.plans)
    relay.wait(lambda: len(relay.plans) > before, "the next step is reported")
    assert relay.plans[-1].feedback.feedback.steps == came.feedback.steps
    assert relay.words.count(LinkMessageType.STEPS) == 1, "steps without a change are sent once"
    late = Progress(theirs, "odom", lambda number, feedback: None)
    packed = some(packed_steps.pack(sent.feedback.feedback.steps))
    before = len(relay.plans)
    late.plan(0, pack_feedback(sent, packed))
    late.steps(packed)
    relay.wait(lambda: len(relay.plans) >= before + 2, "steps that arrive after their progress")
    assert relay.plans[-1].feedback.feedback.steps == came.feedback.steps
    relay.reporter.begin_session()
    relay.wait(lambda: relay.words.count(LinkMessageType.STEPS) == 2, "another session is sent everything")
    relay.executor.shutdown()


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
    for moment in range(5, 5 + JOINT_MESSAGES):
        publish(moment, with_base=False)
    last = 4.0 + JOINT_MESSAGES
    wait_until(lambda: newest() == (last, pytest.approx(0.1 * last), 2.0), 60.0, "joints that no base goes with")
