"""Postures of an arm that tell the most of its links, and that it reaches without touching anything."""

from __future__ import annotations

import mujoco
import numpy as np

from valor.calibration.dynamics import COM_ERROR, MASS_ERROR, TORQUE_ERROR, Regressor
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.robot.model import Model

INSIDE = 0.2  # from the joints' limits [rad]
ENDLESS = 3.0  # from zero at most, of a joint that turns without end [rad]
CLEAR = 0.03  # between any two parts of the robot [m]
NEARER = 0.002  # than in the beginning, that makes no difference [m]
LOOKS = 16  # along a way
CANDIDATES = 24  # that the next one is chosen from
TRIES = 3000  # in which they are looked for


class NoPoseError(ValorError):
    """The arm cannot go anywhere from where it is."""


class Poses:
    """Chosen one after the other, each from where the one before has the arm."""

    def __init__(self, model: Model, group: str, position: FloatArray, seed: int = 0) -> None:
        """Of an arm.

        Args:
            model: every joint in it, with the shapes that collide (``full_model(robot, "collision")``).
            group: of robot.yaml, such as ``left_arm``.
            position: (n,) the posture that the robot is in [rad]; all but the arm stays so.
            seed: of the candidates.
        """
        robot = model.robot
        self._model, self._data = model, mujoco.MjData(model.mj)
        self._mj = mj = model.mj
        mj.geom_margin[:] = np.maximum(mj.geom_margin, CLEAR)  # of two shapes the greater counts
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
        self._way = [position[self._arm].copy()]  # that the arm has come
        self._known = np.eye(4 * len(self._joints))

    def next(self) -> FloatArray:
        """(m,) where the arm shall go from where it is [rad].

        Raises:
            NoPoseError: every way begins with a touch, or ends in one.
        """
        position = self._with(self._way[-1])
        best, most, found = None, -np.inf, 0
        for _ in range(TRIES):
            goal = self._rng.uniform(self._lower, self._upper)
            if not self.clear(position, goal):
                continue
            rows = self._rows(goal)
            told = float(np.linalg.slogdet(self._known + rows.T @ rows)[1])
            if told > most:
                best, most = (goal, rows), told
            found += 1
            if found == CANDIDATES:
                break
        if best is None:
            raise NoPoseError(f"{self._group}: no way from where it is that keeps {CLEAR * 100:g} cm off everything")
        self._known += best[1].T @ best[1]
        self._way.append(best[0])
        return best[0]

    def back(self, at: FloatArray, reached: int) -> list[FloatArray]:
        """(m,) each, one after the other: where the arm shall go to be where it was in the beginning [rad].

        Straight where nothing is in between, else by the way that it came.

        Args:
            at: (m,) where it is [rad], in a pose or on the way to the next.
            reached: poses that it has been in.
        """
        came, made = self._way[: reached + 1], list[FloatArray]()
        while len(came) > 1 and not self.clear(self._with(at), came[0]):
            made.append(at := came.pop())
        return [*made, self._way[0]]

    def clear(self, position: FloatArray, goal: FloatArray) -> bool:
        """Whether the way of the arm from a posture (n,) of the robot to (m,) keeps off everything [rad].

        What is nearer than ``CLEAR`` in the beginning may stay so, and come no nearer.
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
        """(n,) the robot's posture with the arm there."""
        whole = self._position.copy()
        whole[self._arm] = goal
        return whole

    def _near(self, position: FloatArray) -> dict[tuple[int, int], float]:
        """Pairs of shapes that are nearer than ``CLEAR``, and how near [m]."""
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
