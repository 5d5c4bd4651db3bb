"""Footstep plan walked in one process: handler and queue of the Motion Manager, controller and plant."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np

from valor.common.behaviors import Behavior
from valor.common.messages import Footstep, FootstepPlanRequest
from valor.common.poses import Pose, middle
from valor.control.steps import SolePose
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.motion_manager.handlers.handler import RejectionCounter
from valor.robot.description import RobotDescription
from valor.robot.legs import knees
from valor.robot.step_plan import FEET, PlanStep
from valor.self_test.closed_loop import ClosedLoop
from valor.whole_body.walking.footsteps import StepQueue
from valor.whole_body.walking.gait import sole_poses

STEP_DURATION = 10.0  # of a step with its transfer, at most [s]
REST = 1.0  # between the last step and the measurement of the feet [s]

Error = tuple[float, float]  # distance [m], turn [rad]


@dataclass(frozen=True)
class Walked:
    """Result of a plan."""

    refusal: str  # reason of the Motion Manager's rejection; empty if it accepted
    fall: str | None = None  # reason of the fall detector, or None
    qp_failures: int = 0  # periods whose QP had no solution
    duration: float = 0.0  # from the plan to rest [s]
    landing: Error = (math.inf, math.inf)  # largest error of a foot at touch-down, as estimated
    # Error of the feet at rest, as estimated and in the simulator, from the feet at the start.
    believed: Error = (math.inf, math.inf)
    true: Error = (math.inf, math.inf)
    knee: float = 0.0  # smallest angle of a knee [rad]

    @property
    def done(self) -> bool:
        """True if the robot rests at the end of the plan, without a fall and without an infeasible QP."""
        return not self.refusal and self.fall is None and self.qp_failures == 0 and math.isfinite(self.believed[0])


def walk_plan(
    robot: RobotDescription,
    steps: Sequence[PlanStep],
    *,
    world: str = "flat",
    profile: str = "hardware",
    seed: int = 0,
) -> Walked:
    """Stand up and walk a plan, given in the frame midway between the feet at the start."""
    loop = ClosedLoop(robot, profile, seed, world)
    loop.settle(0.3)
    loop.run(2.0)
    return take_plan(loop, steps)


def take_plan(loop: ClosedLoop, steps: Sequence[PlanStep]) -> Walked:
    """Walk a plan with a robot that stands under control; see ``walk_plan``."""
    robot = loop.robot
    queue = StepQueue()
    fsm = BehaviorFsm()
    for behavior in (Behavior.STAND_PREP, Behavior.STAND, Behavior.STEP):
        fsm.go(behavior, "test")
    components = SimpleNamespace(
        robot=robot,
        fsm=fsm,
        step_queue=queue,
        whole_body=loop.controller,
        rejections=RejectionCounter(),
        soles=lambda: sole_poses(loop.state),
    )
    handler = FootstepPlanHandler(cast("Any", components))
    from_feet, from_true_feet = middle(*_believed(loop)), middle(*_true(loop))
    planned = [(FEET.index(step.foot), from_feet @ step.sole) for step in steps]
    reply = handler.handle(FootstepPlanRequest(steps=footsteps(steps, planned)), "test")
    if not reply.accepted:
        return Walked(reply.reason)
    loop.request.steps = queue
    began, landed, landing = loop.time, -1, (0.0, 0.0)
    bent = knees(robot)
    knee = math.inf

    def go_on() -> None:
        nonlocal knee
        loop.step()
        knee = min(knee, float(bent.flexion(loop.plant.joint_position).min()))

    while queue.running and loop.fall is None and loop.time - began < STEP_DURATION * len(steps):
        go_on()
        if queue.last_performed > landed:
            landed = queue.last_performed
            foot, sole = planned[landed]
            far, turned = _error(_believed(loop)[foot], sole)
            landing = (max(landing[0], far), max(landing[1], turned))
    duration, until = loop.time - began, loop.time + REST
    while loop.fall is None and loop.time < until:
        go_on()
    walked = Walked("", loop.fall, loop.command.qp_failures, duration, knee=knee)
    if loop.fall is not None or queue.state != "finished":
        return walked
    last = dict(planned)
    back = from_true_feet @ from_feet.inverse()
    believed = [_error(_believed(loop)[foot], sole) for foot, sole in last.items()]
    true = [_error(_true(loop)[foot], back @ sole) for foot, sole in last.items()]
    return replace(walked, landing=landing, believed=_largest(believed), true=_largest(true))


def footsteps(steps: Sequence[PlanStep], planned: Sequence[tuple[int, Pose]]) -> list[Footstep]:
    """Footsteps of a request, from steps and the foot and sole in odom of each."""
    return [
        Footstep(
            step_index=index,
            foot=foot,
            position_in_odom=np.array(sole.position),
            orientation_in_odom=np.array(sole.orientation),
            swing_height=step.swing_height,
            swing_duration=step.step_duration,
            transfer_duration=step.sway_duration,
        )
        for index, (step, (foot, sole)) in enumerate(zip(steps, planned, strict=True))
    ]


def _believed(loop: ClosedLoop) -> tuple[Pose, Pose]:
    left, right = sole_poses(loop.state)
    return _pose(left), _pose(right)


def _true(loop: ClosedLoop) -> tuple[Pose, Pose]:
    data, feet = loop.plant.data, loop.robot.tables.feet
    soles = [data.site(foot.sole) for foot in (feet.left, feet.right)]
    left, right = (SolePose(sole.xpos.copy(), sole.xmat.reshape(3, 3).copy()) for sole in soles)
    return _pose(left), _pose(right)


def _pose(sole: SolePose) -> Pose:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, sole.rotation.ravel())
    x, y, z = map(float, sole.position)
    qw, qx, qy, qz = map(float, quaternion)
    return Pose((x, y, z), (qw, qx, qy, qz))


def _error(sole: Pose, wanted: Pose) -> Error:
    return math.dist(sole.position, wanted.position), abs(math.remainder(sole.yaw - wanted.yaw, math.tau))


def _largest(errors: Sequence[Error]) -> Error:
    return max(far for far, _ in errors), max(turned for _, turned in errors)
