"""A twin's bytes say what the Bifrost message says, to rclpy and to rosbags."""

from __future__ import annotations

import importlib
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bifrost import Message, Received, codec
from harness.examples import examples
from valor.bag_recorder.twin import TwinEncoder, twin_type
from valor.common.messages import Footstep, FootstepPlanRequest, Motor
from valor.common.topics import TOPICS
from valor.ros.definitions import UnknownTypeError, definition

MESSAGES = sorted({topic.type for topic in TOPICS}, key=lambda message: message.__name__)
ENCODERS = {message: TwinEncoder(message) for message in MESSAGES}
SECOND = 1_000_000_000
TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)
VALUES: dict[str, st.SearchStrategy[Any]] = {
    "bool": st.booleans(),
    "int": st.integers(-(2**63), 2**63 - 1),
    "float": st.floats(),
    "str": TEXT,
    "list<str>": st.lists(TEXT, max_size=5),
    "float64[]": st.lists(st.floats(), max_size=9).map(lambda values: np.array(values, np.float64)),
    "uint8[]": st.binary(max_size=9).map(lambda values: np.frombuffer(values, np.uint8)),
}


@pytest.fixture(scope="module")
def typestore() -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    for message in MESSAGES:
        store.register(get_types_from_msg(definition(twin_type(message)), twin_type(message)))
    return store


def of(message: type[Message]) -> st.SearchStrategy[Message]:
    fields = codec(message).schema.types[message.__name__]
    return st.builds(message, **{name: VALUES[type_name] for name, type_name in fields})


def same(one: object, other: object) -> bool:
    """Equal values of equal kinds; NaN equals NaN."""
    if isinstance(one, np.ndarray):
        return one.tobytes() == np.asarray(other, one.dtype).tobytes()
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    return bool(one == other)


@examples(300)
@given(data=st.data())
def test_every_message_reads_the_same_from_its_twin(typestore: Any, data: st.DataObject) -> None:
    message_type = data.draw(st.sampled_from(MESSAGES))
    message = data.draw(of(message_type))
    origin, sequence = data.draw(TEXT), data.draw(st.integers(0, 2**64 - 1))
    stamp = data.draw(st.integers(0, 2**31 * SECOND - 1))
    encoded = ENCODERS[message_type].encode(Received(message, 0, sequence, origin), stamp)

    ros_type = getattr(importlib.import_module("valor_msgs.msg"), message_type.__name__)
    for twin in (
        deserialize_message(encoded, ros_type),
        typestore.deserialize_cdr(encoded, twin_type(message_type)),
    ):
        assert twin.header.stamp.sec * SECOND + twin.header.stamp.nanosec == stamp
        assert twin.header.frame_id == origin
        assert twin.bifrost_sequence == sequence
        for name in message_type.__struct_fields__:
            assert same(getattr(message, name), getattr(twin, name)), name


@examples(100)
@given(data=st.data())
def test_the_bytes_are_those_of_another_encoder(typestore: Any, data: st.DataObject) -> None:
    message_type = data.draw(st.sampled_from(MESSAGES))
    message = data.draw(of(message_type))
    encoded = ENCODERS[message_type].encode(Received(message, 0, 1, "node"), 5 * SECOND)
    name = twin_type(message_type)
    assert bytes(typestore.serialize_cdr(typestore.deserialize_cdr(encoded, name), name)) == encoded


def test_layouts_do_not_pile_up() -> None:
    encoder = TwinEncoder(Motor)
    empty = np.zeros(0)
    for length in range(3 * TwinEncoder.LAYOUTS):
        message = Motor(0, 0, 0, np.zeros(length, np.uint8), empty, empty, empty, empty, empty, "", 0)
        encoder.encode(Received(message, 0, 1, "node"), 0)
    assert len(encoder._pack) <= TwinEncoder.LAYOUTS


def test_an_integer_beyond_64_signed_bits_is_refused() -> None:
    empty = np.zeros(0)
    message = Motor(2**63, 0, 0, np.zeros(0, np.uint8), empty, empty, empty, empty, empty, "", 0)
    with pytest.raises(struct.error):
        TwinEncoder(Motor).encode(Received(message, 0, 1, "node"), 0)


def test_a_message_within_a_message_has_no_twin_and_says_so() -> None:
    with pytest.raises(TypeError, match=r"FootstepPlanRequest\.steps: .*Footstep.* has no ROS twin"):
        TwinEncoder(FootstepPlanRequest)
    assert TwinEncoder(Footstep)


def test_a_type_that_is_not_installed_is_named() -> None:
    with pytest.raises(UnknownTypeError, match="octomap_msgs/msg/Octomap is not installed here"):
        definition("octomap_msgs/msg/Octomap")


@pytest.mark.parametrize(
    "installed",
    [
        "sensor_msgs/msg/Image",
        "control_msgs/msg/JointTrajectoryControllerState",
        "vigir_footstep_planning_msgs/action/ExecuteStepPlan_Feedback",
    ],
)
def test_a_definition_is_whole(installed: str) -> None:
    """rosbags needs nothing but the text, and a store that knows the type already agrees with it."""
    types = get_types_from_msg(definition(installed), installed)
    assert installed in types
    assert "std_msgs/msg/Header" in types
    assert "builtin_interfaces/msg/Time" in types
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    ours = get_typestore(Stores.ROS2_JAZZY)
    for name, fields in types.items():
        if name in ours.fielddefs:
            assert ours.fielddefs[name] == fields, name
