"""The Motion Manager without its sockets: Proprioceptor in, Motor and MotionState out.

One period: watchdogs → estimate → state machines → reference → control → Motor. Whatever happens on the way, a Motor
leaves for every Proprioceptor.
"""

from __future__ import annotations

import logging

import numpy as np

from valor.common.behaviors import Behavior, Locomotion, Manipulation
from valor.common.messages import MotionState, Motor, Proprioceptor
from valor.common.topics import PROPRIOCEPTOR
from valor.motion_manager.parts import Parts
from valor.motion_manager.safety.custody import BROUGHT_TO_STAND
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.state import RobotState
from valor.whole_body.watchdog import ProprioceptorWatchdog

FAULTY = 0.01  # without a believable Proprioceptor, or with errors of ours, before the robot is let go [s]
LOGGED = 10.0  # between lines on errors that go on [s]
LONGEST_PERIOD = 0.02  # of periods that were missed, so much is made up for [s]

_log = logging.getLogger("motion_manager")


class MotionManager:
    """Everything between one Proprioceptor and the Motor that answers it.

    Attributes:
        parts: what it is made of.
    """

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        self.parts = parts = Parts(robot, model)
        self.fsm, self.custody, self.rejections = parts.fsm, parts.custody, parts.rejections
        self._dt = robot.control_period
        self._most_faults, self._errors_a_line = round(FAULTY / self._dt), round(LOGGED / self._dt)
        self._watchdog = ProprioceptorWatchdog(len(robot.joints))
        self._sequence = 0
        self._proprioceptor_sequence = 0
        self._errors = 0  # consecutive

    # --- for the loop ---------------------------------------------------------------------------------------------

    @property
    def time(self) -> int:
        """Robot time [ns]."""
        return self.parts.time

    @property
    def missed(self) -> int:
        """Proprioceptors that were not seen, since start."""
        return self._watchdog.missed

    def tick(self, proprioceptor: Proprioceptor) -> Motor:
        """The Motor that answers a Proprioceptor."""
        self.parts.balance.command = None
        try:
            self._control(proprioceptor)
            self._errors = 0
        except Exception:
            self._errors += 1
            if self._errors == 1 or self._errors % self._errors_a_line == 0:
                _log.exception("error in a control period; the last command goes on with damping")
            self._repeat()
            if self._errors >= self._most_faults:
                self.custody.fall("errors of the Motion Manager, see its log")
        self._sequence += 1
        self._proprioceptor_sequence = proprioceptor.sequence
        behavior = self.custody.announced(self.time)
        return self.parts.command.message(proprioceptor.time, self._sequence, proprioceptor.sequence, behavior)

    def report(self, motor_time: float = 0.0, tick_time: float = 0.0) -> MotionState:
        """What the Motion Manager did and believes; the times are those that ``MotionState`` has fields for [s]."""
        return self.parts.report(self._proprioceptor_sequence, motor_time=motor_time, tick_time=tick_time)

    # --- one period -----------------------------------------------------------------------------------------------

    def _control(self, proprioceptor: Proprioceptor) -> None:
        parts = self.parts
        if fault := self._watchdog.fault(proprioceptor):
            self.rejections.add(PROPRIOCEPTOR.name, "comms_manager", "malformed", fault)
            if self._watchdog.malformed >= self._most_faults:
                self.custody.fall(f"{self._watchdog.malformed} consecutive Proprioceptors malformed: {fault}")
            self._repeat()
            return
        if self._watchdog.repeated(proprioceptor):
            return
        before, parts.time = parts.time, proprioceptor.time
        if (taken := self._take(proprioceptor)) is None:
            self._stand_aside(proprioceptor)
            return
        state, taken_over = taken
        self._decide(proprioceptor, state)
        # Of periods that were missed, some are made up for.
        dt = self._dt if taken_over else min(max((parts.time - before) * 1e-9, self._dt), LONGEST_PERIOD)
        self._move(proprioceptor, state, dt)
        self.custody.ours = True

    def _take(self, proprioceptor: Proprioceptor) -> tuple[RobotState, bool] | None:
        """Where the robot is, and whether it was taken over just now; None: somebody else leads it."""
        parts, custody = self.parts, self.custody
        gap = self._watchdog.discontinuity(proprioceptor)
        was_aside = custody.aside
        if custody.stand_aside(proprioceptor.motor_behavior):
            return None
        if was_aside:
            gap = gap or BROUGHT_TO_STAND
        taken_over = gap is not None or not custody.ours
        if taken_over:
            parts.estimator.reset()
            parts.detector.reset()
        state = parts.state = parts.estimator.update(proprioceptor)
        custody.take_over(proprioceptor.motor_behavior, parts.time, gap, state)
        if taken_over and self.fsm.locomotion is not Locomotion.FALL:
            parts.drivers.let_go(self.fsm.locomotion)
        return state, taken_over

    def _stand_aside(self, proprioceptor: Proprioceptor) -> None:
        """Somebody else has the joints. Should the robot be ours in the next moment, they stay where they are."""
        parts = self.parts
        if parts.drivers.current is not None:
            parts.drivers.let_go(Locomotion.IDLE)
            parts.controller.leave()
        zeros = np.zeros_like(proprioceptor.joint_position)
        parts.command.hold(proprioceptor.joint_position, zeros, proprioceptor.joint_effort)

    def _decide(self, proprioceptor: Proprioceptor, state: RobotState) -> None:
        """Which states the machines are in for this period, and who drives in them."""
        parts, now = self.parts, self.time * 1e-9
        self._watch(state)
        self.custody.resume(proprioceptor.motor_behavior, state)
        parts.device_reactions.update()
        parts.drivers.proceed(state, now)
        parts.upper_body.enter(self.fsm.manipulation, self.fsm.attention, now)
        parts.drivers.change(state, now)

    def _watch(self, state: RobotState) -> None:
        """Fall, when balance is lost."""
        parts, locomotion = self.parts, self.fsm.locomotion
        parts.falling = ""
        if locomotion.balancing or locomotion is Locomotion.STAND_PREP:
            parts.falling = parts.detector.update(state, parts.controller.footholds(state)) or ""
            if parts.falling and locomotion.balancing:
                self.custody.fall(parts.falling)

    def _move(self, proprioceptor: Proprioceptor, state: RobotState, dt: float) -> None:
        """Advance what is wanted of the joints, and fill the command."""
        parts, now = self.parts, self.time * 1e-9
        parts.upper_body.update(now)
        parts.hand_contacts.update(proprioceptor)
        parts.hand_loads.update(proprioceptor, state, parts.hand_contacts, now)
        if parts.hand_goals.active and self.fsm.manipulation is not Manipulation.TELEOP:
            parts.hand_goals.release_all(f"the behavior is {self.fsm.behavior}")
        for side, force in enumerate(parts.hand_loads.resisted):
            if force:
                reason = f"it presses with {force:.0f} N; expected at most {parts.robot.tables.hands.most_pressing:g} N"
                parts.hand_goals.give_way(side, reason, state.joint_position, now)
        parts.hand_goals.advance(state, state.joint_position, now, dt)
        parts.reference.advance(now, dt)
        parts.balance.recover(parts.hand_contacts)
        parts.drivers.drive(state, now, dt)

    def _repeat(self) -> None:
        """A period without a command of its own: the last one, damped; limp once the robot is in Fall."""
        parts = self.parts
        if self.fsm.behavior is Behavior.FALL:
            parts.drivers.go_limp()
            parts.command.limp(parts.command.position)
        else:
            parts.command.repeat()
