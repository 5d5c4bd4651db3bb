"""What the robot does about a device's fault: a table. Who watches the devices is ``watch.py``."""

from __future__ import annotations

from collections.abc import Mapping

from valor.common.behaviors import Reaction
from valor.comms_manager.hardware.device import Fault, Part

LEGS_TO_LIMP = 2  # leg units without motors, from which on the robot cannot carry itself


SPOKEN: Mapping[Reaction, str] = {
    Reaction.KEEP_BALANCE: "the robot goes on",
    Reaction.SOFT_STOP: "the robot comes to rest",
    Reaction.HOLD: "the robot holds its joints",
    Reaction.LIMP: "the robot goes limp",
}
"""For people."""

_BALANCE, _STOP, _HOLD = Reaction.KEEP_BALANCE, Reaction.SOFT_STOP, Reaction.HOLD

# fmt: off
_TABLE: Mapping[Fault, tuple[Reaction, ...]] = {
    #                   legs    upper body  IMU     foot      hand
    Fault.SILENT:      (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE),
    Fault.UNPLUGGED:   (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE),
    Fault.UNREAD:      (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE),
    Fault.OVERDUE:     (_BALANCE, _BALANCE, _BALANCE, _BALANCE, _BALANCE),
    Fault.SLOW:        (_STOP,  _BALANCE,   _STOP,  _STOP,    _BALANCE),
    Fault.FAULTY:      (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE),
    Fault.DISABLED:    (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE),
    Fault.ENCODER:     (_HOLD,  _STOP,      _HOLD,  _STOP,    _BALANCE),
    Fault.WARM:        (_STOP,  _BALANCE,   _STOP,  _BALANCE, _BALANCE),
    Fault.HOT:         (_HOLD,  _STOP,      _HOLD,  _STOP,    _BALANCE),
    Fault.LOW_VOLTAGE: (_STOP,  _BALANCE,   _STOP,  _BALANCE, _BALANCE),
    Fault.FLAT:        (_HOLD,  _STOP,      _HOLD,  _STOP,    _BALANCE),
}
# fmt: on

REACTIONS: Mapping[Fault, Mapping[Part, Reaction]] = {
    fault: dict(zip((Part.LEGS, Part.UPPER_BODY, Part.IMU, Part.FOOT, Part.HAND), row, strict=True))
    for fault, row in _TABLE.items()
}
"""Besides it: two leg units or more without motors, and the robot goes limp; what ails an IMU while another one is
well harms nobody."""
