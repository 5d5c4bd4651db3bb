"""Balance reflex: brings a robot without a command source to a stand.

A robot in the middle of a step cannot be held: its DCM is on the way from foot to foot. The process that sends Motor
therefore runs this reflex when the Motion Manager times out. It needs only the robot's state, and balances with the
Whole-Body Controller: a foot in the air comes down where the DCM needs it, closing steps follow until both feet stand
side by side, and then the robot is at rest and can be held.
"""

from math import hypot

import numpy as np

from valor.common.behaviors import BALANCING, REFLEX, STEPPING, WALKING, Behavior
from valor.common.messages import Motor, Proprioceptor
from valor.control.controller import JointTargets, Request
from valor.control.estimation.estimator import FloatingBaseEstimator
from valor.control.fall import FallDetector
from valor.control.motor_command import MotorCommand
from valor.control.watchdog import ProprioceptorWatchdog
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.whole_body.command import QpStatus
from valor.whole_body.controller import WholeBodyController

LONGEST = 5.0  # Longest duration of the reflex [s]
SETTLED = 0.5  # Duration at rest after which it ends [s]
STILL = 0.03  # CoM speed below which the robot is at rest [m/s]
FAULTY = 0.01  # Duration without a valid Proprioceptor or a solution after which it ends [s]
LIFTED = 0.02  # Fraction of the weight below which a foot is in the air


class BalanceReflex:
    """Balances a robot from its present state until it stands still on both feet."""

    def __init__(self, robot: RobotDescription) -> None:
        model = controller_model(robot)
        n = len(robot.joints)
        self._period = robot.control_period
        self._most_faults = round(FAULTY / robot.control_period)
        self._estimator = FloatingBaseEstimator(robot, model)
        self._controller = WholeBodyController(robot, self._estimator.kinematics)
        self._detector = FallDetector(robot)
        self._command = MotorCommand(robot)
        self._watchdog = ProprioceptorWatchdog(n)
        self._lifted = LIFTED * self._estimator.kinematics.mass * self._estimator.kinematics.gravity
        self._zeros = np.zeros(n)
        self._sequence = self._faults = 0
        self._behavior: str = REFLEX
        self._upper_body = JointTargets(  # at rest
            self._zeros, self._zeros, self._zeros, robot.servo_stiffness, robot.servo_damping
        )
        self._still = 0.0  # duration at rest [s]
        self.time = self.peak = 0.0  # duration [s]; largest distance of the DCM from its reference [m]
        self._found = False
        self.done = True  # whether it has ended: the robot can be held, or is limp because it falls
        self.outcome = ""  # reason of the end

    def needed(self, behavior: str, proprioceptor: Proprioceptor) -> bool:
        """Return whether a robot in ``behavior`` cannot be held: it steps, or balances with a foot in the air."""
        carried = min(float(proprioceptor.left_foot_wrench[2]), float(proprioceptor.right_foot_wrench[2]))
        return behavior in STEPPING | WALKING or (behavior in BALANCING and carried < self._lifted)

    @property
    def limp(self) -> bool:
        """True if the robot is limp."""
        return self._behavior == Behavior.FALL

    def begin(self, last: Motor) -> None:
        """Start; the upper body stays where the last Motor commanded it."""
        self._estimator.reset()
        self._detector.reset()
        self._upper_body.position, self._sequence = last.position, last.sequence
        self.time = self.peak = self._still = 0.0
        self._faults, self._behavior = 0, REFLEX
        self._found = self.done = False
        self.outcome = ""

    def update(self, proprioceptor: Proprioceptor, *, limp: bool = False, hold: bool = False) -> Motor:
        """Return the Motor for a Proprioceptor; the last one if ``done``. Devices may require limp or held joints."""
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
        """Return the Motor of a robot that is requested limp; ``last`` is the last Motor of another source, or None."""
        if last is not None:
            self.begin(last)
        self._let_go(proprioceptor, "somebody wants it limp")
        return self._message(proprioceptor)

    def _balance(self, proprioceptor: Proprioceptor, hold: bool) -> None:
        state, controller = self._estimator.update(proprioceptor), self._controller
        if not self._found:
            self._found = True
            controller.begin(state)
            controller.catch(state)
        if falling := self._detector.update(state, controller.footholds(state)):
            self._let_go(proprioceptor, falling)
            return
        targets, zeros = self._upper_body, self._zeros
        command = controller.update(state, Request(targets), self._period)
        self._command.balance(command, targets.position, zeros, zeros, 1.0)
        if command.qp_status is QpStatus.INFEASIBLE:
            self._repeat("the whole-body QP is infeasible")
            return
        self._faults = 0
        x, y, _ = (state.dcm_in_odom - command.dcm_reference_in_odom).tolist()
        self.peak = max(self.peak, hypot(x, y))
        if not controller.at_rest:
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
        self._command.repeat()
        self._faults += 1
        if self._faults >= self._most_faults:
            self._end(why)

    def _let_go(self, proprioceptor: Proprioceptor, why: str) -> None:
        self._command.limp(np.nan_to_num(proprioceptor.joint_position))
        self._behavior = Behavior.FALL  # as from the Motion Manager: Fall is latched
        self._end(f"let go: {why}")

    def _end(self, outcome: str) -> None:
        self.done, self.outcome = True, f"{outcome}, after {self.time:.2f} s; DCM off by {self.peak:.3f} m at most"
