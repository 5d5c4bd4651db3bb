"""Drivers with balance control: a controller moves the joints, at rest, with steps of a source, or at a velocity."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from valor.common.behaviors import Behavior, Locomotion, Manipulation
from valor.control.controller import JointCommand, JointTargets, Request
from valor.control.state import RobotState
from valor.control.steps import StepSource
from valor.motion_manager.locomotion.driver import Driver
from valor.whole_body.command import QpStatus, WholeBodyCommand

if TYPE_CHECKING:
    from valor.motion_manager.components import Components

BLEND = 0.3  # blending from the servos to the Whole-Body Controller [s]
LONGEST_INFEASIBLE = 0.05  # duration of an infeasible whole-body QP before Soft Stop [s]

_log = logging.getLogger("motion_manager")


class BalanceControl:
    """The controllers with their inputs, for all states that balance. Times are robot time [s]."""

    def __init__(self, components: Components) -> None:
        self._components = components
        self._fsm, self._whole_body, self._exchange = components.fsm, components.whole_body, components.exchange
        self._most_failures = round(LONGEST_INFEASIBLE / components.robot.control_period)
        self._no_effort = np.zeros(len(components.robot.joints))
        self.command: JointCommand | None = None  # of this period; None if no controller controls the joints
        self._blend_start = 0.0
        self._failures = 0  # of the QP, consecutive
        self._recovering = False  # as last reported

    def begin(self, state: RobotState, now: float) -> None:
        """Start to balance."""
        components = self._components
        components.detector.reset()
        self._exchange.begin(state)
        components.gains.reset()
        components.servos.reset()
        self._failures = 0
        self._blend_start = now

    def drive(self, source: StepSource | None, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period; ``source`` supplies the steps, None for a robot at rest."""
        components = self._components
        motors, reference = components.command, components.reference
        self._choose_steps(source, now)
        gains = components.gains
        gains.advance()
        place, rate, frozen = reference.position, reference.velocity, reference.frozen
        targets = JointTargets(place, rate, reference.acceleration, gains.stiffness, gains.damping, frozen)
        request = Request(targets, self._fsm.locomotion, components.velocity_steps.wanted, source)
        command = self.command = self._exchange.update(state, request, dt, now)
        fraction = min(1.0, (now - self._blend_start) / BLEND)
        offsets = components.servos.offsets(state, command, dt, complete=fraction >= 1.0)
        if components.arm_pd is not None:
            offsets = components.arm_pd.apply(state, command)
        effort = components.posture.effort(now) if fraction < 1.0 else self._no_effort
        motors.balance(command, place, rate, effort, fraction, offsets=offsets, held=frozen)
        infeasible = isinstance(command, WholeBodyCommand) and command.qp_status is QpStatus.INFEASIBLE
        self._failures = self._failures + 1 if infeasible else 0
        if self._failures >= self._most_failures and self._fsm.may_go(Behavior.SOFT_STOP):
            self._fsm.go(Behavior.SOFT_STOP, f"the whole-body QP was infeasible for {self._failures} periods in a row")
        fault = self._exchange.settled(now)
        if fault and self._fsm.may_go(Behavior.SOFT_STOP):
            self._fsm.go(Behavior.SOFT_STOP, fault)

    def _choose_steps(self, source: StepSource | None, now: float) -> None:
        """Stop a walk for an exchange of controllers; change to Stand at the end of a plan."""
        steps = self._components.step_queue
        self._components.velocity_steps.advance(now)
        if self._exchange.resting:
            self._components.velocity_steps.stop()
        if not self._exchange.at_rest:
            return
        if steps.take_finished() and source is steps:
            self._fsm.go(Behavior.STAND, steps.reason or "the footstep plan is done")

    def end_stepping(self, to: Locomotion) -> None:
        """Leave Step or Walk: the present step comes to rest if the next state balances."""
        self._components.velocity_steps.stop()
        if to.balancing:
            self._components.step_queue.stop(f"{self._fsm.behavior}: {self._fsm.reason}")
        else:
            self._components.step_queue.fail(self._fsm.reason)

    def recover(self) -> None:
        """Allow recovery steps, once a period, unless hands under a client's control may hold on to what they touch."""
        controller, fsm = self._whole_body, self._fsm
        holding = fsm.manipulation is Manipulation.TELEOP and self._components.hand_contacts.touching
        controller.may_recover = fsm.locomotion.recovering and not holding
        if controller.recovering is self._recovering:
            return
        self._recovering = controller.recovering
        if self._recovering:
            _log.warning("%s", controller.watch.reason)
            fsm.note(controller.watch.reason)
        elif fsm.locomotion.recovering:
            fsm.note(f"{fsm.behavior} again after a step that kept the balance")


class BalanceDriver(Driver):
    """Balances, at rest."""

    states: ClassVar[tuple[Locomotion, ...]] = (Locomotion.STAND, Locomotion.SOFT_STOP)
    source: StepSource | None = None

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        if not isinstance(before, BalanceDriver):
            self.components.balance.begin(state, now)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        self.components.balance.drive(self.source, state, now, dt)


class StepDriver(BalanceDriver):
    """Balances and executes the steps of a plan."""

    states: ClassVar[tuple[Locomotion, ...]] = (Locomotion.STEP,)

    def __init__(self, components: Components) -> None:
        super().__init__(components)
        self.source = components.step_queue

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        self.components.whole_body.pelvis.go_home()
        super().enter(before, state, now)

    def leave(self, to: Locomotion) -> None:
        self.components.balance.end_stepping(to)


class WalkDriver(StepDriver):
    """Balances and walks at a commanded velocity."""

    states: ClassVar[tuple[Locomotion, ...]] = (Locomotion.WALK,)

    def __init__(self, components: Components) -> None:
        super().__init__(components)
        self.source = components.velocity_steps
