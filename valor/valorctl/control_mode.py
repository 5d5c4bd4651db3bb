"""The control mode: what it is, and how it is changed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import bifrost
from valor.common import mode_names
from valor.common.behaviors import Obstacle
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import robots_hosts
from valor.common.messages import BehaviorReply, BehaviorRequest, ControlModeReport, ModeStatus
from valor.common.topics import BEHAVIOR, CONTROL_MODE
from valor.valorctl.node import hear, join

ACTION = "mode_controllers/control_mode_controller/change_control_mode"
CHANGE_TIMEOUT = 60.0  # a change may have to wait for the robot to move [s]
_REPORT_TIMEOUT = 2.0  # reports come ten times a second [s]
_LOOK = 0.05  # [s]


def flag_names(status: int) -> list[str]:
    """The flags set in a status, by name; bits that have none as hexadecimal."""
    names = [flag.name for flag in ModeStatus if status & flag and flag.name]
    if rest := status & ~sum(ModeStatus):
        names.append(f"0x{rest:x}")
    return names


@dataclass(frozen=True)
class ModeChange:
    """What became of a request."""

    requested: str
    current: str
    status: int
    latency: float  # from the goal sent to its result [s]
    reason: str  # why it was refused; empty: not known

    @property
    def reached(self) -> bool:
        """Whether the mode asked for is the current one now; also when it had been before."""
        refused = self.status & (ModeStatus.MODE_REJECTED | ModeStatus.MODE_PREEMPTED)
        return self.current == self.requested and not refused

    def describe(self) -> str:
        """One line."""
        flags = ", ".join(flag_names(self.status)) or "no flags"
        if self.reached:
            word = (
                "control mode was already" if self.status & ModeStatus.MODE_DUPLICATE else "accepted: control mode is"
            )
            return f"{word} {self.current} ({flags}; {self.latency * 1e3:.0f} ms)"
        because = f": {self.reason}" if self.reason else ""
        return f"control mode {self.requested} refused ({flags}){because}; it is {self.current or 'none'}"


def report(instance: Instance) -> ControlModeReport:
    """The VRC's newest report; errors as of ``aged_report``."""
    return aged_report(instance)[0]


def aged_report(instance: Instance) -> tuple[ControlModeReport, float]:
    """The VRC's newest report, and how old it is at most, where it comes through the link [s]; else 0.

    Raises:
        ValorError: it is silent.
    """
    if robots_hosts(instance.settings()):
        from valor.valorctl.beyond_link import mode

        return mode(instance)
    with join(instance) as node:
        return hear(CONTROL_MODE, CONTROL_MODE.subscriber(node), _REPORT_TIMEOUT), 0.0


def change(instance: Instance, mode: str, check: Callable[[], None] = lambda: None) -> ModeChange:
    """Ask the VRC for a control mode, as any ROS client would; where it obeys none, the Motion Manager.

    Args:
        instance: must be up.
        mode: by name.
        check: called while waiting; may raise to give up.

    Raises:
        ValorError: no answer, or no result in time.
    """
    if instance.settings().ros_refusal:
        return _lead(instance, mode, check)
    from vigir_humanoid_control_msgs.action import ChangeControlMode

    from valor.valorctl.ros_client import RosClient

    with RosClient(instance, check) as ros:
        began = time.monotonic()
        result = ros.call_action(ChangeControlMode, ACTION, ChangeControlMode.Goal(mode_request=mode), CHANGE_TIMEOUT)
        latency = time.monotonic() - began
        status = result.result
        made = ModeChange(mode, status.current_control_mode, status.status, latency, "")
        if made.reached:
            return made
        refused, _, reason = ros.diagnosis("last control mode refused").partition(": ")
    return replace(made, reason=reason if refused == mode else "")


def enter(instance: Instance, mode: str, check: Callable[[], None] = lambda: None) -> None:
    """Change the control mode.

    Raises:
        ValorError: it was refused, or nobody answers; says why.
    """
    made = change(instance, mode, check)
    if not made.reached:
        raise ValorError(made.describe())


def _lead(instance: Instance, mode: str, check: Callable[[], None]) -> ModeChange:
    """Ask the Motion Manager for what a mode means; the VRC follows it there."""
    behaviors = mode_names.behaviors(mode)
    began = time.monotonic()
    with join(instance) as node:
        client = BEHAVIOR.client(node)
        reports = CONTROL_MODE.subscriber(node)
        report = None
        reason = next((why for each in behaviors if (why := _reach(client, each, began, check))), "")
        while report is None or (not reason and report.current_control_mode != mode):
            check()
            report = hear(CONTROL_MODE, reports, _REPORT_TIMEOUT)
            if time.monotonic() - began > CHANGE_TIMEOUT:
                reason = reason or f"valor_ros_controller has not followed within {CHANGE_TIMEOUT:g} s"
    status = ModeStatus.MODE_REJECTED | ModeStatus.ERR_INVALID_TRANSITION if reason else ModeStatus.MODE_ACCEPTED
    return ModeChange(mode, report.current_control_mode, status, time.monotonic() - began, reason)


def _reach(
    client: bifrost.Client[BehaviorRequest, BehaviorReply], behavior: str, began: float, check: Callable[[], None]
) -> str:
    """Ask until a behavior is reached; why it is not, or nothing."""
    while time.monotonic() - began <= CHANGE_TIMEOUT:
        check()
        reply = client.call(BehaviorRequest(behavior), timeout=CHANGE_TIMEOUT)
        if not reply.accepted and reply.obstacle != Obstacle.WAIT:
            return reply.reason
        if reply.accepted and reply.behavior == behavior:
            return ""
        time.sleep(_LOOK)
    return f"{behavior} not reached within {CHANGE_TIMEOUT:g} s"
