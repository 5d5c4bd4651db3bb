"""Series-elastic joints of the simulated robot: motor, spring, and the force loop of their device (thesis 3.1.1)."""

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped, parts
from valor.robot.description import RobotDescription
from valor.robot.tables import Springs

_DAMPING = 0.7  # ratio of the force loop with the joint locked
_ROWS = 6  # of the state


class SeriesElastic:
    """Motors and springs of m joints. A physics step is also a cycle of the device's force loop.

    With motor inertia B, spring stiffness k at the joint, joint velocity q̇ and the frequencies ω of the loop and ω_d of
    the disturbance observer (Kong, Bae & Tomizuka 2009)::

        τ ← τ + dt·k·(v − q̇)                        of the spring, on the joint; τ_m with the load cell's noise
        p = B·Δτ_m/(k·dt)                           momentum of the motor against the joint
        z ← z + dt·(u − τ_m − d);  d = ω_d·(z − p)      friction, and what moving with the joint takes
        u = τ* + (B·ω²/k − 1)·(τ* − τ_m) − 2·ζ·ω·p + d  clipped to the effort limits
        v ← v + dt·(u − τ)/B                        of the motor; Coulomb friction slows it

    With the joint locked and without friction, τ follows τ* by a second-order lag of frequency ω.

    Attributes:
        joints: (m,) indices among the robot's joints.
        stiffness: (m,) of the springs at the joints [N·m/rad].
        torque, speed, drive: (m,) of the springs [N·m], and of the motors [rad/s] and [N·m], at the joints.
    """

    def __init__(
        self, robot: RobotDescription, springs: Springs, friction: FloatArray, noise: float, step: float
    ) -> None:
        """``friction``: (n,) of all joints [N·m]; ``noise``: deviation of the measured torque [N·m]."""
        self.joints = np.array([robot.index[name] for name in springs.actuators], dtype=np.intp)
        m, limit = self.joints.size, robot.effort_limit[self.joints]
        self.stiffness = springs.stiffness * np.square(limit / springs.force) / [*springs.actuators.values()]
        self._inertia = np.array([robot.tables.joints[name].armature for name in springs.actuators])
        self._limit, self._friction, self._step = limit, friction[self.joints], step
        self._loop, self._observer = math.tau * springs.bandwidth, math.tau * springs.observer
        self._noise, self._rng = noise, np.random.default_rng(0)
        self._asked, self._state, self._next = np.zeros((3, m)), np.zeros((_ROWS, m)), np.zeros((_ROWS, m))
        self.torque: FloatArray
        self.torque, self.speed, self.drive = self._state[:3]
        self._wanted, self._velocity, self._error = self._asked
        self._advance = Kernel("springs", self._expressions, (self._asked, self._state), (self._next,))

    def update(self, wanted: FloatArray, velocity: FloatArray) -> None:
        """Process one physics step, with (n,) set-points [N·m] and joint velocities [rad/s]."""
        self._wanted[:], self._velocity[:] = wanted[self.joints], velocity[self.joints]
        if self._noise:
            self._rng.standard_normal(out=self._error)
        self._advance()
        self._state[:] = self._next

    def _expressions(self, asked: Expression, state: Expression) -> Sequence[Expression]:
        wanted, velocity, error = parts(asked)
        torque, speed, drive, before, total, disturbance = parts(state)
        rows = (self.stiffness, self._inertia, self._limit, self._friction)
        k, b, limit, friction = (ca.DM(row[np.newaxis]) for row in rows)
        dt, loop = self._step, self._loop
        torque = torque + dt * k * (speed - velocity)
        measured = torque + self._noise * error
        momentum = b * (measured - before) / (k * dt)
        total = total + dt * (drive - measured - disturbance)
        disturbance = self._observer * (total - momentum)
        drive = wanted + (b * loop**2 / k - 1.0) * (wanted - measured) - 2.0 * _DAMPING * loop * momentum + disturbance
        drive = clipped(drive, -limit, limit)
        speed = speed + dt * (drive - torque) / b
        speed = speed - clipped(speed, -dt * friction / b, dt * friction / b)
        return [ca.vertcat(torque, speed, drive, measured, total, disturbance)]
