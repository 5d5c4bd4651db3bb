"""Trajectory of a swinging foot: up and over, down to the ground, and further down until it touches.

The ground between footholds is unknown; between different heights there is an edge, maybe right in front of the toe or
behind the heel. The foot therefore rises before it moves forward, and arrives before it descends: more so the higher
the step. It then leaves the ground heel first, rotating about its toe: behind a body that climbs or sinks over the
other leg, a level foot would exceed the ankle's range.
"""

from dataclasses import dataclass
from math import cos, sin

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.control.steps import SolePose

FOLLOWING = 0.06  # Time in which a late foot moves to a new foothold [s]
HURRY = 4.0  # Acceleration of a late foot [m/s²]
SHORTEST_RISE = 0.01  # Shortest rise to the apex; with less time the foot descends at once [s]
HIGH_STEP = 0.1  # Height between footholds from which LIFT and LANDING apply fully [m]
LIFT = 0.2  # Fraction of the time with vertical motion only, at the start (up) or end (down)
LANDING = 0.1  # Fraction of the time with vertical motion only, at the end of a step up
PEEL, MOST_PEELED = 4.0, 0.5  # Pitch of the leaving foot, toes down: per height [rad/m], at most [rad]
PEELED, LEVEL = 0.3, 0.75  # Fractions of the time of the largest pitch, and of level again


@dataclass(slots=True)
class SwingPoint:
    """Reference of a swinging sole in odom."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)
    velocity: FloatArray  # (6,) linear [m/s], angular [rad/s]
    acceleration: FloatArray  # (6,) [m/s², rad/s²]


class Quintic:
    """Polynomial of fifth degree from a motion to uniform motion; from rest, minimum jerk (Flash & Hogan 1985)."""

    def __init__(
        self, begin: FloatArray, end: FloatArray, began: float, duration: float, end_velocity: float = 0.0
    ) -> None:
        """Plan from (3, k) position, velocity and acceleration at ``began`` [s] to (k,) ``end`` and its velocity."""
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
        """Return (3, k) position, velocity and acceleration at ``time`` [s], clamped to ``began`` and ``ends``."""
        t = max(0.0, min(time, self.ends) - self._began)
        t2, t3 = t * t, t * t * t
        powers = (
            (1.0, t, t2, t3, t2 * t2, t2 * t3),
            (0.0, 1.0, 2.0 * t, 3.0 * t2, 4.0 * t3, 5.0 * t2 * t2),
            (0.0, 0.0, 2.0, 6.0 * t, 12.0 * t2, 20.0 * t3),
        )
        result: FloatArray = np.array(powers) @ self._coefficients
        return result


class Hump:
    """Motion over a peak, at rest there, to an end; directly to the end after the peak."""

    def __init__(
        self, begin: FloatArray, began: float, *, peak: tuple[float, float], end: tuple[float, float], velocity: float
    ) -> None:
        """Plan from (3, 1) position, velocity and acceleration at ``began`` [s]; ends are positions and times [s]."""
        there, when = peak
        self._up: Quintic | None = None
        if when - began > SHORTEST_RISE:
            self._up = Quintic(begin, np.array((there,)), began, when - began)
            begin, began = np.array(((there,), (0.0,), (0.0,))), when
        self._down = Quintic(begin, np.array((end[0],)), began, max(end[1] - began, SHORTEST_RISE), velocity)

    def at(self, time: float) -> FloatArray:
        """Return (3, 1) position, velocity and acceleration at ``time`` [s]."""
        up = self._up
        return up.at(time) if up is not None and time < up.ends else self._down.at(time)


class SwingTrajectory:
    """Swing from rest to the ground: quintics in the plane and orientation, humps in height and peeling."""

    def __init__(
        self,
        start: SolePose,
        target: SolePose,
        *,
        height: float,
        duration: float,
        depth: float,
        descent: float,
        late_descent: float = 0.0,
        toe: float = 0.0,
    ) -> None:
        """Plan from pose to pose in ``duration`` [s], with the apex ``height`` above the higher of both [m].

        The foot ends ``depth`` below the target [m] at the downward speed ``descent``, kept afterwards, and without
        ground accelerates to ``late_descent`` [m/s]. It peels about its ``toe``, ahead of the sole's origin; 0: not
        [m].
        """
        self._depth, self._descent, self._toe = depth, descent, toe
        self._late_descent = max(descent, late_descent)
        self._hurries = (self._late_descent - descent) / HURRY  # time until that speed [s]
        self._following: Quintic | None = None
        begin, end = float(start.position[2]), float(target.position[2])
        self._apex = max(begin, end) + height
        self._apex_time = 0.5 * duration
        step = min(1.0, abs(end - begin) / HIGH_STEP)
        self._departs = LIFT * step * duration if end > begin else 0.0
        self._arrives = 1.0 - step * (LIFT if end < begin else LANDING)  # of the duration
        self._peak = min(MOST_PEELED, PEEL * abs(end - begin)) if toe else 0.0
        self._peaks = PEELED * duration
        self._axis = start.rotation[:, 1].copy()
        motion = np.zeros((3, 6))
        motion[0, :3] = start.position
        self._plan(motion, np.zeros((3, 1)), start.rotation, target, (0.0, duration))

    def retarget(self, time: float, target: SolePose, duration: float) -> None:
        """Change end pose and duration of the complete swing [s] at ``time`` [s] since the start, without a jump."""
        motion, peel = self._flat(time), self._peeling.at(time)
        start = rotation.from_rotation_vector(motion[0, 3:]) @ self._start
        motion[0, 3:] = 0.0
        left = self._ends - time
        if left > 0.0:
            stretch = (duration - time) / left
            self._apex_time = time + (self._apex_time - time) * stretch
            self._peaks = time + (self._peaks - time) * stretch
        self._plan(motion, peel, start, target, (time, duration))

    def follow(self, time: float, position: FloatArray) -> None:
        """Move a late foot over (3,) ``position`` in odom [m], from ``time`` [s], without a jump."""
        self._following = Quintic(self._flat(time)[:, :2], position[:2], time, FOLLOWING)

    def _plan(
        self, motion: FloatArray, peel: FloatArray, start: FloatArray, target: SolePose, times: tuple[float, float]
    ) -> None:
        """Plan from now to the end: from ``motion`` (3, 6), angles from ``start`` (3, 3), and ``peel`` (3, 1)."""
        time, duration = times
        end = np.empty(6)
        end[:3], end[3:] = target.position, rotation.rotation_vector(target.rotation @ start.T)
        end[2] -= self._depth
        departs = max(time, min(self._departs, 0.5 * duration))
        arrives = max(departs + SHORTEST_RISE, self._arrives * duration)
        self._start, self._ends = start, duration
        self._horizontal = Quintic(motion, end, departs, arrives - departs)
        self._vertical = Hump(
            motion[:, 2:3],
            time,
            peak=(self._apex, self._apex_time),
            end=(float(end[2]), duration),
            velocity=-self._descent,
        )
        self._peeling = Hump(peel, time, peak=(self._peak, self._peaks), end=(0.0, LEVEL * duration), velocity=0.0)

    def _flat(self, time: float) -> FloatArray:
        """(3, 6) motion of the sole without peeling; angles as in ``_plan``."""
        motion = self._horizontal.at(time)
        motion[:, 2] = self._vertical.at(time)[:, 0]
        if time > self._ends:
            motion[:, 2] = self._late_at(time - self._ends, motion[0, 2])
            if self._following is not None:
                motion[:, :2] = self._following.at(time)
        return motion

    def _late_at(self, late: float, z: float) -> tuple[float, float, float]:
        """Height [m], speed [m/s], acceleration [m/s²] of a foot ``late`` [s], expected at height z [m]."""
        speed, most, hurries = self._descent, self._late_descent, self._hurries
        if late < hurries:
            return z - (speed + 0.5 * HURRY * late) * late, -speed - HURRY * late, -HURRY
        return z - 0.5 * (speed + most) * hurries - most * (late - hurries), -most, 0.0

    def at(self, time: float) -> SwingPoint:
        """Return the reference at ``time`` [s] since the start."""
        motion = self._flat(time)
        turned = rotation.from_rotation_vector(motion[0, 3:]) @ self._start
        if self._peak:
            turned = self._add_peel(motion, turned, *self._peeling.at(time)[:, 0].tolist())
        return SwingPoint(motion[0, :3], turned, motion[1], motion[2])

    def _add_peel(
        self, motion: FloatArray, turned: FloatArray, angle: float, rate: float, acceleration: float
    ) -> FloatArray:
        """Pitch the sole in ``motion`` about its toe; return its rotation (3, 3)."""
        s, c = self._toe * sin(angle), self._toe * cos(angle)
        motion[:, 2] += (s, c * rate, c * acceleration - s * rate * rate)
        peel = rotation.from_rotation_vector(angle * self._axis)
        spin = rate * self._axis
        carried = peel @ motion[1, 3:]
        motion[2, 3:] = acceleration * self._axis + peel @ motion[2, 3:] + rotation.cross(spin, carried)
        motion[1, 3:] = spin + carried
        result: FloatArray = peel @ turned
        return result
