"""Packed progress of step plans and hand goals for the link."""

import struct
import zlib
from typing import Any

from valor_msgs.msg import HandGoalStatus
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step

from valor.link.errors import SealError
from valor.ros.packed_steps import varint, varints

FEEDBACK = "robot_controllers/footstep_controller/execute_feedback"
GOAL_STATUS = "flor/{}/goal_status"
FeedbackMessage = ExecuteStepPlan.Impl.FeedbackMessage
_PLAN = struct.Struct(">II")  # checksum of the steps, time [ms]; then the numbers of the feedback
_LIMITS = (2**7, *(2**31,) * 7, 2**32, 2**32)  # of those numbers, exclusive
_HAND = struct.Struct(">IBHH")  # time [ms], state, errors [mm, mrad]
_STATES = ("idle", "moving", "reached", "out_of_reach", "resisted")
_MOST = 2**16 - 1
STAMP = slice(4, 8)
"""Bytes of the time in a packed feedback."""
TEXT = 200  # longest reason [B]


def checksum(steps: bytes) -> int:
    """Checksum that identifies packed steps in a feedback; 0: no steps."""
    return zlib.crc32(steps) if steps else 0


def checksum_of(data: bytes) -> int:
    """Checksum of the steps of a packed feedback."""
    return int.from_bytes(data[: STAMP.start], "big")


def pack_feedback(message: Any, steps: bytes) -> bytes:
    """Packed ``FeedbackMessage``; ``steps``: its packed steps."""
    feedback = message.feedback
    numbers = (
        feedback.controller_state, feedback.queue_size, feedback.first_queued_step_index,
        feedback.last_queued_step_index, feedback.last_performed_step_index, feedback.currently_executing_step_index,
        feedback.first_changeable_step_index, feedback.stepping_status, feedback.status.error, feedback.status.warning,
    )  # fmt: skip
    texts = "\0".join((feedback.status.error_msg, feedback.status.warning_msg)).encode()
    packed: bytes = _PLAN.pack(checksum(steps), _milliseconds(feedback.header.stamp))
    return packed + b"".join(map(varint, numbers)) + texts[:TEXT]


def unpack_feedback(data: bytes, stored: dict[int, list[Step]], frame: str) -> Any:
    """Inverse of ``pack_feedback``: ``FeedbackMessage`` without the goal's id. Raises SealError: malformed.

    ``stored``: received steps by their checksum; ``frame``: tf frame odom.
    """
    try:
        plan, stamp = _PLAN.unpack_from(data)
    except struct.error:
        raise SealError(f"a plan's progress of {len(data)} bytes") from None
    numbers, at = varints(data, _PLAN.size, len(_LIMITS))
    if any(not (0 if most == 2**32 else -most) <= each < most for each, most in zip(numbers, _LIMITS, strict=True)):
        raise SealError(f"a plan's progress: {numbers}")
    message = FeedbackMessage()
    feedback = message.feedback
    (
        feedback.controller_state, feedback.queue_size, feedback.first_queued_step_index,
        feedback.last_queued_step_index, feedback.last_performed_step_index, feedback.currently_executing_step_index,
        feedback.first_changeable_step_index, feedback.stepping_status, feedback.status.error, feedback.status.warning,
    ) = numbers  # fmt: skip
    error, _, warning = data[at:].decode(errors="replace").partition("\0")
    feedback.status.error_msg, feedback.status.warning_msg = error, warning
    for header in (feedback.header, feedback.feedback.header):
        header.frame_id = frame
        _stamp(header.stamp, stamp)
    feedback.feedback.steps = stored.get(plan, [])
    return message


def pack_hand(status: HandGoalStatus) -> bytes:
    """Packed status of a hand goal, without the hand."""
    state = _STATES.index(status.state) if status.state in _STATES else len(_STATES)
    errors = (_clamped(1e3 * status.position_error), _clamped(1e3 * status.orientation_error))
    packed: bytes = _HAND.pack(status.time // 10**6 % 2**32, state, *errors)
    return packed + bytes(status.reason, "utf-8")[:TEXT]


def unpack_hand(data: bytes, hand: int) -> HandGoalStatus:
    """Inverse of ``pack_hand``; ``hand``: index in ``HANDS``. Raises SealError: malformed."""
    try:
        stamp, state, position, orientation = _HAND.unpack_from(data)
    except struct.error:
        raise SealError(f"a hand's status of {len(data)} bytes") from None
    return HandGoalStatus(
        time=stamp * 10**6, hand=hand, state=_STATES[state] if state < len(_STATES) else "unknown",
        reason=data[_HAND.size :].decode(errors="replace"),
        position_error=1e-3 * position, orientation_error=1e-3 * orientation,
    )  # fmt: skip


def _clamped(number: float) -> int:
    return _MOST if not number < _MOST else round(max(0.0, number))


def _milliseconds(stamp: Any) -> int:
    return int(1000 * stamp.sec + stamp.nanosec // 10**6) % 2**32


def _stamp(stamp: Any, milliseconds: int) -> None:
    stamp.sec, rest = divmod(milliseconds, 1000)
    stamp.nanosec = rest * 10**6
