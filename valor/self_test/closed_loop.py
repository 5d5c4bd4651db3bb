"""Plant and Whole-Body Controller in one process, without sockets.

The plant has the errors of an actuator profile; the controller has the nominal model and receives only Proprioceptor.
The command for period k is computed from the measurement at its start, as between the processes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from time import perf_counter

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.control.controller import JointTargets, Request
from valor.control.estimation.estimator import FloatingBaseEstimator
from valor.control.fall import FallDetector
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.robot.checks.stance import Stance
from valor.robot.description import RobotDescription
from valor.robot.legs import knees
from valor.robot.model import controller_model
from valor.robot.tables import SIDES
from valor.self_test.results import Measurements
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors
from valor.whole_body.command import WholeBodyCommand
from valor.whole_body.controller import WholeBodyController

_AT_LIMIT = 0.999  # share of an effort limit


class ClosedLoop:
    """Robot in a world, under control."""

    def __init__(self, robot: RobotDescription, profile: str = "ideal", seed: int = 0, world: str = "flat") -> None:
        self.robot = robot
        self.plant = Plant(robot, world, profile, seed)
        self.sensors = Sensors(robot, self.plant, robot.tables.actuators[profile].noise, seed)
        model = controller_model(robot)
        self.estimator = FloatingBaseEstimator(robot, model)
        self.controller = WholeBodyController(robot, self.estimator.kinematics)
        self.detector = FallDetector(robot)
        n = len(robot.joints)
        self.reference = JointTargets(
            robot.nominal_posture.copy(), np.zeros(n), np.zeros(n), robot.servo_stiffness, robot.servo_damping
        )
        self.request = Request(self.reference)  # its steps are taken
        self.state: RobotState  # of the last period
        self.command: WholeBodyCommand  # of the last period
        self.fall: str | None = None  # first reason of the FallDetector; None before
        self.tick_times: list[float] = []  # computing time of each period: estimator, fall detection and controller [s]
        self.sequence = 0
        self._motors = MotorCommand(robot)
        self._no_effort = np.zeros(n)
        self.substeps = round(robot.control_period / self.plant.step_time)  # of the plant in a period
        self._started = False

    @property
    def time(self) -> float:
        """Robot time [s]."""
        return self.sequence * self.robot.control_period

    def settle(self, seconds: float, posture: FloatArray | None = None) -> None:
        """Hold a posture, nominal by default, on the joints' servos without the controller."""
        self.plant.actuators.hold(self.robot.nominal_posture if posture is None else posture)
        for _ in range(round(seconds / self.robot.control_period)):
            self.plant.step(self.substeps)
            self.sequence += 1

    def run(self, seconds: float, each: Callable[[ClosedLoop], None] | None = None) -> None:
        """Run under control; ``each`` is called after every period."""
        for _ in range(round(seconds / self.robot.control_period)):
            self.step()
            if each is not None:
                each(self)

    def step(self) -> None:
        """One control period."""
        measured = self.sensors.measure(self.sequence, round(self.time * 1e9))
        began = perf_counter()
        self.state = state = self.estimator.update(measured)
        if not self._started:
            self.controller.begin(state)
            self._started = True
        reason = self.detector.update(state, self.controller.footholds(state))
        self.command = command = self.controller.update(state, self.request, self.robot.control_period)
        self.tick_times.append(perf_counter() - began)
        if reason is not None and self.fall is None:
            self.fall = reason
        reference = self.reference
        self._motors.balance(command, reference.position, reference.velocity, self._no_effort, 1.0)
        self.sequence += 1
        time = round(self.time * 1e9)
        self.plant.actuators.obey(self._motors.message(time, self.sequence, self.sequence - 1, Behavior.STAND))
        self.plant.step(self.substeps)


def leg_length(robot: RobotDescription) -> float:
    """Length of the shorter straight leg, hip to sole [m]."""
    stance = Stance(robot)
    lengths = []
    for side in SIDES:
        ankle = stance.data.joint(stance.pitch_joints(side)[-1]).xanchor
        sole, _ = stance.site(stance.foot(side).sole)
        lengths.append(stance.leg_length(side) + float(ankle[2] - sole[2]))
    return min(lengths)


class MeasuredLoop(ClosedLoop):
    """Closed loop with ``Measurements`` since the latest ``begin``."""

    def __init__(self, robot: RobotDescription, profile: str, seed: int = 0) -> None:
        super().__init__(robot, profile, seed)
        self._knees = knees(robot).indices
        self._limit = _AT_LIMIT * robot.effort_limit
        self.begin()

    def begin(self) -> None:
        """Clear all measurements."""
        self._start: FloatArray = self.plant.data.qpos[:2].copy()
        self._periods = 0
        self._tilt, self._knee_margin = 0.0, math.inf
        self._squares: FloatArray = np.zeros(3)
        self._at_limit: FloatArray = np.zeros(len(self.robot.joints))
        self._solved_until = self.command.qp_failures if self._started else 0

    @property
    def tilt(self) -> float:
        """Angle of the base from upright [rad]."""
        _, x, y, _ = self.plant.data.qpos[3:7].tolist()
        return math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y)))

    def _measure(self) -> None:
        self._tilt = max(self._tilt, self.tilt)
        position = self.plant.joint_position[self._knees]
        margin = np.minimum(position - self.robot.lower[self._knees], self.robot.upper[self._knees] - position)
        self._knee_margin = min(self._knee_margin, float(margin.min()))

    def settle(self, seconds: float, posture: FloatArray | None = None) -> None:
        super().settle(seconds, posture)
        self._measure()

    def step(self) -> None:
        super().step()
        self._periods += 1
        self._measure()
        self._squares += np.square(self.state.dcm_in_odom - self.command.dcm_reference_in_odom)
        self._at_limit += np.abs(self.plant.actuators.effort) >= self._limit

    def measurements(self) -> Measurements:
        """Measurements since ``begin``."""
        periods = max(1, self._periods)
        shares = dict(zip(self.robot.joints, (self._at_limit / periods).tolist(), strict=True))
        return Measurements(
            tilt=self._tilt,
            dcm_error=float(np.sqrt(self._squares / periods).max()) if self._periods else None,
            distance=float(np.hypot(*(self.plant.data.qpos[:2] - self._start))),
            knee_margin=self._knee_margin if math.isfinite(self._knee_margin) else None,
            at_limit={name: share for name, share in shares.items() if share > 0},
            unsolved=self.command.qp_failures - self._solved_until if self._started else 0,
        )
