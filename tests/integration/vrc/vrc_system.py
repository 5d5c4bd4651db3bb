"""A robot on its feet with the VRC before it, and what an ordinary ROS 2 client does with it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from harness.instance import RunningInstance, fresh_instance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from valor.common.messages import ModeStatus
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
HOME = ROBOT.tables.arm_presets["home"]["right"]
FORWARD = ROBOT.tables.arm_presets["forward"]["right"]
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED = 0, -1, -2, -4
ACCEPTED, REJECTED, DUPLICATE, EXTERNAL_CHANGE = 1, 2, 16, 32
NOT_READY, INVALID_MODE, INVALID_TRANSITION = 512, 1024, 2048
STATUS_SUCCEEDED, STATUS_CANCELED, STATUS_ABORTED = 4, 5, 6
VRC = "valor_ros_controller"
PATIENCE = 60.0  # [s]
STILL, MOTION = 50, 0.003  # joint states in which no joint has moved by more; noise alone makes 0.0015 [rad]


@contextmanager
def standing_robot() -> Iterator[RunningInstance]:
    """Everything but the recorder, in real time (nobody waits for the VRC), with the robot on its feet."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home), "vrc", real_time_factor=1.0) as running,
    ):
        for process in ("comms_manager", "motion_manager", "footstep_converter", VRC):
            running.start(process)
        for process in (VRC, "footstep_converter"):
            running.wait_ready(process, 2 * PATIENCE)
        yield running


def go(ros: RosClient, mode: str) -> None:
    """Be in a mode; stand is given only once Stand Prep is done."""

    def there() -> bool:
        result = ros.change_mode(mode)
        return bool(result.status & ModeStatus.MODE_ACCEPTED) and result.current_control_mode == mode

    wait_until(there, PATIENCE, f"control mode {mode}", period=0.2)


def pass_robot_time(ros: RosClient, seconds: float) -> None:
    """Let the robot's clock, which a busy machine slows down, go on for so long."""

    def now() -> int:
        assert ros.joint_state is not None
        return stamp(ros.joint_state)

    end = now() + round(seconds * 1e9)
    wait_until(lambda: now() >= end, PATIENCE, f"{seconds:g} s of robot time")


class Topic:
    """All messages of a ROS topic, with whatever quality of service its publisher offers."""

    def __init__(self, ros: RosClient, message_type: type, name: str, *, latched: bool = False) -> None:
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.messages: list[Any] = []
        self._ros = ros
        self._subscription = ros.node.create_subscription(message_type, name, self.messages.append, qos)
        ros._executor.wake()

    def close(self) -> None:
        self._ros.destroy(self._ros.node.destroy_subscription, self._subscription)


def resting(ros: RosClient) -> dict[str, float]:
    """Joint positions [rad] of a robot that stands still, to be compared with later.

    The test before may have left it settling: for a second after a goal an arm goes on by some hundredths.
    """
    states = Topic(ros, JointState, "/joint_states")

    def still() -> bool:
        last = [state.position for state in states.messages[-STILL:]]
        return len(last) == STILL and float(np.ptp(last, axis=0).max()) < MOTION

    wait_until(still, PATIENCE, "the robot at rest")
    state = states.messages[-1]
    states.close()
    return dict(zip(state.name, state.position, strict=True))


def stamp(message: Any) -> int:
    """Of a message's header [ns]."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def ask(ros: RosClient, kind: Any, service: str, /, **fields: Any) -> Any:
    """What a service answers."""
    client = ros.node.create_client(kind, service)
    try:
        assert client.wait_for_service(PATIENCE), f"no service {service}"
        return ros._wait(ros._call(client.call_async, kind.Request(**fields)), PATIENCE, f"{service} to answer")
    finally:
        ros.destroy(ros.node.destroy_client, client)


def errors(ros: RosClient, target: dict[str, float]) -> dict[str, float]:
    """How far joints are from where they shall be [rad]."""
    positions = ros.joint_positions()
    return {name: abs(positions[name] - value) for name, value in target.items()}


def send(ros: RosClient, target: dict[str, float], seconds: float) -> Any:
    """A goal of the right arm, under way."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(target)
    point = JointTrajectoryPoint(positions=list(target.values()), time_from_start=Duration(sec=int(seconds)))
    goal.trajectory.points = [point]
    client = ros._trajectory["right_arm"]
    assert client.wait_for_server(PATIENCE)
    handle = ros._wait(ros._call(client.send_goal_async, goal), PATIENCE, "an answer to the goal")
    assert handle.accepted
    return handle


def publish(ros: RosClient, topic: str, message: Any) -> None:
    """Once, to whoever listens."""
    publisher = ros.node.create_publisher(type(message), topic, 1)
    wait_until(publisher.get_subscription_count, PATIENCE, f"somebody to listen to {topic}")
    publisher.publish(message)
    wait_until(publisher.wait_for_all_acked, PATIENCE, f"{topic} to be taken")
    ros.destroy(ros.node.destroy_publisher, publisher)
