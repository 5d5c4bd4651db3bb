"""Detection that a standing robot must step to keep its balance."""

from math import hypot

from valor.common.arrays import FloatArray
from valor.control.fall import corners_on_ground, sole_corners
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.soles import convex_hull, distance_outside


class BalanceWatch:
    """Detects when fixed feet will not hold the DCM, so that a standing robot must step to keep its balance.

    One sample is not enough: the estimate is noisy. After a detection it is disarmed until the DCM has been well
    inside, so that a robot that leans on something does not keep stepping.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._table = robot.read(Tuning).disturbance
        self._corners = sole_corners(robot.tables.feet)
        self._near_since: int | None = None
        self._armed = True
        self.reason = ""  # reason of the last detection

    def update(self, state: RobotState, reference: FloatArray) -> bool:
        """Return whether to step now, with both feet on the ground; ``reference`` is (3,) of the DCM [m]."""
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
