"""Acceptance tests of a controller beside the Whole-Body Controller: it takes over, is pushed, walks and gives back."""

from collections.abc import Callable, Iterator
from functools import partial

import msgspec
import numpy as np

from valor.common.behaviors import Behavior
from valor.control.controller import ControllerFactory
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY, Controllers
from valor.self_test.acceptance import DIRECTIONS, PUSH, RECOVERY, WALK, push_impulse, walking_speed
from valor.self_test.results import AcceptanceResult
from valor.self_test.robot_in_process import RobotInProcess
from valor.simulation.plant import SimulationDivergedError

STAND = 3.0  # under its control [s]
EXCHANGE = 5.0  # longest duration [s]
_WAY = (0.5, 1.5)  # length of a walk, share of the requested length


class ControllerTest:
    """The acceptance tests of a controller on a robot under one actuator profile."""

    def __init__(self, robot: RobotDescription, profile: str, name: str, make: ControllerFactory) -> None:
        names = [WHOLE_BODY, name]
        tables = msgspec.structs.replace(robot.tables, controllers=Controllers(stand=names, walk=names))
        self._robot = RobotDescription(robot.folder, tables)
        self._profile, self._name, self._make = profile, name, make
        self._speed = walking_speed(robot)

    def tests(self) -> Iterator[tuple[str, Callable[[], AcceptanceResult]]]:
        """Name and function of each test."""
        tests: dict[str, Callable[[RobotInProcess], tuple[str, str]]] = {
            "take over": self._stand,
            **{f"push {name}": partial(self._push, direction) for name, direction in DIRECTIONS.items()},
            Behavior.WALK: self._walk,
            "give back": self._give_back,
        }
        for name, test in tests.items():
            yield name, partial(self._run, name, test)

    def _run(self, name: str, test: Callable[[RobotInProcess], tuple[str, str]]) -> AcceptanceResult:
        robot = RobotInProcess(self._robot, self._profile, 0, others=[self._make])
        measured = ""
        try:
            reason = self._take_over(robot)
            if not reason:
                reason, measured = test(robot)
        except SimulationDivergedError as error:
            reason = str(error)
        return AcceptanceResult(self._profile, name, not reason, reason, measured)

    def _take_over(self, robot: RobotInProcess) -> str:
        exchange = robot.manager.components.exchange
        if refused := robot.stand_up():
            return refused
        robot.run(1.0)
        if refusal := exchange.choose(self._name, robot.manager.components.state):
            return refusal
        robot.run_until(lambda: exchange.active.name == self._name or not exchange.pending, EXCHANGE)
        robot.run(STAND)
        return self._lost(robot, self._name)

    def _lost(self, robot: RobotInProcess, name: str) -> str:
        """Reason why a controller is not in control; empty if it is."""
        exchange = robot.manager.components.exchange
        if robot.behavior is Behavior.FALL:
            return f"fell: {robot.manager.fsm.reason}"
        return "" if exchange.active.name == name else exchange.reason

    def _stand(self, robot: RobotInProcess) -> tuple[str, str]:
        return "", f"height {robot.plant.data.qpos[2]:.3f} m"

    def _push(self, direction: tuple[float, float, float], robot: RobotInProcess) -> tuple[str, str]:
        impulse = push_impulse(robot.plant)
        robot.plant.push(impulse * np.array(direction), PUSH)
        robot.run(RECOVERY)
        return self._lost(robot, self._name), f"{impulse:.1f} N·s"

    def _walk(self, robot: RobotInProcess) -> tuple[str, str]:
        if refusal := robot.ask(Behavior.WALK):
            return refusal, ""
        start = robot.plant.data.qpos[:2].copy()
        robot.walk((self._speed, 0.0, 0.0), WALK)
        way, asked = float(np.hypot(*(robot.plant.data.qpos[:2] - start))), self._speed * WALK
        measured = f"{way:.2f} m of {asked:.2f}, {self._speed:.2f} m/s"
        reason = self._lost(robot, self._name)
        if not reason and not _WAY[0] * asked < way < _WAY[1] * asked:
            reason = f"walked {measured}"
        return reason, measured

    def _give_back(self, robot: RobotInProcess) -> tuple[str, str]:
        if refusal := robot.ask(Behavior.WALK):
            return refusal, ""
        robot.walk((self._speed, 0.0, 0.0), 0.3 * WALK)
        components = robot.manager.components
        asked = robot.time
        if refusal := components.exchange.choose(WHOLE_BODY, components.state):
            return refusal, ""
        while components.exchange.active.name != WHOLE_BODY and robot.time < asked + EXCHANGE:
            robot.walk((self._speed, 0.0, 0.0), self._robot.control_period)
        taken = robot.time - asked
        robot.walk((self._speed, 0.0, 0.0), 0.3 * WALK)
        return self._lost(robot, WHOLE_BODY), f"after {taken:.1f} s, walking on"
