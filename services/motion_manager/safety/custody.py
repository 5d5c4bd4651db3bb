"""Who leads the robot: this Motion Manager, the Comms Manager in its place, or nobody yet; how one follows the other.

A robot is led without a break for as long as its Proprioceptors come. It is found again after a gap of robot time,
after the Comms Manager's reflex has had it, and by a new process; then it moves only by a command.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from valor.common.behaviors import REFLEX, Behavior, Locomotion
from valor.common.topics import PROPRIOCEPTOR
from valor.motion_manager.safety.stance import Stance
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.motion_manager.states.transitions import RESUMED, WAY_BACK, WAYS_TO
from valor.whole_body.state import RobotState
from valor.whole_body.watchdog import LONGEST_GAP, Gap

ASIDE = "the Comms Manager brings the robot to stand, whose Motion Manager fell silent"
BROUGHT_TO_STAND = Gap("the Comms Manager brought the robot to stand", same_world=True)
_log = logging.getLogger("motion_manager")


class Custody:
    """Takes the robot over, and stands aside.

    Attributes:
        ours: a believable Proprioceptor has been answered, and nobody else leads the robot.
        aside: the Comms Manager's reflex has it.
        silent: set by the loop: why no Proprioceptor comes, or an empty text.
        since: robot time since when the robot has been in our hands without a break [ns].
    """

    def __init__(self, fsm: BehaviorFsm, stance: Stance, swings: Callable[[RobotState], bool]) -> None:
        """``swings``: whether the robot is in the middle of a step, and moves."""
        self._fsm, self._stance, self._swings = fsm, stance, swings
        self._said = dict.fromkeys(WAYS_TO, -1)  # robot time of the last Motor in a behavior [ns]
        self.ours = self.aside = False
        self.silent = ""
        self.since = 0

    def refusal(self, target: Behavior) -> str:
        """Why there is no robot to bring into a behavior; an empty text: there is one.

        Beside the reflex, which is a Soft Stop, Fall is obeyed at once and Freeze as soon as both feet stand.
        """
        if self.aside:
            return "" if target in WAYS_TO else ASIDE
        return self.silent or ("" if self.ours else f"no {PROPRIOCEPTOR.name} yet")

    def stand_aside(self, motor_behavior: str) -> bool:
        """While the Comms Manager's reflex brings the robot to stand nobody else leads it; returns whether it does.

        A robot that is let go stays so: the reflex yields to that.
        """
        fsm = self._fsm
        aside = motor_behavior == REFLEX and fsm.behavior is not Behavior.FALL
        if aside and not self.aside:
            self.ours = False
            ways = WAY_BACK[Behavior.SOFT_STOP] if fsm.behavior is Behavior.IDLE else (Behavior.SOFT_STOP,)
            if fsm.may_go(ways[0]):
                self._go(ways, ASIDE)
            fsm.remark(ASIDE)
        self.aside = aside
        return aside

    def announced(self, time: int) -> str:
        """The behavior to be said in a Motor for the robot time [ns]."""
        behavior = self._fsm.behavior
        if behavior in self._said:
            self._said[behavior] = time
        # Freeze beside the reflex is an order to it; anything else would be passed over.
        return REFLEX if self.aside and behavior is not Behavior.FREEZE else behavior

    def take_over(self, motor_behavior: str, time: int, gap: Gap | None, state: RobotState) -> None:
        """Settle in which behavior a robot is to be led, before it is.

        Args:
            motor_behavior: that it was in last, as its devices know.
            time: robot time [ns].
            gap: what lies between this state and the one before.
            state: of the robot.
        """
        if self._fsm.behavior is not Behavior.IDLE or self.ours:
            self._follow(motor_behavior, time)
        if gap is not None or not self.ours:
            self.since = time
        if gap is not None:
            self._find_again(gap, state)

    def resume(self, before: str, state: RobotState) -> None:
        """The first robot of this process: new, or left behind by a Motion Manager that ended in a behavior.

        Only a robot that nobody has led yet moves by itself.
        """
        fsm = self._fsm
        if fsm.behavior is not Behavior.IDLE or self.ours:
            return
        if not before:
            fsm.go(Behavior.STAND_PREP, "first Proprioceptor")
            return
        found = next((behavior for behavior in Behavior if behavior == before), Behavior.FREEZE)
        reason = f"the Motion Manager began anew; before, the robot was in {before}"
        after = RESUMED[found]
        if found.balancing and (lost := self._stance.lost(state)):
            after, reason = Behavior.FALL, f"{reason}; {lost}"
        self._go(WAY_BACK[after], reason)
        fsm.remark(reason)

    def fall(self, reason: str) -> None:
        """Fall-safe, from wherever there is an edge to it; one that is frozen goes on being held."""
        if self._fsm.may_go(Behavior.FALL) and self._fsm.behavior is not Behavior.FREEZE:
            self._fsm.go(Behavior.FALL, reason)

    def _follow(self, motor_behavior: str, time: int) -> None:
        """The Comms Manager was told to stop the robot while we were silent: it stays stopped."""
        fsm = self._fsm
        stopped = next((behavior for behavior in WAYS_TO if behavior == motor_behavior), None)
        if stopped is None or stopped is fsm.behavior:
            return
        if (said := self._said[stopped]) >= 0 and time - said <= LONGEST_GAP * 1e9:
            return  # our own word of a moment ago
        for way in WAYS_TO[stopped]:
            if fsm.may_go(way[0]):
                self._go(way, f"the Comms Manager was told to: {stopped}")
                return

    def _find_again(self, gap: Gap, state: RobotState) -> None:
        """The robot has lived without us for a while; its devices have held its joints.

        One that balanced, and stands still on both feet, goes on being held: to let go would fell it. One that is
        still in the middle of a step, or that does not stand any more, is let go, and so is one that is not known. One
        that was being brought to its posture stays where it is: nothing moves because something restarted.
        """
        _log.warning("%s", gap.reason)
        fsm = self._fsm
        if fsm.behavior is Behavior.STAND_PREP:
            fsm.go(Behavior.FREEZE, f"{gap.reason}; what was on its way to the posture is held")
            return
        lost = "" if gap.same_world else "it is not known"
        lost = lost or ("it was stepping, and moves" if self._swings(state) else "")
        lost = lost or ("it was getting up" if fsm.locomotion is Locomotion.GET_UP else "")
        lost = lost or self._stance.lost(state)
        if lost:
            self.fall(f"{gap.reason}; {lost}" if gap.same_world else gap.reason)
        elif fsm.locomotion.balancing:
            # From Step and Walk by way of Soft Stop.
            steps = (Behavior.FREEZE,) if fsm.may_go(Behavior.FREEZE) else (Behavior.SOFT_STOP, Behavior.FREEZE)
            self._go(steps, f"{gap.reason}; it stands, and is held")

    def _go(self, way: tuple[Behavior, ...], reason: str) -> None:
        for behavior in way:
            self._fsm.go(behavior, reason)
