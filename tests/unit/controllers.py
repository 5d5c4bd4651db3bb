"""Controllers for tests of their exchange."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from valor.common.behaviors import Locomotion
from valor.control.controller import Controller, JointCommand, Request
from valor.control.state import RobotState
from valor.robot.description import RobotDescription


class Statue(Controller):
    """Servos hold legs and waist as they were, with the torques that they had."""

    name = "statue"
    states = frozenset({Locomotion.STAND, Locomotion.WALK})

    def __init__(self, robot: RobotDescription) -> None:
        self.robot, self.seconds = robot, 0.0
        self.joints = np.zeros(len(robot.joints), dtype=bool)
        for group in ("left_leg", "right_leg", "torso"):
            self.joints[robot.group_indices(group)] = True

    @property
    def at_rest(self) -> bool:
        return True

    def begin(self, state: RobotState, last: JointCommand | None) -> None:
        assert last is not None
        self.seconds, zeros = 0.0, np.zeros_like(last.effort)
        effort = np.clip(last.effort, -self.robot.effort_limit, self.robot.effort_limit)
        self.held = JointCommand(
            state.joint_position.copy(), zeros, effort, self.robot.servo_stiffness, self.robot.servo_damping
        )

    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        self.seconds += dt
        return self.held


class Spoiled(Statue):
    """A statue that goes wrong after ``sound`` [s]."""

    name = "spoiled"

    def __init__(self, robot: RobotDescription, spoil: Spoil, sound: float = 1.0) -> None:
        super().__init__(robot)
        self._spoil, self._sound, self.rng = spoil, sound, np.random.default_rng(0)

    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        command = super().update(state, request, dt)
        assert command is not None
        return self._spoil(self, command, state) if self.seconds > self._sound else command


Spoil = Callable[[Spoiled, JointCommand, RobotState], JointCommand | None]


def _raises(spoiled: Spoiled, command: JointCommand, state: RobotState) -> JointCommand:
    raise ValueError("lost its mind")


def _sleeps(spoiled: Spoiled, command: JointCommand, state: RobotState) -> JointCommand:
    time.sleep(3.0 * spoiled.robot.control_period)
    return command


def _spikes(spoiled: Spoiled, command: JointCommand, state: RobotState) -> JointCommand:
    if spoiled.rng.random() < 0.95:
        return command
    return replace(command, position=command.position + spoiled.rng.choice((-1.0, 1.0), command.position.size))


def _drifts(spoiled: Spoiled, command: JointCommand, state: RobotState) -> JointCommand:
    away = np.zeros_like(command.position)
    for side in "lr":
        away[spoiled.robot.index[f"{side}_ankle_pitch"]] = 0.3 * (spoiled.seconds - 1.0)
    return replace(command, position=command.position + away)


def _reverses(spoiled: Spoiled, command: JointCommand, state: RobotState) -> JointCommand:
    return replace(command, position=2.0 * state.joint_position - command.position)


def _kicks(spoiled: Spoiled, command: JointCommand, state: RobotState) -> JointCommand:
    return replace(command, effort=command.effort + 5.0 * spoiled.robot.effort_limit)


SPOILED: dict[str, tuple[Spoil, str]] = {
    "not a number": (lambda s, c, x: replace(c, position=np.full_like(c.position, np.nan)), "is not finite"),
    "infinite gains": (lambda s, c, x: replace(c, stiffness=np.full_like(c.stiffness, np.inf)), "is not finite"),
    "negative damping": (lambda s, c, x: replace(c, damping=-c.damping), "is negative"),
    "wrong size": (lambda s, c, x: replace(c, effort=c.effort[:-1]), "has the shape"),
    "exception": (_raises, "ValueError: lost its mind"),
    "silence": (lambda s, c, x: None, "no command for"),
    "sleep": (_sleeps, "ms; expected at most"),
    "spikes": (_spikes, "expected at most"),
    "kick": (_kicks, "effort limit; expected"),
    "drift": (_drifts, "outside the support polygon"),
    "reversed": (_reverses, ""),
    "no torque": (lambda s, c, x: replace(c, effort=0.0 * c.effort, stiffness=0.0 * c.stiffness), ""),
}
"""Defect → how a command gets it, and part of the fault to be named."""
