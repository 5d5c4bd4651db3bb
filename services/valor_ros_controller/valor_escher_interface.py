"""Valor Escher Interface (VEI): the Motion System over Bifrost (thesis sections 4.1.4 and 4.2.2). Update thread."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from math import isfinite
from typing import Any

import numpy as np

import bifrost
from valor.common import topics
from valor.common.arrays import FloatArray
from valor.common.behaviors import STOPPED, Behavior
from valor.common.messages import (
    BehaviorRequest,
    ControllerCycle,
    ControlModeReport,
    JointCommands,
    JointSetpoints,
    MotionState,
    PelvisSetpoint,
    Proprioceptor,
)
from valor.robot.commanded_limits import Indices
from valor.valor_ros_controller.behavior_transition import BehaviorAnswer, BehaviorTransition, TransitionState
from valor.valor_ros_controller.control_modes import ModeReport
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("valor_escher_interface")

LATE = 1  # periods that a cycle may be late without being counted
STRANGE = 100_000  # gap from which on robot time is assumed to have changed [periods]
ESTIMATE_TIMEOUT = 0.01  # of the MotionState of a measurement [s]
REPORT_PERIOD = 0.1
"""Period of the control mode's report on Bifrost, in addition to changes [s]."""


class ValorEscherInterface:
    """Input and output over Bifrost, and behavior transitions.

    Attributes:
        late: number of late cycles, in robot time.
        longest_gap: between two cycles since the last diagnostics, which reset it [periods].
        rejected: number of messages with wrong lengths or not finite numbers.
    """

    def __init__(
        self,
        node: bifrost.Node,
        commander: Callable[[Callable[[], None]], BehaviorCommander],
        hw: ValorEscherHWInterface,
        decimation: int,
        silence_timeout: float,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Connect.

        Args:
            node: of the Bifrost network.
            commander: creates the sender of behavior requests; its argument is called after each reply.
            hw: stores measurements and set-points.
            decimation: number of Proprioceptors per cycle.
            silence_timeout: of a process that stops publishing [s].
            clock: monotonic [s].
        """
        self._clock = clock
        self._hw = hw
        self._decimation = decimation
        self._timeout = silence_timeout
        self._n = len(hw.robot.joints)
        self._proprioceptor = topics.PROPRIOCEPTOR.subscriber(node)
        self._motion_state = topics.MOTION_STATE.subscriber(node)
        self.subscribers: dict[topics.Topic[Any], bifrost.Subscriber[Any]] = {
            topics.PROPRIOCEPTOR: self._proprioceptor,
            topics.MOTION_STATE: self._motion_state,
        }
        self._robot_clock = topics.CLOCK.subscriber(node)
        self._frozen = topics.FROZEN.subscriber(node)
        self._controllers = topics.CONTROLLERS.subscriber(node)
        self._batteries = topics.BATTERIES.subscriber(node)
        self._setpoints = topics.JOINT_SETPOINTS.publisher(node)
        self._pelvis = topics.PELVIS.publisher(node)
        self._joint_commands = topics.JOINT_COMMANDS.publisher(node)
        self._cycle = topics.CYCLE.publisher(node)
        self._control_mode = topics.CONTROL_MODE.publisher(node)
        self._commander = commander(self.wake)
        self._transition: BehaviorTransition | None = None
        self._number = 1
        self._last_sequence = 0
        self._received_sequence = 0
        self._proprioceptor_at = self._motion_at = -np.inf
        self._written: Indices | None = None
        self._split = 0  # number of robot joints among the written ones; the others are the pelvis'
        self._names: list[str] = []
        self._reported: ModeReport | None = None
        self._reported_at = -np.inf
        self.behavior = ""  # of the Motion System; empty before the first report and while it is silent
        self.behavior_reason = ""  # of its last change
        self.silent = "comms_manager"  # name of the silent process; empty: none
        self.motion_state: bifrost.Received[MotionState] | None = None  # latest valid MotionState with its envelope
        self.rejected = self.set_points_sent = self.late = self.longest_gap = 0

    @property
    def proprioceptor_age(self) -> float:
        """Age of the latest Proprioceptor [s]; inf before the first."""
        return self._clock() - self._proprioceptor_at

    @property
    def motion_state_age(self) -> float:
        """Age of the latest MotionState [s]; inf before the first."""
        return self._clock() - self._motion_at

    def wake(self) -> None:
        """Make ``receive`` return at once. From any thread."""
        self._proprioceptor.wake()

    def receive(self, timeout: float) -> bool:
        """Wait for the next cycle's Proprioceptor and store it; returns whether it was received in ``timeout`` [s].

        During a transition it returns with every Proprioceptor, as the Motion System reports at the same rate.
        """
        deadline = self._clock() + timeout
        while True:
            received = self._proprioceptor.receive(max(1e-3, deadline - self._clock()))
            if received is None:
                return False
            self._proprioceptor_at = self._clock()
            self._received_sequence = received.message.sequence
            if (due := self._take(received.message)) or self.in_transition:
                if due and self._hw.estimate_needed:
                    self._await_estimate()
                return due

    def _await_estimate(self) -> None:
        """Wait for the MotionState of the measurement."""
        end = self._clock() + ESTIMATE_TIMEOUT
        while self._hw.motion is None or self._hw.motion.time < self._hw.time:
            if (received := self._motion_state.receive(end - self._clock())) is None:
                return
            self._store_motion(received)

    @property
    def in_transition(self) -> bool:
        return self._transition is not None and self._transition.state is TransitionState.PROCESSING

    def _take(self, measured: Proprioceptor) -> bool:
        # A decreasing sequence results from a restarted Comms Manager.
        if 0 <= measured.sequence - self._last_sequence < self._decimation:
            return False
        position, velocity = measured.joint_position, measured.joint_velocity
        if len(position) != self._n or len(velocity) != self._n or len(measured.joint_effort) != self._n:
            self._reject(f"{topics.PROPRIOCEPTOR.name}: {len(position)} joints; expected {self._n}")
            return False
        if not isfinite(position @ position + velocity @ velocity):  # faster than a test of each number
            self._reject(f"{topics.PROPRIOCEPTOR.name}: a joint's position or velocity is not finite")
            return False
        gap = measured.sequence - self._last_sequence
        if 0 < gap < STRANGE:
            self.late += gap > self._decimation + LATE
            self.longest_gap = max(self.longest_gap, gap)
        self._last_sequence = measured.sequence
        self._hw.store_measurement(measured)
        return True

    def _reject(self, text: str) -> None:
        self.rejected += 1
        if self.rejected == 1 or self.rejected % 1000 == 0:
            _log.warning("rejected %s (%d in total)", text, self.rejected)

    def poll(self) -> None:
        """Receive the Motion System's state, detect silent processes, and continue the transition."""
        now = self._clock()
        clock = self._robot_clock.latest()
        if clock is not None and clock.message.mode == topics.PAUSED and not self.silent:
            self._proprioceptor_at = self._motion_at = now  # no process is silent while simulated time is paused
        motion, hw = self._hw.motion, self._hw
        kept = hw.estimate_needed and motion is not None and motion.time == hw.time  # a later one would not fit
        if not kept and (received := self._motion_state.latest()) is not None:
            self._store_motion(received)
        if (controllers := self._controllers.latest()) is not None:
            self._hw.balance_controllers = controllers.message
        if (frozen := self._frozen.latest()) is not None:
            self._hw.frozen = tuple(frozen.message.limbs)
        if (battery := self._batteries.latest()) is not None:
            self._hw.battery = battery.message
        self.silent = self._silent_process(now)
        if now - self._motion_at > self._timeout:
            self.behavior = ""
        self._proceed(now)

    def _store_motion(self, received: bifrost.Received[MotionState]) -> None:
        motion = received.message
        vectors = (motion.joint_setpoint, motion.pelvis_setpoint, motion.pelvis_in_support)
        if [len(vector) for vector in vectors] != [self._n, 6, 6] or not isfinite(sum(v @ v for v in vectors)):
            self._reject(
                f"{topics.MOTION_STATE.name}: expected {self._n} finite numbers in joint_setpoint, 6 of the pelvis"
            )
            return
        self._motion_at = self._clock()
        self.motion_state = received
        self._hw.store_motion(motion)
        self.behavior, self.behavior_reason = motion.behavior, motion.reason

    def _silent_process(self, now: float) -> str:
        """Name of the process that stopped; the other one may be silent as a consequence."""
        motion_silent = now - self._motion_at > self._timeout
        if now - self._proprioceptor_at <= self._timeout:
            return "motion_manager" if motion_silent else ""
        # In lockstep the Comms Manager waits for the Motor of its last Proprioceptor: a Motion Manager that owes it has
        # stopped. If the Comms Manager died before that Proprioceptor arrived everywhere, it left the network.
        motion = self._hw.motion
        owed = motion is not None and motion.proprioceptor_sequence < self._received_sequence
        return "motion_manager" if motion_silent and owed and self._proprioceptor.publishers else "comms_manager"

    def begin_transition(self, commands: tuple[str, str]) -> BehaviorTransition:
        """Request two behaviors in order; ends a transition in progress."""
        self._transition = BehaviorTransition(commands, self._number, self.behavior, self._transition)
        self._number += 2
        self._proceed(self._clock())
        return self._transition

    def freeze(self, limbs: Sequence[str]) -> Future[BehaviorAnswer]:
        """Request to freeze exactly these limbs."""
        return self._commander.freeze(limbs)

    def abandon_transition(self, reason: str) -> None:
        """Send no more requests of the transition."""
        self._commander.discard()
        if self._transition:
            self._transition.abandon(reason)

    def _proceed(self, now: float) -> None:
        answer = self._commander.answers.read()
        if self._transition and self.behavior:
            command = self._transition.update(now, self.behavior, self.behavior_reason, answer)
            if command:
                self._commander.request(*command)

    def write(self) -> None:
        """Send the cycle's commands."""
        hw = self._hw
        if hw.joint_command is not None:
            (joints, command, seconds), hw.joint_command = hw.joint_command, None
            message = JointCommands(
                time=hw.time,
                period=self._decimation * hw.robot.control_period,
                names=[hw.names[joint] for joint in joints],
                position=command.position[joints],
                velocity=command.velocity[joints],
                effort=command.effort[joints],
                stiffness=command.stiffness[joints],
                damping=command.damping[joints],
                computed_in=seconds,
            )
            self._joint_commands.publish(message)
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
            self.command_pelvis(position[k:], velocity[k:])
        self.set_points_sent += 1

    def publish_cycle(self) -> None:
        """Report the end of a cycle, for a world in lockstep."""
        self._cycle.publish(ControllerCycle(self._hw.time, self._last_sequence, self._decimation))

    def command_pelvis(self, position: FloatArray, velocity: FloatArray) -> None:
        """Send a set-point of the pelvis: (6,) as in ``PelvisSetpoint``, and its rates."""
        self._pelvis.publish(PelvisSetpoint(self._hw.time, position, velocity))

    def report(self, report: ModeReport) -> None:
        """Publish the control mode on change and every ``REPORT_PERIOD``."""
        now = self._clock()
        if report is self._reported and now - self._reported_at < REPORT_PERIOD:
            return
        self._reported, self._reported_at = report, now
        self._control_mode.publish(
            ControlModeReport(self._hw.time, report.requested, report.current, int(report.status), self.behavior)
        )

    def close(self) -> None:
        """End the commander's thread. The owner closes the node."""
        self._commander.close()


ANSWER_TIMEOUT = 2.0  # of a behavior request [s]


class BehaviorCommander:
    """Sends behavior requests one at a time; a newer request replaces a waiting one."""

    def __init__(self, node: bifrost.Node, answered: Callable[[], None]) -> None:
        """``answered`` is called after each reply, in the commander's thread."""
        self.answers: RealTimeBuffer[BehaviorAnswer] = RealTimeBuffer()  # replies
        self._answered = answered
        self._client = topics.BEHAVIOR.client(node)
        self._stopper = topics.STOP.client(node)
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="behavior_commander")
        self._latest: Future[None] | None = None

    def request(self, number: int, behavior: str) -> None:
        self.discard()
        self._latest = self._thread.submit(self._serve, number, behavior)

    def freeze(self, limbs: Sequence[str]) -> Future[BehaviorAnswer]:
        """Request to freeze exactly these limbs; it is not replaced."""
        future = self._thread.submit(self._call, 0, Behavior.FREEZE, limbs)
        future.add_done_callback(lambda _: self._answered())
        return future

    def discard(self) -> None:
        """Discard a request that has not been sent yet."""
        if self._latest is not None:
            self._latest.cancel()

    def _serve(self, number: int, behavior: str) -> None:
        self.answers.write(self._call(number, behavior))
        self._answered()

    def _call(self, number: int, behavior: str, limbs: Sequence[str] = ()) -> BehaviorAnswer:
        # Without a Motion Manager, the Comms Manager stops the robot.
        client = self._stopper if behavior in STOPPED and self._client.server is None else self._client
        try:
            reply = client.call(BehaviorRequest(behavior, list(limbs)), ANSWER_TIMEOUT)
        except bifrost.Error as error:
            return BehaviorAnswer(number, False, str(error), silent=True)
        server = "the Motion Manager" if client is self._client else "the Comms Manager"
        reason = f"{server} rejected {behavior}: {reply.reason}"
        return BehaviorAnswer(number, reply.accepted, reason, reply.behavior, obstacle=reply.obstacle)

    def close(self) -> None:
        """End the thread, at the latest when a request in progress has timed out."""
        self._thread.shutdown(cancel_futures=True)
        self._client.close()
        self._stopper.close()
