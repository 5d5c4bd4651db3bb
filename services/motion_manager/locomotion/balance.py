"""Drivers of a robot that balances: the Whole-Body Controller has the joints, at rest or with steps of some source."""

from __future__ import annotations

import logging

import numpy as np

from valor.common.behaviors import Behavior, Locomotion, Manipulation
from valor.motion_manager.hands.hand_contact import HandContacts
from valor.motion_manager.joints.joint_gains import JointGains
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.servo_compensation import ServoCompensation
from valor.motion_manager.locomotion.driver import Driver
from valor.motion_manager.locomotion.posture_control import PostureControl
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.robot.description import RobotDescription
from valor.whole_body.balance.fall import FallDetector
from valor.whole_body.controller import WholeBodyController
from valor.whole_body.motor_command import MotorCommand
from valor.whole_body.state import QpStatus, RobotState, UpperBodyReference, WholeBodyCommand
from valor.whole_body.walking.footsteps import StepSource
from valor.whole_body.walking.step_queue import StepQueue
from valor.whole_body.walking.velocity_steps import VelocitySteps

BLEND = 0.3  # over which the Whole-Body Controller takes the joints over [s]
LONGEST_INFEASIBLE = 0.05  # the whole-body QP, without a break, before the robot is stopped [s]

_log = logging.getLogger("motion_manager")


class BalanceControl:
    """The Whole-Body Controller with all that it is given, whichever state it balances in. Times are robot time [s].

    Attributes:
        command: of the Whole-Body Controller in this period; None: it has not the joints.
    """

    def __init__(
        self,
        robot: RobotDescription,
        fsm: BehaviorFsm,
        *,
        controller: WholeBodyController,
        detector: FallDetector,
        reference: JointReference,
        posture: PostureControl,
        motors: MotorCommand,
        gains: JointGains,
        servos: ServoCompensation,
        velocity_steps: VelocitySteps,
        step_queue: StepQueue,
    ) -> None:
        self._fsm, self.controller, self._detector = fsm, controller, detector
        self._reference, self._posture, self._motors, self._gains = reference, posture, motors, gains
        self._servos = servos
        self._velocity_steps, self._step_queue = velocity_steps, step_queue
        self._most_failures = round(LONGEST_INFEASIBLE / robot.control_period)
        self._no_effort = np.zeros(len(robot.joints))
        self.command: WholeBodyCommand | None = None
        self._blend_began = 0.0
        self._failures = 0  # of the QP, consecutive
        self._recovering = False  # said to be

    def begin(self, state: RobotState, now: float) -> None:
        """Balance from here on."""
        self._detector.reset()
        self.controller.reset(state)
        self._gains.reset()
        self._motors.set_gains(self._gains.stiffness, self._gains.damping)
        self._servos.reset()
        self._failures = 0
        self._blend_began = now

    def drive(self, source: StepSource | None, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period; ``source`` gives the steps to be taken."""
        self._choose_steps(source, now)
        if self._gains.advance():
            self._motors.set_gains(self._gains.stiffness, self._gains.damping)
        reference = self._reference
        command = self.command = self.controller.update(
            state, UpperBodyReference(reference.position, reference.velocity, reference.acceleration), dt
        )
        share = min(1.0, (now - self._blend_began) / BLEND)
        offsets = self._servos.offsets(state, command, dt, whole=share >= 1.0)
        effort = self._posture.effort(now) if share < 1.0 else self._no_effort  # by then it counts no more
        self._motors.balance(command, reference.position, reference.velocity, effort, share, offsets=offsets)
        self._failures = self._failures + 1 if command.qp_status is QpStatus.INFEASIBLE else 0
        if self._failures >= self._most_failures and self._fsm.may_go(Behavior.SOFT_STOP):
            self._fsm.go(Behavior.SOFT_STOP, f"the whole-body QP was infeasible for {self._failures} periods in a row")

    def _choose_steps(self, source: StepSource | None, now: float) -> None:
        """Where steps come from, once those of another state have come to rest; a plan that is done: Stand."""
        self._velocity_steps.advance(now)
        if self.controller.stepping:
            return
        self.controller.step_source = source
        if self._step_queue.take_finished() and source is self._step_queue:
            self._fsm.go(Behavior.STAND, self._step_queue.reason or "the footstep plan is done")

    def end_stepping(self, to: Locomotion) -> None:
        """Step or Walk is left: what has begun comes to rest, if somebody balances."""
        self._velocity_steps.stop()
        if to.balancing:
            self._step_queue.stop(f"{self._fsm.behavior}: {self._fsm.reason}")
        else:
            self._step_queue.fail(self._fsm.reason)

    def recover(self, hands: HandContacts) -> None:
        """Once a period, in every state: whether a push may be answered by a step; and say so when it is.

        Hands that are led from outside and touch something may hold on to it: then the feet stay.
        """
        controller, fsm = self.controller, self._fsm
        holding = fsm.manipulation is Manipulation.TELEOP and hands.touching
        controller.may_recover = fsm.locomotion.recovering and not holding
        if controller.recovering is self._recovering:
            return
        self._recovering = controller.recovering
        if self._recovering:
            _log.warning("%s", controller.watch.reason)
            fsm.remark(controller.watch.reason)
        elif fsm.locomotion.recovering:
            fsm.remark(f"{fsm.behavior} again after a step that kept the balance")


class Balanced(Driver):
    """The robot balances, at rest."""

    source: StepSource | None = None  # of the steps that it takes

    def __init__(self, balance: BalanceControl) -> None:
        self._balance = balance

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Begin to balance, or go on."""
        if not isinstance(before, Balanced):
            self._balance.begin(state, now)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Balance."""
        self._balance.drive(self.source, state, now, dt)


class Stepping(Balanced):
    """The robot balances, and takes the steps of a source."""

    def __init__(self, balance: BalanceControl, source: StepSource) -> None:
        super().__init__(balance)
        self.source = source

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Steps are taken with the pelvis where it belongs."""
        self._balance.controller.pelvis.go_home()
        super().enter(before, state, now)

    def leave(self, to: Locomotion) -> None:
        """No further step is begun."""
        self._balance.end_stepping(to)
