"""Plant and Whole-Body Controller in one process, without sockets: what a Motor and a Proprioceptor would carry.

The plant is the simulator's own, with an actuator profile's errors; the controller has the nominal model and sees
Proprioceptor alone. Every control period the command for period k answers the measurement at its start, as between the
real processes.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.messages import JointMode, Motor
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors
from valor.whole_body.balance.fall import FallDetector
from valor.whole_body.controller import WholeBodyController
from valor.whole_body.estimation.estimator import FloatingBaseEstimator
from valor.whole_body.state import RobotState, UpperBodyReference, WholeBodyCommand

MODES = {"force": JointMode.FORCE, "impedance": JointMode.IMPEDANCE, "position": JointMode.POSITION}


class ClosedLoop:
    """The robot in a world, standing under control.

    Attributes:
        state, command: of the last period.
        fall: the FallDetector's first word, and ``fall_time`` when it came [s]; None while it is silent.
        tick_times: of each period, estimator, fall detection and controller [s].
    """

    def __init__(self, robot: RobotDescription, profile: str = "ideal", seed: int = 0, world: str = "flat") -> None:
        self.robot = robot
        self.plant = Plant(robot, world, profile, seed)
        self.sensors = Sensors(robot, self.plant, robot.tables.actuators[profile].noise, seed)
        model = controller_model(robot)
        self.estimator = FloatingBaseEstimator(robot, model)
        self.controller = WholeBodyController(robot, model)
        self.detector = FallDetector(robot)
        n = len(robot.joints)
        self.reference = UpperBodyReference(robot.nominal_posture.copy(), np.zeros(n), np.zeros(n))
        self.state: RobotState
        self.command: WholeBodyCommand
        self.fall: str | None = None
        self.fall_time: float | None = None
        self.tick_times: list[float] = []
        self.sequence = 0
        control = [joint.control for joint in robot.tables.joints.values()]
        self._mode = np.array([MODES[word] for word in control], dtype=np.uint8)
        self._led = np.zeros(n, dtype=bool)  # by the controller
        self._led[model.joint_indices] = True
        impedance = self._mode == JointMode.IMPEDANCE
        self._stiffness = np.where(impedance, robot.servo_stiffness, 0.0)
        self._damping = np.where(impedance, robot.servo_damping, 0.0)
        self._substeps = round(robot.control_period / self.plant.step_time)
        self._started = False

    @property
    def time(self) -> float:
        """Robot time [s]."""
        return self.sequence * self.robot.control_period

    def settle(self, seconds: float, posture: FloatArray | None = None) -> None:
        """Hold a posture (nominal if none is given) on the joints' servos, as before control."""
        self.plant.actuators.hold(self.robot.nominal_posture if posture is None else posture)
        for _ in range(round(seconds / self.robot.control_period)):
            self.plant.step(self._substeps)
            self.sequence += 1

    def run(self, seconds: float, each: Callable[[ClosedLoop], None] | None = None) -> None:
        """Go on under control; ``each`` is called after every period."""
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
            self.controller.reset(state)
            self._started = True
        reason = self.detector.update(state, self.controller.footholds(state))
        self.command = command = self.controller.update(state, self.reference, self.robot.control_period)
        self.tick_times.append(perf_counter() - began)
        if reason is not None and self.fall is None:
            self.fall, self.fall_time = reason, self.time
        position = np.where(self._led, command.position, self.reference.position)
        self._obey(
            self._mode,
            position=position,
            velocity=command.velocity,
            effort=command.effort,
            stiffness=self._stiffness,
            damping=self._damping,
        )

    def limp(self) -> None:
        """One period after a fall: no effort, only damping."""
        none = np.zeros(len(self.robot.joints))
        compliant = self._mode != JointMode.POSITION
        mode = np.where(compliant, JointMode.FORCE, JointMode.OFF).astype(np.uint8)
        damping = np.where(compliant, self.robot.servo_damping, 0.0)
        self._obey(mode, position=none, velocity=none, effort=none, stiffness=none, damping=damping)

    def _obey(
        self,
        mode: npt.NDArray[np.uint8],
        *,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray,
        stiffness: FloatArray,
        damping: FloatArray,
    ) -> None:
        """Send a Motor's drive and let the plant go on by one period."""
        self.sequence += 1
        motor = Motor(
            time=round(self.time * 1e9),
            sequence=self.sequence,
            proprioceptor_sequence=self.sequence - 1,
            mode=mode,
            position=position,
            velocity=velocity,
            effort=effort,
            stiffness=stiffness,
            damping=damping,
            behavior=Behavior.STAND,
            writer=1,
        )
        self.plant.actuators.obey(motor)
        self.plant.step(self._substeps)
