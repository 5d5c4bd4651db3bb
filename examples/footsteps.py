#!/usr/bin/env python3
"""Steps of one's own: ``python footsteps.py 4 0.15`` takes four of 0.15 m ahead, and closes the feet.

Footholds are given in the frame ``base_footprint``, between the soles, as it is when the plan comes.
"""

from __future__ import annotations

import sys

import rclpy
from modes import change_mode
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Foot, FootstepExecutionStatus, Step

ACTION = "robot_controllers/footstep_controller/execute_step_plan"
HALF_WIDTH = 0.1  # from the middle to a sole [m]: ESCHER's
PATIENCE = 120.0  # [s]


def main(steps: int, length: float) -> None:
    """Send the plan, print which step came down, wait for the end."""
    node = rclpy.create_node("footsteps")
    change_mode(node, "step")
    plan = ExecuteStepPlan.Goal().step_plan
    plan.header.frame_id = "base_footprint"  # its stamp stays 0: newest
    for index in range(steps + 1):
        step = Step(step_index=index, valid=True)
        step.foot.foot_index = Foot.LEFT if index % 2 == 0 else Foot.RIGHT
        step.foot.pose.position.x = length * min(index + 1, steps)
        step.foot.pose.position.y = HALF_WIDTH if index % 2 == 0 else -HALF_WIDTH
        plan.steps.append(step)
    client = ActionClient(node, ExecuteStepPlan, ACTION)
    client.wait_for_server(PATIENCE) or sys.exit(f"no {ACTION}")
    handle = done(node, client.send_goal_async(ExecuteStepPlan.Goal(step_plan=plan), feedback_callback=report))
    result = done(node, handle.get_result_async()).result
    if result.controller_state != ExecuteStepPlan.Feedback.FINISHED:
        sys.exit(f"not walked: status {result.status.status} of {FootstepExecutionStatus.__name__}")
    print(f"{len(plan.steps)} steps done")


def report(message) -> None:
    """Feedback comes ten times a second."""
    print(f"last step down: {message.feedback.last_performed_step_index}", flush=True)


def done(node: Node, future: Future):
    """What comes of it."""
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    return future.result() or sys.exit("no answer")


if __name__ == "__main__":
    rclpy.init()
    main(int(sys.argv[1]), float(sys.argv[2]))
    rclpy.shutdown()
