"""Definitions in a bag are complete for other readers; types have the middleware's hashes."""

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from valor.ros.definitions import UnknownTypeError, definition, message_type, type_hash
from valor.ros.topics import shown

pytestmark = pytest.mark.portable


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
def test_rosbags_decodes_with_a_definition_only(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(name), name))
    # The hash covers all contained types; rosbags computes it independently.
    assert store.hash_rihs01(name) == type_hash(name)


def test_a_type_that_is_not_installed_has_no_text_hash_or_class() -> None:
    assert type_hash("no_msgs/msg/Such") == ""
    for ask in (definition, message_type):
        with pytest.raises(UnknownTypeError, match="no_msgs/msg/Such"):
            ask("no_msgs/msg/Such")


def test_only_hidden_topics_of_actions_are_shown() -> None:
    action = "/arm/follow_joint_trajectory/_action"
    assert all(shown(name) for name in ("/joint_states", f"{action}/feedback", f"{action}/status"))
    hidden = ("/arm/_hidden/_action/status", "/_action/other", "/scan/_service_event", "/_feedback")
    assert not any(shown(name) for name in hidden)
