"""Motion Manager without sockets: Proprioceptor in, Motor and MotionState out.

One period: watchdogs → estimate → state machines → reference → control → Motor. Every Proprioceptor gets a Motor, also
after an error.
"""

import logging
from collections.abc import Sequence

import numpy as np

from valor.common.behaviors import Behavior, Locomotion, Manipulation
from valor.common.messages import MotionState, Motor, Proprioceptor
from valor.common.topics import PROPRIOCEPTOR
from valor.control.controller import ControllerFactory
from valor.control.state import RobotState
from valor.control.watchdog import ProprioceptorWatchdog
from valor.motion_manager.components import Components
from valor.motion_manager.safety import BROUGHT_TO_STAND
from valor.robot.description import RobotDescription
from valor.robot.model import Model

FAULTY = 0.01  # duration of malformed Proprioceptors or internal errors before Fall [s]
LOGGED = 10.0  # interval of log lines on continued errors [s]
LONGEST_PERIOD = 0.02  # longest time step, after missed periods [s]

_log = logging.getLogger("motion_manager")


class MotionManager:
    """Control of a robot, one period after the other."""

    def __init__(self, robot: RobotDescription, model: Model, others: Sequence[ControllerFactory] = ()) -> None:
        """``others``: controllers beside the Whole-Body Controller."""
        self.components = components = Components(robot, model, others)
        self.fsm, self.authority, self.rejections = components.fsm, components.authority, components.rejections
        self._dt = robot.control_period
        self._most_faults, self._errors_a_line = round(FAULTY / self._dt), round(LOGGED / self._dt)
        self._watchdog = ProprioceptorWatchdog(len(robot.joints))
        self._sequence = 0
        self._proprioceptor_sequence = 0
        self._errors = 0  # consecutive

    @property
    def time(self) -> int:
        """Robot time [ns]."""
        return self.components.time

    @property
    def missed(self) -> int:
        """Number of missed Proprioceptors since start."""
        return self._watchdog.missed

    def tick(self, proprioceptor: Proprioceptor) -> Motor:
        """Compute the Motor for a Proprioceptor."""
        self.components.balance.command = None
        try:
            self._control(proprioceptor)
            self._errors = 0
        except Exception:
            self._errors += 1
            if self._errors == 1 or self._errors % self._errors_a_line == 0:
                _log.exception("error in a control period; repeating the last command with damping")
            self._repeat()
            if self._errors >= self._most_faults:
                self.authority.fall("errors of the Motion Manager, see its log")
        self._sequence += 1
        self._proprioceptor_sequence = proprioceptor.sequence
        behavior = self.authority.motor_behavior(self.time)
        return self.components.command.message(proprioceptor.time, self._sequence, proprioceptor.sequence, behavior)

    def report(self, motor_time: float = 0.0, tick_time: float = 0.0) -> MotionState:
        """State after the last period; for the times see ``MotionState`` [s]."""
        return self.components.report(self._proprioceptor_sequence, motor_time=motor_time, tick_time=tick_time)

    def _control(self, proprioceptor: Proprioceptor) -> None:
        components = self.components
        if fault := self._watchdog.fault(proprioceptor):
            self.rejections.add(PROPRIOCEPTOR.name, "comms_manager", "malformed", fault)
            if self._watchdog.malformed >= self._most_faults:
                self.authority.fall(f"{self._watchdog.malformed} consecutive Proprioceptors malformed: {fault}")
            self._repeat()
            return
        if self._watchdog.repeated(proprioceptor):
            return
        before, components.time = components.time, proprioceptor.time
        if (acquired := self._acquire(proprioceptor)) is None:
            self._yield(proprioceptor)
            return
        state, is_new = acquired
        components.command.measure(state.joint_position, proprioceptor.joint_velocity)
        self._decide(proprioceptor, state)
        dt = self._dt if is_new else min(max((components.time - before) * 1e-9, self._dt), LONGEST_PERIOD)
        self._move(proprioceptor, state, dt)
        self.authority.in_control = True

    def _acquire(self, proprioceptor: Proprioceptor) -> tuple[RobotState, bool] | None:
        """The robot's state, and whether control was acquired in this period; None while the reflex is in control."""
        components, authority = self.components, self.authority
        gap = self._watchdog.discontinuity(proprioceptor)
        yielded = authority.yielding
        if authority.yield_to_reflex(proprioceptor.motor_behavior):
            return None
        if yielded:
            gap = gap or BROUGHT_TO_STAND
        is_new = gap is not None or not authority.in_control
        if is_new:
            components.estimator.reset()
            components.detector.reset()
        state = components.state = components.estimator.update(proprioceptor)
        authority.acquire(proprioceptor.motor_behavior, components.time, gap, state)
        if is_new and self.fsm.locomotion is not Locomotion.FALL:
            components.drivers.reset_driver(self.fsm.locomotion)
        return state, is_new

    def _yield(self, proprioceptor: Proprioceptor) -> None:
        """Command the measured joint positions, for the case that control returns in the next period."""
        components = self.components
        if components.drivers.current is not None:
            components.drivers.reset_driver(Locomotion.IDLE)
            components.exchange.end()
        zeros = np.zeros_like(proprioceptor.joint_position)
        components.command.hold(proprioceptor.joint_position, zeros, proprioceptor.joint_effort)

    def _decide(self, proprioceptor: Proprioceptor, state: RobotState) -> None:
        components, now = self.components, self.time * 1e-9
        self._watch(state)
        self.authority.resume(proprioceptor.motor_behavior, state)
        components.device_reactions.update()
        components.drivers.proceed(state, now)
        if components.upper_body.frozen and not self.fsm.locomotion.balancing:
            components.freeze(())
        components.upper_body.enter(self.fsm.manipulation, self.fsm.attention, now)
        components.drivers.change(state, now)

    def _watch(self, state: RobotState) -> None:
        components, locomotion = self.components, self.fsm.locomotion
        components.falling = ""
        if locomotion.balancing or locomotion is Locomotion.STAND_PREP:
            components.falling = components.detector.update(state, components.exchange.footholds(state)) or ""
            if components.falling and locomotion.balancing:
                self.authority.fall(components.falling)

    def _move(self, proprioceptor: Proprioceptor, state: RobotState, dt: float) -> None:
        """Advance the joint reference, and fill the command."""
        components, now = self.components, self.time * 1e-9
        components.upper_body.update(state.joint_position, now)
        components.hand_contacts.update(proprioceptor)
        components.hand_loads.update(proprioceptor, state, components.hand_contacts, now)
        if components.hand_goals.active and self.fsm.manipulation is not Manipulation.TELEOP:
            components.hand_goals.release_all(f"the behavior is {self.fsm.behavior}")
        for side, force in enumerate(components.hand_loads.resisted):
            if force:
                most = components.robot.tables.hands.most_pressing
                reason = f"it presses or lifts with {force:.0f} N; expected at most {most:g} N"
                components.hand_goals.give_way(side, reason, state.joint_position, now)
        components.hand_goals.advance(state, state.joint_position, now, dt)
        components.reference.advance(now, dt)
        components.balance.recover()
        components.drivers.drive(state, now, dt)

    def _repeat(self) -> None:
        """Repeat the last command with damping; in Fall, command damping only."""
        components = self.components
        if self.fsm.behavior is Behavior.FALL:
            components.drivers.go_limp()
            components.command.limp(components.command.position)
        else:
            components.command.repeat()
