"""Definitions in a bag are complete to others' readers."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from valor.bag_recorder.definitions import definition


@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/msg/JointState",
        "valor_msgs/msg/MotionState",
        "vigir_footstep_planning_msgs/msg/StepPlan",
        "vigir_footstep_planning_msgs/action/ExecuteStepPlan_Feedback",
    ],
)
def test_a_definition_can_be_decoded_with_by_rosbags_alone(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(name), name))
    text, _ = store.generate_msgdef(name)  # names every type that is contained, however deep
    assert text
