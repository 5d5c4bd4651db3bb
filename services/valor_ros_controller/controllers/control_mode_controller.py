"""The state machine of control modes (thesis sections 3.5 and 4.2.2).

It follows two things: what clients ask for, and what the Motion System reports. The report decides. A mode is current
only once the Motion System is in the behavior that the mode stands for, and a change that nobody asked for (a fall, a
restart, another commander, the end of a footstep plan) is followed at once and reported as external.

No input or output here: requests come in through a queue, the report goes out as an attribute.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from valor.common.behaviors import ControlMode, Obstacle, requester
from valor.common.messages import ModeStatus
from valor.valor_ros_controller.behavior_transition import BehaviorTransition, TransitionState
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controllers.mode_requests import (
    ModeClient,
    ModeRefusedError,
    ModeReport,
    Target,
    admit,
    first_stop,
)
from valor.valor_ros_controller.refusals import BoundedLog, Refusals, bounded
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("control_mode_controller")

_S = ModeStatus
_WHY = {Obstacle.TRANSITION: _S.ERR_INVALID_TRANSITION}
"""What a refusal of the Motion System means, but for robots that are not ready."""


class MotionSystem(Protocol):
    """What the controller needs of the Motion System."""

    behavior: str  # as reported; empty: not heard, or silent
    behavior_reason: str
    silent: str  # name of the process that is silent; empty: none

    def begin_transition(self, commands: tuple[str, str]) -> BehaviorTransition:
        """Ask for two behaviors, one after the other; ends a transition that is under way."""

    def abandon_transition(self, reason: str) -> None:
        """Ask for nothing more."""

    def wake(self) -> None:
        """Have ``update`` called soon. From any thread."""


@dataclass
class _Change:
    """A change under way."""

    requested: str
    target: Target
    client: ModeClient | None
    transition: BehaviorTransition


class ControlModeController:
    """Control modes: one change at a time.

    Attributes:
        report: what ``/flor/controller/mode`` says.
        reports: how often the report changed.
        active_mode: whose controllers are to run; empty: none may.
        hard_resets: how often all controllers had to start anew.
        stops: how often those of a mode that leaves the behavior as it is had to: of stop.
        refusals: of requests.
    """

    name = "control_mode_controller"
    type = "valor_ros_controller/ControlModeController"

    def __init__(self, table: ControlModeTable, motion_system: MotionSystem, refusal: str = "") -> None:
        """Begin without knowing where the robot is; ``refusal``: why every request is refused; empty: it is not."""
        self._table = table
        self._motion = motion_system
        self._requests: deque[tuple[str, ModeClient | None]] = deque()
        self._change: _Change | None = None
        self._answers: list[tuple[ModeClient, ModeReport]] = []
        self._followed = ""  # the behavior that the mode was last compared with
        self._again = ""  # a mode that the controller itself shall ask for
        self.report = ModeReport("", ControlMode.NONE, _S.ERR_CONTROLLER_NOT_READY)
        self.reports = 1
        self.active_mode = ""
        self.hard_resets = 0
        self.stops = 0
        self.refusals = Refusals(BoundedLog(_log), "control mode {}")
        self._waits_for = ""
        self._refusal = refusal

    @property
    def current(self) -> str:
        """The mode that the robot is in."""
        return self.report.current

    def request(self, mode: str, client: ModeClient | None = None) -> None:
        """Ask for a mode, by name in any case, or for an emergency stop. From any thread."""
        self._requests.append((bounded(mode), client))
        self._motion.wake()

    def start(self, hw: ValorEscherHWInterface) -> None:
        """It runs from the beginning; its first report says that nothing is known yet."""

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """It runs to the end; what is under way is left to the Motion System."""

    def update(self, hw: ValorEscherHWInterface) -> None:
        """One cycle."""
        motion, reports = self._motion, self.reports
        if not motion.behavior:
            if self.active_mode or self._change:
                self._lose_motion_system()
        else:
            if self._change:
                self._proceed(self._change)
            if not self._change and motion.behavior != self._followed:
                self._follow()
            elif again := self._take_again():
                self._begin(again, Target(again), None)
        if self.reports != reports:
            return  # each report is seen for a cycle, that of an external change above all
        while self._requests:
            self._consider(*self._requests.popleft())

    def answer(self) -> None:
        """Tell who asked. Once the mode's controllers run: what is sent on that word comes behind the change."""
        answers, self._answers = self._answers, []
        for client, report in answers:
            client.finish(report)

    # --- what the Motion System does ------------------------------------------------------------------------------

    def _lose_motion_system(self) -> None:
        """It is silent: no mode holds, no controller may run, and what was not asked yet is asked no more."""
        self._again = ""
        self._motion.abandon_transition(f"{self._motion.silent} is silent")
        if self._change:
            self._finish(_S.MODE_REJECTED | _S.ERR_CONTROLLER_NOT_READY, f"{self._motion.silent} is silent")
        _log.warning("%s is silent: the control mode is unknown", self._motion.silent)
        self._followed = ""
        self.active_mode = ""
        self._set(ModeReport(self.report.requested, ControlMode.NONE, _S.EXTERNAL_CHANGE | _S.ERR_CONTROLLER_NOT_READY))

    def _follow(self) -> None:
        """The behavior changed and nobody here asked for it."""
        motion, previous = self._motion, self.current
        began = not self._followed
        self._followed = motion.behavior
        if not began and self._table.fits(previous, motion.behavior):
            return
        mode = self._table.behaviors.get(motion.behavior, ControlMode.NONE)
        if self._table.modes[mode].switch == "hard_reset" and not began:
            self.hard_resets += 1
        self.active_mode = mode
        self._set(ModeReport(self.report.requested, mode, _S.EXTERNAL_CHANGE))
        _log.info(
            "control mode %s -> %s: the Motion System is in %s (%s)",
            previous,
            mode,
            motion.behavior,
            motion.behavior_reason,
        )
        done = mode == ControlMode.STAND and not requester(motion.behavior_reason)
        self._again = (self._table.modes[previous].when_done or "") if done and not began else ""

    def _take_again(self) -> str:
        """The mode to ask for without being asked, once: in the cycle after the change was reported as external."""
        again, self._again = self._again, ""
        return "" if self._change else again

    def _proceed(self, change: _Change) -> None:
        """A change is under way: see how far it is."""
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
        # A mode that stands for no behavior is left only when the behavior changes.
        if behavior == before or self._table.fits(self.current, behavior):
            actual = self.current
        else:
            actual = self._table.behaviors.get(behavior, ControlMode.NONE)
        stop = first_stop(self._table, actual, change.target.other_stops)
        if stop and not (transition.silent or transition.diverted):
            # The mode was another than it seemed when the emergency stop was asked for.
            self._refused(change.requested, transition.reason)
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

    # --- what clients ask for -------------------------------------------------------------------------------------

    def _consider(self, requested: str, client: ModeClient | None) -> None:
        """Begin what is asked for, or refuse it."""
        change = self._change
        try:
            if self._refusal:
                raise ModeRefusedError(_S.ERR_INVALID_TRANSITION, self._refusal)
            if not self._motion.behavior:
                waiting = self._motion.silent or "the Motion System"
                raise ModeRefusedError(_S.ERR_CONTROLLER_NOT_READY, f"{waiting} is silent")
            under_way = change.target.mode if change else ""
            target = admit(self._table, requested, self.current, self._motion.behavior, under_way)
        except ModeRefusedError as refused:
            self._refuse(requested, client, refused.error, str(refused))
            return
        if not change and target.mode == self.current:
            self._restart(target.mode, again=True)
            report = ModeReport(target.mode, self.current, _S.MODE_ACCEPTED | _S.MODE_DUPLICATE)
            self._set(report)
            self._conclude(client, report)
            return
        if change:
            self._finish(_S.MODE_PREEMPTED, f"preempted by {target.mode}")
        self._begin(requested, target, client, under_way=change is not None)

    def _begin(self, requested: str, target: Target, client: ModeClient | None, *, under_way: bool = False) -> None:
        """Ask the Motion System for what a mode stands for.

        Args:
            requested: as asked.
            target: the mode.
            client: who asked.
            under_way: another change was, so that the Motion System may be about to be elsewhere.
        """
        name = target.mode
        mode = self._table.modes[name]
        self._restart(name)
        if not mode.motion or (mode.motion[1] == self._motion.behavior and not under_way):
            # Nothing to ask for: the mode keeps the behavior, or differs in its controllers alone.
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

    def _restart(self, name: str, *, again: bool = False) -> None:
        """Have controllers start anew where a mode says so; asked for ``again``, stop alone: of what moves since."""
        mode = self._table.modes[name]
        if mode.switch == "hard_reset" and not (again and mode.motion):
            self.hard_resets += 1
            self.stops += not mode.motion

    def _finish(self, status: ModeStatus, reason: str, current: str | None = None) -> None:
        """The change under way is over."""
        change = self._change
        assert change is not None
        self._change = None
        report = ModeReport(change.target.mode, current or self.current, status)
        if not status & _S.MODE_ACCEPTED:
            self._refused(change.requested, reason)
        self._set(report)
        self._conclude(change.client, report)

    def _refuse(self, requested: str, client: ModeClient | None, error: ModeStatus, reason: str) -> None:
        """Nothing happens but an answer; the report on the topic carries it too, with the mode unchanged."""
        self._refused(requested, reason)
        report = ModeReport(requested, self.current, _S.MODE_REJECTED | error)
        if self._change is None:
            self._set(report)
        self._conclude(client, report)

    def _conclude(self, client: ModeClient | None, report: ModeReport) -> None:
        """Have who asked told what became of it; ``None``: nobody waits."""
        if client:
            self._answers.append((client, report))

    def _refused(self, requested: str, reason: str) -> None:
        """Have the reason told: ``ControlModeStatus`` has no place for it."""
        self.refusals.add(requested, reason)

    def _set(self, report: ModeReport) -> None:
        self.report = report
        self.reports += 1
