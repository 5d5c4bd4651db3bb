"""Valor Escher Interface (VEI): the Motion System's side, over Bifrost (thesis sections 4.1.4 and 4.2.2).

Measurements and the Motion System's state come in, set-points and the control mode's report go out, all in the update
thread. Asking for a behavior waits for a reply, so the commander does it in a thread of its own.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from math import isfinite
from typing import Any

import numpy as np

import bifrost
from valor.common import topics
from valor.common.arrays import FloatArray
from valor.common.messages import (
    ControllerCycle,
    ControlModeReport,
    JointSetpoints,
    MotionState,
    PelvisSetpoint,
    Proprioceptor,
    StepStatus,
)
from valor.robot.commanded_limits import Indices
from valor.valor_ros_controller.behavior_commander import Commander
from valor.valor_ros_controller.behavior_transition import BehaviorTransition, TransitionState
from valor.valor_ros_controller.controllers.mode_requests import ModeReport
from valor.valor_ros_controller.cycle_gaps import CycleGaps
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("valor_escher_interface")

LATE = 1  # a cycle that comes more than so many periods after it was due is late
REPORT_PERIOD = 0.1
"""The control mode is reported on Bifrost on change and this often [s]."""


class ValorEscherInterface:
    """Bifrost in and out, and the Motion System's behavior.

    Attributes:
        behavior: of the Motion System; empty before the first report and while it is silent.
        behavior_reason: of its last change.
        silent: name of the process that is silent; empty: none.
        motion_state: the newest believable MotionState and its envelope.
        step_status: what the Motion System says of a footstep plan; None: not heard, or silent.
        gaps: between cycles.
        rejected: how many messages were of the wrong length or not finite.
    """

    def __init__(
        self,
        node: bifrost.Node,
        commander: Callable[[Callable[[], None]], Commander],
        hw: ValorEscherHWInterface,
        decimation: int,
        silence_timeout: float,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Connect.

        Args:
            node: to the Bifrost network.
            commander: makes what asks for behaviors, which is closed with the interface; takes what it is to call
                after each answer.
            hw: where measurements go and set-points come from.
            decimation: a cycle is due at every n-th Proprioceptor.
            silence_timeout: a process that publishes nothing for so long is silent [s].
            clock: monotonic [s].
        """
        self._clock = clock
        self.gaps = CycleGaps(decimation + LATE)
        self._hw = hw
        self._decimation = decimation
        self._timeout = silence_timeout
        self._n = len(hw.robot.joints)
        self._proprioceptor = topics.PROPRIOCEPTOR.subscriber(node)
        self._motion_state = topics.MOTION_STATE.subscriber(node)
        self._step_status = topics.STEP_STATUS.subscriber(node)
        self.heard: dict[topics.Topic[Any], bifrost.Subscriber[Any]] = {
            topics.PROPRIOCEPTOR: self._proprioceptor,
            topics.MOTION_STATE: self._motion_state,
            topics.STEP_STATUS: self._step_status,
        }
        self._robot_clock = topics.CLOCK.subscriber(node)
        self._setpoints = topics.JOINT_SETPOINTS.publisher(node)
        self._pelvis = topics.PELVIS.publisher(node)
        self._cycle = topics.CYCLE.publisher(node)
        self._control_mode = topics.CONTROL_MODE.publisher(node)
        self._commander = commander(self.wake)
        self._transition: BehaviorTransition | None = None
        self._number = 1
        self._last_sequence = 0
        self._newest_sequence = 0
        self._heard_proprioceptor = self._heard_motion = -np.inf
        self._written: Indices | None = None
        self._split = 0  # so many of the joints written are the robot's; the others are the pelvis'
        self._names: list[str] = []
        self._reported: ModeReport | None = None
        self._reported_at = -np.inf
        self.behavior = ""
        self.behavior_reason = ""
        self.silent = "comms_manager"
        self.motion_state: bifrost.Received[MotionState] | None = None
        self.step_status: StepStatus | None = None
        self.rejected = 0
        self.set_points_sent = 0

    @property
    def proprioceptor_age(self) -> float:
        """Since the newest Proprioceptor came [s]; inf before the first."""
        return self._clock() - self._heard_proprioceptor

    @property
    def motion_state_age(self) -> float:
        """Since the newest MotionState came [s]; inf before the first."""
        return self._clock() - self._heard_motion

    def wake(self) -> None:
        """Make ``receive`` return at once: there is something to see to. From any thread."""
        self._proprioceptor.wake()

    def receive(self, timeout: float) -> bool:
        """Wait for the Proprioceptor that a cycle is due for, and store it.

        Args:
            timeout: how long to wait [s].

        Returns:
            Whether it came. While a transition is under way this returns with every Proprioceptor, for the Motion
            System reports as often.
        """
        deadline = self._clock() + timeout
        while True:
            received = self._proprioceptor.receive(max(1e-3, deadline - self._clock()))
            if received is None:
                return False
            self._heard_proprioceptor = self._clock()
            self._newest_sequence = received.message.sequence
            if (due := self._take(received.message)) or self.in_transition:
                return due

    @property
    def in_transition(self) -> bool:
        """Whether something has been asked for and is not done yet."""
        return self._transition is not None and self._transition.state is TransitionState.PROCESSING

    def _take(self, measured: Proprioceptor) -> bool:
        """Store a measurement if a cycle is due for it."""
        # A sequence that goes back is a Comms Manager that started anew.
        if 0 <= measured.sequence - self._last_sequence < self._decimation:
            return False
        position, velocity = measured.joint_position, measured.joint_velocity
        if len(position) != self._n or len(velocity) != self._n or len(measured.joint_effort) != self._n:
            self._reject(f"{topics.PROPRIOCEPTOR.name}: {len(position)} joints; expected {self._n}")
            return False
        if not isfinite(position @ position + velocity @ velocity):  # quicker than looking at each number
            self._reject(f"{topics.PROPRIOCEPTOR.name}: a joint's position or velocity is not finite")
            return False
        self.gaps.note(measured.sequence - self._last_sequence, self._clock())
        self._last_sequence = measured.sequence
        self._hw.take_measurement(measured)
        return True

    def _reject(self, text: str) -> None:
        self.rejected += 1
        if self.rejected == 1 or self.rejected % 1000 == 0:
            _log.warning("refused %s (%d so far)", text, self.rejected)

    def listen(self) -> None:
        """Take in the Motion System's state, who is silent, and how the transition under way fares."""
        now = self._clock()
        self._excuse_silence(now)
        received = self._motion_state.latest()
        if received is not None:
            motion = received.message
            pelvis = (motion.pelvis_setpoint, motion.pelvis_in_support)
            numbers = sum(vector @ vector for vector in (motion.joint_setpoint, *pelvis))
            if (
                len(motion.joint_setpoint) == self._n
                and all(len(vector) == 6 for vector in pelvis)
                and isfinite(numbers)
            ):
                self._heard_motion = now
                self.motion_state = received
                self._hw.take_motion(motion)
                self.behavior, self.behavior_reason = motion.behavior, motion.reason
            else:
                self._reject(
                    f"{topics.MOTION_STATE.name}: joint_setpoint is not {self._n} finite numbers, or a pelvis' not 6"
                )
        self.silent = self._who_is_silent(now)
        if (steps := self._step_status.latest()) is not None:
            self.step_status = steps.message
        if now - self._heard_motion > self._timeout:
            self.behavior = ""
            self.step_status = None
        self._proceed(now)

    def _excuse_silence(self, now: float) -> None:
        """While a simulation's time is paused, nobody has anything to say, and what goes on goes on afterwards."""
        clock = self._robot_clock.latest()
        if clock is not None and clock.message.mode == topics.PAUSED and not self.silent:
            self._heard_proprioceptor = self._heard_motion = now

    def _who_is_silent(self, now: float) -> str:
        """The process that stopped; the other one may have nothing to say without it."""
        proprioceptor_silent = now - self._heard_proprioceptor > self._timeout
        motion_silent = now - self._heard_motion > self._timeout
        if proprioceptor_silent and motion_silent:
            # In lockstep the Comms Manager waits for the Motor that it is owed: who owes it, stopped. Unless the Comms
            # Manager died before its last Proprioceptor had reached everybody: then it is gone from the network.
            motion = self._hw.motion
            owed = motion is not None and motion.proprioceptor_sequence < self._newest_sequence
            return "motion_manager" if owed and self._proprioceptor.publishers else "comms_manager"
        if proprioceptor_silent:
            return "comms_manager"
        return "motion_manager" if motion_silent else ""

    def begin_transition(self, commands: tuple[str, str]) -> BehaviorTransition:
        """Ask for two behaviors, one after the other; ends a transition that is under way."""
        self._transition = BehaviorTransition(commands, self._number, self.behavior, self._transition)
        self._number += 2
        self._proceed(self._clock())
        return self._transition

    def abandon_transition(self, reason: str) -> None:
        """Ask for nothing more."""
        self._commander.forget()
        if self._transition:
            self._transition.abandon(reason)

    def _proceed(self, now: float) -> None:
        """The transition under way: what was answered and reported, and what is to be asked for next."""
        answer = self._commander.answers.read()
        if self._transition and self.behavior:
            command = self._transition.update(now, self.behavior, self.behavior_reason, answer)
            if command:
                self._commander.ask(*command)

    def write(self) -> None:
        """Send the set-points of the joints that are written."""
        hw = self._hw
        if hw.written is not self._written:
            self._written = hw.written
            self._split = int(np.searchsorted(hw.written, self._n))
            self._names = [hw.names[i] for i in hw.written[: self._split]]
        if not len(hw.written):
            return
        position, velocity, acceleration = hw.rectify()
        k = self._split
        if k:
            self._setpoints.publish(JointSetpoints(hw.time, self._names, position[:k], velocity[:k], acceleration[:k]))
        if k < len(position):
            self.lead_pelvis(position[k:], velocity[k:])
        self.set_points_sent += 1

    def tell_cycle(self) -> None:
        """A cycle is done: a world in lockstep may go on."""
        self._cycle.publish(ControllerCycle(self._hw.time, self._last_sequence, self._decimation))

    def lead_pelvis(self, position: FloatArray, velocity: FloatArray) -> None:
        """Say where the pelvis shall be: (6,) as in ``PelvisSetpoint``, and their rates."""
        self._pelvis.publish(PelvisSetpoint(self._hw.time, position, velocity))

    def report(self, report: ModeReport) -> None:
        """Tell Bifrost of the control mode: on change, and every ``REPORT_PERIOD``."""
        now = self._clock()
        if report is self._reported and now - self._reported_at < REPORT_PERIOD:
            return
        self._reported, self._reported_at = report, now
        self._control_mode.publish(
            ControlModeReport(self._hw.time, report.requested, report.current, int(report.status), self.behavior)
        )

    def close(self) -> None:
        """End the thread. The node, and what belongs to it, is closed by its owner."""
        self._commander.close()
