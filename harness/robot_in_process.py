"""Plant and Motion Manager in one process, without sockets: behaviors are asked for, Motors obeyed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest, Motor, Proprioceptor
from valor.control.controller import ControllerFactory
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.manager import MotionManager
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors

LYING = 3.0  # after a fall [s]
STANDING = 2.0  # in Stand, at the end [s]


class RobotInProcess:
    """A robot in a world with the Motion Manager that drives it, without sockets.

    Attributes:
        peak: (n,) largest torque of each joint [N·m]; set it to zero to begin anew.
        measured: what the sensors said in the last period, and motor: what was made of it.
        each: called in every period, once both are there.
    """

    measured: Proprioceptor
    motor: Motor

    def __init__(
        self,
        robot: RobotDescription,
        profile: str,
        seed: int,
        world: str = "flat",
        others: Sequence[ControllerFactory] = (),
    ) -> None:
        self.plant = Plant(robot, world, profile, seed)
        self.manager = MotionManager(robot, controller_model(robot), others)
        self.peak: FloatArray = np.zeros(len(robot.joints))
        self._sensors = Sensors(robot, self.plant, robot.tables.actuators[profile].noise, seed)
        self._period = robot.control_period
        self._substeps = round(robot.control_period / self.plant.step_time)
        self._sequence = 0
        self.each: Callable[[], None] | None = None

    @property
    def time(self) -> float:
        """Robot time [s]."""
        return self._sequence * self._period

    @property
    def behavior(self) -> Behavior:
        """Of the Motion Manager."""
        return self.manager.fsm.behavior

    def ask(self, behavior: Behavior) -> str:
        """Ask for a behavior: why it was refused, or an empty text."""
        reply = BehaviorHandler(self.manager.components).handle(BehaviorRequest(behavior), "benchmark")
        return "" if reply.accepted else reply.reason

    def step(self) -> None:
        """One control period."""
        self._sequence += 1
        self.measured = self._sensors.measure(self._sequence, round(self.time * 1e9))
        self.motor = self.manager.tick(self.measured)
        if self.each is not None:
            self.each()
        self.plant.actuators.obey(self.motor)
        self.plant.step(self._substeps)
        np.maximum(self.peak, np.abs(self.plant.actuators.effort), out=self.peak)

    def run(self, seconds: float) -> None:
        """So long."""
        for _ in range(round(seconds / self._period)):
            self.step()

    def run_until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Until a condition holds, at most so long; whether it came to hold."""
        for _ in range(round(seconds / self._period)):
            if condition():
                return True
            self.step()
        return condition()

    def fall(self, push: tuple[float, float, float]) -> None:
        """Stand, be pushed over, lie still."""
        assert self.run_until(lambda: not self.ask(Behavior.STAND), 10.0), self.ask(Behavior.STAND)
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

    def get_up(self) -> str:
        """Get up and stand: what came in between, or an empty text."""
        self.peak[:] = 0.0
        if refused := self.ask(Behavior.GET_UP):
            return f"refused: {refused}"
        self.run_until(lambda: self.behavior is not Behavior.GET_UP, 60.0)
        return "" if self.behavior is Behavior.STAND_PREP else self.manager.fsm.reason

    def stand(self) -> str:
        """From Stand Prep to Stand, for a while: what came in between, or an empty text."""
        if not self.run_until(lambda: not self.ask(Behavior.STAND), 10.0):
            return self.ask(Behavior.STAND)
        self.run(STANDING)
        return "" if self.behavior is Behavior.STAND else self.manager.fsm.reason
