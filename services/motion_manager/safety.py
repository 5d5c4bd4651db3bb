"""Safety: control authority, stance, and reactions to device faults.

Motion Manager, Comms Manager or no process controls the robot. The Motion Manager reacquires control after a gap in
robot time, a balance reflex or a process restart; the robot then moves only on command.
"""

import logging
from collections.abc import Callable, Mapping
from math import degrees

from valor.common.behaviors import REFLEX, Behavior, Locomotion, Reaction
from valor.common.messages import DeviceStatus
from valor.common.topics import PROPRIOCEPTOR
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.control.watchdog import LONGEST_GAP, Gap
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.robot.description import RobotDescription

UPRIGHT = 0.5  # largest tilt, fraction of that at which the robot counts as falling
FOOT_LOAD = 0.15  # least load of each foot, fraction of the robot's weight
FEET_LOAD = 0.6  # least load of both feet together, fraction of the robot's weight

REFLEX_ACTIVE = "the Comms Manager is bringing the robot to stand after a timeout of the Motion Manager"
BROUGHT_TO_STAND = Gap("the Comms Manager brought the robot to stand", same_world=True)
_log = logging.getLogger("motion_manager")
_B, _R = Behavior, Reaction

RESUMED: Mapping[Behavior, Behavior] = {
    behavior: _B.IDLE if behavior is _B.IDLE else _B.FALL if behavior.fallen else _B.FREEZE for behavior in _B
}
"""Behavior of a robot before a restart → behavior after it, at rest until a command.

A robot that balanced and is not upright on both feet changes to Fall instead.
"""

WAYS_TO: Mapping[Behavior, tuple[tuple[Behavior, ...], ...]] = {
    _B.FALL: ((_B.FALL,), (_B.FREEZE, _B.FALL)),
    _B.FREEZE: ((_B.FREEZE,), (_B.SOFT_STOP, _B.FREEZE), (_B.FALL, _B.FREEZE)),
}
"""Stops that the Comms Manager executes without a Motion Manager → paths to them; the first possible one is used."""

WAY_BACK: Mapping[Behavior, tuple[Behavior, ...]] = {
    _B.IDLE: (),
    _B.FREEZE: (_B.FREEZE,),
    _B.FALL: (_B.FREEZE, _B.FALL),
    _B.SOFT_STOP: (_B.STAND_PREP, _B.STAND, _B.SOFT_STOP),
}
"""Behavior → path from Idle, executed within one period after a restart or at a reflex."""

DEMANDS: Mapping[Reaction, tuple[Behavior, ...]] = {
    _R.KEEP_BALANCE: (),
    _R.SOFT_STOP: (_B.SOFT_STOP,),
    _R.HOLD: (_B.FREEZE, _B.SOFT_STOP, _B.FALL),
    _R.LIMP: (_B.FALL, _B.SOFT_STOP, _B.FREEZE),
}
"""Reaction → behaviors, the demanded one first; the others are steps towards it, or second best."""

ENOUGH: Mapping[Reaction, frozenset[Behavior]] = {
    _R.KEEP_BALANCE: frozenset(Behavior),
    # Before it balances, the robot stands on its servos and accepts no commands.
    _R.SOFT_STOP: frozenset({_B.SOFT_STOP, _B.FREEZE, _B.FALL, _B.GET_UP, _B.IDLE, _B.STAND_PREP}),
    _R.HOLD: frozenset({_B.FREEZE, _B.FALL, _B.IDLE}),
    _R.LIMP: frozenset({_B.FALL, _B.IDLE}),
}
"""Reaction → behaviors that satisfy it."""


class Stance:
    """Reasons why a robot of a weight [N] does not stand; empty if it does."""

    def __init__(self, robot: RobotDescription, weight: float) -> None:
        self._weight = weight
        self._tilt = UPRIGHT * robot.read(Tuning).fall.tilt

    def lost(self, state: RobotState) -> str:
        return self.not_upright(state) or self.not_loaded(state)

    def not_upright(self, state: RobotState) -> str:
        if state.tilt <= self._tilt:
            return ""
        return f"the pelvis is tilted {degrees(state.tilt):.0f}°; expected at most {degrees(self._tilt):.0f}°"

    def not_loaded(self, state: RobotState) -> str:
        left, right = state.foot_forces.tolist()
        for foot, force in (("left", left), ("right", right)):
            if force < FOOT_LOAD * self._weight:
                return f"the {foot} foot carries {force:.0f} N; expected at least {FOOT_LOAD * self._weight:.0f} N"
        if left + right < FEET_LOAD * self._weight:
            return f"the feet carry {left + right:.0f} N; expected at least {FEET_LOAD * self._weight:.0f} N"
        return ""


class ControlAuthority:
    """Acquires and yields control of the robot."""

    def __init__(self, fsm: BehaviorFsm, stance: Stance, swings: Callable[[RobotState], bool]) -> None:
        """``swings``: whether the robot is in a step, with moving legs."""
        self._fsm, self._stance, self._swings = fsm, stance, swings
        self._sent = dict.fromkeys(WAYS_TO, -1)  # robot time of the last Motor with this behavior [ns]
        self.in_control = self.yielding = False  # since a valid Proprioceptor; while the reflex is in control
        self.no_robot = ""  # set by the loop: reason why no Proprioceptor arrives; empty if they do
        self.since = 0  # robot time since which control is uninterrupted [ns]

    def rejection(self, target: Behavior) -> str:
        """Reason why the Motion Manager cannot change to a behavior; empty if it is in control."""
        if self.yielding:
            return "" if target in WAYS_TO else REFLEX_ACTIVE
        return self.no_robot or ("" if self.in_control else f"no {PROPRIOCEPTOR.name} yet")

    def yield_to_reflex(self, motor_behavior: str) -> bool:
        """Yield, except in Fall, while the Comms Manager's reflex brings the robot to stand; return whether."""
        fsm = self._fsm
        yielding = motor_behavior == REFLEX and fsm.behavior is not Behavior.FALL
        if yielding and not self.yielding:
            self.in_control = False
            path = WAY_BACK[Behavior.SOFT_STOP] if fsm.behavior is Behavior.IDLE else (Behavior.SOFT_STOP,)
            if fsm.may_go(path[0]):
                self._go(path, REFLEX_ACTIVE)
            fsm.note(REFLEX_ACTIVE)
        self.yielding = yielding
        return yielding

    def motor_behavior(self, time: int) -> str:
        """The behavior to send in the Motor for a robot time [ns]."""
        behavior = self._fsm.behavior
        if behavior in self._sent:
            self._sent[behavior] = time
        # Freeze is a command to the reflex; it ignores other behaviors.
        return REFLEX if self.yielding and behavior is not Behavior.FREEZE else behavior

    def acquire(self, motor_behavior: str, time: int, gap: Gap | None, state: RobotState) -> None:
        """Change to the behavior in which control starts or continues; the devices stored ``motor_behavior``."""
        if self._fsm.behavior is not Behavior.IDLE or self.in_control:
            self._follow_stop(motor_behavior, time)
        if gap is not None or not self.in_control:
            self.since = time
        if gap is not None:
            self._acquire_after(gap, state)

    def resume(self, before: str, state: RobotState) -> None:
        """First robot state of this process: change to Stand Prep, or the behavior after ``before`` the restart."""
        fsm = self._fsm
        if fsm.behavior is not Behavior.IDLE or self.in_control:
            return
        if not before:
            fsm.go(Behavior.STAND_PREP, "first Proprioceptor")
            return
        found = next((behavior for behavior in Behavior if behavior == before), Behavior.FREEZE)
        reason = f"the Motion Manager restarted; before, the robot was in {before}"
        after = RESUMED[found]
        if found.balancing and (lost := self._stance.lost(state)):
            after, reason = Behavior.FALL, f"{reason}; {lost}"
        self._go(WAY_BACK[after], reason)
        fsm.note(reason)

    def fall(self, reason: str) -> None:
        """Change to Fall if possible; a robot in Freeze stays held."""
        if self._fsm.may_go(Behavior.FALL) and self._fsm.behavior is not Behavior.FREEZE:
            self._fsm.go(Behavior.FALL, reason)

    def _follow_stop(self, motor_behavior: str, time: int) -> None:
        """Change to a stop that the Comms Manager received during the gap."""
        fsm = self._fsm
        stopped = next((behavior for behavior in WAYS_TO if behavior == motor_behavior), None)
        if stopped is None or stopped is fsm.behavior:
            return
        if (sent := self._sent[stopped]) >= 0 and time - sent <= LONGEST_GAP * 1e9:
            return  # an echo of this process' own Motor
        for path in WAYS_TO[stopped]:
            if fsm.may_go(path[0]):
                self._go(path, f"stop requested at the Comms Manager: {stopped}")
                return

    def _acquire_after(self, gap: Gap, state: RobotState) -> None:
        """Hold a robot that stands after a gap, in which the devices held its joints; else let it fall."""
        _log.warning("%s", gap.reason)
        fsm = self._fsm
        if fsm.behavior is Behavior.STAND_PREP:
            fsm.go(Behavior.FREEZE, f"{gap.reason}; the joints are held on their way to the posture")
            return
        lost = "" if gap.same_world else "another world"
        lost = lost or ("it was stepping, and moves" if self._swings(state) else "")
        lost = lost or ("it was getting up" if fsm.locomotion is Locomotion.GET_UP else "")
        lost = lost or self._stance.lost(state)
        if lost:
            self.fall(f"{gap.reason}; {lost}" if gap.same_world else gap.reason)
        elif fsm.locomotion.balancing:
            # From Step and Walk, Freeze is reached through Soft Stop.
            path = (Behavior.FREEZE,) if fsm.may_go(Behavior.FREEZE) else (Behavior.SOFT_STOP, Behavior.FREEZE)
            self._go(path, f"{gap.reason}; it stands, and is held")

    def _go(self, path: tuple[Behavior, ...], reason: str) -> None:
        for behavior in path:
            self._fsm.go(behavior, reason)


class DeviceReactions:
    """Applies the latest demand; never changes back automatically."""

    def __init__(self, fsm: BehaviorFsm, stepping: Callable[[], bool]) -> None:
        """``stepping``: whether a step has not come to rest; until then Freeze is not possible."""
        self._fsm = fsm
        self._stepping = stepping
        self.demand = Reaction.KEEP_BALANCE  # the latest
        self._reason = ""

    def receive(self, status: DeviceStatus) -> None:
        """Store a demand; an unknown one counts as ``hold``."""
        self.demand = next((reaction for reaction in Reaction if reaction == status.reaction), Reaction.HOLD)
        self._reason = status.reason

    def update(self) -> None:
        """Change the behavior once a period, if the demand is not satisfied."""
        if self._fsm.behavior in ENOUGH[self.demand]:
            return
        for behavior in DEMANDS[self.demand]:
            if behavior is Behavior.FREEZE and self._stepping():
                continue
            if behavior is self._fsm.behavior:
                return
            if self._fsm.may_go(behavior):
                self._fsm.go(behavior, self._reason)
                return
