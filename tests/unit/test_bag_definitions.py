"""Definitions in a bag are complete to others' readers; types have the hashes that the middleware knows."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.context import Context
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from valor.ros.definitions import UnknownTypeError, definition, message_type, type_hash
from valor.ros.topics import shown


@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/msg/JointState",
        "valor_msgs/msg/MotionState",
        "vigir_footstep_planning_msgs/msg/StepPlan",
        "vigir_footstep_planning_msgs/action/ExecuteStepPlan_Feedback",
        "vigir_footstep_planning_msgs/action/ExecuteStepPlan_FeedbackMessage",
        "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
        "action_msgs/msg/GoalStatusArray",
    ],
)
def test_a_definition_can_be_decoded_with_by_rosbags_alone(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(name), name))
    # Of every type that is contained, however deep, reckoned by another's program.
    assert store.hash_rihs01(name) == type_hash(name)


@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/msg/JointState",
        "valor_msgs/msg/MotionState",
        "control_msgs/action/FollowJointTrajectory_Feedback",
        "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
    ],
)
def test_the_hash_of_a_type_is_that_which_its_publishers_tell(name: str, ros_domain: int) -> None:
    context = Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("publisher", context=context)
    try:
        node.create_publisher(message_type(name), "/typed", 1)
        (publisher,) = node.get_publishers_info_by_topic("/typed")
    finally:
        node.destroy_node()
        context.shutdown()
    told = publisher.topic_type_hash
    assert (publisher.topic_type, type_hash(name)) == (name, f"RIHS{told.version:02d}_{bytes(told.value).hex()}")


def test_of_a_type_that_is_not_here_there_is_neither_text_nor_hash_nor_class() -> None:
    assert type_hash("no_msgs/msg/Such") == ""
    for ask in (definition, message_type):
        with pytest.raises(UnknownTypeError, match="no_msgs/msg/Such"):
            ask("no_msgs/msg/Such")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("/joint_states", True),
        ("/arm/follow_joint_trajectory/_action/feedback", True),
        ("/arm/follow_joint_trajectory/_action/status", True),
        ("/arm/_hidden/_action/status", False),
        ("/_action/other", False),
        ("/scan/_service_event", False),
        ("/_feedback", False),
    ],
)
def test_of_hidden_topics_those_of_actions_alone_are_shown(name: str, expected: bool) -> None:
    assert shown(name) == expected
