"""Detection that a standing robot must step to keep its balance."""

from collections import deque
from math import hypot, inf

import numpy as np

from valor.common.arrays import FloatArray
from valor.control.fall import corners_on_ground, sole_corners
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.soles import convex_hull, distance_outside


class BalanceWatch:
    """Detects when fixed feet will not hold the DCM, so that a standing robot must step to keep its balance.

    The DCM is near the edge of the support polygon, or so fast that it will soon be outside: a push shows in its
    velocity long before its position. One sample is not enough: the estimate is noisy. After a detection it is disarmed
    until the DCM has been well inside and slow, so that a robot that leans on something does not keep stepping.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._table = robot.read(Tuning).disturbance
        self._corners = sole_corners(robot.tables.feet)
        self._recent: deque[tuple[int, float, float]] = deque()  # time [ns] and DCM, over ``speed_time``
        self._near_since: int | None = None
        self._armed = True
        self.velocity = np.zeros(3)  # (3,) of the DCM in the plane, 0 if it is slow [m/s]
        self.reason = ""  # reason of the last detection

    def reset(self) -> None:
        """Forget where the DCM has been, when balance starts."""
        self._recent.clear()

    def update(self, state: RobotState, reference: FloatArray) -> bool:
        """Return whether to step now, with both feet on the ground; ``reference`` is (3,) of the DCM [m]."""
        table = self._table
        x, y, _ = state.dcm_in_odom.tolist()
        cx, cy, _ = reference.tolist()
        vx, vy = self._moves(state.time, x, y)
        if (x - cx) * vx + (y - cy) * vy <= 0.0:  # not away
            vx = vy = 0.0
        speed = hypot(vx, vy)
        if speed == 0.0 and hypot(x - cx, y - cy) < table.calm:
            self._armed, self._near_since = True, None
            return False
        if not self._armed:
            return False
        hull = convex_hull(corners_on_ground(self._corners, state.sole_positions_in_odom, state.sole_rotations_in_odom))
        outside = distance_outside(hull, x, y)
        soon = distance_outside(hull, x + table.look_ahead * vx, y + table.look_ahead * vy) if speed else -inf
        if outside < -table.edge_margin and soon < table.edge_ahead:
            self._near_since = None
            return False
        if self._near_since is None:
            self._near_since = state.time
        if state.time - self._near_since < 1e9 * table.edge_time:
            return False
        self._armed, self._near_since, self.velocity = False, None, np.array((vx, vy, 0.0))
        where = "outside" if outside > 0.0 else "inside"
        self.reason = (
            f"stepping to keep balance: DCM {abs(outside):.3f} m {where} the edge of the support polygon, "
            f"at {speed:.1f} m/s"
        )
        return True

    def _moves(self, time: int, x: float, y: float) -> tuple[float, float]:
        """Velocity of the DCM [m/s]; 0 if it is slow or was not watched for long enough."""
        recent, table = self._recent, self._table
        if recent and time - recent[-1][0] > 1e9 * table.speed_time:
            recent.clear()
        recent.append((time, x, y))
        while len(recent) > 1 and time - recent[1][0] >= 1e9 * table.speed_time:
            recent.popleft()
        began, px, py = recent[0]
        if time - began < 1e9 * table.speed_time:
            return 0.0, 0.0
        lasted = 1e-9 * (time - began)
        vx, vy = (x - px) / lasted, (y - py) / lasted
        return (vx, vy) if hypot(vx, vy) > table.pushed_speed else (0.0, 0.0)
