"""Messages of the HDT bridge: conversion both ways, and rejection of invalid ones."""

from __future__ import annotations

import time as clock

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from valor_msgs.msg import HdtCommand as RosCommand
from valor_msgs.msg import HdtState as RosState

from bifrost import Received
from harness.waiting import some
from valor.common.messages import HdtCommand, HdtState
from valor.hdt_bridge.service import statistics
from valor.ros.mirror import from_ros, to_ros

numbers = st.lists(st.floats(allow_nan=False), max_size=8).map(np.array)
flags = st.lists(st.integers(0, 255), max_size=8).map(lambda each: np.array(each, dtype=np.uint8))
counts = st.integers(0, 2**63 - 1)


@given(counts, counts, counts, flags, numbers, numbers, st.floats(0, 60))
def test_commands_and_states_are_converted_unchanged(
    time: int, sequence: int, motor: int, bits: np.ndarray, one: np.ndarray, two: np.ndarray, voltage: float
) -> None:
    command = HdtCommand(time, sequence, motor, bits, one, two, one, two, one)
    state = HdtState(time, sequence, motor, one, two, one, two, voltage, bits)
    for message, mirror in ((command, RosCommand()), (state, RosState())):
        to_ros(Received(message, 1, 17, "comms_manager"), mirror)
        received = deserialize_message(serialize_message(mirror), type(mirror))
        assert (received.header.frame_id, received.bifrost_sequence) == ("", 17)
        assert abs(received.header.stamp.sec - clock.time()) < 60.0 and from_ros(type(message), received) == message


def diagnostics(name: str = "hdt_driver", message: str = "ready", **changes: str) -> DiagnosticArray:
    fields = dict.fromkeys(("cycle_time_mean", "cycle_time_max", "period_mean", "period_max", "cpu_percent"), "0.5")
    fields |= dict.fromkeys(("pid", "cycles", "overruns", "rejected", "memory_mib"), "7")
    values = [KeyValue(key=key, value=value) for key, value in (fields | changes).items() if value]
    return DiagnosticArray(status=[DiagnosticStatus(name=name, message=message, values=values)])


def test_diagnostics_of_the_driver_become_its_statistics() -> None:
    report = some(statistics(diagnostics()))
    assert (report.service, report.state, report.detail) == ("hdt_driver", "ready", "")
    assert (report.pid, report.cpu_percent) == (7, 0.5)
    waiting = some(statistics(diagnostics(message="left_arm: it does not respond")))
    assert (waiting.state, waiting.detail) == ("starting", "left_arm: it does not respond")
    for invalid in ({"name": "valor_ros_controller: loop"}, {"pid": ""}, {"cycles": "many"}):
        assert statistics(diagnostics(**invalid)) is None
