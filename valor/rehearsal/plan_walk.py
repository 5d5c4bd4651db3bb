"""A footstep plan walked in one process: the Motion Manager's handler and queue, controller and plant in a loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import mujoco
import numpy as np

from valor.common.behaviors import Behavior
from valor.common.messages import Footstep, FootstepPlanRequest
from valor.common.poses import Pose, middle
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.rehearsal.closed_loop import ClosedLoop
from valor.robot.description import RobotDescription
from valor.robot.footsteps import FEET
from valor.robot.legs import knees
from valor.whole_body.walking.gait import sole_poses
from valor.whole_body.walking.step_queue import StepQueue
from valor.whole_body.walking.swing import SolePose

STEP_DURATION = 10.0  # no step takes longer, with the weight's transfer [s]
REST = 1.0  # after the last step, before the feet are looked at [s]

Error = tuple[float, float]  # distance [m], turn [rad]


class PlannedStep(Protocol):
    """One step of a plan, in the plan's frame; heights and durations of 0 are the robot's own."""

    @property
    def foot(self) -> str:
        """Left or right."""

    @property
    def sole(self) -> Pose:
        """Where it comes to stand."""

    @property
    def swing_height(self) -> float:
        """[m]."""

    @property
    def step_duration(self) -> float:
        """Of the swing [s]."""

    @property
    def sway_duration(self) -> float:
        """Of the double support before it [s]."""


@dataclass(frozen=True)
class Walked:
    """What became of a plan.

    Attributes:
        refusal: the Motion Manager's, or an empty text.
        fall: the fall detector's word, or None.
        qp_failures: periods whose QP had no solution.
        duration: from the plan to rest [s].
        landing: largest error with which a foot came down, as the robot believes.
        believed: of the feet at rest from the plan, as the robot believes.
        true: likewise by the simulator, both measured from the feet as they stood at the start.
        dcm_error: (3,) RMS of the DCM's error [m].
        knee: smallest angle of a knee [rad].
    """

    refusal: str
    fall: str | None = None
    qp_failures: int = 0
    duration: float = 0.0
    landing: Error = (math.inf, math.inf)
    believed: Error = (math.inf, math.inf)
    true: Error = (math.inf, math.inf)
    dcm_error: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    knee: float = 0.0

    @property
    def done(self) -> bool:
        """Whether it came to rest at the plan's end without a fall and without an infeasible QP."""
        return not self.refusal and self.fall is None and self.qp_failures == 0 and math.isfinite(self.believed[0])


def walk_plan(
    robot: RobotDescription,
    steps: Sequence[PlannedStep],
    *,
    world: str = "flat",
    profile: str = "hardware",
    seed: int = 0,
) -> Walked:
    """Stand up, and walk a plan that is given in the frame of the feet as they stand."""
    loop = ClosedLoop(robot, profile, seed, world)
    loop.settle(0.3)
    loop.run(2.0)
    return take_plan(loop, steps)


def take_plan(loop: ClosedLoop, steps: Sequence[PlannedStep]) -> Walked:
    """Likewise, of a robot that stands."""
    robot = loop.robot
    queue = StepQueue()
    fsm = BehaviorFsm()
    for behavior in (Behavior.STAND_PREP, Behavior.STAND, Behavior.STEP):
        fsm.go(behavior, "test")
    handler = FootstepPlanHandler(
        robot, fsm, queue, Rejections(), lambda: sole_poses(loop.state), recovering=lambda: loop.controller.recovering
    )
    from_feet, from_true_feet = middle(*_believed(loop)), middle(*_true(loop))
    planned = [(FEET.index(step.foot), from_feet @ step.sole) for step in steps]
    reply = handler.handle(FootstepPlanRequest(steps=footsteps(steps, planned)), "test")
    if not reply.accepted:
        return Walked(reply.reason)
    loop.controller.step_source = queue
    began, landed, landing = loop.time, -1, (0.0, 0.0)
    errors: list[np.ndarray] = []
    bent = knees(robot)
    knee = math.inf

    def go_on() -> None:
        nonlocal knee
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
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
    x, y, z = map(float, np.sqrt(np.square(errors).mean(axis=0)))
    walked = Walked("", loop.fall, loop.command.qp_failures, duration, dcm_error=(x, y, z), knee=knee)
    if loop.fall is not None or queue.state != "finished":
        return walked
    last = dict(planned)
    back = from_true_feet @ from_feet.inverse()
    believed = [_error(_believed(loop)[foot], sole) for foot, sole in last.items()]
    true = [_error(_true(loop)[foot], back @ sole) for foot, sole in last.items()]
    return replace(walked, landing=landing, believed=_largest(believed), true=_largest(true))


def footsteps(steps: Sequence[PlannedStep], planned: Sequence[tuple[int, Pose]]) -> list[Footstep]:
    """As a request has them: steps, and the foot and sole in odom of each."""
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
