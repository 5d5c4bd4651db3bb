"""How old what a browser says may be, by what it has answered.

A browser sends no times that could be trusted. But its messages come in the order in which they were made: one that
comes after the answer to a question was made after the question was asked. So whatever comes is at most as old as the
newest question that had been answered before it; what waited in a cut connection is found out, however late it comes.
"""

from __future__ import annotations

PERIOD = 0.1  # between questions [s]
MOTION = 0.5  # a command that moves the robot as long as it comes is no older [s]
COMMAND = 2.0  # nor any other [s]


class Heartbeat:
    """Questions to one browser. ``now``: monotonic [s]."""

    def __init__(self, now: float) -> None:
        self._answered = now

    def answered(self, asked: float) -> None:
        """The question that was asked at ``asked`` has been answered."""
        self._answered = max(self._answered, asked)

    def bound(self, now: float) -> float:
        """How old what comes now is at most [s]."""
        return now - self._answered
