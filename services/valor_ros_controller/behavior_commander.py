"""Asking the Motion Manager for behaviors, in a thread of its own: somebody has to wait for the reply."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

import bifrost
from valor.common import topics
from valor.common.behaviors import STOPPED
from valor.common.messages import BehaviorRequest
from valor.valor_ros_controller.behavior_transition import BehaviorAnswer
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer

ANSWER_TIMEOUT = 2.0
"""How long the Motion Manager may take to answer a behavior command [s]."""


class Commander(Protocol):
    """Carries commands to the Motion Manager and its answers back.

    Attributes:
        answers: what became of commands.
    """

    answers: RealTimeBuffer[BehaviorAnswer]

    def ask(self, number: int, behavior: str) -> None:
        """Ask for a behavior; never waits."""

    def forget(self) -> None:
        """Drop a command that has not been sent yet."""

    def close(self) -> None:
        """Ask no more."""


class BehaviorCommander(threading.Thread):
    """Asks the Motion Manager for behaviors, one at a time, newest first.

    Attributes:
        commands: (number, behavior) to ask for.
        answers: what became of them.
    """

    def __init__(self, node: bifrost.Node, answered: Callable[[], None]) -> None:
        """Start the thread, in which ``answered`` is called after each answer."""
        super().__init__(name="behavior_commander", daemon=True)
        self.commands: RealTimeBuffer[tuple[int, str]] = RealTimeBuffer()
        self.answers: RealTimeBuffer[BehaviorAnswer] = RealTimeBuffer()
        self._answered = answered
        self._client = topics.BEHAVIOR.client(node)
        self._stopper = topics.STOP.client(node)
        self._wake = threading.Event()
        self._closing = False
        self.start()

    def ask(self, number: int, behavior: str) -> None:
        """Ask for a behavior; never waits."""
        self.commands.write((number, behavior))
        self._wake.set()

    def forget(self) -> None:
        """Drop a command that has not been sent yet."""
        self.commands.write((0, ""))

    def run(self) -> None:
        """The thread."""
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._closing:
                return
            number, behavior = self.commands.read() or (0, "")
            if behavior:
                self.answers.write(self._call(number, behavior))
                self._answered()

    def _call(self, number: int, behavior: str) -> BehaviorAnswer:
        # Where there is no Motion Manager, the Comms Manager stops the robot.
        client = self._stopper if behavior in STOPPED and self._client.server is None else self._client
        try:
            reply = client.call(BehaviorRequest(behavior), ANSWER_TIMEOUT)
        except bifrost.Error as error:
            return BehaviorAnswer(number, False, str(error), silent=True)
        asked = "the Motion Manager" if client is self._client else "the Comms Manager"
        reason = f"{asked} refused {behavior}: {reply.reason}"
        return BehaviorAnswer(number, reply.accepted, reason, reply.behavior, obstacle=reply.obstacle)

    def close(self) -> None:
        """End the thread, at the latest when a call under way has timed out."""
        self._closing = True
        self._wake.set()
        if self.is_alive():
            self.join()
        self._client.close()
        self._stopper.close()
