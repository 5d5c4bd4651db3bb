"""ROS mirror types: rclpy and rosbags decode the same values as the Bifrost message."""

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
from valor.bag_recorder.bifrost_tap import TwinEncoder, twin_type
from valor.common.messages import FootstepPlanRequest, Motor
from valor.common.topics import TOPICS
from valor.ros.definitions import definition

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
def test_every_message_equals_its_ros_mirror(typestore: Any, data: st.DataObject) -> None:
    message_type = data.draw(st.sampled_from(MESSAGES))
    message = data.draw(of(message_type))
    origin, sequence = data.draw(TEXT), data.draw(st.integers(0, 2**64 - 1))
    stamp = data.draw(st.integers(0, 2**31 * SECOND - 1))
    encoded = ENCODERS[message_type].encode(Received(message, 0, sequence, origin), stamp)

    ros_type = getattr(importlib.import_module("valor_msgs.msg"), message_type.__name__)
    for twin in (deserialize_message(encoded, ros_type), typestore.deserialize_cdr(encoded, twin_type(message_type))):
        assert twin.header.stamp.sec * SECOND + twin.header.stamp.nanosec == stamp
        assert twin.header.frame_id == origin and twin.bifrost_sequence == sequence
        for name in message_type.__struct_fields__:
            assert same(getattr(message, name), getattr(twin, name)), name
    assert bytes(typestore.serialize_cdr(twin, twin_type(message_type))) == encoded


def motor(sequence: int, joints: int) -> Motor:
    empty = np.zeros(0)
    return Motor(sequence, 0, 0, np.zeros(joints, np.uint8), empty, empty, empty, empty, empty, "", 0)


def test_the_number_of_stored_layouts_is_bounded() -> None:
    encoder = TwinEncoder(Motor)
    for length in range(3 * TwinEncoder.LAYOUTS):
        encoder.encode(Received(motor(0, length), 0, 1, "node"), 0)
    assert len(encoder._pack) <= TwinEncoder.LAYOUTS


def test_values_and_types_without_a_ros_equivalent_are_rejected() -> None:
    with pytest.raises(struct.error):
        TwinEncoder(Motor).encode(Received(motor(2**63, 0), 0, 1, "node"), 0)
    with pytest.raises(TypeError, match=r"FootstepPlanRequest\.steps: .*Footstep.* has no ROS equivalent"):
        TwinEncoder(FootstepPlanRequest)
