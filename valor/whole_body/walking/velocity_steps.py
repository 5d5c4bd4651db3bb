"""Walking by velocity: the steps that carry the robot at the commanded velocity.

The robot's *middle*, midway between the feet, moves with the velocity from step to step; each foot comes down half a
step width beside it. Sideways, the first foot of a pair moves by both feet's distance and the second closes up.
The velocity changes by a limited amount a step, and is zero after a timeout.

Without vision, the ground ahead is the plane through the last footholds: a weighted least-squares fit, the latest
counting most. Its slope is drawn towards zero (ridge regression), for a few footholds within a metre do not separate
bumps from slope. The positions of feet tell more than their tilt, which follows the few centimetres under the edges.
"""

from collections import deque
from collections.abc import Sequence
from math import cos, inf, sin

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.control.steps import SolePose, Step
from valor.robot.footsteps import LEFT, RIGHT
from valor.robot.motion_tables import Walking
from valor.whole_body.walking.footsteps import beside, level_pose, side_by_side

FOOTHOLDS = 3  # Footholds stored
FADING = 0.6  # Weight of a foothold relative to the next one
LEVELNESS = 0.03  # Weight of level ground in the fit [m²]
STEEPEST = 0.12  # Steepest accepted slope, along either axis


class GroundPlane:
    """Height of the ground over odom's x and y, from the footholds."""

    def __init__(self) -> None:
        self._footholds: deque[FloatArray] = deque(maxlen=FOOTHOLDS)
        self._middle = np.zeros(3)
        self._slope = np.zeros(2)

    def forget(self) -> None:
        """Clear the footholds."""
        self._footholds.clear()
        self._middle, self._slope = np.zeros(3), np.zeros(2)

    def stand(self, soles: tuple[FloatArray, FloatArray], moved: bool) -> None:
        """Update the plane from (3,) soles in odom [m], last mover second; ``moved``: a foot has stepped."""
        feet = self._footholds
        if len(feet) < 2:
            feet.clear()
            feet.extend(soles)
        elif moved:
            feet[-1] = soles[0]
            feet.append(soles[1])
        else:
            feet[-2], feet[-1] = soles
        self._fit()

    def height(self, x: float, y: float) -> float:
        """Return the height of the ground in odom [m]."""
        mx, my, mz = self._middle.tolist()
        sx, sy = self._slope.tolist()
        return float(mz + sx * (x - mx) + sy * (y - my))

    def _fit(self) -> None:
        places = np.array(self._footholds)
        weights = FADING ** np.arange(len(places) - 1.0, -1.0, -1.0)
        self._middle = weights @ places / weights.sum()
        places -= self._middle
        ways, rises = places[:, :2], places[:, 2]
        normal = ways.T @ (weights[:, None] * ways) + LEVELNESS * np.eye(2)
        self._slope = np.clip(np.linalg.solve(normal, ways.T @ (weights * rises)), -STEEPEST, STEEPEST)


STILL = np.array((1e-3, 1e-3, 1e-3))  # Velocities below count as zero [m/s, m/s, rad/s]
AHEAD = 3  # steps


class VelocitySteps:
    """``StepSource`` that plans steps from the commanded velocity."""

    def __init__(self, table: Walking) -> None:
        self._table = table
        self._highest = np.array((table.max_forward_speed, table.max_lateral_speed, table.max_turn_rate))
        self._lowest = np.array((-table.max_backward_speed, -table.max_lateral_speed, -table.max_turn_rate))
        self._change = np.array((table.speed_change, table.speed_change, table.turn_change))
        self.wanted = np.zeros(3)  # (3,) commanded, within the limits
        self._heard = 0.0
        self._now = 0.0
        self._last_foot: int | None = None
        self._next_velocity = np.zeros(3)
        self._ground = GroundPlane()
        self._moved = False  # whether a foot moved since the last request of steps
        self.velocity = np.zeros(3)  # (3,) of the step under way: forward, left [m/s], turning [rad/s]

    def command(self, velocity: FloatArray, now: float) -> None:
        """Set (3,) the velocity forward, left [m/s], turning [rad/s], clamped to the robot's limits."""
        self.wanted = np.clip(velocity, self._lowest, self._highest)
        self._heard = self._now = now

    def advance(self, now: float) -> None:
        """Advance to robot time [s]; an expired command becomes a stop."""
        self._now = now
        if now - self._heard > self._table.command_timeout:
            self.wanted = np.zeros(3)

    def stop(self) -> None:
        """Stop walking."""
        self.wanted = np.zeros(3)

    def durations(self, velocity: FloatArray) -> tuple[float, float]:
        """Return durations of swing and transfer [s]: at speed steps are shorter in time, so that knees stay bent."""
        table = self._table
        forward, left, turn = map(abs, velocity.tolist())
        # Aside, one step of two is as long as both; a turn moves the feet by half their distance, one of them back.
        share = min(1.0, (forward + 2.0 * left + table.step_width * turn) / table.full_speed)
        return (
            table.swing_duration + share * (table.fast_swing_duration - table.swing_duration),
            table.transfer_duration + share * (table.fast_transfer_duration - table.transfer_duration),
        )

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """Return the next steps; none for a robot that is to stand with its feet side by side."""
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
        """Set the velocity to that of the started step."""
        self.velocity, self._last_foot = self._next_velocity, step.foot

    def ended(self, step: Step) -> None:
        """Record that a foot moved."""
        self._moved = True

    def rested(self) -> None:
        """Clear velocity, foot and ground."""
        self.velocity, self._last_foot = np.zeros(3), None
        self._ground.forget()

    def _changed(self, velocity: FloatArray) -> FloatArray:
        new: FloatArray = velocity + np.clip(self.wanted - velocity, -self._change, self._change)
        return np.where(np.abs(new) < STILL, 0.0, new)

    @staticmethod
    def _first(velocity: FloatArray) -> int:
        _, left, turn = velocity.tolist()
        return LEFT if (left if left else turn) > 0.0 else RIGHT

    def _step(self, foot: int, stance: SolePose, velocity: FloatArray) -> Step:
        """Step of ``foot`` from the other's position at the velocity."""
        table = self._table
        swing, transfer = self.durations(velocity)
        period = swing + transfer
        side = 1.0 if foot == LEFT else -1.0
        forward, lateral, turn = (velocity * period).tolist()
        leads = max(0.0, 2.0 * lateral * side)  # distance of both steps, or zero
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
        return side_by_side(soles[foot], beside(soles[1 - foot], foot, self._table.step_width))
