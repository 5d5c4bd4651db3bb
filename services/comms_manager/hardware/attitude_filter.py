"""An attitude from rates and accelerations, for sensors that do not say theirs.

A complementary filter on SO(3) after Mahony, Hamel and Pflimlin ("Nonlinear Complementary Filters on the Special
Orthogonal Group", IEEE TAC 2008, the passive filter without bias), with the accelerometer as its one reference::

    q' = ½ q ⊗ (ω + k_P · a/|a| × R(q)ᵀ e_z)

What a robot's own accelerations do to the reference averages out over 1/k_P; the heading is the gyroscopes' alone.
"""

from __future__ import annotations

import math

from valor.common.rotation import Quaternion, Vector, multiply, unit, vertical

GRAVITY = 9.80665  # [m/s²]
TIME_CONSTANT = 10.0  # 1/k_P, in which a wrong tilt goes back to the accelerometers' by a factor of e [s]
# At rest, from which the first attitude is taken: a robot that walks is never as still for so long [s].
ALIGNMENT = 0.5
LONGEST_GAP = 0.05  # between samples: what happens in between is the last rate's guess [s]
REST_RATE = 0.1  # a sensor at rest turns less [rad/s]
STEADY, REST_FORCE = 0.3, 0.5  # its specific force stays as near to its mean, and that is as near to g [m/s²]
AGREEMENT = 0.03  # with the tilt by gravity, by which after a gap nothing is taken to have happened [rad]


class AttitudeFilter:
    """Attitude of a sensor with x, y, z axes in a world whose z axis points up; its heading begins at 0.

    Attributes:
        orientation: w, x, y, z; None until the sensor has been at rest.
    """

    def __init__(self) -> None:
        self.orientation: Quaternion | None = None
        self._rested = 0.0  # [s]
        self._samples = 0
        self._mean: Vector = (0.0, 0.0, 0.0)  # of the specific force meanwhile [m/s²]

    def reset(self) -> None:
        """Begin anew: nobody knows how the sensor was turned meanwhile."""
        self.__init__()  # type: ignore[misc]

    def update(self, rate: Vector, force: Vector, elapsed: float) -> None:
        """Take a sample in.

        Args:
            rate: angular velocity in the sensor [rad/s].
            force: specific force in the sensor [m/s²].
            elapsed: since the sample before, by the sensor's own clock [s].
        """
        if elapsed > LONGEST_GAP and not self._agrees(rate, force):
            self.reset()
        elif self.orientation is None:
            self._align(rate, force, elapsed)
        elif elapsed <= LONGEST_GAP:
            self.orientation = _turned(self.orientation, rate, force, elapsed)

    def _agrees(self, rate: Vector, force: Vector) -> bool:
        """Whether the sensor is at rest, and tilted as before."""
        if self.orientation is None or math.hypot(*rate) > REST_RATE:
            return False
        ux, uy, uz = vertical(self.orientation)
        fx, fy, fz = force
        across = math.hypot(fy * uz - fz * uy, fz * ux - fx * uz, fx * uy - fy * ux)
        return math.atan2(across, fx * ux + fy * uy + fz * uz) < AGREEMENT

    def _align(self, rate: Vector, force: Vector, elapsed: float) -> None:
        """Take the mean of the specific force at rest to point up."""
        steady = self._samples == 0 or math.dist(force, self._mean) < STEADY
        if math.hypot(*rate) > REST_RATE or not steady:
            self.reset()
            return
        self._samples += 1
        x, y, z = (mean + (each - mean) / self._samples for mean, each in zip(self._mean, force, strict=True))
        self._mean = x, y, z
        self._rested += elapsed
        if self._rested >= ALIGNMENT and abs(math.hypot(x, y, z) - GRAVITY) < REST_FORCE:
            self.orientation = _about_horizontal(math.atan2(y, z), math.atan2(-x, math.hypot(y, z)))


def _about_horizontal(roll: float, pitch: float) -> Quaternion:
    """Pitched, then rolled about its own x axis [rad]."""
    y = (math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0)
    return multiply(y, (math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0))


def _turned(q: Quaternion, rate: Vector, force: Vector, elapsed: float) -> Quaternion:
    """The attitude after a time [s], turned by the rate and drawn towards where the specific force points up."""
    ux, uy, uz = vertical(q)
    fx, fy, fz = force
    gain = 1.0 / (TIME_CONSTANT * max(math.hypot(fx, fy, fz), 0.1 * GRAVITY))
    turn = (
        elapsed * (rate[0] + gain * (fy * uz - fz * uy)),
        elapsed * (rate[1] + gain * (fz * ux - fx * uz)),
        elapsed * (rate[2] + gain * (fx * uy - fy * ux)),
    )
    angle = math.hypot(*turn)
    share = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return unit(multiply(q, (math.cos(0.5 * angle), share * turn[0], share * turn[1], share * turn[2])))
