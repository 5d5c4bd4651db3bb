"""Drivers of a robot that nobody balances: limp, held by its servos, or on its way up from the floor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from valor.common.behaviors import Behavior
from valor.motion_manager.locomotion.driver import Driver, Leaves
from valor.motion_manager.locomotion.get_up import GetUp
from valor.motion_manager.locomotion.posture_control import PostureControl
from valor.motion_manager.safety.stance import Stance
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.whole_body.balance.fall import FallDetector
from valor.whole_body.controller import WholeBodyController
from valor.whole_body.estimation.estimator import FloatingBaseEstimator
from valor.whole_body.motor_command import MotorCommand
from valor.whole_body.state import RobotState


class Limp(Driver):
    """No effort, only damping."""

    leaves = Leaves.LIMP

    def __init__(self, controller: WholeBodyController, command: MotorCommand) -> None:
        self._controller, self._command = controller, command

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Let everything go."""
        self._controller.leave()

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Be limp."""
        self._command.limp(state.joint_position)


class Held(Driver):
    """The joints by their servos, where they were found or came to rest."""

    leaves = Leaves.HELD

    def __init__(self, controller: WholeBodyController, posture: PostureControl) -> None:
        self._controller, self._posture = controller, posture

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Hold them."""
        self._controller.leave()
        if before is None:
            self._posture.take_up(state.joint_position, state.joint_effort)
        elif before.leaves is Leaves.LIMP:
            self._posture.take_up(state.joint_position, np.zeros_like(state.joint_effort))
        elif before.leaves is Leaves.HELD:
            self._posture.hold(now)
        else:
            self._posture.take_over(state.joint_position)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Hold on, or move on."""
        self._posture.drive(now)


class Prepared(Held):
    """Likewise, on the way to the nominal posture and there."""

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Set out."""
        super().enter(before, state, now)
        self._posture.prepare(now)

    def not_prepared(self, state: RobotState, now: float) -> str:
        """How far it is."""
        return self._posture.not_arrived(now, state.joint_velocity)


class Rising(Driver):
    """Up from the floor; then to Stand Prep by itself, and back to Fall when it cannot."""

    def __init__(
        self,
        *,
        fsm: BehaviorFsm,
        fall: Callable[[str], None],
        stance: Stance,
        estimator: FloatingBaseEstimator,
        detector: FallDetector,
        controller: WholeBodyController,
        command: MotorCommand,
        get_up: GetUp,
    ) -> None:
        """``fall``: lets the robot go, for a reason."""
        self._fsm, self._fall, self._stance = fsm, fall, stance
        self._estimator, self._detector = estimator, detector
        self._controller, self._command, self._get_up = controller, command, get_up

    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Begin with the first key pose."""
        self._controller.leave()
        self._get_up.begin(state, now)

    def proceed(self, state: RobotState, now: float) -> None:
        """Go on with the next key pose, be done, or give up."""
        get_up = self._get_up
        before = get_up.progress
        get_up.update(state, now)
        if get_up.failure:
            self._fall(f"getting up was given up: {get_up.failure}")
        elif get_up.done and (reason := self._stance.lost(state)):
            self._fall(f"getting up was given up: {reason}")
        elif get_up.done:
            self._estimator.reset()
            self._detector.reset()
            self._fsm.go(Behavior.STAND_PREP, "up again")
        elif get_up.progress != before:
            self._fsm.remark(get_up.progress)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Towards the key pose."""
        self._get_up.drive(self._command, state, now)
