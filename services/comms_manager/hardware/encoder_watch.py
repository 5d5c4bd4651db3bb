"""Whether an encoder can be believed: a joint that is knocked moves fast, one whose encoder jumps does not move at all.

::

    knock   ___..-'''¯¯¯     answers on the way: their velocities fit, or it goes on with the next one, or is braked
    jump    ______|¯¯¯¯¯     none: before and after, the joint goes on as it did
    glitch  ______|_____     leaps back
"""

from __future__ import annotations

import math

SPEED, MARGIN = 1.2, 0.05  # a joint moves by at most so many times its velocity limit, and so far [rad]
SMALLEST = 0.24  # less is no jump: a joint that is knocked and braked at once may come so far between answers [rad]
LONGEST_PAUSE = 0.1  # between answers; after a longer one the joint may be anywhere [s]
MISFIT = 0.2  # of a movement, that may differ from what the velocities at its ends make of it
# Of a leap's speed, at least, with the next answer: then it is a joint that moves. A knock may lose half of its speed
# from one answer to the next; 0.48 is what is left of the smallest jump that is to be told, 0.25 rad, at 6 rad/s.
GOES_ON = 0.49
DOUBTS_TO_FAULT = 3  # answers after a leap, after which it is the encoder


class EncoderWatch:
    """One joint's answers, each against the one before.

    Attributes:
        position: what the encoder said last, believed or not; NaN: nothing yet [rad].
        jumped: it is not to be believed, until it is calibrated.
    """

    def __init__(self, velocity_limit: float) -> None:
        """``velocity_limit``: of the joint by its own motor [rad/s]."""
        self._limit = SPEED * velocity_limit
        self.position = math.nan
        self.jumped = False
        self._velocity = self._time = 0.0
        self._leap = 0.0  # that nobody knows yet what to make of [rad]; 0: none
        self._speed = 0.0  # with which it would have moved [rad/s]
        self._doubts = 0  # answers since
        self._knocked = 0.0  # with which it moves now, quicker than it can by itself; 0: it does not [rad/s]

    def forget(self) -> None:
        """Nobody has listened for a while: the joint may be anywhere. An encoder that jumped stays one that did."""
        self.position, self._leap, self._knocked = math.nan, 0.0, 0.0

    def believes(self, position: float, velocity: float, time: float) -> bool:
        """Whether an answer is to be taken in.

        Of an encoder that jumped every one is, so that it is told; ``position`` says then what the joint's servo goes
        by.

        Args:
            position: [rad].
            velocity: that the device says [rad/s].
            time: of the answer, by the device's clock [s].
        """
        moved, elapsed = position - self.position, max(0.0, time - self._time)
        before, mean = self._velocity, 0.5 * (self._velocity + velocity)
        self.position, self._velocity, self._time = position, velocity, time
        if self.jumped or math.isnan(moved):
            return True
        if not 0.0 < elapsed <= LONGEST_PAUSE:
            self._leap = self._knocked = 0.0
            return True
        speed = moved / elapsed
        quick = abs(moved) > max(SMALLEST, self._limit * elapsed + MARGIN)
        if self._leap:
            if abs(moved + self._leap) < 0.5 * abs(self._leap):  # back again
                self._leap = 0.0
                return True
            if speed / self._speed >= GOES_ON or self._is_braked(moved, before, velocity, elapsed):
                self._leap, self._knocked = 0.0, speed
                return True
            self._doubts += 1
            self.jumped = self._doubts >= DOUBTS_TO_FAULT
            return self.jumped
        fits = abs(moved - mean * elapsed) <= MARGIN + MISFIT * abs(moved)
        if quick and not fits and self._knocked * speed <= 0.0:
            self._leap, self._speed, self._doubts = moved, speed, 1
            return False
        self._knocked = speed if quick else 0.0
        return True

    def _is_braked(self, moved: float, before: float, velocity: float, elapsed: float) -> bool:
        """Whether a leap was a knock that the servo brakes at once, and turns round within an answer or two.

        At the leap it said that it is quicker than it can be by itself; it moves on by what it says; and braked all the
        time as it is now, it was quick enough to come so far.
        """
        side = math.copysign(1.0, self._leap)
        mean = 0.5 * (before + velocity)
        fastest = before + 0.5 * (before - velocity)  # on average, since the answer before the leap
        return (
            side * before > self._limit
            and abs(moved - mean * elapsed) <= 0.5 * MARGIN + MISFIT * abs(moved)
            and (1.0 - MISFIT) * abs(self._leap) <= MARGIN + side * fastest * self._leap / self._speed
        )
