"""Control modes of a real Motion System: asked for by action and topic, reported on ROS and Bifrost."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

import bifrost
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import (
    ACCEPTED,
    DUPLICATE,
    INVALID_MODE,
    INVALID_TRANSITION,
    PATIENCE,
    REJECTED,
    Topic,
    go,
    pass_robot_time,
)
from valor.common.messages import ControlModeReport
from valor.common.topics import CONTROL_MODE, MOTION_STATE, REJECTION


def test_modes(ros: RosClient, node: bifrost.Node) -> None:
    go(ros, "stand")
    reports = CONTROL_MODE.subscriber(node, queue=1000)
    repeat = ros.change_mode("STAND")
    assert repeat.status == ACCEPTED | DUPLICATE and repeat.current_control_mode == "stand"
    for name, status in (("dance", REJECTED | INVALID_MODE), ("none", REJECTED | INVALID_TRANSITION)):
        result = ros.change_mode(name)
        assert (result.status, result.current_control_mode) == (status, "stand")
    diagnostics = Topic(ros, DiagnosticArray, "/diagnostics")

    def said() -> dict[str, str]:
        return {
            pair.key: pair.value
            for message in diagnostics.messages[-1:]
            for status in message.status
            for pair in status.values
        }

    wait_until(lambda: "none: not allowed from stand" in said().get("last control mode rejected", ""), PATIENCE, "why")
    assert said()["behavior"] == "stand"
    diagnostics.close()
    result = ros.change_mode("Stand_Manipulate")
    assert (result.status, result.current_control_mode) == (ACCEPTED, "stand_manipulate")
    wait_until(
        lambda: [r for r in ros.reports if r.current_control_mode == "stand_manipulate" and r.status == ACCEPTED],
        PATIENCE,
        "the report of stand_manipulate on ROS",
    )
    assert any(report.status & 8 for report in ros.reports), "no report said that the change is processed"
    seen: list[ControlModeReport] = []

    def twin() -> bool:
        seen.extend(received.message for received in reports.drain())
        return bool(seen) and seen[-1].current_control_mode == "stand_manipulate"

    wait_until(twin, PATIENCE, "the report on Bifrost")
    assert seen[-1].behavior == "stand_manipulate"
    reports.close()


def test_the_topic_changes_modes_and_an_emergency_stop_keeps_the_balance(ros: RosClient, node: bifrost.Node) -> None:
    go(ros, "stand")
    publisher = ros.node.create_publisher(VigirControlModeCommand, "/flor/controller/mode_command", 1)
    wait_until(lambda: publisher.get_subscription_count() > 0, PATIENCE, "the VRC to listen to mode_command")
    publisher.publish(VigirControlModeCommand(requested_control_mode=VigirControlModeCommand.EMERGENCY_STOP))
    wait_until(lambda: ros.reports and ros.reports[-1].current_control_mode == "soft_stop", PATIENCE, "soft_stop")
    state = MOTION_STATE.subscriber(node)
    received = state.receive(PATIENCE)
    assert received is not None and received.message.behavior == "soft_stop"
    state.close()
    publisher.publish(VigirControlModeCommand(requested_control_mode="stand"))
    wait_until(lambda: ros.reports[-1].current_control_mode == "stand", PATIENCE, "stand")
    # What is no message at all leaves the VRC unmoved.
    publisher.publish(b"\x00\x01\x00\x00" + b"\xff" * 40)
    assert ros.change_mode("stand").status == ACCEPTED | DUPLICATE
    ros.destroy(ros.node.destroy_publisher, publisher)


@pytest.mark.parametrize("kind", [Twist, TwistStamped])
def test_cmd_vel_walks_in_mode_walk_and_nowhere_else(ros: RosClient, node: bifrost.Node, kind: type) -> None:
    publisher = ros.node.create_publisher(kind, "/cmd_vel", 1)
    motion = MOTION_STATE.subscriber(node)
    twist = kind()
    getattr(twist, "twist", twist).linear.x = 0.3
    places: list[float] = []
    times: list[int] = []

    def walked(distance: float) -> bool:
        publisher.publish(twist)
        state = motion.latest()
        if state is not None:
            assert state.message.behavior in ("stand", "walk"), state.message.reason
            places.append(float(state.message.pelvis_position_in_odom[0]))
            times.append(state.message.time)
        return bool(places) and places[-1] - places[0] > distance

    def stood() -> bool:
        assert not walked(0.1)
        return bool(times) and times[-1] - times[0] > 400_000_000

    def rests() -> bool:
        state = motion.latest()
        return state is not None and bool(abs(state.message.pelvis_linear_velocity_in_odom[0]) < 0.02)

    go(ros, "stand")
    wait_until(rests, PATIENCE, "the robot at rest", period=0.02)
    wait_until(stood, PATIENCE, "0.4 s of robot time", period=0.02)
    go(ros, "walk")
    wait_until(lambda: walked(0.4), PATIENCE, "walking 0.4 m", period=0.02)
    go(ros, "stand")
    ros.destroy(ros.node.destroy_publisher, publisher)
    motion.close()


def test_mode_changes_do_not_make_the_motion_system_refuse_set_points_for_long(
    manipulating: RosClient, node: bifrost.Node
) -> None:
    rejections = REJECTION.subscriber(node, queue=1000)
    for mode in ("stand", "stand_manipulate", "manipulate", "stand", "stand_manipulate"):
        assert manipulating.change_mode(mode).status == ACCEPTED
    pass_robot_time(manipulating, 0.5)
    assert manipulating.change_mode("stand_manipulate").status == ACCEPTED | DUPLICATE
    pass_robot_time(manipulating, 0.5)
    late = rejections.latest()
    assert late is None or late.message.count < 200, "set-points go on being sent where they are not accepted"
    rejections.close()
