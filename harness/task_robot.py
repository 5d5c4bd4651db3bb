"""A task done in one process, as an operator would: steps to a stance, fingers to a preset, hand goals in odom."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from harness.manipulating_robot import ManipulatingRobot
from valor.common.behaviors import Behavior
from valor.common.messages import FootstepPlanRequest, HandGoalStatus
from valor.common.poses import Pose, middle
from valor.manipulation.known import TASKS
from valor.manipulation.plan import REACHED, RESISTED, HandMove
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.robot.description import RobotDescription
from valor.robot.footsteps import FEET
from valor.robot.step_plan import plan_to
from valor.self_test.plan_walk import footsteps
from valor.simulation import worlds

SETTLED = 1.5  # from the last step, or a behavior, to what comes next [s]
STEPPING = 3.0  # that no step takes longer [s]
RIGHT = 1


@dataclass
class Outcome:
    """What became of a task.

    Attributes:
        turned: of the fixture at the end, by the simulator [rad].
        time: from the first step to the last goal [robot time, s].
        fell: whether the robot did.
        reason: why it ended early, or an empty text.
        states: of the hand, after each goal.
    """

    task: str
    turned: float = 0.0
    time: float = 0.0
    fell: bool = False
    reason: str = ""
    states: list[tuple[str, str]] = field(default_factory=list)

    @property
    def done(self) -> bool:
        """True if it was."""
        return not self.reason and self.turned >= TASKS[self.task].enough


class TaskRobot(ManipulatingRobot):
    """A robot before a door or a valve."""

    def __init__(self, robot: RobotDescription, profile: str, seed: int, task: str, *, shut: bool = False) -> None:
        self._task, self.plan = task, TASKS[task].plan(robot, seed)
        super().__init__(robot, profile, seed, world=TASKS[task].blocked if shut else task)

    def turned(self, joint: str) -> float:
        """Of the world's, by the simulator [rad]."""
        return float(self.plant.data.joint(f"{worlds.PREFIX}{joint}").qpos[0])

    def do(self, each: Callable[[str], None] = lambda _: None) -> Outcome:
        """Carry the task out; ``each`` is told what is done next."""
        outcome, began = Outcome(self._task), self.time
        each("walk up")
        outcome.reason = self._walk_up() or self._manipulate(outcome, each)
        if self.behavior is Behavior.FALL:
            outcome.fell, outcome.reason = True, f"fell: {self.manager.fsm.reason}"
        outcome.turned, outcome.time = self.turned(TASKS[self._task].fixture), self.time - began
        return outcome

    def _walk_up(self) -> str:
        """By footsteps to the stance: why it did not get there."""
        for behavior in (Behavior.STAND, Behavior.STEP):
            if not self.run_until(lambda: not self.ask(behavior), 5.0):  # noqa: B023
                return self.ask(behavior)
            self.run(0.5)
        soles = [_pose(sole.position, sole.rotation) for sole in self.manager.components.soles()]
        here, limits = middle(soles[0], soles[1]), self.robot.tables.footsteps
        assert limits is not None
        x, y, yaw = self.plan.stance
        goal = here.inverse() @ Pose((x, y, 0.0), (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))
        steps = plan_to((*goal.position[:2], goal.yaw), limits, self.robot.tables.walking)
        placed = [(FEET.index(step.foot), here @ step.sole) for step in steps]
        request = FootstepPlanRequest(steps=footsteps(steps, placed))
        reply = FootstepPlanHandler(self.manager.components).handle(request, "benchmark")
        if not reply.accepted:
            return reply.reason
        ended = (Behavior.STAND, Behavior.FALL)
        if not self.run_until(lambda: self.behavior in ended, STEPPING * (len(steps) + 2)):
            return "the steps did not end"
        self.run(SETTLED)
        return ""

    def _manipulate(self, outcome: Outcome, each: Callable[[str], None]) -> str:
        if not self.run_until(lambda: not self.ask(Behavior.STAND_MANIPULATE), 5.0):
            return self.ask(Behavior.STAND_MANIPULATE)
        self.run(SETTLED)
        preset = self.robot.tables.hand_presets[self.plan.fingers]["right"]
        joints = np.array([self.robot.index[name] for name in preset])
        self.follow(joints, np.array(list(preset.values())))
        free = self.plan.moves[0]
        for move in self.plan.moves:
            each(move.name)
            status = self._lead(move)
            outcome.states.append((move.name, status.state))
            free = move if status.state == REACHED else free
            if status.state == RESISTED:
                for retreat in self.plan.retreat(free):
                    each(retreat.name)
                    outcome.states.append((retreat.name, self._lead(retreat).state))
                return f"{move.name}: {self.plan.resisted}: {status.reason}"
            if self.behavior is not Behavior.STAND_MANIPULATE:
                return f"{self.behavior}: {self.manager.fsm.reason}"
        return ""

    def _lead(self, move: HandMove) -> HandGoalStatus:
        """The hand to a goal, reached or not."""
        goals = self.manager.components.hand_goals
        self.send(RIGHT, np.array(move.hand.position), np.array(move.hand.rotation))
        self.step()
        self.run_until(lambda: goals.status(RIGHT, 0).state != "moving", move.patience)
        return goals.status(RIGHT, 0)


def _pose(position: np.ndarray, rotation: np.ndarray) -> Pose:
    x, y, z = map(float, position)
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return Pose((x, y, z), (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))
