"""What is done about devices that fail: the Comms Manager says what is demanded, the tables how to get there."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from valor.common.behaviors import Behavior, Reaction
from valor.common.messages import DeviceStatus
from valor.motion_manager.states.behavior_fsm import BehaviorFsm

_B, _R = Behavior, Reaction

DEMANDS: Mapping[Reaction, tuple[Behavior, ...]] = {
    _R.KEEP_BALANCE: (),
    _R.SOFT_STOP: (_B.SOFT_STOP,),
    _R.HOLD: (_B.FREEZE, _B.SOFT_STOP, _B.FALL),
    _R.LIMP: (_B.FALL, _B.SOFT_STOP, _B.FREEZE),
}
"""``DeviceStatus.reaction`` → behaviors, the wanted one first; the others are ways there, or better than nothing."""

ENOUGH: Mapping[Reaction, frozenset[Behavior]] = {
    _R.KEEP_BALANCE: frozenset(Behavior),
    # Before it balances, the robot stands on its servos and obeys nobody.
    _R.SOFT_STOP: frozenset({_B.SOFT_STOP, _B.FREEZE, _B.FALL, _B.GET_UP, _B.IDLE, _B.STAND_PREP}),
    _R.HOLD: frozenset({_B.FREEZE, _B.FALL, _B.IDLE}),
    _R.LIMP: frozenset({_B.FALL, _B.IDLE}),
}
"""Behaviors in which nothing more is to be done."""


class DeviceReactions:
    """Follows the Comms Manager's word on the devices, as long as it says so; never leads back by itself."""

    def __init__(self, fsm: BehaviorFsm, stepping: Callable[[], bool]) -> None:
        """``stepping``: whether a step has not come to rest; until then the joints cannot be held."""
        self._fsm = fsm
        self._stepping = stepping
        self._demand = Reaction.KEEP_BALANCE
        self._reason = ""

    def hear(self, status: DeviceStatus) -> None:
        """Take note of the newest word; one that is not known is taken for the gravest that keeps the robot up."""
        self._demand = next((reaction for reaction in Reaction if reaction == status.reaction), Reaction.HOLD)
        self._reason = status.reason

    def update(self) -> None:
        """Once a period: go where the devices' condition demands."""
        if self._fsm.behavior in ENOUGH[self._demand]:
            return
        for behavior in DEMANDS[self._demand]:
            if behavior is Behavior.FREEZE and self._stepping():
                continue
            if behavior is self._fsm.behavior:
                return
            if self._fsm.may_go(behavior):
                self._fsm.go(behavior, self._reason)
                return
