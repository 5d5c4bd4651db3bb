"""The balance reflex: what brings a robot to stand that nobody leads any more.

A robot in the middle of a step cannot be held: its DCM is on the way from foot to foot. Whoever hands Motors out
therefore keeps this, for when the Motion Manager falls silent. It knows nothing of what the Motion Manager had in mind:
it looks at the robot, and balances it with the Whole-Body Controller. A foot in the air comes down where the DCM needs
it, closing steps follow until both feet stand side by side, and then the robot is at rest and can be held.
"""

from __future__ import annotations

from math import hypot

import numpy as np

from valor.common.behaviors import BALANCING, REFLEX, STEPPING, WALKING, Behavior
from valor.common.messages import Motor, Proprioceptor
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.whole_body.balance.fall import FallDetector
from valor.whole_body.controller import WholeBodyController
from valor.whole_body.estimation.estimator import FloatingBaseEstimator
from valor.whole_body.motor_command import MotorCommand
from valor.whole_body.state import QpStatus, UpperBodyReference
from valor.whole_body.watchdog import ProprioceptorWatchdog

LONGEST = 5.0  # that it drives the robot [s]
SETTLED = 0.5  # at rest for so long, it is done [s]
STILL = 0.03  # of the CoM: slower than this it is at rest [m/s]
FAULTY = 0.01  # without a believable Proprioceptor or a solution, after which it gives up [s]
LIFTED = 0.02  # of the robot's weight: a foot that carries less is in the air


class BalanceReflex:
    """Balances a robot from wherever it is found until it stands still on both feet.

    Attributes:
        done: it has nothing more to do: the robot is to be held, or was let go for it falls.
        outcome: why, in words.
        time: for how long it drives, or drove [s].
        peak: of the DCM's distance from its reference meanwhile [m].
    """

    def __init__(self, robot: RobotDescription) -> None:
        model = controller_model(robot)
        n = len(robot.joints)
        self._period = robot.control_period
        self._most_faults = round(FAULTY / robot.control_period)
        self._estimator = FloatingBaseEstimator(robot, model)
        self._controller = WholeBodyController(robot, model)
        self._detector = FallDetector(robot)
        self._command = MotorCommand(robot)
        self._watchdog = ProprioceptorWatchdog(n)
        self._lifted = LIFTED * self._estimator.dynamics.mass * self._estimator.dynamics.gravity
        self._zeros = np.zeros(n)
        self._sequence = self._faults = 0
        self._behavior: str = REFLEX
        self._upper_body = self._zeros  # where its joints stay [rad]
        self._still = 0.0  # for how long the robot has been at rest [s]
        self.time = self.peak = 0.0
        self._found = False
        self.done = True
        self.outcome = ""

    def needed(self, behavior: str, proprioceptor: Proprioceptor) -> bool:
        """Whether a robot left in ``behavior`` cannot simply be held: it steps, or balances with a foot in the air."""
        carried = min(float(proprioceptor.left_foot_wrench[2]), float(proprioceptor.right_foot_wrench[2]))
        return behavior in STEPPING | WALKING or (behavior in BALANCING and carried < self._lifted)

    @property
    def limp(self) -> bool:
        """Whether it has let the robot go."""
        return self._behavior == Behavior.FALL

    def begin(self, last: Motor) -> None:
        """Take over; the upper body stays where the last Motor wanted it."""
        self._estimator.reset()
        self._detector.reset()
        self._upper_body, self._sequence = last.position, last.sequence
        self.time = self.peak = self._still = 0.0
        self._faults, self._behavior = 0, REFLEX
        self._found = self.done = False
        self.outcome = ""

    def update(self, proprioceptor: Proprioceptor, *, limp: bool = False, hold: bool = False) -> Motor:
        """The Motor that answers a Proprioceptor; when ``done``, the last one.

        Args:
            proprioceptor: it.
            limp: the devices demand that the robot goes limp.
            hold: the devices demand that the joints are held, as soon as both feet stand.
        """
        self.time += self._period
        if fault := self._watchdog.fault(proprioceptor):
            self._repeat(fault)
        elif limp:
            self._let_go(proprioceptor, "the devices demand it")
        else:
            self._balance(proprioceptor, hold)
        if not self.done and self.time >= LONGEST:
            self._end(f"not at rest within {LONGEST:g} s")
        return self._message(proprioceptor)

    def let_go(self, proprioceptor: Proprioceptor, last: Motor | None) -> Motor:
        """The Motor of a robot that somebody wants limp, whoever led it until ``last``."""
        if last is not None:
            self.begin(last)
        self._let_go(proprioceptor, "somebody wants it limp")
        return self._message(proprioceptor)

    def _balance(self, proprioceptor: Proprioceptor, hold: bool) -> None:
        state, controller = self._estimator.update(proprioceptor), self._controller
        if not self._found:
            self._found = True
            controller.reset(state)
            controller.catch(state)
        if falling := self._detector.update(state, controller.footholds(state)):
            self._let_go(proprioceptor, falling)
            return
        zeros, place = self._zeros, self._upper_body
        command = controller.update(state, UpperBodyReference(place, zeros, zeros), self._period)
        self._command.balance(command, place, zeros, zeros, 1.0)
        if command.qp_status is QpStatus.INFEASIBLE:
            self._repeat("the whole-body QP is infeasible")
            return
        self._faults = 0
        x, y, _ = (state.dcm_in_odom - command.dcm_reference_in_odom).tolist()
        self.peak = max(self.peak, hypot(x, y))
        if controller.stepping:
            self._still = 0.0
        elif hold:
            self._end("held, as is demanded")
        else:
            x, y, _ = state.com_velocity_in_odom.tolist()
            self._still = self._still + self._period if hypot(x, y) < STILL else 0.0
            if self._still >= SETTLED:
                self._end("it stands")

    def _message(self, proprioceptor: Proprioceptor) -> Motor:
        self._sequence += 1
        return self._command.message(proprioceptor.time, self._sequence, proprioceptor.sequence, self._behavior)

    def _repeat(self, why: str) -> None:
        """A period without a command of its own."""
        self._command.repeat()
        self._faults += 1
        if self._faults >= self._most_faults:
            self._end(why)

    def _let_go(self, proprioceptor: Proprioceptor, why: str) -> None:
        self._command.limp(np.nan_to_num(proprioceptor.joint_position))
        self._behavior = Behavior.FALL  # as if the Motion Manager had said so: it is kept
        self._end(f"let go: {why}")

    def _end(self, outcome: str) -> None:
        self.done, self.outcome = True, f"{outcome}, after {self.time:.2f} s; DCM off by {self.peak:.3f} m at most"
