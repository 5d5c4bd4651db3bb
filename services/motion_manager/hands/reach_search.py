"""Path search of an arm for goals that straight motion does not reach.

Straight motion may end in a corner of the joint limits. So it is tried in advance, in longer steps. If it ends short,
postures that reach the goal are searched: from the arm's position, from the end of the trial, from the nominal posture
and from random ones. The limits are a box, so straight lines in joint space connect all postures; the fastest one
without self-collision is used. Each period computes a part.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.control.kinematics import ModelJoints
from valor.motion_manager.hands.arm_kinematics import ArmKinematics
from valor.robot.model import Model

AT_ONCE = 4  # kernel calls in a period
STRIDE = 0.04  # time step of the trial [s]
LONGEST = 12.0  # duration of the trial, at most [s]
POSTURES = 32  # random initial postures of a search
STEPS = 40  # steps of a search
ENOUGH = 6  # postures to find
BETWEEN = 6  # random intermediate postures of a path
NEAR = (0.001, 0.003)  # largest errors of a found posture [m, rad]
ARRIVED = (0.003, 0.012)  # largest errors of a successful trial [m, rad]
PAIRS = 4  # pairs of shapes checked in a period
LOOKS = 0.15  # distance of the postures checked on a path [rad]


@dataclass(frozen=True)
class Start:
    """Initial values of a search."""

    position: FloatArray  # (m,) [rad]
    joint_position: FloatArray  # (n,) of the robot's joints [rad]
    stuck: FloatArray  # (m,) 1 for joints that do not move
    tried: bool  # whether straight motion has ended short


class ReachSearch:
    """Search for one arm."""

    def __init__(
        self,
        model: Model,
        arm: ArmKinematics,
        tried: ArmKinematics,
        *,
        nominal: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        speed: FloatArray,
    ) -> None:
        """``arm`` has the target; ``tried`` is a second instance for the search."""
        self._arm, self._kinematics = arm, tried
        self._nominal, self._speed, self._bounds = nominal, speed, bounds
        self._clearance = _Clearance(model, arm)
        self._work: Iterator[None] = iter(())
        self.way: list[FloatArray] = []  # (k, m) postures to the goal, if straight motion does not reach it [rad]
        self.over, self.straight = True, False  # whether the search has ended, straight motion reaches the goal
        self.barred = False  # whether all paths to found postures collide with the body

    def begin(self, start: Start) -> None:
        """Start a search for the arm's present target."""
        k = self._kinematics
        k.place[:], k.turn[:], k.beside[:] = self._arm.place, self._arm.turn, self._arm.beside
        k.carried[:], k.stuck[:] = 0.0, start.stuck
        self.way, self.over, self.straight, self.barred = [], False, False, False
        self._work = self._search(start)

    def stop(self) -> None:
        """Abandon the search."""
        self.way, self.over, self.straight, self.barred, self._work = [], True, False, False, iter(())

    def advance(self) -> None:
        """Compute the part of one period."""
        if not self.over:
            self.over = next(self._work, self) is self

    def _search(self, start: Start) -> Iterator[None]:
        end = start.position
        if not start.tried:
            k = self._kinematics
            k.posture[:] = self._nominal
            yield from self._try(start.position)
            if _within(k.errors, ARRIVED):
                self.straight = True
                return
            end = k.position.copy()
        found = list[tuple[float, FloatArray]]()
        for first in self._firsts(start, end):
            yield from self._descend(first)
            if _within(self._kinematics.errors, NEAR):
                posture = self._kinematics.position.copy()
                found.append((float((np.abs(posture - start.position) / self._speed).max()), posture))
                if len(found) == ENOUGH:
                    break
        fastest = [posture for _, posture in sorted(found, key=lambda each: each[0])]
        ways = [[posture] for posture in fastest]
        ways += [[between, posture] for between in self._betweens(start) for posture in fastest]
        for way in ways:
            if (yield from self._clear([start.position, *way], start.joint_position)):
                self.way = way
                return
        self.barred = bool(ways)

    def _firsts(self, start: Start, end: FloatArray) -> Iterator[FloatArray]:
        lower, upper = self._bounds
        random = np.random.default_rng(20)
        for first in (end, start.position, self._nominal, *random.uniform(lower, upper, (POSTURES, len(lower)))):
            yield np.where(start.stuck, start.position, first)

    def _betweens(self, start: Start) -> Iterator[FloatArray]:
        random = np.random.default_rng(4).uniform(*self._bounds, (BETWEEN, len(self._nominal)))
        for posture in (self._nominal, *random):
            yield np.where(start.stuck, start.position, posture)

    def _try(self, position: FloatArray) -> Iterator[None]:
        k, (lower, upper) = self._kinematics, self._bounds
        k.position[:] = position
        for i in range(round(LONGEST / STRIDE)):
            k.lead()
            if _within(k.errors, ARRIVED):
                return
            np.clip(k.position + STRIDE * k.rate, lower, upper, out=k.position)
            if i % AT_ONCE == AT_ONCE - 1:
                yield

    def _descend(self, position: FloatArray) -> Iterator[None]:
        k = self._kinematics
        k.position[:] = position
        for i in range(STEPS):
            k.search()
            if _within(k.errors, NEAR):
                return
            k.position[:] = k.stepped
            if i % AT_ONCE == AT_ONCE - 1:
                yield
        k.look()

    def _clear(self, way: list[FloatArray], joint_position: FloatArray) -> Generator[None, None, bool]:
        for one, other in pairwise(way):
            count = max(2, int(np.abs(other - one).max() / LOOKS))
            for fraction in np.linspace(1.0, 0.0, count, endpoint=False):
                self._clearance.stand(one + fraction * (other - one), joint_position)
                for pairs in self._clearance.parts:
                    yield
                    if not self._clearance.kept(pairs):
                        return False
        return True


class _Clearance:
    """Self-collision check of an arm (``self_collision``); ``parts``: pairs of shapes for each period."""

    def __init__(self, model: Model, arm: ArmKinematics) -> None:
        table, joints = model.robot.tables.self_collision, ModelJoints(model)
        self._mj, self._data, self._distance = model.mj, mujoco.MjData(model.mj), table.distance
        self._data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._indices = joints.places
        self._arm = 7 + np.array([joints.indices.index(i) for i in arm.joints.tolist()], dtype=np.intp)
        pairs = [
            (model.shape(one), model.shape(other))
            for one, other in table.pairs
            if any(arm.carries(model.body(each)) for each in (one, other))
        ]
        self.parts = [pairs[i : i + PAIRS] for i in range(0, len(pairs), PAIRS)]

    def stand(self, position: FloatArray, joint_position: FloatArray) -> None:
        """Set the posture (m,) of the arm and (n,) of the robot [rad]."""
        self._data.qpos[7:] = joint_position[self._indices]
        self._data.qpos[self._arm] = position
        mujoco.mj_kinematics(self._mj, self._data)

    def kept(self, pairs: list[tuple[int, int]]) -> bool:
        """Return whether these pairs keep their distance."""
        most = self._distance
        return all(mujoco.mj_geomDistance(self._mj, self._data, *pair, most, None) >= most for pair in pairs)


def _within(errors: FloatArray, most: tuple[float, float]) -> bool:
    return bool(errors[0] <= most[0] and errors[1] <= most[1])
