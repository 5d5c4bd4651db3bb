"""The walking pad: a velocity as long as a button is held, and none a moment after it is let go.

Nothing is remembered but the newest press. Whoever holds a button says so ten times a second; whoever is gone says
nothing. The robot itself lets go of a velocity that is not repeated within half a second.
"""

from __future__ import annotations

from dataclasses import dataclass

HELD = 0.3  # a button that was not heard of for so long is let go [s]

Velocity = tuple[float, float, float]  # forward, left [m/s], turning left [rad/s]

DIRECTIONS: dict[str, Velocity] = {
    "turn left": (0.0, 0.0, 1.0),
    "forward": (1.0, 0.0, 0.0),
    "turn right": (0.0, 0.0, -1.0),
    "left": (0.0, 1.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}
FASTEST: Velocity = (0.4, 0.1, 0.3)  # at full speed [m/s, m/s, rad/s]
STILL: Velocity = (0.0, 0.0, 0.0)


@dataclass
class Pad:
    """What is held.

    Attributes:
        speed: share of ``FASTEST``.
    """

    speed: float = 0.5
    _direction: str = ""
    _until: float = 0.0
    _moves: bool = False

    def hold(self, direction: str, now: float) -> bool:
        """A button is held down at ``now``, monotonic [s]; whether it is the press itself."""
        began = not self._moves or direction != self._direction
        self._direction, self._until, self._moves = direction, now + HELD, True
        return began

    def release(self) -> None:
        """Whatever was held is let go."""
        self._until = 0.0

    def velocity(self, now: float) -> Velocity | None:
        """To be sent now; None: nothing is held, and it has been said that nothing is."""
        if not self._moves:
            return None
        if now >= self._until:
            self._moves = False
            return STILL
        forward, left, turn = DIRECTIONS[self._direction]
        return (
            forward * FASTEST[0] * self.speed,
            left * FASTEST[1] * self.speed,
            turn * FASTEST[2] * self.speed,
        )
