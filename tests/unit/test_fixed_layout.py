"""Numbers of ROS messages, where they stand: as rclpy writes and reads them, whatever the lengths."""

from __future__ import annotations

import array

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, JointState
from valor_msgs.msg import HdtState

from valor.ros.fixed_layout import Layout, Stream

numbers = st.lists(st.floats(allow_nan=False), max_size=9)
bits = st.lists(st.integers(0, 255), max_size=9)
counts = st.integers(-(2**63), 2**63 - 1)


def state(origin: str, time: int, position: list[float], velocity: list[float], fault: list[int]) -> HdtState:
    message = HdtState(time=time, voltage=48.5, fault=array.array("B", fault))
    message.position, message.velocity = array.array("d", position), array.array("d", velocity)
    message.header.frame_id, message.header.stamp.nanosec = origin, 7
    return message


states = st.builds(state, st.text("aé", max_size=9), counts, numbers, numbers, bits)


@given(st.lists(states, min_size=1, max_size=6))
def test_what_rclpy_wrote_is_read_and_what_is_written_rclpy_reads(said: list[HdtState]) -> None:
    stream = Stream(HdtState)
    for message in said:
        heard = stream.received(bytes(serialize_message(message)))
        assert heard["time"].item() == message.time
        assert heard["header.stamp.nanosec"].item() == 7
        assert heard["position"].tolist() == list(message.position)
        assert heard["fault"].tolist() == list(message.fault)
        layout = Layout(message)
        layout.stamp(5_000_000_009)
        layout.numbers["velocity"][:] = range(len(message.velocity))
        back = deserialize_message(bytes(layout.bytes), HdtState)
        assert (back.header.stamp.sec, back.header.stamp.nanosec) == (5, 9)
        assert list(back.velocity) == list(range(len(message.velocity)))
        assert (back.time, back.position, back.header.frame_id) == (
            message.time,
            message.position,
            message.header.frame_id,
        )


def test_another_layout_is_not_taken_for_ones_own() -> None:
    layout = Layout(state("left_arm", 1, [1.0, 2.0], [], [1]))
    other = [
        state("left_arm", 2, [3.0], [4.0], [1]),  # as long
        state("right_ar", 2, [3.0, 4.0], [], [1]),
        state("left_arm", 2, [3.0, 4.0], [], []),
    ]
    for message in other:
        assert not layout.read(bytes(serialize_message(message)))
    assert not layout.read(b"") and not layout.read(bytes(layout.bytes)[:-1])
    assert not layout.read(b"\0\0" + bytes(layout.bytes)[2:]), "big-endian"
    assert layout.numbers["position"].tolist() == [1.0, 2.0], "nothing of them was taken over"
    assert layout.read(bytes(serialize_message(state("left_arm", 2, [3.0, 4.0], [], [9]))))
    assert layout.numbers["position"].tolist() == [3.0, 4.0]


@pytest.mark.parametrize("message", [Imu(), JointState(name=["knee"])])
def test_fields_that_it_cannot_place_are_named(message: object) -> None:
    with pytest.raises(ValueError, match="expected numbers, strings and sequences of numbers"):
        Layout(message)
