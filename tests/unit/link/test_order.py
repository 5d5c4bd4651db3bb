"""Of two commands to one target, the older one is never executed last."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Empty
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

from harness.emulated_channel import Conditions
from harness.link_pair import Pair
from harness.places import ROBOTS
from valor.link.classes import MessageClass
from valor.link.endpoint import Arrived
from valor.link.fields import Layout
from valor.link_robot.command_executor import CommandExecutor
from valor.robot.description import RobotDescription
from valor.ros.limbs import HANDS
from valor.ros.link_messages import ACTIONS, COMMANDS, LinkMessageType, MessageCodec, pack_message, unpack_message
from valor.valorctl.instance.ros_domain import reserve

ROBOT = RobotDescription.load(ROBOTS / "escher")
CODEC = MessageCodec(ROBOT)
TOPICS = {command.name: index for index, command in enumerate(COMMANDS)}
LEFT_ARM = next(index for index, action in enumerate(ACTIONS) if action.target == "left_arm")
PAIRS = 200


@pytest.fixture
def node() -> Iterator[Node]:
    with reserve("link_order") as reservation:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=reservation.domain)
        node = rclpy.create_node("link_order", context=context)
        yield node
        node.destroy_node()
        context.try_shutdown()


class Robot:
    """The robot's side: the executor, over a link in simulated time.

    Attributes:
        executed, rejected: ids of commands, in order; reasons by id.
    """

    def __init__(self, node: Node, loss: float) -> None:
        self.link = Pair(Layout(ROBOT), lambda: None, Conditions(bandwidth=9600.0, delay=0.1, loss=loss), seed=3)
        self.executed: list[int] = []
        self.rejected: dict[int, str] = {}
        self.link.execute = CommandExecutor(node, self, ROBOT).execute  # type: ignore[arg-type]
        self.link.until(lambda: self.link.operator.other.lower_bound(self.link.now) > 0.0, 10.0)

    def send(self, kind: MessageClass, content: bytes, _: float) -> None:
        type_, number, text = unpack_message(content)
        if type_ is LinkMessageType.REFUSED:
            self.rejected[number] = text.decode()
        else:
            self.executed.append(number)
        self.link.robot.send(kind, content, self.link.robot_time)

    def publish(self, name: str, message: Any) -> int:
        """Send a command to the robot; returns its id."""
        content = pack_message(LinkMessageType.TOPIC, TOPICS[name], CODEC.pack(message))
        return self.link.operator.send(MessageClass.COMMAND, content, self.link.now)

    def arrive(self, number: int, type_: LinkMessageType, index: int, message: Any = None) -> str:
        """A command arrives; returns the reason of its rejection, empty if it is executed."""
        content = pack_message(type_, index, b"" if message is None else CODEC.pack(message))
        assert self.link.execute is not None
        self.link.execute(Arrived(MessageClass.COMMAND, number, content))
        return self.rejected.get(number, "")


@pytest.mark.parametrize(("loss", "apart"), [(0.05, 1.0), (0.2, 0.5)])
def test_the_older_of_two_commands_is_never_executed_last(node: Node, loss: float, apart: float) -> None:
    robot = Robot(node, loss)
    pairs = []
    for number in range(PAIRS):
        hand = HANDS[number % 2]
        first = robot.publish(f"flor/{hand}/goal_pose", PoseStamped())
        robot.link.run(apart)
        cancels = number % 4 > 1
        newer = robot.publish(
            f"flor/{hand}/goal_{'cancel' if cancels else 'pose'}", Empty() if cancels else PoseStamped()
        )
        pairs.append((first, newer))
        robot.link.run(1.5)
    robot.link.run(10.0)
    order = {number: place for place, number in enumerate(robot.executed)}
    both = [pair for pair in pairs if set(pair) <= set(order)]
    assert len(both) > PAIRS / 2 and all(order[older] < order[newer] for older, newer in both)
    assert any("superseded" in reason for reason in robot.rejected.values()), "no command overtook another"


def test_a_mode_change_is_a_barrier_and_a_canceled_goal_does_not_start(node: Node) -> None:
    robot = Robot(node, 0.0)
    mode = VigirControlModeCommand(requested_control_mode="walk")
    assert not robot.arrive(5, LinkMessageType.TOPIC, TOPICS["flor/l_hand/goal_pose"], PoseStamped())
    assert not robot.arrive(4, LinkMessageType.TOPIC, TOPICS["flor/r_hand/goal_pose"], PoseStamped()), "another target"
    assert not robot.arrive(8, LinkMessageType.TOPIC, TOPICS["flor/controller/mode_command"], mode)
    assert "superseded by command 8" in robot.arrive(
        7, LinkMessageType.TOPIC, TOPICS["flor/pelvis_controller/goal_pose"], PoseStamped()
    )
    goal = FollowJointTrajectory.Goal()
    assert "superseded by command 8" in robot.arrive(6, LinkMessageType.GOAL, LEFT_ARM, goal)
    robot.arrive(11, LinkMessageType.CANCEL, 10)
    assert robot.arrive(10, LinkMessageType.GOAL, LEFT_ARM, goal) == "canceled"
