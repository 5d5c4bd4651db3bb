"""A prepared message holds nothing but the message."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from control_msgs.msg import JointTrajectoryControllerState
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from trajectory_msgs.msg import JointTrajectoryPoint

from valor.ros.definitions import definition
from valor.ros.prepared_message import PreparedMessage, mark, stamp_mark


def test_a_strict_reader_takes_a_message_with_empty_sequences() -> None:
    name = "control_msgs/msg/JointTrajectoryControllerState"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(name), name))
    message = JointTrajectoryControllerState(joint_names=["a"], speed_scaling_factor=0.5)
    message.header.stamp = stamp_mark()
    message.reference = JointTrajectoryPoint(positions=[mark(0)])
    prepared = PreparedMessage(message, 1)
    prepared.values[0] = 0.25
    read = store.deserialize_cdr(prepared.serialized(Time(sec=3, nanosec=4)), name)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (3, 4)
    assert list(read.reference.positions) == [0.25]
    assert read.speed_scaling_factor == 0.5
