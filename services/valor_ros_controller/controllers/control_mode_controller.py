"""State machine of control modes (thesis sections 3.5 and 4.2.2). Without input and output.

A mode is current once the Motion System reports its behavior. A change without a request (a fall, a restart, another
client, the end of a footstep plan) is followed and reported as external.
"""

import logging
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass

from valor.common.behaviors import ControlMode, Obstacle, requester
from valor.common.messages import ModeStatus
from valor.valor_ros_controller.behavior_transition import BehaviorAnswer, BehaviorTransition, TransitionState
from valor.valor_ros_controller.control_modes import (
    ControlModeTable,
    ModeClient,
    ModeRejectedError,
    ModeReport,
    Target,
    admit,
)
from valor.valor_ros_controller.controller_manager import Controller
from valor.valor_ros_controller.rejection_log import BoundedLog, RejectionLog, bounded
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

_log = logging.getLogger("control_mode_controller")

_S = ModeStatus
_WHY = {Obstacle.TRANSITION: _S.ERR_INVALID_TRANSITION}
"""Error flags by obstacle; else the robot is not ready."""


@dataclass
class _Change:
    """Change in progress."""

    requested: str
    target: Target
    client: ModeClient | None
    transition: BehaviorTransition


class ControlModeController(Controller):
    """Control modes, changed one at a time.

    Attributes:
        report: content of ``/flor/controller/mode``.
        hard_resets: number of restarts of all controllers; ``stops`` of these by a mode without behaviors (stop).
    """

    name = "control_mode_controller"
    type = "valor_ros_controller/ControlModeController"

    def __init__(self, table: ControlModeTable, motion_system: ValorEscherInterface, rejection: str = "") -> None:
        """``rejection``: reason to reject every request; empty: none."""
        self._table = table
        self._motion = motion_system
        self._requests: deque[tuple[str, ModeClient | None]] = deque()
        self._change: _Change | None = None
        self._freezes: deque[tuple[str, ModeClient | None, Future[BehaviorAnswer]]] = deque()  # of limbs, in progress
        self._answers: list[tuple[ModeClient, ModeReport]] = []
        self._followed = ""  # behavior last compared with the mode
        self._next_mode = ""  # mode to request without a client
        self.report = ModeReport("", ControlMode.NONE, _S.ERR_CONTROLLER_NOT_READY)
        self.reports = 1  # number of changes of the report
        self.active_mode = ""  # mode whose controllers are allowed; empty: none
        self.hard_resets = self.stops = 0
        self.rejections = RejectionLog(BoundedLog(_log), "control mode {}")  # of requests
        self._waits_for = ""
        self._rejection = rejection

    @property
    def current(self) -> str:
        """Mode of the robot."""
        return self.report.current

    def request(self, mode: str, client: ModeClient | None = None) -> None:
        """Request a mode by name in any case, an emergency stop, or ``freeze`` with limbs. From any thread."""
        self._requests.append((bounded(mode), client))
        self._motion.wake()

    def update(self, hw: ValorEscherHWInterface) -> None:
        motion, reports = self._motion, self.reports
        while self._freezes and self._freezes[0][2].done():
            self._end_freeze(*self._freezes.popleft())
        if not motion.behavior:
            if self.active_mode or self._change:
                self._lose_motion_system()
        else:
            if self._change:
                self._proceed(self._change)
            if not self._change and motion.behavior != self._followed:
                self._follow()
            else:
                mode, self._next_mode = self._next_mode, ""  # once, in the cycle after the report of the change
                if mode and not self._change:
                    self._begin(mode, Target(mode), None)
        if self.reports != reports:
            return  # each report is published for a cycle
        while self._requests:
            self._consider(*self._requests.popleft())

    def answer(self) -> None:
        """Send results, after the mode's controllers have started: a client may use them on receipt."""
        answers, self._answers = self._answers, []
        for client, report in answers:
            client.finish(report)

    def _lose_motion_system(self) -> None:
        """Drop mode, controllers and requests while it is silent."""
        self._next_mode = ""
        self._motion.abandon_transition(f"{self._motion.silent} is silent")
        if self._change:
            self._finish(_S.MODE_REJECTED | _S.ERR_CONTROLLER_NOT_READY, f"{self._motion.silent} is silent")
        _log.warning("%s is silent: the control mode is unknown", self._motion.silent)
        self._followed = ""
        self.active_mode = ""
        self._set(ModeReport(self.report.requested, ControlMode.NONE, _S.EXTERNAL_CHANGE | _S.ERR_CONTROLLER_NOT_READY))

    def _follow(self) -> None:
        motion, previous = self._motion, self.current
        first = not self._followed
        self._followed = motion.behavior
        if not first and self._table.fits(previous, motion.behavior):
            return
        mode = self._table.behaviors.get(motion.behavior, ControlMode.NONE)
        if self._table.modes[mode].switch == "hard_reset" and not first:
            self.hard_resets += 1
        self.active_mode = mode
        self._set(ModeReport(self.report.requested, mode, _S.EXTERNAL_CHANGE))
        actual = f"{motion.behavior} ({motion.behavior_reason})"
        _log.info("control mode %s -> %s: the Motion System is in %s", previous, mode, actual)
        done = mode == ControlMode.STAND and not requester(motion.behavior_reason)
        self._next_mode = (self._table.modes[previous].when_done or "") if done and not first else ""

    def _proceed(self, change: _Change) -> None:
        transition = change.transition
        if transition.state is TransitionState.PROCESSING:
            if transition.waits_for and not self._waits_for:
                _log.info("control mode %s waits: %s", change.target.mode, transition.waits_for)
            self._waits_for = transition.waits_for
            return
        behavior, before = self._motion.behavior, self._followed
        self._followed = behavior
        if transition.state is TransitionState.DONE:
            _log.info("control mode %s -> %s", self.current, change.target.mode)
            self.active_mode = change.target.mode
            self._finish(_S.MODE_ACCEPTED, "", current=change.target.mode)
            return
        # A mode without behaviors ends only when the behavior changes.
        if behavior == before or self._table.fits(self.current, behavior):
            actual = self.current
        else:
            actual = self._table.behaviors.get(behavior, ControlMode.NONE)
        stop = self._table.first_stop(actual, change.target.other_stops)
        if stop and not (transition.silent or transition.diverted):
            # The emergency stop was chosen for a mode that had already ended.
            self.rejections.add(change.requested, transition.reason)
            self._change = None
            self._set(ModeReport(stop.mode, actual, _S.MODE_PROCESSING))
            self._begin(change.requested, stop, change.client)
            return
        status = _S.MODE_REJECTED
        if not transition.diverted:
            status |= _WHY.get(transition.obstacle, _S.ERR_CONTROLLER_NOT_READY)
        else:
            status |= _S.EXTERNAL_CHANGE
            if self._table.modes[actual].switch == "hard_reset":
                self.hard_resets += 1
        self.active_mode = actual
        self._finish(status, transition.reason, current=actual)

    def _consider(self, requested: str, client: ModeClient | None) -> None:
        change = self._change
        try:
            if self._rejection:
                raise ModeRejectedError(_S.ERR_INVALID_TRANSITION, self._rejection)
            if not self._motion.behavior:
                waiting = self._motion.silent or "the Motion System"
                raise ModeRejectedError(_S.ERR_CONTROLLER_NOT_READY, f"{waiting} is silent")
            name, *limbs = requested.lower().split() or [""]
            if name == ControlMode.FREEZE and limbs:
                self._freezes.append((requested, client, self._motion.freeze(limbs)))
                return
            under_way = change.target.mode if change else ""
            target = admit(self._table, requested, self.current, self._motion.behavior, under_way)
        except ModeRejectedError as rejected:
            self._reject(requested, client, rejected.error, str(rejected))
            return
        if not change and target.mode == self.current:
            self._restart(target.mode, repeated=True)
            report = ModeReport(target.mode, self.current, _S.MODE_ACCEPTED | _S.MODE_DUPLICATE)
            self._set(report)
            self._conclude(client, report)
            return
        if change:
            self._finish(_S.MODE_PREEMPTED, f"preempted by {target.mode}")
        self._begin(requested, target, client, under_way=change is not None)

    def _begin(self, requested: str, target: Target, client: ModeClient | None, *, under_way: bool = False) -> None:
        """Request the behaviors of a mode; ``under_way``: another change may still take effect."""
        name = target.mode
        mode = self._table.modes[name]
        self._restart(name)
        if not mode.motion or (mode.motion[1] == self._motion.behavior and not under_way):
            # The mode keeps the behavior, or differs only in its controllers.
            self.active_mode = name
            report = ModeReport(name, name, _S.MODE_ACCEPTED)
            self._set(report)
            self._conclude(client, report)
            return
        if mode.switch != "on_feedback":
            self.active_mode = name
        report = ModeReport(name, self.current, _S.MODE_PROCESSING)
        self._change = _Change(requested, target, client, self._motion.begin_transition(mode.motion))
        self._set(report)
        if client:
            client.processing(report)

    def _end_freeze(self, requested: str, client: ModeClient | None, future: Future[BehaviorAnswer]) -> None:
        """Report the Motion Manager's reply to a request to freeze limbs; the mode stays."""
        answer = future.result()
        if not answer.accepted:
            error = _S.ERR_CONTROLLER_NOT_READY if answer.silent else _S.ERR_INVALID_BEHAVIOR_MODE
            self._reject(requested, client, error, answer.reason)
            return
        report = ModeReport(requested, self.current, _S.MODE_ACCEPTED)
        if self._change is None:
            self._set(report)
        self._conclude(client, report)

    def _restart(self, name: str, *, repeated: bool = False) -> None:
        """Restart controllers if the mode does so; a ``repeated`` request only in stop, for what has moved since."""
        mode = self._table.modes[name]
        if mode.switch == "hard_reset" and not (repeated and mode.motion):
            self.hard_resets += 1
            self.stops += not mode.motion

    def _finish(self, status: ModeStatus, reason: str, current: str | None = None) -> None:
        change = self._change
        assert change is not None
        self._change = None
        report = ModeReport(change.target.mode, current or self.current, status)
        if not status & _S.MODE_ACCEPTED:
            self.rejections.add(change.requested, reason)
        self._set(report)
        self._conclude(change.client, report)

    def _reject(self, requested: str, client: ModeClient | None, error: ModeStatus, reason: str) -> None:
        self.rejections.add(requested, reason)
        report = ModeReport(requested, self.current, _S.MODE_REJECTED | error)
        if self._change is None:
            self._set(report)
        self._conclude(client, report)

    def _conclude(self, client: ModeClient | None, report: ModeReport) -> None:
        if client:
            self._answers.append((client, report))

    def _set(self, report: ModeReport) -> None:
        self.report = report
        self.reports += 1
