"""Loop of the Motion Manager: receives a Proprioceptor, sends its Motor, then processes the rest."""

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import bifrost
from valor.common.messages import BehaviorChange, FrozenLimbs, Proprioceptor
from valor.common.priority import take_real_time
from valor.common.processes import BY_NAME
from valor.common.topics import (
    BEHAVIOR_CHANGE,
    CONTROLLERS,
    FROZEN,
    HAND_GOAL_STATUS,
    MOTION_STATE,
    MOTOR,
    PROPRIOCEPTOR,
    REJECTION,
    STEP_STATUS,
)
from valor.common.trace import Stage
from valor.motion_manager.controllers import controller_factories
from valor.motion_manager.handlers.handler import Handler, make_all
from valor.motion_manager.manager import MotionManager
from valor.motion_manager.safety import REFLEX_ACTIVE
from valor.robot.model import controller_model
from valor.service import Context, quiet_collector

COMMANDS_AT_ONCE = 8  # messages of one topic in a cycle
COMMANDS_TIME = 2e-4  # for the messages of all topics in a cycle, at least one of each [s]
REQUESTS_AT_ONCE = 2  # requests of one topic in a cycle
HAND_STATUS_PERIOD = 0.1  # while a goal controls a hand [s of robot time]
STEP_STATUS_PERIOD = 0.1  # [s of robot time]
SILENCE = 2.0  # timeout without a Proprioceptor, after which the service is not ready [s]
NAP = 0.02  # longest wait for an input [s]
STALL = 0.1  # interval between two cycles, from which the process was stopped or starved [s]
CATCHING_UP = 0.1  # for reading the Proprioceptors of a stall, at most [s]
LULL = 1e-3  # time without another Proprioceptor, after which the last one is the latest [s]

Input = bifrost.Subscriber[Any] | bifrost.Server[Any, Any]

_log = logging.getLogger("motion_manager")


class MotionManagerService:
    """Bifrost interface of the ``MotionManager``."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._trace = context.trace
        self._statistics.state("starting", "building the Whole-Body Controller")
        node = context.node
        robot = context.robot
        self._manager = MotionManager(robot, controller_model(robot), controller_factories(robot))
        self._motor = MOTOR.publisher(node)
        self._motion_state = MOTION_STATE.publisher(node)
        self._behavior_change = BEHAVIOR_CHANGE.publisher(node)
        self._frozen = FROZEN.publisher(node)
        self._controllers = CONTROLLERS.publisher(node)
        self._exchange_changes = -1  # the controllers at the start are published, too
        self._rejection = REJECTION.publisher(node)
        self._step_status = STEP_STATUS.publisher(node)
        self._hand_status = HAND_GOAL_STATUS.publisher(node)
        self._hand_changes = 0
        self._hand_status_due = 0
        self._commands: dict[Input, Callable[[], object]] = {}
        self._requests: dict[Input, Callable[[], object]] = {}
        for handler in make_all(self._manager.components):
            if isinstance(handler, Handler):
                subscriber = handler.topic.subscriber(node)
                inputs = self._requests if handler.after_motor else self._commands
                inputs[subscriber] = partial(self._drain, handler, subscriber)
            else:
                server = handler.topic.server(node, handler.handle)
                self._requests[server] = partial(server.serve, REQUESTS_AT_ONCE)
        # Subscribed last, when everything is ready to process it.
        self._proprioceptor = PROPRIOCEPTOR.subscriber(node)
        self._inputs: bifrost.Poller[Input] = bifrost.Poller((self._proprioceptor, *self._commands, *self._requests))
        self._polled = float("inf")  # monotonic time of the last poll [s]
        self._commands_end = 0.0  # deadline for commands of this cycle, monotonic [s]
        self._changes = -1  # the initial behavior is published, too
        self._frozen_limbs: tuple[str, ...] | None = None
        self._step_status_due = 0
        self._step_changes = 0
        self._tick_time = 0.0  # duration of the last tick [s]
        self._statistics.count(self._counts)
        self._statistics.watch((self._proprioceptor, *self._commands, *self._requests))
        self._statistics.depend({PROPRIOCEPTOR: self._proprioceptor}, lambda: self._manager.time)

    def run(self) -> None:
        """Send a Motor for every Proprioceptor until the context stops.

        Commands received before a Proprioceptor count in its period. Each cycle processes a bounded number of messages,
        of several senders in turn; the rest waits for the next cycle, or is dropped and counted.
        """
        quiet_collector()
        if take_real_time(BY_NAME[self._context.name].real_time):
            _log.info("the loop runs in real time")
        np.seterr(all="ignore")  # checks for non-finite values are explicit
        self._wait_for_robot(f"no {PROPRIOCEPTOR.name} yet")
        received_at = time.monotonic()
        while not self._context.stopping.is_set():
            proprioceptor, start, waiting = self._wait()
            self._commands_end = time.monotonic() + COMMANDS_TIME
            for item in waiting:
                if item in self._commands:
                    self._commands[item]()
            self._trace.mark(Stage.TAKE_COMMANDS)
            if proprioceptor is not None:
                self._tick(proprioceptor, start)
            for item in waiting:
                if item in self._requests:
                    self._requests[item]()
            self._report()
            self._trace.cycle()
            self._trace.mark(Stage.ATTEND)
            if proprioceptor is not None:
                received_at = start
                self._statistics.cycle(start)
                self._tick_time = time.monotonic() - start
                continue
            if time.monotonic() - received_at > SILENCE:
                self._wait_for_robot(f"{PROPRIOCEPTOR.name} is silent: is the Comms Manager running?")
            self._statistics.idle()

    def _wait(self) -> tuple[Proprioceptor | None, float, list[Input]]:
        """Wait for an input: the robot's Proprioceptor or None, its arrival time [s], and all inputs with messages."""
        received = self._proprioceptor.receive(0.0)  # arrived during the tick
        waiting = self._inputs.look(NAP if received is None else 0.0)
        woken = time.monotonic()
        if woken - self._polled > STALL:
            received = self._latest(received)
            woken = time.monotonic()
        self._polled = woken
        self._trace.mark(Stage.AWAIT)
        if received is None and self._proprioceptor in waiting:
            received = self._proprioceptor.receive(0.0)
        self._trace.mark(Stage.DECODE)
        if received is None:
            return None, woken, waiting
        if received.origin != PROPRIOCEPTOR.owner:
            # Proprioceptors of a bag played into a running system are rejected.
            reason = f"comes from {received.origin}; expected {PROPRIOCEPTOR.owner}"
            self._manager.rejections.add(PROPRIOCEPTOR.name, received.origin, "origin", reason)
            return None, woken, waiting
        return received.message, min(woken, received.arrived * 1e-9), waiting

    def _latest(self, received: bifrost.Received[Proprioceptor] | None) -> bifrost.Received[Proprioceptor] | None:
        """The latest Proprioceptor after a stall; older ones are discarded."""
        until = time.monotonic() + CATCHING_UP
        while time.monotonic() < until and (newer := self._proprioceptor.receive(LULL)) is not None:
            received = newer
        return received

    def close(self) -> None:
        """Close the inputs; the node belongs to the context."""
        self._inputs.close()

    def _wait_for_robot(self, why: str) -> None:
        if self._manager.authority.no_robot != why:
            self._manager.authority.no_robot = why
            self._statistics.state("starting", why)

    def _tick(self, proprioceptor: Proprioceptor, start: float) -> None:
        """Process one control period: publish the Motor first."""
        manager = self._manager
        motor = manager.tick(proprioceptor)
        self._trace.mark(Stage.CONTROL)
        self._motor.publish(motor)
        self._trace.mark(Stage.SEND_MOTOR, proprioceptor.sequence)
        self._motion_state.publish(manager.report(time.monotonic() - start, self._tick_time))
        self._trace.mark(Stage.SEND_STATE)
        authority = manager.authority
        if authority.yielding:
            self._wait_for_robot(REFLEX_ACTIVE)
        elif authority.in_control and authority.no_robot:
            authority.no_robot = ""
            self._statistics.state("ready")

    def _report(self) -> None:
        """Publish rejections, status and behavior changes, after the Motor."""
        manager = self._manager
        for rejection in manager.rejections.take():
            self._rejection.publish(rejection)
        steps = manager.components.step_queue
        changed = steps.changes != self._step_changes
        if changed or manager.time >= self._step_status_due or manager.time < self._step_status_due - 1e9:
            self._step_changes = steps.changes
            self._step_status_due = manager.time + round(STEP_STATUS_PERIOD * 1e9)
            self._step_status.publish(steps.status(manager.time))
        self._report_hands()
        self._report_controllers()
        if manager.fsm.changes != self._changes:
            self._changes = manager.fsm.changes
            _log.info("behavior %s: %s", manager.fsm.behavior, manager.fsm.reason)
            self._behavior_change.publish(BehaviorChange(manager.time, manager.fsm.behavior, manager.fsm.reason))
        if (frozen := manager.components.upper_body.frozen) != self._frozen_limbs:
            self._frozen_limbs = frozen
            _log.info("frozen limbs: %s", ", ".join(frozen) or "none")
            self._frozen.publish(FrozenLimbs(manager.time, list(frozen)))

    def _report_controllers(self) -> None:
        """Publish the controllers on every change."""
        exchange = self._manager.components.exchange
        if exchange.changes != self._exchange_changes:
            self._exchange_changes = exchange.changes
            _log.info("controller %s: %s", exchange.active.name, exchange.reason or "started")
            self._controllers.publish(exchange.status(self._manager.time))

    def _counts(self) -> tuple[int, int]:
        manager = self._manager
        inputs = (self._proprioceptor, *self._commands, *self._requests)
        commands = [item for item in self._commands if isinstance(item, bifrost.Subscriber)]
        rejected = manager.rejections.total + sum(item.rejected for item in inputs)
        return rejected, manager.missed + sum(subscriber.drops for subscriber in commands)

    def _drain(self, handler: Handler[Any], subscriber: bifrost.Subscriber[Any]) -> None:
        for received in subscriber.drain(COMMANDS_AT_ONCE, self._commands_end - time.monotonic()):
            handler.handle(received, self._manager.time)

    def _report_hands(self) -> None:
        """Publish the hands' status on change, and periodically while a goal controls a hand."""
        goals, time = self._manager.components.hand_goals, self._manager.time
        changed = goals.changes != self._hand_changes
        due = goals.active and not self._hand_status_due - 1e9 < time < self._hand_status_due
        if changed or due:
            self._hand_changes = goals.changes
            self._hand_status_due = time + round(HAND_STATUS_PERIOD * 1e9)
            for side in goals.sides:
                self._hand_status.publish(goals.status(side, time))
