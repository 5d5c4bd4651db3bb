"""A footstep plan through the Motion Manager's own handler and queue, on a plant that is not the controller's model."""

from __future__ import annotations

import math

from valor.rehearsal.plan_walk import walk_plan
from valor.robot.description import RobotDescription
from valor.robot.step_plan import PlanStep


def test_the_feet_come_to_stand_where_the_plan_says(robot: RobotDescription) -> None:
    steps = [
        PlanStep(foot="left", x=0.2, y=0.12, yaw=0.1),
        PlanStep(foot="right", x=0.25, y=-0.1, yaw=0.1),
        PlanStep(foot="left", x=0.22, y=0.1, yaw=0.1),
    ]
    walked = walk_plan(robot, steps, seed=1)
    assert walked.done, (walked.refusal, walked.fall, walked.qp_failures)
    far, turned = walked.believed
    assert far < 0.03
    assert turned < math.radians(3.0)
    assert walked.knee > 0.3
