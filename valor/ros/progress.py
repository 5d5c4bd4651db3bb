"""How a step plan and a hand's goal fare, as few bytes for the link, and back as the robot's own messages."""

from __future__ import annotations

import struct
import zlib
from typing import Any

from valor_msgs.msg import HandGoalStatus
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step

from valor.link.errors import SealError
from valor.ros.varints import varint, varints

FEEDBACK = "robot_controllers/footstep_controller/execute_feedback"
GOAL_STATUS = "flor/{}/goal_status"
FeedbackMessage = ExecuteStepPlan.Impl.FeedbackMessage
_PLAN = struct.Struct(">II")  # plan, time [ms]; behind them the feedback's own numbers
_MOST_OF = (2**7, *(2**31,) * 7, 2**32, 2**32)  # of those numbers; they are less
_HAND = struct.Struct(">IBHH")  # time [ms], state, errors [mm, mrad]
_STATES = ("idle", "moving", "reached", "out_of_reach", "resisted")
_MOST = 2**16 - 1
STAMP = slice(4, 8)
"""Where a packed feedback has its time."""
TEXT = 200  # of a reason [B]


def mark(steps: bytes) -> int:
    """By which a plan's progress names its packed steps; 0: none."""
    return zlib.crc32(steps) if steps else 0


def mark_of(data: bytes) -> int:
    """That of the steps that a packed feedback names."""
    return int.from_bytes(data[: STAMP.start], "big")


def pack_feedback(message: Any, steps: bytes) -> bytes:
    """Of a ``FeedbackMessage``; ``steps``: those that it has, packed."""
    told = message.feedback
    numbers = (
        told.controller_state, told.queue_size, told.first_queued_step_index, told.last_queued_step_index,
        told.last_performed_step_index, told.currently_executing_step_index, told.first_changeable_step_index,
        told.stepping_status, told.status.error, told.status.warning,
    )  # fmt: skip
    texts = "\0".join((told.status.error_msg, told.status.warning_msg)).encode()
    packed: bytes = _PLAN.pack(mark(steps), _milliseconds(told.header.stamp))
    return packed + b"".join(map(varint, numbers)) + texts[:TEXT]


def unpack_feedback(data: bytes, known: dict[int, list[Step]], frame: str) -> Any:
    """The ``FeedbackMessage``, without its goal's id.

    Args:
        data: of ``pack_feedback``.
        known: steps by their mark.
        frame: odom, as tf names it.

    Raises:
        SealError: it is none.
    """
    try:
        plan, stamp = _PLAN.unpack_from(data)
    except struct.error:
        raise SealError(f"a plan's progress of {len(data)} bytes") from None
    numbers, at = varints(data, _PLAN.size, len(_MOST_OF))
    if any(not (0 if most == 2**32 else -most) <= each < most for each, most in zip(numbers, _MOST_OF, strict=True)):
        raise SealError(f"a plan's progress: {numbers}")
    message = FeedbackMessage()
    told = message.feedback
    (
        told.controller_state, told.queue_size, told.first_queued_step_index, told.last_queued_step_index,
        told.last_performed_step_index, told.currently_executing_step_index, told.first_changeable_step_index,
        told.stepping_status, told.status.error, told.status.warning,
    ) = numbers  # fmt: skip
    error, _, warning = data[at:].decode(errors="replace").partition("\0")
    told.status.error_msg, told.status.warning_msg = error, warning
    for header in (told.header, told.feedback.header):
        header.frame_id = frame
        _stamp(header.stamp, stamp)
    told.feedback.steps = known.get(plan, [])
    return message


def pack_hand(status: HandGoalStatus) -> bytes:
    """Of a hand's goal, without which hand it is."""
    state = _STATES.index(status.state) if status.state in _STATES else len(_STATES)
    errors = (_whole(1e3 * status.position_error), _whole(1e3 * status.orientation_error))
    packed: bytes = _HAND.pack(status.time // 10**6 % 2**32, state, *errors)
    return packed + bytes(status.reason, "utf-8")[:TEXT]


def unpack_hand(data: bytes, hand: int) -> HandGoalStatus:
    """The message.

    Raises:
        SealError: it is none.
    """
    try:
        stamp, state, position, orientation = _HAND.unpack_from(data)
    except struct.error:
        raise SealError(f"a hand's status of {len(data)} bytes") from None
    return HandGoalStatus(
        time=stamp * 10**6, hand=hand, state=_STATES[state] if state < len(_STATES) else "unknown",
        reason=data[_HAND.size :].decode(errors="replace"),
        position_error=1e-3 * position, orientation_error=1e-3 * orientation,
    )  # fmt: skip


def _whole(number: float) -> int:
    return _MOST if not number < _MOST else round(max(0.0, number))


def _milliseconds(stamp: Any) -> int:
    return int(1000 * stamp.sec + stamp.nanosec // 10**6) % 2**32


def _stamp(stamp: Any, milliseconds: int) -> None:
    stamp.sec, rest = divmod(milliseconds, 1000)
    stamp.nanosec = rest * 10**6
