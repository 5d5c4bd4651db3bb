"""What MoveIt sends, to the actions that the robot's MoveIt configuration names: followed, point by point.

MoveIt's simple controller manager takes a plan apart by controller, leaves the stamp at zero, and begins at the joint
states that it has seen, which are not quite what is commanded.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.planned_trajectory import Planned, planned
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import PATIENCE, ROBOT, STATUS_SUCCEEDED, SUCCESSFUL, errors, go
from valor.common.arrays import FloatArray
from valor.common.topics import JOINT_SETPOINTS
from valor.moveit.groups import groups
from valor.moveit.parameters import controllers, joint_limits
from valor.robot.model_tree import read

SAID = 0.01  # by which the first point is beside where the joints are [rad]
BEHIND = 0.03  # of the set-points, after what was sent [rad]
BOTH = ("left_arm_traj_controller", "right_arm_traj_controller")


class MoveIt:
    """As far as the robot sees it."""

    def __init__(self, ros: RosClient) -> None:
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient

        manager = controllers(groups(ROBOT, read(ROBOT)))["moveit_simple_controller_manager"]
        limits = joint_limits(ROBOT)
        self.ros = ros
        self.joints: dict[str, list[str]] = {name: manager[name]["joints"] for name in BOTH}
        self._scaling = float(limits["default_velocity_scaling_factor"])
        self._limits = limits["joint_limits"]
        actions = {name: f"/{name}/{manager[name]['action_ns']}" for name in BOTH}
        self._clients = {name: ActionClient(ros.node, FollowJointTrajectory, each) for name, each in actions.items()}
        for client in self._clients.values():
            assert client.wait_for_server(PATIENCE), f"no action server {client._action_name}"

    def plan(self, joints: list[str], presets: list[str], points: int) -> Planned:
        """From the joint states through presets, as fast as the configuration lets it."""
        now, generator = self.ros.joint_positions(), np.random.default_rng(points)
        start = [now[joint] for joint in joints] + generator.uniform(-SAID, SAID, len(joints))
        sides = [ROBOT.tables.arm_presets[preset] for preset in presets]
        path = np.array([start, *([(each["left"] | each["right"])[joint] for joint in joints] for each in sides)])
        speed, push = (
            np.array([self._scaling * self._limits[joint][key] for joint in joints])
            for key in ("max_velocity", "max_acceleration")
        )
        return planned(path, speed, push, points)

    def send(self, name: str, joints: list[str], plan: Planned, tolerance: float | None = None) -> Any:
        """A controller's part of a plan, under way; returns the goal's handle."""
        from builtin_interfaces.msg import Duration
        from control_msgs.action import FollowJointTrajectory
        from control_msgs.msg import JointTolerance
        from trajectory_msgs.msg import JointTrajectoryPoint

        own = [joints.index(joint) for joint in self.joints[name]]
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = self.joints[name]
        for i, seconds in enumerate(plan.time):
            whole, rest = divmod(round(seconds * 1e9), 10**9)
            vectors = {
                "positions": plan.position[i, own].tolist(),
                "velocities": plan.velocity[i, own].tolist(),
                "accelerations": plan.acceleration[i, own].tolist(),
            }
            goal.trajectory.points.append(
                JointTrajectoryPoint(**vectors, time_from_start=Duration(sec=whole, nanosec=rest))
            )
        if tolerance:
            goal.goal_tolerance = [JointTolerance(name=joint, position=tolerance) for joint in self.joints[name]]
            goal.goal_time_tolerance = Duration(sec=3)
        client = self._clients[name]
        handle = self.ros._wait(self.ros._call(client.send_goal_async, goal), PATIENCE, f"{name} to answer")
        assert handle.accepted
        return handle

    def end(self, handle: Any) -> Any:
        """The result of a goal."""
        return self.ros._wait(self.ros._call(handle.get_result_async), 2 * PATIENCE, "the goal's end")

    def close(self) -> None:
        for client in self._clients.values():
            self.ros._call(client.destroy)


@pytest.fixture(scope="module")
def moveit(ros: RosClient) -> Iterator[MoveIt]:
    client = MoveIt(ros)
    go(ros, "stand")
    go(ros, "stand_manipulate")
    yield client
    client.close()


@pytest.mark.parametrize(
    ("presets", "points", "tolerance"),
    [(["forward"], 50, None), (["side", "home"], 500, None), (["forward", "home"], 120, 0.04)],
)
def test_an_arms_plan_is_followed(
    moveit: MoveIt, node: bifrost.Node, presets: list[str], points: int, tolerance: float | None
) -> None:
    setpoints = JOINT_SETPOINTS.subscriber(node, queue=20_000)
    wait_until(setpoints.ready, PATIENCE, "set-points")
    name = "right_arm_traj_controller"
    joints = moveit.joints[name]
    plan = moveit.plan(joints, presets, points)
    answer = moveit.end(moveit.send(name, joints, plan, tolerance))
    assert (answer.status, answer.result.error_code) == (STATUS_SUCCEEDED, SUCCESSFUL), answer.result.error_string
    sent = commanded(setpoints, joints)
    setpoints.close()
    assert furthest(sent, plan) < BEHIND
    target = dict(zip(joints, plan.position[-1], strict=True))
    wait_until(lambda: max(errors(moveit.ros, target).values()) < BEHIND, PATIENCE, "the arm where it was sent")


def test_a_plan_of_both_arms_is_followed_by_both_at_once(moveit: MoveIt, node: bifrost.Node) -> None:
    setpoints = JOINT_SETPOINTS.subscriber(node, queue=20_000)
    wait_until(setpoints.ready, PATIENCE, "set-points")
    joints = [joint for name in BOTH for joint in moveit.joints[name]]
    plan = moveit.plan(joints, ["forward", "side", "home"], 200)
    for handle in [moveit.send(name, joints, plan) for name in BOTH]:
        answer = moveit.end(handle)
        assert (answer.status, answer.result.error_code) == (STATUS_SUCCEEDED, SUCCESSFUL), answer.result.error_string
    sent = commanded(setpoints, joints)
    setpoints.close()
    halves = [slice(0, len(joints) // 2), slice(len(joints) // 2, None)]
    late = []
    for half in halves:
        part = Planned(plan.time, plan.position[:, half], plan.velocity[:, half], plan.acceleration[:, half])
        assert furthest((sent[0], sent[1][:, half]), part) < BEHIND
        late.append(delay((sent[0], sent[1][:, half]), part))
    assert abs(late[0] - late[1]) < 0.3, "one arm began long after the other"


def commanded(setpoints: Any, joints: list[str]) -> tuple[FloatArray, FloatArray]:
    """(k,) robot time [s] and (k, n) set-points of joints; the arms have others' as well."""
    messages = [received.message for received in setpoints.drain()]
    assert setpoints.drops == 0
    messages = [message for message in messages if set(joints) <= set(message.names)]
    places = [messages[0].names.index(joint) for joint in joints]
    return np.array([each.time * 1e-9 for each in messages]), np.array([each.position[places] for each in messages])


def delay(sent: tuple[FloatArray, FloatArray], plan: Planned) -> float:
    """Robot time at which a plan began [s]: when what was sent fits the whole of it best."""
    time, position = sent
    first, last = float(time[0]), float(time[-1] - plan.time[-1])  # all of it was sent while one listened
    assert last > first, "the set-points end before the plan does"
    step, best, room = 0.08, (first + last) / 2, (last - first) / 2
    while step > 0.004:  # few set-points at first
        some = slice(None, None, max(1, round(step / 0.01)))
        starts = np.clip(np.arange(best - room, best + room + step, step), first, last)
        best = float(min(starts, key=lambda start: _apart(time[some] - start, position[some], plan).max()))
        step, room = 0.25 * step, 2.0 * step
    return best


def furthest(sent: tuple[FloatArray, FloatArray], plan: Planned) -> float:
    """How far set-points ever were beside a plan, once the start's error is made good [rad]."""
    time, position = sent
    return float(_apart(time - delay(sent, plan), position, plan).max())


def _apart(time: FloatArray, position: FloatArray, plan: Planned) -> FloatArray:
    planned_there = np.stack([np.interp(time, plan.time, column) for column in plan.position.T], axis=1)
    apart: FloatArray = np.abs(position - planned_there)[time > 0.0].max(axis=1, initial=0.0)
    return apart if len(apart) else np.array([np.inf])
