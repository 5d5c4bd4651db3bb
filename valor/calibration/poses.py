"""Informative poses of an arm, with paths free of collisions."""

import mujoco
import numpy as np

from valor.calibration.dynamics import COM_ERROR, MASS_ERROR, TORQUE_ERROR, Regressor
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.robot.model import Model

INSIDE = 0.2  # distance from the joints' limits [rad]
ENDLESS = 3.0  # largest angle of a joint without limits [rad]
CLEAR = 0.03  # distance between any two parts of the robot [m]
NEARER = 0.002  # tolerated approach of parts that are nearer at the start [m]
LOOKS = 16  # samples along a path
CANDIDATES = 24  # for the next pose
TRIES = 3000  # to find candidates


class NoPoseError(ValorError):
    """No pose is reachable from the present one."""


class Poses:
    """Sequence of poses, each reachable from the previous one."""

    def __init__(self, model: Model, group: str, position: FloatArray, seed: int = 0) -> None:
        """Start at a posture (n,) of the robot [rad]; only the arm ``group`` changes.

        ``model``: with every joint and the collision shapes (``full_model(robot, "collision")``).
        """
        robot = model.robot
        self._model, self._data = model, mujoco.MjData(model.mj)
        self._mj = mj = model.mj
        mj.geom_margin[:] = np.maximum(mj.geom_margin, CLEAR)  # the larger margin of two shapes applies
        self._joints = tuple(robot.tables.group(group))
        self._arm = robot.group_indices(group)
        self._group, self._rng = group, np.random.default_rng([seed, 7])
        self._qpos = np.arange(mj.nq)[model.qpos]
        self._lower = np.maximum(robot.lower[self._arm] + INSIDE, -ENDLESS)
        self._upper = np.minimum(robot.upper[self._arm] - INSIDE, ENDLESS)
        self._regressor = Regressor(model, self._joints)
        masses = mj.body_mass[self._regressor.bodies]
        self._scale = np.column_stack((MASS_ERROR * masses, *[COM_ERROR * masses] * 3)).reshape(-1) / TORQUE_ERROR
        self._position = position.copy()
        self._way = [position[self._arm].copy()]  # poses so far
        self._known = np.eye(4 * len(self._joints))

    def next(self) -> FloatArray:
        """Return the next pose (m,) [rad]; raises ``NoPoseError`` if no path is free."""
        position = self._with(self._way[-1])
        best, most, found = None, -np.inf, 0
        for _ in range(TRIES):
            goal = self._rng.uniform(self._lower, self._upper)
            if not self.clear(position, goal):
                continue
            rows = self._rows(goal)
            information = float(np.linalg.slogdet(self._known + rows.T @ rows)[1])
            if information > most:
                best, most = (goal, rows), information
            found += 1
            if found == CANDIDATES:
                break
        if best is None:
            raise NoPoseError(f"{self._group}: no free path from its position with {CLEAR * 100:g} cm to everything")
        self._known += best[1].T @ best[1]
        self._way.append(best[0])
        return best[0]

    def back(self, at: FloatArray, reached: int) -> list[FloatArray]:
        """Positions (m,) [rad] on the way back to the start: straight if that path is free, else by the poses.

        ``at``: (m,) position [rad], in a pose or on the way to the next; ``reached``: number of poses reached.
        """
        reached_poses, made = self._way[: reached + 1], list[FloatArray]()
        while len(reached_poses) > 1 and not self.clear(self._with(at), reached_poses[0]):
            made.append(at := reached_poses.pop())
        return [*made, self._way[0]]

    def clear(self, position: FloatArray, goal: FloatArray) -> bool:
        """Return whether the arm's path from a posture (n,) of the robot to (m,) is free [rad].

        Parts that are nearer than ``CLEAR`` at the start may stay so, but come no nearer.
        """
        start = position[self._arm]
        whole = position.copy()
        at_first = self._near(whole)
        for share in np.linspace(0.0, 1.0, LOOKS)[:0:-1]:
            whole[self._arm] = start + share * (goal - start)
            if any(distance < at_first.get(pair, CLEAR) - NEARER for pair, distance in self._near(whole).items()):
                return False
        return True

    def _with(self, goal: FloatArray) -> FloatArray:
        whole = self._position.copy()
        whole[self._arm] = goal
        return whole

    def _near(self, position: FloatArray) -> dict[tuple[int, int], float]:
        """Distances of shapes that are nearer than ``CLEAR``, by pair [m]."""
        data = self._data
        data.qpos[:] = self._model.nominal_qpos()
        data.qpos[self._qpos] = position
        mujoco.mj_kinematics(self._mj, data)
        mujoco.mj_collision(self._mj, data)
        contacts = data.contact
        near: dict[tuple[int, int], float] = {}
        for (one, other), distance in zip(contacts.geom.tolist(), contacts.dist.tolist(), strict=True):
            near[one, other] = min(near.get((one, other), CLEAR), distance)
        return near

    def _rows(self, goal: FloatArray) -> FloatArray:
        whole = self._with(goal)
        self._regressor.place(np.array((1.0, 0.0, 0.0, 0.0)), whole)
        rows: FloatArray = self._regressor.gravity() * self._scale
        return rows
