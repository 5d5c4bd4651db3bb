"""The robot, over Bifrost: its state, and its stop."""

from __future__ import annotations

import threading
import time
from typing import Any

import bifrost
from valor.common.behaviors import Behavior
from valor.common.stopping import HALT, MotionSystem
from valor.common.topics import CONTROL_MODE, PROPRIOCEPTOR

_UNWATCHED = 5.0  # time without requests for the state after which it is not received any more [s]
_SAFE = (*HALT.reached, Behavior.IDLE, "")  # behaviors in which the robot does not move by itself; "": motors off


def described(mode: str, behavior: str, age: float | None) -> dict[str, Any]:
    """State for the page; ``age`` is of the behavior [s], None if none was received."""
    return {"mode": mode, "behavior": behavior or "motors off", "safe": behavior in _SAFE, "age": age}


class BifrostRobot:
    """Called by the service's loop (``turn``) and by the server's threads (others)."""

    def __init__(self, node: bifrost.Node) -> None:
        self._node = node
        self._modes = CONTROL_MODE.subscriber(node)
        self._senses: bifrost.Subscriber[Any] | None = None  # 500 messages per second: while a page is open
        self._lock = threading.Lock()
        self._asked = float("-inf")  # last request for the state, monotonic [s]
        self._mode = self._behavior = ""
        self._arrived: float | None = None  # of the behavior, monotonic [s]

    def turn(self) -> None:
        """Receive the state while a page is open."""
        with self._lock:
            watched = time.monotonic() - self._asked < _UNWATCHED
            if self._senses is not None and not watched:
                self._senses.close()
                self._senses = None
            if watched:
                self._receive()

    def state(self) -> dict[str, Any]:
        """Return the latest state."""
        with self._lock:
            self._asked = time.monotonic()
            self._receive()
            return described(self._mode, self._behavior, self._arrived and time.monotonic() - self._arrived)

    def _receive(self) -> None:
        if self._senses is None:
            self._senses = PROPRIOCEPTOR.subscriber(self._node)
        if (mode := self._modes.latest()) is not None:
            self._mode = mode.message.current_control_mode
        if (senses := self._senses.latest()) is not None:
            self._behavior, self._arrived = senses.message.motor_behavior, 1e-9 * senses.arrived

    def stop(self) -> tuple[bool, str]:
        """Stop the robot; returns whether that is confirmed, and a text."""
        began = time.monotonic()
        with MotionSystem(self._node, HALT, began) as system:
            system.advance()
            while not (state := system.confirmed()) and time.monotonic() - began < HALT.longest:
                system.wait()
                system.advance()
            after = time.monotonic() - began
            unconfirmed = f"NOT confirmed: {system.seen()}; use the robot's own stop"
            return bool(state), f"confirmed: stopped after {after:.2f} s ({state})" if state else unconfirmed

    def close(self) -> None:
        """Close nothing: the node does."""
