"""Processes on the hosts of ``cables``: an operator's ROS 2 program, and a tap on the Motion Manager's own host.

    python -m benchmarks.cable_ends tap HOME INSTANCE FILE
    python -m benchmarks.cable_ends operate HOME INSTANCE

Lines on the operator's standard input:

    mode NAME | velocity VX | arm ANGLE SECONDS | hand HEIGHT | steps INDEX COUNT
    goal mode … | goal arm … | goal steps … | known | ends | quit

Each line sends one message, or a goal of the action; ``sent`` confirms it. ``known`` prints whether all have
subscribers and servers, ``ends`` the status of the latest goal.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Foot, Step, StepPlan
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

import bifrost
from valor.common.instance import Instance
from valor.common.topics import HAND_GOAL, MOTION_STATE, REJECTION, STEP_STATUS, VELOCITY
from valor.robot.description import RobotDescription

ARM = "left_arm"
HALF_WIDTH = 0.1  # from the middle to a sole [m]: ESCHER's
HAND = (0.45, 0.3)  # ahead and to the left of the pelvis [m]
ENDED = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}


class Operator:
    """A node, and what it sends."""

    def __init__(self, instance: Instance) -> None:
        os.environ.update(instance.environment())
        settings = instance.settings()
        self._arm = list(RobotDescription.load(settings.robot).tables.group(ARM))
        rclpy.init(domain_id=settings.ros_domain_id)
        self._node = rclpy.create_node("cable_operator")
        topics = {
            "mode": (VigirControlModeCommand, "/flor/controller/mode_command"),
            "velocity": (Twist, "/cmd_vel"),
            "arm": (JointTrajectory, f"/trajectory_controllers/{ARM}_traj_controller/joint_trajectory"),
            "hand": (PoseStamped, "/flor/l_hand/goal_pose"),
            "steps": (StepPlan, "/robot_controllers/footstep_controller/execute_step_plan"),
        }
        self._publishers = {name: self._node.create_publisher(*topic, 10) for name, topic in topics.items()}
        self._makers: dict[str, Callable[..., Any]] = {
            "mode": lambda name: VigirControlModeCommand(requested_control_mode=name),
            "velocity": _velocity,
            "arm": self._reach,
            "hand": _hand,
            "steps": _steps,
        }
        actions = {
            "mode": (ChangeControlMode, "/mode_controllers/control_mode_controller/change_control_mode"),
            "arm": (FollowJointTrajectory, f"/trajectory_controllers/{ARM}_traj_controller/follow_joint_trajectory"),
            "steps": (ExecuteStepPlan, "/robot_controllers/footstep_controller/execute_step_plan"),
        }
        self._clients = {name: ActionClient(self._node, *action) for name, action in actions.items()}
        self.ends = "nothing sent"
        threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True).start()

    def known(self) -> bool:
        """Return whether somebody listens to all of it."""
        topics = all(each.get_subscription_count() for each in self._publishers.values())
        return topics and all(each.server_is_ready() for each in self._clients.values())

    def send_goal(self, what: str, *arguments: str) -> None:
        """One goal; ``ends`` says what is known of it."""
        made = self._makers[what](*arguments)
        goals = {
            "mode": lambda: ChangeControlMode.Goal(mode_request=made.requested_control_mode),
            "arm": lambda: FollowJointTrajectory.Goal(trajectory=made),
            "steps": lambda: ExecuteStepPlan.Goal(step_plan=made),
        }
        self.ends = "no answer"
        self._clients[what].send_goal_async(goals[what]()).add_done_callback(self._answered)

    def _answered(self, future: Any) -> None:
        handle = future.result()
        self.ends = "accepted" if handle.accepted else "rejected"
        if handle.accepted:
            handle.get_result_async().add_done_callback(self._ended)

    def _ended(self, future: Any) -> None:
        said = getattr(future.result().result, "error_string", "")
        self.ends = f"{ENDED.get(future.result().status, 'unknown')} {said}".strip()

    def send(self, what: str, *arguments: str) -> None:
        """One message."""
        self._publishers[what].publish(self._makers[what](*arguments))

    def _reach(self, angle: str, seconds: str) -> JointTrajectory:
        point = JointTrajectoryPoint(positions=[0.0] * len(self._arm))
        point.positions[-1] = float(angle)
        point.positions[3] = -0.4
        point.time_from_start.sec = int(float(seconds))
        return JointTrajectory(joint_names=self._arm, points=[point])


def _velocity(speed: str) -> Twist:
    message = Twist()
    message.linear.x = float(speed)
    return message


def _hand(height: str) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "pelvis"
    message.pose.position.x, message.pose.position.y = HAND
    message.pose.position.z = float(height)
    message.pose.orientation.w = 1.0
    return message


def _steps(first: str, count: str) -> StepPlan:
    plan = StepPlan()
    plan.header.frame_id = "base_footprint"
    for index in range(int(count)):
        step = Step(step_index=int(first) + index, valid=True)
        left = index % 2 == 0
        step.foot.foot_index = Foot.LEFT if left else Foot.RIGHT
        step.foot.pose.position.y = HALF_WIDTH if left else -HALF_WIDTH
        plan.steps.append(step)
    return plan


def operate(home: str, name: str) -> None:
    """Send what standard input says until ``quit``."""
    operator = Operator(Instance(name, Path(home)))
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "quit":
            break
        if line.strip() == "known":
            print(operator.known(), flush=True)
        elif line.strip() == "ends":
            print(operator.ends, flush=True)
        elif line.startswith("goal "):
            operator.send_goal(*line.split()[1:])
            print("sent", flush=True)
        else:
            operator.send(*line.split())
            print("sent", flush=True)
    rclpy.shutdown()


PERIOD = 0.05  # between two looks [s]


def tap(home: str, name: str, file: str) -> None:
    """Write what arrives at the Motion Manager, a JSON object a line, by the wall clock [s], until killed."""
    instance = Instance(name, Path(home))
    with (
        bifrost.Node("cable_tap", network=bifrost.Network.load(instance.network_file, instance.keys)) as node,
        open(file, "a", buffering=1, encoding="utf-8") as out,
    ):
        velocities, goals = VELOCITY.subscriber(node, queue=5000), HAND_GOAL.subscriber(node, queue=5000)
        steps = STEP_STATUS.subscriber(node, queue=1000)
        rejections, states = REJECTION.subscriber(node, queue=5000), MOTION_STATE.subscriber(node)

        def note(kind: str, **what: Any) -> None:
            out.write(json.dumps({"at": time.time(), "kind": kind, **what}) + "\n")

        while True:
            for velocity in velocities.drain():
                note("velocity", value=velocity.message.linear_x)
            for goal in goals.drain():
                note("hand", value=float(goal.message.position[2]) if goal.message.active else None)
            for step in steps.drain():
                if step.message.executing_step_index >= 0:
                    note("step", value=step.message.executing_step_index)
            for rejection in rejections.drain():
                note("rejection", value=rejection.message.topic, reason=rejection.message.reason)
            if (state := states.latest()) is not None:
                found = state.message
                place = [float(each) for each in found.pelvis_position_in_odom]
                setpoint = [round(float(each), 5) for each in found.joint_setpoint]
                _, x, y, _ = (float(each) for each in found.pelvis_orientation_in_odom)
                upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of its lean
                note("state", behavior=found.behavior, place=place, upright=upright, setpoint=setpoint)
            time.sleep(PERIOD)


if __name__ == "__main__":
    (tap if sys.argv[1] == "tap" else operate)(*sys.argv[2:])
