#!/usr/bin/env python3
"""One goal for an arm: one of its joints turned, the others where they are.

python arm_goal.py right elbow_pitch 0.4     # turn by 0.4 rad in 2 s
"""

from __future__ import annotations

import sys

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.srv import QueryTrajectoryState
from modes import change_mode
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectoryPoint

PATIENCE = 60.0  # [s]


def main(side: str, turned: str, by: float) -> None:
    """Ask where the arm is, send the goal, wait for its end."""
    node = rclpy.create_node("arm_goal")
    change_mode(node, "stand_manipulate")
    controller = f"trajectory_controllers/{side}_arm_traj_controller"
    action = ActionClient(node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory")
    query = node.create_client(QueryTrajectoryState, f"{controller}/query_state")
    if not (action.wait_for_server(PATIENCE) and query.wait_for_service(PATIENCE)):
        sys.exit(f"no {controller}")
    now = done(node, query.call_async(QueryTrajectoryState.Request(time=node.get_clock().now().to_msg())))
    positions = dict(zip(now.name, now.position, strict=True))
    joint = next((each for each in positions if each.endswith(turned)), None) or sys.exit(f"no {turned}: {now.name}")
    positions[joint] += by
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(positions)
    point = JointTrajectoryPoint(positions=list(positions.values()), time_from_start=Duration(sec=2))
    goal.trajectory.points = [point]
    handle = done(node, action.send_goal_async(goal, feedback_callback=lambda told: None))
    ended = done(node, handle.get_result_async()).result
    if ended.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
        sys.exit(f"error {ended.error_code}: {ended.error_string}")
    print(f"{joint} is at {positions[joint]:.3f} rad")


def done(node: Node, future: Future):
    """What comes of it."""
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    return future.result() or sys.exit("no answer")


if __name__ == "__main__":
    rclpy.init()
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
    rclpy.shutdown()
