"""A robot in one process that falls and gets up."""

from __future__ import annotations

from functools import cached_property

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.get_up_planning.rollouts import topple
from valor.robot.get_up_table import Posture
from valor.self_test import robot_in_process

LYING = 3.0  # after a fall [s]
STANDING = 2.0  # in Stand, at the end [s]


class RobotInProcess(robot_in_process.RobotInProcess):
    """A robot in a world under its Motion Manager."""

    @cached_property
    def peak(self) -> FloatArray:
        """(n,) largest torque of each joint [N·m]; set it to zero to begin anew."""
        return np.zeros_like(self.plant.actuators.effort)

    def step(self) -> None:
        """One control period."""
        super().step()
        np.maximum(self.peak, np.abs(self.plant.actuators.effort), out=self.peak)

    def fall(self, push: tuple[float, float, float]) -> None:
        """Stand, be pushed over, lie still."""
        assert not (refused := self.stand_up()), refused
        self.run(0.5)
        self.plant.push(np.array(push), 0.1)
        assert self.run_until(lambda: self.behavior is Behavior.FALL, 3.0)
        self.run(LYING)

    def lie_face_down(self) -> None:
        """Fallen, as it lies after a push from behind: put there, limp."""
        self.step()
        for behavior in (Behavior.STAND, Behavior.FALL):
            self.manager.fsm.go(behavior, "put on the floor")
        model, data = self.plant.model, self.plant.data
        data.qpos[:7] = (0.0, 0.0, 0.15, 0.5**0.5, 0.0, 0.5**0.5, 0.0)
        data.qvel[:] = 0.0
        mujoco.mj_forward(model.mj, data)
        self.run(1.0)

    def topple(self, way: Posture, seed: int) -> None:
        """Fallen towards a side from any posture of the arms, much as it falls when pushed: put there tilted, limp."""
        self.step()
        for behavior in (Behavior.STAND, Behavior.FALL):
            self.manager.fsm.go(behavior, "toppled")
        topple(self.plant.model, self.plant.data, way, np.random.default_rng(seed))
        mujoco.mj_forward(self.plant.model.mj, self.plant.data)
        self.run(LYING)

    def get_up(self) -> str:
        """Get up and stand: what came in between, or an empty text."""
        self.peak[:] = 0.0
        if refused := self.ask(Behavior.GET_UP):
            return f"refused: {refused}"
        self.run_until(lambda: self.behavior is not Behavior.GET_UP, 120.0)
        return "" if self.behavior is Behavior.STAND_PREP else self.manager.fsm.reason

    def stand(self) -> str:
        """From Stand Prep to Stand, for a while: what came in between, or an empty text."""
        if refused := self.stand_up():
            return refused
        self.run(STANDING)
        return "" if self.behavior is Behavior.STAND else self.manager.fsm.reason
