"""Who has the joints: the driver of the Locomotion FSM's state, which takes over from that of the state before."""

from __future__ import annotations

from collections.abc import Mapping

from valor.common.behaviors import Locomotion
from valor.motion_manager.locomotion.driver import JUST_BEGUN, Driver
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.whole_body.state import RobotState


class Drivers:
    """Has the driver of the Locomotion FSM's state drive.

    Attributes:
        current: who drove in the last period; None: the joints are nobody's yet.
    """

    def __init__(self, fsm: BehaviorFsm, drivers: Mapping[Locomotion, Driver]) -> None:
        """``drivers``: of every state its own."""
        self._fsm, self._drivers = fsm, drivers
        self.current: Driver | None = None

    def of(self, locomotion: Locomotion) -> Driver:
        """The one of a state."""
        return self._drivers[locomotion]

    def proceed(self, state: RobotState, now: float) -> None:
        """Who drove and goes on may find that its state ends."""
        if self.current is self.of(self._fsm.locomotion):
            self.current.proceed(state, now)

    def change(self, state: RobotState, now: float) -> None:
        """Hand the joints over if the Locomotion FSM has another state than in the last period."""
        before, self.current = self.current, self.of(self._fsm.locomotion)
        if self.current is before:
            return
        if before is not None:
            before.leave(self._fsm.locomotion)
        self.current.enter(before, state, now)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period, after ``change``."""
        assert self.current is not None
        self.current.drive(state, now, dt)

    def let_go(self, to: Locomotion) -> None:
        """Whatever holds the joints in a state begins anew, from where they are found."""
        if self.current is not None:
            self.current.leave(to)
        self.current = None

    def go_limp(self) -> None:
        """Fall without a state of the robot to be believed: nothing is taken over."""
        self.current = self.of(Locomotion.FALL)

    def not_prepared(self, state: RobotState, now: float) -> str:
        """Why the nominal posture is not reached; an empty text: it is."""
        return self.current.not_prepared(state, now) if self.current else JUST_BEGUN
