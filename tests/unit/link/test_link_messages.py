"""What goes to the robot: messages come back whole, garbage raises the link's error, a stop is known as one."""

import contextlib
from typing import Any

import pytest
from geometry_msgs.msg import Twist
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Empty
from trajectory_msgs.msg import JointTrajectoryPoint
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

from harness.examples import examples
from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.common.linking import parsed
from valor.link.classes import MessageClass
from valor.link.errors import SealError
from valor.robot.description import RobotDescription
from valor.ros import link_messages
from valor.ros.link_messages import ACTIONS, COMMANDS, LinkMessageType, MessageCodec, class_of, unpack_message

ROBOT = RobotDescription.load(ROBOTS / "escher")
CODEC = MessageCodec(ROBOT)


@pytest.mark.parametrize("row", [*ACTIONS, *COMMANDS], ids=lambda row: row.name)
def test_every_row_travels_and_comes_back(row: Any) -> None:
    kind: Any = getattr(row.type, "Goal", row.type)
    assert CODEC.unpack(CODEC.pack(kind()), kind) == kind()


def test_a_goal_of_an_arm_is_as_long_as_its_numbers() -> None:
    kind = ACTIONS[2].type.Goal
    goal = kind()
    goal.trajectory.joint_names = list(ROBOT.tables.group("left_arm"))
    goal.trajectory.points = [JointTrajectoryPoint(positions=[0.1 * each for each in range(7)])]
    assert len(CODEC.pack(goal)) < len(serialize_message(goal)) / 2 and CODEC.unpack(CODEC.pack(goal), kind) == goal


@examples(100)
@given(st.binary(max_size=200))
def test_garbage_raises_the_links_error_alone(data: bytes) -> None:
    with contextlib.suppress(SealError):
        unpack_message(data)
    with contextlib.suppress(SealError):
        CODEC.unpack(data, Twist)


def test_words_come_back() -> None:
    assert unpack_message(link_messages.pack_message(LinkMessageType.REFUSED, 7, b"why")) == (
        LinkMessageType.REFUSED, 7, b"why",
    )  # fmt: skip
    with pytest.raises(SealError, match="at least 5"):
        unpack_message(bytes((LinkMessageType.GOAL, 1)))


def test_stops_are_stops() -> None:
    soft_stop, mode = COMMANDS[0], COMMANDS[1]
    assert class_of(soft_stop, Empty()) is MessageClass.STOP
    assert class_of(mode, VigirControlModeCommand(requested_control_mode="EMERGENCY_STOP")) is MessageClass.STOP
    assert class_of(mode, VigirControlModeCommand(requested_control_mode="walk")) is MessageClass.COMMAND


def test_the_option_names_a_domain_and_what_stands_between() -> None:
    assert parsed("77", "go_on").domain == 77
    through = parsed("0:9000", "stop")
    assert (through.domain, through.slow, through.fast, through.when_lost) == (0, 9000, 9001, "stop")
    assert parsed(None, "go_on").domain is None
    assert (parsed("77:9000@800", "go_on").slow, parsed("77@800", "go_on").rate) == (9000, 800)
    with pytest.raises(ConfigurationError, match="RATE from 600 B/s"):
        parsed("77@599", "go_on")
    for wrong in ("", "x", "300", "7:", "7:x", "7:70000", "-1", "7:8:9", "7@", "7@x"):
        with pytest.raises(ConfigurationError, match="--link"):
            parsed(wrong, "go_on")
