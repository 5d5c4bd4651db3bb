"""`mode`: report and change of the control mode."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import bifrost
from valor.common import mode_names
from valor.common.behaviors import Obstacle
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import BehaviorReply, BehaviorRequest, ControlModeReport, ModeStatus
from valor.common.topics import BEHAVIOR, CONTROL_MODE
from valor.ros.limbs import LAST_MODE_REJECTED
from valor.valorctl.drive.node import join, next_message

ACTION = "mode_controllers/control_mode_controller/change_control_mode"
CHANGE_TIMEOUT = 60.0  # includes motions of the robot [s]
_REPORT_TIMEOUT = 2.0  # reports are published at 10 Hz [s]
_POLL = 0.05  # [s]
_Behaviors = bifrost.Client[BehaviorRequest, BehaviorReply]


def flag_names(status: int) -> list[str]:
    """Names of the flags set in a status; unnamed bits as hexadecimal."""
    names = [flag.name for flag in ModeStatus if status & flag and flag.name]
    if rest := status & ~sum(ModeStatus):
        names.append(f"0x{rest:x}")
    return names


@dataclass(frozen=True)
class ModeChange:
    """Result of a request."""

    requested: str
    current: str
    status: int
    latency: float  # from goal to result [s]
    reason: str = ""  # of a rejection; empty: unknown

    @property
    def reached(self) -> bool:
        """True if the requested mode is the current one, also if it was before; or the limbs are frozen."""
        refused = self.status & (ModeStatus.MODE_REJECTED | ModeStatus.MODE_PREEMPTED)
        return (self.current == self.requested or " " in self.requested) and not refused

    def describe(self) -> str:
        """One line."""
        flags = ", ".join(flag_names(self.status)) or "no flags"
        if self.reached:
            before = self.status & ModeStatus.MODE_DUPLICATE
            words = "control mode was already" if before else "accepted: control mode is"
            words = f"accepted: {self.requested}; control mode is" if " " in self.requested else words
            return f"{words} {self.current} ({flags}; {self.latency * 1e3:.0f} ms)"
        because = f": {self.reason}" if self.reason else ""
        return f"control mode {self.requested} rejected ({flags}){because}; it is {self.current or 'none'}"


def report(instance: Instance) -> ControlModeReport:
    """The VRC's latest report; raises ``ValorError`` if it does not publish."""
    with join(instance) as node:
        return next_message(CONTROL_MODE, CONTROL_MODE.subscriber(node), _REPORT_TIMEOUT)


def change(instance: Instance, mode: str, check: Callable[[], None] = lambda: None) -> ModeChange:
    """Request a control mode from the VRC as a ROS client; from the Motion Manager if ROS commands are rejected.

    ``mode`` is one, or ``freeze`` with limbs, separated by spaces.

    ``check`` is called while waiting and may raise. Raises ``ValorError`` without a response, or a result in time.
    """
    began = time.monotonic()
    if instance.settings().ros_refusal:
        current, status, reason = _request_behaviors(instance, mode, began, check)
        return ModeChange(mode, current, status, time.monotonic() - began, reason)
    from vigir_humanoid_control_msgs.action import ChangeControlMode

    from valor.valorctl.drive.ros_client import RosClient

    with RosClient(instance, check) as ros:
        began = time.monotonic()
        result = ros.call_action(ChangeControlMode, ACTION, ChangeControlMode.Goal(mode_request=mode), CHANGE_TIMEOUT)
        latency = time.monotonic() - began
        status = result.result
        made = ModeChange(mode, status.current_control_mode, status.status, latency)
        if made.reached:
            return made
        rejected, _, reason = ros.diagnosis(LAST_MODE_REJECTED).partition(": ")
    return replace(made, reason=reason if rejected == mode else "")


def enter(instance: Instance, mode: str, check: Callable[[], None] = lambda: None) -> None:
    """Change the control mode; raises ``ValorError`` with the reason if it is rejected."""
    made = change(instance, mode, check)
    if not made.reached:
        raise ValorError(made.describe())


def _request_behaviors(instance: Instance, mode: str, began: float, check: Callable[[], None]) -> tuple[str, int, str]:
    """Request the behaviors of a mode from the Motion Manager; the VRC follows. Returns mode, status and reason."""
    mode, *limbs = mode.split()
    with join(instance) as node:
        client = BEHAVIOR.client(node)
        reports = CONTROL_MODE.subscriber(node)
        requests = [BehaviorRequest(each, limbs) for each in ([mode] if limbs else mode_names.behaviors(mode))]
        reason = next((why for each in requests if (why := _reach(client, each, began, check))), "")
        current = next_message(CONTROL_MODE, reports, _REPORT_TIMEOUT).current_control_mode
        while not reason and not limbs and current != mode:
            check()
            current = next_message(CONTROL_MODE, reports, _REPORT_TIMEOUT).current_control_mode
            if time.monotonic() - began > CHANGE_TIMEOUT:
                reason = f"valor_ros_controller has not followed within {CHANGE_TIMEOUT:g} s"
    return (
        current,
        ModeStatus.MODE_REJECTED | ModeStatus.ERR_INVALID_TRANSITION if reason else ModeStatus.MODE_ACCEPTED,
        reason,
    )


def _reach(client: _Behaviors, request: BehaviorRequest, began: float, check: Callable[[], None]) -> str:
    """Request until a behavior is reached, or its limbs frozen; returns why it is not, or an empty string."""
    while time.monotonic() - began <= CHANGE_TIMEOUT:
        check()
        reply = client.call(request, timeout=CHANGE_TIMEOUT)
        if not reply.accepted and reply.obstacle != Obstacle.WAIT:
            return reply.reason
        if reply.accepted and (request.limbs or reply.behavior == request.behavior):
            return ""
        time.sleep(_POLL)
    return f"{request.behavior} not reached within {CHANGE_TIMEOUT:g} s"
