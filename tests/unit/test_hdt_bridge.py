"""What the HDT bridge makes of messages: the same on the other side, and nothing of what it cannot read."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from valor_msgs.msg import HdtCommand as RosCommand
from valor_msgs.msg import HdtState as RosState

from bifrost import Message, Received
from valor.common.messages import HdtCommand, HdtState
from valor.hdt_bridge.driver_report import statistics
from valor.hdt_bridge.twin import Twin

numbers = st.lists(st.floats(allow_nan=False), max_size=8).map(np.array)
flags = st.lists(st.integers(0, 255), max_size=8).map(lambda each: np.array(each, dtype=np.uint8))
counts = st.integers(0, 2**63 - 1)


def same(a: Message, b: Message) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in a.__struct_fields__)


@given(counts, counts, counts, flags, numbers, numbers)
def test_commands_cross_unchanged(
    time: int, sequence: int, motor: int, mode: np.ndarray, one: np.ndarray, two: np.ndarray
) -> None:
    twin = Twin(HdtCommand, RosCommand)
    said = HdtCommand(time, sequence, motor, mode, one, two, one, two, one)
    ros = twin.to_ros(Received(said, 1, 17, "comms_manager"), 3_000_000_001)
    heard = deserialize_message(ros, RosCommand)
    assert (heard.header.frame_id, heard.bifrost_sequence, heard.header.stamp.sec) == ("comms_manager", 17, 3)
    assert same(twin.from_ros(ros), said)
    assert same(twin.from_ros(bytes(serialize_message(heard))), said), "as rclpy has it"


@given(counts, counts, flags, numbers, numbers, st.floats(0, 60))
def test_states_cross_unchanged(
    time: int, sequence: int, fault: np.ndarray, one: np.ndarray, two: np.ndarray, voltage: float
) -> None:
    twin = Twin(HdtState, RosState)
    said = HdtState(time, sequence, sequence, one, two, one, two, voltage, fault)
    ros = twin.to_ros(Received(said, 1, 1, "x"), 0)
    heard = twin.from_ros(ros)
    assert same(heard, said)
    twin.from_ros(twin.to_ros(Received(HdtState(0, 0, 0, two, one, two, one, 0.0, fault[::-1]), 1, 1, "x"), 0))
    assert same(heard, said), "what was handed over is not written over by the next"


def diagnostics(name: str = "hdt_driver", message: str = "ready", **changes: str) -> DiagnosticArray:
    whole = dict.fromkeys(("cycle_time_mean", "cycle_time_max", "period_mean", "period_max", "cpu_percent"), "0.5")
    whole |= dict.fromkeys(("pid", "cycles", "overruns", "rejected", "memory_mib"), "7")
    values = [KeyValue(key=key, value=value) for key, value in (whole | changes).items() if value]
    return DiagnosticArray(status=[DiagnosticStatus(name=name, message=message, values=values)])


def test_the_drivers_word_becomes_its_statistics() -> None:
    report = statistics(diagnostics())
    assert report is not None
    assert (report.service, report.state, report.detail, report.pid, report.cpu_percent) == (
        "hdt_driver",
        "ready",
        "",
        7,
        0.5,
    )
    waiting = statistics(diagnostics(message="left_arm: segment 0 does not answer"))
    assert waiting is not None
    assert (waiting.state, waiting.detail) == ("starting", "left_arm: segment 0 does not answer")


def test_what_others_say_and_what_cannot_be_read_is_nobodys_statistics() -> None:
    assert statistics(diagnostics(name="valor_ros_controller: loop")) is None
    assert statistics(diagnostics(pid="")) is None
    assert statistics(diagnostics(cycles="many")) is None
