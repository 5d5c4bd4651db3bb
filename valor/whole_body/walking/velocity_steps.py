"""Walking by velocity: the steps that carry the robot at the velocity asked for.

The robot's *middle* moves with the velocity from step to step, and each foot comes down half a step width beside it. To
the side both feet of a pair of steps would meet, so the foot that leads takes the way of both, and the other closes up.
Each step's velocity differs from the last one's by no more than a limit, and without word for a while it is zero.

The ground is not seen: it is taken to go on as it went under the last feet (``ground``).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, inf, sin

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.robot.footsteps import LEFT, RIGHT
from valor.robot.motion_tables import Walking
from valor.whole_body.walking.footsteps import Step, beside, level_pose, side_by_side
from valor.whole_body.walking.ground import GroundPlane
from valor.whole_body.walking.swing import SolePose

STILL = np.array((1e-3, 1e-3, 1e-3))  # velocities below it are none [m/s, m/s, rad/s]
AHEAD = 3  # steps


class VelocitySteps:
    """A ``StepSource`` that makes its steps on line.

    Attributes:
        velocity: (3,) of the step being taken: forward, left [m/s], turning [rad/s].
    """

    def __init__(self, table: Walking) -> None:
        self._table = table
        self._highest = np.array((table.max_forward_speed, table.max_lateral_speed, table.max_turn_rate))
        self._lowest = np.array((-table.max_backward_speed, -table.max_lateral_speed, -table.max_turn_rate))
        self._change = np.array((table.speed_change, table.speed_change, table.turn_change))
        self._wanted = np.zeros(3)
        self._heard = 0.0
        self._now = 0.0
        self._last_foot: int | None = None
        self._next_velocity = np.zeros(3)
        self._ground = GroundPlane()
        self._moved = False  # a foot, since the last steps were asked for
        self.velocity = np.zeros(3)

    def command(self, velocity: FloatArray, now: float) -> None:
        """Walk so from now on: (3,) forward, left [m/s], turning [rad/s], clamped to what the robot can do."""
        self._wanted = np.clip(velocity, self._lowest, self._highest)
        self._heard = self._now = now

    def advance(self, now: float) -> None:
        """Robot time [s]: a command that is too old is a stop."""
        self._now = now
        if now - self._heard > self._table.command_timeout:
            self._wanted = np.zeros(3)

    def stop(self) -> None:
        """Do not walk any more."""
        self._wanted = np.zeros(3)

    def durations(self, velocity: FloatArray) -> tuple[float, float]:
        """Of swing and transfer [s] at a velocity: quick steps are short ones, which leave the knees bent."""
        table = self._table
        forward = float(velocity[0])
        share = min(1.0, abs(forward) / table.full_speed)
        return (
            table.swing_duration + share * (table.fast_swing_duration - table.swing_duration),
            table.transfer_duration + share * (table.fast_transfer_duration - table.transfer_duration),
        )

    # --- StepSource -----------------------------------------------------------------------------------------------

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """The next steps; none when the robot shall stand and its feet are side by side."""
        velocity = self._changed(self.velocity)
        self._next_velocity = velocity
        foot = self._first(velocity) if self._last_foot is None else 1 - self._last_foot
        steps: list[Step] = []
        places = list(soles)
        while len(steps) < AHEAD and (velocity.any() or not self._aligned(places, foot)):
            if not steps:
                self._ground.stand((soles[foot].position, soles[1 - foot].position), self._moved)
                self._moved = False
            step = self._step(foot, places[1 - foot], velocity)
            steps.append(step)
            places[foot] = step.sole
            foot, velocity = 1 - foot, self._changed(velocity)
        return steps

    def began(self, step: Step) -> None:
        """The velocity of the first step is the robot's now."""
        self.velocity, self._last_foot = self._next_velocity, step.foot

    def ended(self, step: Step) -> None:
        """Its foot tells of the ground."""
        self._moved = True

    def rested(self) -> None:
        """The next walk begins with either foot."""
        self.velocity, self._last_foot = np.zeros(3), None
        self._ground.forget()

    # --- helpers --------------------------------------------------------------------------------------------------

    def _changed(self, velocity: FloatArray) -> FloatArray:
        """The velocity of the step after one with ``velocity``."""
        new: FloatArray = velocity + np.clip(self._wanted - velocity, -self._change, self._change)
        return np.where(np.abs(new) < STILL, 0.0, new)

    @staticmethod
    def _first(velocity: FloatArray) -> int:
        """The foot that leads."""
        _, left, turn = velocity.tolist()
        return LEFT if (left if left else turn) > 0.0 else RIGHT

    def _step(self, foot: int, stance: SolePose, velocity: FloatArray) -> Step:
        """The step of ``foot`` from the other's place, at the velocity."""
        table = self._table
        swing, transfer = self.durations(velocity)
        period = swing + transfer
        side = 1.0 if foot == LEFT else -1.0
        forward, lateral, turn = (velocity * period).tolist()
        leads = max(0.0, 2.0 * lateral * side)  # the way of both steps, or none
        yaw = rotation.yaw(stance.rotation)
        # From the stance foot to the middle as it is, then with the velocity, then to the foot's side of it.
        x, y = 0.0, 0.5 * side * table.step_width
        x, y = x + forward, y + leads * side
        c, s = cos(turn), sin(turn)
        half = 0.5 * side * table.step_width
        x, y = x - s * half, y + c * half
        cy, sy = cos(yaw), sin(yaw)
        px, py, _ = stance.position.tolist()
        px, py = px + cy * x - sy * y, py + sy * x + cy * y
        return Step(
            index=-1,
            foot=foot,
            sole=level_pose(px, py, self._ground.height(px, py), yaw + turn),
            swing_height=table.swing_height,
            swing_duration=swing,
            transfer_duration=transfer,
            adjustable=inf,
        )

    def _aligned(self, soles: Sequence[SolePose], foot: int) -> bool:
        """Whether a step on the spot would not change much."""
        return side_by_side(soles[foot], beside(soles[1 - foot], foot, self._table.step_width))
