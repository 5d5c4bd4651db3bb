"""The HDT bridge between a network and a graph: what the driver says arrives, as it was said, and nothing else does."""

from __future__ import annotations

import array
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context as RosContext
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from valor_msgs.msg import HdtCommand as RosCommand
from valor_msgs.msg import HdtState as RosState

import bifrost
from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.unit.test_hdt_bridge import diagnostics, same
from valor.common.errors import ConfigurationError
from valor.common.messages import HdtCommand, HdtState, Statistics
from valor.common.topics import HDT_COMMANDS, HDT_STATES, STATISTICS
from valor.hdt_bridge.service import HdtBridge
from valor.service import Context

PATIENCE = 20.0  # [s]
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LIMBS = ("left_arm", "right_arm", "left_hand", "right_hand")


@dataclass
class Bridge:
    """A bridge that runs in a thread, and both of its sides."""

    node: bifrost.Node
    ros: Node
    own: bifrost.Subscriber[Statistics]

    def listen(self, limb: str) -> bifrost.Subscriber[HdtState]:
        return HDT_STATES[limb].subscriber(self.node, queue=100)


@pytest.fixture
def bridge(instance: RunningInstance, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bridge]:
    for name, value in instance.instance.environment().items():
        monkeypatch.setenv(name, value)
    node = instance.node("comms_manager")
    own = STATISTICS["hdt_bridge"].subscriber(node, queue=100)
    context = RosContext()
    rclpy.init(context=context, domain_id=instance.settings.ros_domain_id)
    ros = rclpy.create_node("hdt_driver", context=context)
    with Context("hdt_bridge", instance.instance) as given:
        made = HdtBridge(given)
        thread = threading.Thread(target=made.run)
        thread.start()
        try:
            yield Bridge(node, ros, own)
        finally:
            given.stopping.set()
            thread.join()
            made.close()
            ros.destroy_node()
            context.try_shutdown()


def state(number: int) -> HdtState:
    n = 7
    four = (np.full(n, float(number + i)) for i in range(4))
    return HdtState(number, number, number - 1, *four, 48.5, np.full(n, number % 256, dtype=np.uint8))  # type: ignore[arg-type, call-arg]


def said(message: HdtState) -> RosState:
    made = RosState()
    for name in message.__struct_fields__:
        value: Any = getattr(message, name)
        if isinstance(value, np.ndarray):
            value = array.array("B" if value.dtype == np.uint8 else "d", value.tobytes())
        setattr(made, name, value)
    return made


def test_states_of_each_limb_reach_the_comms_manager_in_order_and_no_other_limb(bridge: Bridge) -> None:
    heard = {limb: bridge.listen(limb) for limb in LIMBS}
    speaking = {limb: bridge.ros.create_publisher(RosState, f"/hdt/{limb}/state", 1) for limb in LIMBS}
    for i, limb in enumerate(LIMBS):
        before = 0
        for number in range(100 * (i + 1), 100 * (i + 1) + 4):

            def arrived(limb: str = limb, number: int = number) -> bifrost.Received[HdtState] | None:
                speaking[limb].publish(said(state(number)))  # again: the driver's topic may lose
                return heard[limb].receive(timeout=0.1)

            received = wait_until(arrived, PATIENCE, f"{limb}: state {number}")
            assert same(received.message, state(received.message.time))
            assert before <= received.message.time <= number
            before = received.message.time
        assert before >= 100 * (i + 1)
        for other in LIMBS[i + 1 :]:
            assert heard[other].latest() is None, f"{other} has said nothing yet"


def test_commands_reach_the_driver_with_their_origin(bridge: Bridge) -> None:
    heard: list[RosCommand] = []
    bridge.ros.create_subscription(RosCommand, "/hdt/right_arm/command", heard.append, NEWEST)
    executor = rclpy.executors.SingleThreadedExecutor(context=bridge.ros.context)
    executor.add_node(bridge.ros)
    speaking = HDT_COMMANDS["right_arm"].publisher(bridge.node)
    numbers = [np.arange(7.0) + i for i in range(5)]

    def arrived() -> bool:
        speaking.publish(HdtCommand(9, 4, 2, np.ones(7, dtype=np.uint8), *numbers))
        executor.spin_once(timeout_sec=0.05)
        return bool(heard)

    wait_until(arrived, PATIENCE, "a command")
    executor.shutdown()
    assert (heard[0].header.frame_id, heard[0].time, heard[0].sequence) == ("comms_manager", 9, 4)
    assert [list(heard[0].position), list(heard[0].velocity)] == [numbers[0].tolist(), numbers[1].tolist()]


def test_the_bridge_says_that_it_is_ready_and_hands_on_what_the_driver_says(bridge: Bridge) -> None:
    own = wait_until(bridge.own.latest, PATIENCE, "the bridge's own statistics").message
    assert (own.service, own.state) == ("hdt_bridge", "ready")
    drivers = STATISTICS["hdt_driver"].subscriber(bridge.node, queue=100)
    speaking = bridge.ros.create_publisher(DiagnosticArray, "/diagnostics", 10)
    wait_until(speaking.get_subscription_count, PATIENCE, "the bridge hears /diagnostics")
    for message, expected in (("ready", ("ready", "")), ("left_arm: silent", ("starting", "left_arm: silent"))):

        def told(message: str = message, expected: tuple[str, str] = expected) -> Statistics | None:
            speaking.publish(diagnostics(name="somebody", message="else"))
            speaking.publish(diagnostics(message=message, cycles="123", cycle_time_max="0.25"))
            received = drivers.receive(timeout=0.2)
            fits = received is not None and (received.message.state, received.message.detail) == expected
            return received.message if received is not None and fits else None

        report = wait_until(told, PATIENCE, f"the driver's word: {message}")
        assert (report.service, report.pid, report.cycles, report.cycle_time_max) == ("hdt_driver", 7, 123, 0.25)


def test_a_robot_without_hdt_arms_has_nothing_to_bridge(instance: RunningInstance) -> None:
    instance.configure(robot=instance.settings.robot.parent / "thor")
    with (
        Context("hdt_bridge", instance.instance) as given,
        pytest.raises(ConfigurationError, match="none of kind hdt_bifrost"),
    ):
        HdtBridge(given)
