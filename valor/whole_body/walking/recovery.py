"""When a standing robot must step to keep its balance, and the steps that it takes.

A DCM near the edge of the support polygon is about to be lost to feet that stay where they are (``fall``). Then the
robot steps at once, on the spot: where the feet really come down, and when, follows the DCM (``step_adjustment``). It
goes on until a step has come down beside the other foot, at nominal width and parallel, and then it stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT
from valor.robot.polygon import convex_hull, distance_outside
from valor.whole_body.balance.support import corners_on_ground, sole_corners
from valor.whole_body.state import RobotState
from valor.whole_body.tuning_tables import Tuning
from valor.whole_body.walking.footsteps import Step, beside, side_by_side
from valor.whole_body.walking.swing import SolePose

AHEAD = 3  # steps


class BalanceWatch:
    """Says when the feet will not hold the DCM any more.

    A single sample does not tell: the estimate is noisy. And having told, it is silent until the DCM has been well
    inside: a robot that leans on something does not step for ever.

    Attributes:
        reason: why it told last.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._table = robot.read(Tuning).disturbance
        self._corners = sole_corners(robot.tables.feet)
        self._near_since: int | None = None
        self._armed = True
        self.reason = ""

    def update(self, state: RobotState, reference: FloatArray) -> bool:
        """Whether to step now.

        Args:
            state: the estimate, of a robot with both feet on the ground.
            reference: (3,) where the DCM shall be [m].
        """
        table = self._table
        x, y, _ = state.dcm_in_odom.tolist()
        cx, cy, _ = reference.tolist()
        if hypot(x - cx, y - cy) < table.calm:
            self._armed, self._near_since = True, None
            return False
        if not self._armed:
            return False
        hull = convex_hull(corners_on_ground(self._corners, state.sole_positions_in_odom, state.sole_rotations_in_odom))
        outside = distance_outside(hull, x, y)
        if outside < -table.edge_margin:
            self._near_since = None
            return False
        if self._near_since is None:
            self._near_since = state.time
        if state.time - self._near_since < 1e9 * table.edge_time:
            return False
        self._armed, self._near_since = False, None
        where = "outside" if outside > 0.0 else "inside"
        self.reason = f"stepping to keep balance: DCM {abs(outside):.3f} m {where} the edge of the support polygon"
        return True


class RecoverySteps:
    """A ``StepSource`` that brings each foot beside the other, quickly, until both are there."""

    def __init__(self, robot: RobotDescription) -> None:
        self._walking, self._table = robot.tables.walking, robot.read(Tuning).disturbance
        self._foot = LEFT
        self._leads = True

    def lead(self, foot: int) -> None:
        """The next step is one of ``foot``, wherever it stands."""
        self._foot, self._leads = foot, True

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """The next steps; none when the feet are side by side."""
        table, walking = self._table, self._walking
        foot, stance = self._foot, soles[1 - self._foot]
        if not self._leads and side_by_side(soles[foot], beside(stance, foot, walking.step_width)):
            return ()
        steps = []
        for _ in range(AHEAD):
            sole = beside(stance, foot, walking.step_width)
            steps.append(
                Step(
                    index=-1,
                    foot=foot,
                    sole=sole,
                    swing_height=table.recovery_swing_height,
                    swing_duration=table.recovery_swing_duration,
                    transfer_duration=table.recovery_transfer_duration,
                    adjustable=inf,
                )
            )
            foot, stance = 1 - foot, sole
        return steps

    def began(self, step: Step) -> None:
        """The other foot is next."""
        self._foot, self._leads = 1 - step.foot, False

    def ended(self, step: Step) -> None:
        """Nothing."""

    def rested(self) -> None:
        """Nothing."""
