"""Plant and Motion Manager in one process, without sockets: behaviors are requested, Motors executed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bifrost import Received
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest, Motor, Proprioceptor, VelocityCommand
from valor.control.controller import ControllerFactory
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.handlers.motion import VelocityHandler
from valor.motion_manager.manager import MotionManager
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors

_CLIENT = "self_test"


class RobotInProcess:
    """A robot in a world under its Motion Manager.

    Attributes:
        measured: Proprioceptor of the last period. motor: the Motor computed from it.
        each: called in every period once both are there.
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
        """``others``: controllers beside the Whole-Body Controller."""
        self.plant = Plant(robot, world, profile, seed)
        self.manager = MotionManager(robot, controller_model(robot), others)
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
        """Behavior of the Motion Manager."""
        return self.manager.fsm.behavior

    def ask(self, behavior: Behavior) -> str:
        """Request a behavior; returns the reason of a rejection, or an empty text."""
        reply = BehaviorHandler(self.manager.components).handle(BehaviorRequest(behavior), _CLIENT)
        return "" if reply.accepted else reply.reason

    def stand_up(self) -> str:
        """Change to Stand as soon as it is accepted; returns the reason why it is not within 10 s, or an empty text."""
        return "" if self.run_until(lambda: not self.ask(Behavior.STAND), 10.0) else self.ask(Behavior.STAND)

    def step(self) -> None:
        """One control period."""
        self._sequence += 1
        self.measured = self._sensors.measure(self._sequence, round(self.time * 1e9))
        self.motor = self.manager.tick(self.measured)
        if self.each is not None:
            self.each()
        self.plant.actuators.obey(self.motor)
        self.plant.step(self._substeps)

    def run(self, seconds: float) -> None:
        """Run for a time."""
        for _ in range(round(seconds / self._period)):
            self.step()

    def run_until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Run until a condition holds, at most for a time; returns whether it holds."""
        for _ in range(round(seconds / self._period)):
            if condition():
                return True
            self.step()
        return condition()

    def walk(self, velocity: tuple[float, float, float], seconds: float) -> None:
        """Walk for a time: forward, left [m/s], turning left [rad/s]."""
        for _ in range(round(seconds / self._period)):
            if self.behavior.locomotion.stepping:
                command = Received(VelocityCommand(self.manager.time, *velocity), 0, 1, "valor_ros_controller")
                VelocityHandler(self.manager.components).handle(command, self.manager.time)
            self.step()
