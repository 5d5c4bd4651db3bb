"""The loop: a Proprioceptor comes, its Motor leaves, and then everything that can wait a little."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import bifrost
from valor.common.messages import (
    BehaviorChange,
    Proprioceptor,
)
from valor.common.priority import take_real_time
from valor.common.processes import BY_NAME
from valor.common.topics import (
    BEHAVIOR_CHANGE,
    HAND_GOAL_STATUS,
    MOTION_STATE,
    MOTOR,
    PROPRIOCEPTOR,
    REJECTION,
    STEP_STATUS,
)
from valor.common.trace import Stage
from valor.motion_manager.handlers.handler import Handler, make_all
from valor.motion_manager.manager import MotionManager
from valor.motion_manager.safety.custody import ASIDE
from valor.robot.model import controller_model
from valor.service import Context, quiet_collector

COMMANDS_AT_ONCE = 8  # of one topic, between two looks for a Proprioceptor
COMMANDS_TIME = 2e-4  # likewise, of all topics together; of each that has any, one at least [s]
REQUESTS_AT_ONCE = 2  # of one topic, likewise
HAND_STATUS_PERIOD = 0.1  # while a goal leads a hand [s of robot time]
STEP_STATUS_PERIOD = 0.1  # [s of robot time]
SILENCE = 2.0  # without a Proprioceptor for so long, this is not in control of a robot [s]
NAP = 0.02  # between looks at requests while no Proprioceptor comes [s]
STALL = 0.1  # between two looks: this process was stopped, or starved [s]
CATCHING_UP = 0.1  # with what has come meanwhile, at most [s]
LULL = 1e-3  # without another Proprioceptor: the newest one is there [s]

Input = bifrost.Subscriber[Any] | bifrost.Server[Any, Any]

_log = logging.getLogger("motion_manager")


class MotionManagerService:
    """Bifrost around the ``MotionManager``."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._trace = context.trace
        self._statistics.state("starting", "building the Whole-Body Controller")
        node = context.node
        self._manager = MotionManager(context.robot, controller_model(context.robot))
        self._motor = MOTOR.publisher(node)
        self._motion_state = MOTION_STATE.publisher(node)
        self._behavior_change = BEHAVIOR_CHANGE.publisher(node)
        self._rejection = REJECTION.publisher(node)
        self._step_status = STEP_STATUS.publisher(node)
        self._hand_status = HAND_GOAL_STATUS.publisher(node)
        self._hand_changes = 0
        self._hand_status_due = 0
        self._commands: dict[Input, Callable[[], object]] = {}
        self._requests: dict[Input, Callable[[], object]] = {}
        for handler in make_all(self._manager.parts):
            if isinstance(handler, Handler):
                subscriber = handler.topic.subscriber(node)
                inputs = self._requests if handler.after_motor else self._commands
                inputs[subscriber] = partial(self._take, handler, subscriber)
            else:
                server = handler.topic.server(node, handler.handle)
                self._requests[server] = partial(server.serve, REQUESTS_AT_ONCE)
        # Last, when everything is ready to answer it: the newest alone, for what is older has passed.
        self._proprioceptor = PROPRIOCEPTOR.subscriber(node)
        self._inputs: bifrost.Poller[Input] = bifrost.Poller((self._proprioceptor, *self._commands, *self._requests))
        self._looked = float("inf")  # when the inputs were, monotonic [s]
        self._commands_end = 0.0  # when no more of them are begun with [s]
        self._changes = -1  # the behavior that it begins with is told, too
        self._step_status_due = 0
        self._step_changes = 0
        self._tick_time = 0.0  # of the last tick [s]
        self._statistics.count(self._counts)
        self._statistics.watch((self._proprioceptor, *self._commands, *self._requests))
        self._statistics.depend({PROPRIOCEPTOR: self._proprioceptor}, lambda: self._manager.time)

    def run(self) -> None:
        """Answer every Proprioceptor until told to stop.

        Between two of them, commands and requests are dealt with as they come: what came before a Proprioceptor counts
        in its period, and takes none of its time. However much comes, each turn takes a bounded part of it, of several
        senders in turn; the rest waits for the next turn, or is dropped and counted.
        """
        quiet_collector()
        if take_real_time(BY_NAME[self._context.name].real_time):
            _log.info("the loop runs in real time")
        np.seterr(all="ignore")  # what is not finite is looked for and dealt with where it matters
        self._wait_for_robot(f"no {PROPRIOCEPTOR.name} yet")
        heard = time.monotonic()
        while not self._context.stopping.is_set():
            proprioceptor, began, waiting = self._wait()
            self._commands_end = time.monotonic() + COMMANDS_TIME
            for item in waiting:
                if item in self._commands:
                    self._commands[item]()
            self._trace.mark(Stage.TAKE_COMMANDS)
            if proprioceptor is not None:
                self._tick(proprioceptor, began)
            for item in waiting:
                if item in self._requests:
                    self._requests[item]()
            self._attend()
            self._trace.cycle()
            self._trace.mark(Stage.ATTEND)
            if proprioceptor is not None:
                heard = began
                self._statistics.cycle(began)
                self._tick_time = time.monotonic() - began
                continue
            if time.monotonic() - heard > SILENCE:
                self._wait_for_robot(f"{PROPRIOCEPTOR.name} is silent: is the Comms Manager running?")
            self._statistics.idle()

    def _wait(self) -> tuple[Proprioceptor | None, float, list[Input]]:
        """Wait for something to come: the robot's Proprioceptor, when it was noticed [s], and all inputs to look at."""
        received = self._proprioceptor.receive(0.0)  # come during the tick
        waiting = self._inputs.look(NAP if received is None else 0.0)
        woken = time.monotonic()
        if woken - self._looked > STALL:
            received = self._newest(received)
            woken = time.monotonic()
        self._looked = woken
        self._trace.mark(Stage.AWAIT)
        if received is None and self._proprioceptor in waiting:
            received = self._proprioceptor.receive(0.0)
        self._trace.mark(Stage.DECODE)
        if received is None:
            return None, woken, waiting
        if received.origin != PROPRIOCEPTOR.owner:
            # A bag played back into a running system must not be taken for the robot.
            reason = f"comes from {received.origin}; expected {PROPRIOCEPTOR.owner}"
            self._manager.rejections.add(PROPRIOCEPTOR.name, received.origin, "origin", reason)
            return None, woken, waiting
        return received.message, min(woken, received.arrived * 1e-9), waiting

    def _newest(self, received: bifrost.Received[Proprioceptor] | None) -> bifrost.Received[Proprioceptor] | None:
        """After a stall: what lay on the way meanwhile comes first, and is past; the last of it counts."""
        until = time.monotonic() + CATCHING_UP
        while time.monotonic() < until and (newer := self._proprioceptor.receive(LULL)) is not None:
            received = newer
        return received

    def close(self) -> None:
        """The node itself belongs to the context."""
        self._inputs.close()

    def _wait_for_robot(self, why: str) -> None:
        """Say that no robot is in our hands."""
        if self._manager.custody.silent != why:
            self._manager.custody.silent = why
            self._statistics.state("starting", why)

    def _tick(self, proprioceptor: Proprioceptor, began: float) -> None:
        """One control period: the Motor first."""
        manager = self._manager
        motor = manager.tick(proprioceptor)
        self._trace.mark(Stage.CONTROL)
        self._motor.publish(motor)
        self._trace.mark(Stage.SEND_MOTOR, proprioceptor.sequence)
        self._motion_state.publish(manager.report(time.monotonic() - began, self._tick_time))
        self._trace.mark(Stage.SEND_STATE)
        custody = manager.custody
        if custody.aside:
            self._wait_for_robot(ASIDE)
        elif custody.ours and custody.silent:
            custody.silent = ""
            self._statistics.state("ready")

    def _attend(self) -> None:
        """What may wait until the Motor has left: reports, counts."""
        manager = self._manager
        for rejection in manager.rejections.take():
            self._rejection.publish(rejection)
        steps = manager.parts.step_queue
        changed = steps.changes != self._step_changes
        if changed or manager.time >= self._step_status_due or manager.time < self._step_status_due - 1e9:
            self._step_changes = steps.changes
            self._step_status_due = manager.time + round(STEP_STATUS_PERIOD * 1e9)
            self._step_status.publish(steps.status(manager.time))
        self._report_hands()
        if manager.fsm.changes != self._changes:
            self._changes = manager.fsm.changes
            _log.info("behavior %s: %s", manager.fsm.behavior, manager.fsm.reason)
            self._behavior_change.publish(BehaviorChange(manager.time, manager.fsm.behavior, manager.fsm.reason))

    def _counts(self) -> tuple[int, int]:
        """What was refused and what was missed, since start."""
        manager = self._manager
        inputs = (self._proprioceptor, *self._commands, *self._requests)
        commands = [item for item in self._commands if isinstance(item, bifrost.Subscriber)]
        rejected = manager.rejections.total + sum(item.rejected for item in inputs)
        return rejected, manager.missed + sum(subscriber.drops for subscriber in commands)

    def _take(self, handler: Handler[Any], subscriber: bifrost.Subscriber[Any]) -> None:
        """Hand over what is dealt with in this turn of the messages of one topic."""
        for received in subscriber.drain(COMMANDS_AT_ONCE, self._commands_end - time.monotonic()):
            handler.handle(received, self._manager.time)

    def _report_hands(self) -> None:
        """On change, and every now and then while a goal leads a hand."""
        goals, time = self._manager.parts.hand_goals, self._manager.time
        changed = goals.changes != self._hand_changes
        due = goals.active and not self._hand_status_due - 1e9 < time < self._hand_status_due
        if changed or due:
            self._hand_changes = goals.changes
            self._hand_status_due = time + round(HAND_STATUS_PERIOD * 1e9)
            for side in goals.sides:
                self._hand_status.publish(goals.status(side, time))
