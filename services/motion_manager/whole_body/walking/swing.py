"""The path of a swinging foot: up and over, down to the ground, and on down until it touches.

What lies between the footholds is not known, but where one is higher than the other there is an edge somewhere, and
it may be right before the toe or right behind the heel. So the foot goes up before it goes forward, and is there before
it goes down: the more of it, the higher the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from motion_manager.whole_body import rotation

FloatArray = npt.NDArray[np.float64]

SHORTEST_RISE = 0.01  # to the apex; with less left the foot goes down from where it is [s]
HIGH_STEP = 0.1  # the height between footholds, up or down, from which on … [m]
LIFT = 0.2  # … this share of the time the foot goes only up, or only down


@dataclass(slots=True)
class SolePose:
    """Where a sole is, in odom."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)


@dataclass(slots=True)
class SwingPoint:
    """Where a swinging sole shall be, in odom."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)
    velocity: FloatArray  # (6,) linear [m/s], angular [rad/s]
    acceleration: FloatArray  # (6,) [m/s², rad/s²]


class Quintic:
    """The polynomial of fifth degree from a motion (position, velocity, acceleration) to steady motion elsewhere.

    From rest to rest it is the minimum-jerk way (Flash & Hogan 1985).
    """

    def __init__(
        self, begin: FloatArray, end: FloatArray, began: float, duration: float, end_velocity: float = 0.0
    ) -> None:
        """Plan.

        Args:
            begin: (3, k) position, velocity, acceleration at ``began``.
            end: (k,) position, where it comes to.
            began: [s].
            duration: above 0 [s].
            end_velocity: with which it comes there, of every component.
        """
        self._began, self.ends = began, began + duration
        t = duration
        position, velocity, acceleration = begin
        way = end - position - (velocity + 0.5 * t * acceleration) * t
        change = (end_velocity - velocity - acceleration * t) * t
        bend = -acceleration * (t * t)
        self._coefficients = np.stack(
            (
                position,
                velocity,
                0.5 * acceleration,
                (10.0 * way - 4.0 * change + 0.5 * bend) / t**3,
                (-15.0 * way + 7.0 * change - bend) / t**4,
                (6.0 * way - 3.0 * change + 0.5 * bend) / t**5,
            )
        )

    def at(self, time: float) -> FloatArray:
        """(3, k) position, velocity and acceleration at ``time`` [s]; the ends' before ``began`` and after ``ends``."""
        t = max(0.0, min(time, self.ends) - self._began)
        t2, t3 = t * t, t * t * t
        powers = (
            (1.0, t, t2, t3, t2 * t2, t2 * t3),
            (0.0, 1.0, 2.0 * t, 3.0 * t2, 4.0 * t3, 5.0 * t2 * t2),
            (0.0, 0.0, 2.0, 6.0 * t, 12.0 * t2, 20.0 * t3),
        )
        result: FloatArray = np.array(powers) @ self._coefficients
        return result


class SwingTrajectory:
    """From rest to the ground: quintics in the plane and in orientation, and two, up and down, in height."""

    def __init__(
        self, start: SolePose, target: SolePose, *, height: float, duration: float, depth: float, descent: float
    ) -> None:
        """Plan.

        Args:
            start: of the sole.
            target: of the sole.
            height: of the apex above the higher of both [m].
            duration: [s].
            depth: below the target, that the foot is led to [m].
            descent: speed at which it comes down there, and goes on down afterwards [m/s].
        """
        self._depth, self._descent = depth, descent
        begin, end = float(start.position[2]), float(target.position[2])
        self._apex = max(begin, end) + height
        self._apex_time = 0.5 * duration
        lift = LIFT * min(1.0, abs(end - begin) / HIGH_STEP)
        self._departs = lift * duration if end > begin else 0.0
        self._arrives = 1.0 - (lift if end < begin else 0.0)  # of the duration
        motion = np.zeros((3, 6))
        motion[0, :3] = start.position
        self._plan(motion, start.rotation, target, 0.0, duration)

    def retarget(self, time: float, target: SolePose, duration: float) -> None:
        """Go elsewhere, or be there at another time: from where the reference is, without a jump.

        Position, velocity and acceleration go on; the way to the apex takes its share of the time that is left.

        Args:
            time: now, since the start [s].
            target: of the sole.
            duration: of the whole swing, later than now [s].
        """
        point = self.at(time)
        motion = np.empty((3, 6))
        motion[0, :3], motion[0, 3:], motion[1], motion[2] = point.position, 0.0, point.velocity, point.acceleration
        left = self._ends - time
        if left > 0.0:
            self._apex_time = time + (self._apex_time - time) * (duration - time) / left
        self._plan(motion, point.rotation, target, time, duration)

    def _plan(self, motion: FloatArray, start: FloatArray, target: SolePose, time: float, duration: float) -> None:
        """From ``motion`` (3, 6) at ``time``; its angles are a rotation vector from ``start`` (3, 3)."""
        end = np.empty(6)
        end[:3], end[3:] = target.position, rotation.rotation_vector(target.rotation @ start.T)
        end[2] -= self._depth
        departs = max(time, min(self._departs, 0.5 * duration))
        arrives = max(departs + SHORTEST_RISE, self._arrives * duration)
        self._start, self._ends = start, duration
        self._horizontal = Quintic(motion, end, departs, arrives - departs)
        self._vertical: list[Quintic] = []
        height = motion[:, 2:3]
        if self._apex_time - time > SHORTEST_RISE:
            apex = np.array((self._apex,))
            self._vertical.append(Quintic(height, apex, time, self._apex_time - time))
            height, time = np.array((apex, (0.0,), (0.0,))), self._apex_time
        self._vertical.append(Quintic(height, end[2:3], time, duration - time, -self._descent))

    def at(self, time: float) -> SwingPoint:
        """The reference at ``time`` [s] since the start."""
        motion = self._horizontal.at(time)
        piece = self._vertical[0] if time < self._vertical[0].ends else self._vertical[-1]
        motion[:, 2] = piece.at(time)[:, 0]
        if time > self._ends:
            motion[:, 2] = (motion[0, 2] - self._descent * (time - self._ends), -self._descent, 0.0)
        turned = rotation.from_rotation_vector(motion[0, 3:]) @ self._start
        return SwingPoint(motion[0, :3], turned, motion[1], motion[2])
