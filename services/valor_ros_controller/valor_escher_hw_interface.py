"""Valor Escher HW Interface (VEHWI): where the robot's state and the controllers' commands are kept (section 3.5).

Also the claims: a joint's command has one writer, the joint controller that claimed it. Robot-level controllers claim
nothing; they add to what the writer wrote.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from valor_common.messages import MotionState, Proprioceptor
from valor_common.robot import RobotDescription

Vector = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

LONGEST_STEP = 0.02
"""A set-point never moves farther at once than its joint may in this time [s], however late the cycle is."""


class JointClaimError(ValueError):
    """Two controllers want to write the same joint."""


class ValorEscherHWInterface:
    """State and commands of all n joints, in the order of ``RobotDescription.joints``.

    Attributes:
        time: robot time of the newest measurement [ns]; 0 before the first.
        measured: the newest Proprioceptor.
        motion: the newest MotionState.
        position, velocity: (n,) measured [rad], [rad/s].
        command_position, command_velocity, command_acceleration: (n,) written by the claimants.
        command_offset: (n,) what robot-level controllers add to the position in this cycle [rad].
        situation: the control mode, or who is silent; for the text of refusals.
        clamped: how often a command had to be brought within a limit.
    """

    def __init__(self, robot: RobotDescription) -> None:
        n = len(robot.joints)
        self.robot = robot
        self.time = 0
        self.measured: Proprioceptor | None = None
        self.motion: MotionState | None = None
        self.position: Vector = np.zeros(n)
        self.velocity: Vector = np.zeros(n)
        self.command_position = np.zeros(n)
        self.command_velocity = np.zeros(n)
        self.command_acceleration = np.zeros(n)
        self.command_offset = np.zeros(n)
        self.situation = "nothing heard yet"
        self.clamped = 0
        self._claims: dict[int, str] = {}
        self._writing: dict[str, Indices] = {}
        self._indices: Indices = np.zeros(0, dtype=np.intp)
        self._sent: Vector = np.zeros(0)
        self._sent_time = 0

    def claim(self, controller: str, joints: Indices) -> None:
        """Make a controller the one writer of joints.

        Raises:
            JointClaimError: another controller has claimed one of them; nothing has changed.
        """
        for joint in joints.tolist():
            owner = self._claims.get(joint, controller)
            if owner != controller:
                raise JointClaimError(
                    f"{controller} and {owner} both write {self.robot.joints[joint]}; expected one writer a joint"
                )
        self._claims.update(dict.fromkeys(joints.tolist(), controller))

    def release(self, controller: str) -> None:
        """Give up a controller's joints."""
        self._claims = {joint: owner for joint, owner in self._claims.items() if owner != controller}
        self.pause(controller)

    def write(self, controller: str, joints: Indices) -> None:
        """The controller's joints are to be sent from now on."""
        if controller not in self._writing:
            self._writing[controller] = joints
            self._rewrite()

    def pause(self, controller: str) -> None:
        """The controller's joints are not to be sent for now."""
        if self._writing.pop(controller, None) is not None:
            self._rewrite()

    def _rewrite(self) -> None:
        before = dict(zip(self._indices.tolist(), self._sent.tolist(), strict=True))
        groups = list(self._writing.values())
        self._indices = np.sort(np.concatenate(groups)) if groups else np.zeros(0, dtype=np.intp)
        # A joint that joins begins where its controller begins: at what the Motion System commands.
        begin = self.command_position[self._indices].tolist()
        joints = self._indices.tolist()
        self._sent = np.array([before.get(joint, first) for joint, first in zip(joints, begin, strict=True)])
        self._limits()

    def _limits(self) -> None:
        robot, indices = self.robot, self._indices
        self._lower, self._upper = robot.lower[indices], robot.upper[indices]
        self._speed = robot.velocity_limit[indices]

    @property
    def written(self) -> Indices:
        """(m,) the joints whose commands are sent, ascending; a new object whenever it changes."""
        return self._indices

    def rectify(self) -> tuple[Vector, Vector, Vector]:
        """The commands to send: base plus offsets, within limits, without a jump (command rectification).

        A command that is not finite leaves the joint where it was.

        Returns:
            (m,) position [rad], velocity [rad/s], acceleration [rad/s²] of the joints ``written``.
        """
        indices = self._indices
        wanted = self.command_position[indices] + self.command_offset[indices]
        step = min(max(0, self.time - self._sent_time) * 1e-9, LONGEST_STEP) * self._speed * 1.05 + 1e-9
        self._sent_time = self.time
        position = np.clip(wanted, self._sent - step, self._sent + step)
        np.clip(position, self._lower, self._upper, out=position)
        velocity = np.clip(self.command_velocity[indices], -self._speed, self._speed)
        acceleration = self.command_acceleration[indices]
        total = position.sum() + velocity.sum() + acceleration.sum()
        if not np.isfinite(total):
            bad = ~(np.isfinite(position) & np.isfinite(velocity) & np.isfinite(acceleration))
            position[bad], velocity[bad], acceleration[bad] = self._sent[bad], 0.0, 0.0
            self.clamped += int(bad.sum())
        elif not np.array_equal(position, wanted):
            self.clamped += 1
        self._sent = position
        return position, velocity, acceleration
