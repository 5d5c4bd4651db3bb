"""How an arm gets to a goal that it does not get to straight: a posture for it, and postures on the way there.

Who goes straight towards a goal may end in a corner of the joints' limits. So a goal's way is tried in advance, in
strides longer than control's. Where it ends short, postures are searched that have the hand there: from where the arm
is, where that way ended, the nominal posture and others at random within the limits. Limits are a box: from any posture
within them a straight line in joint space leads to any other; the quickest that keeps the arm off the body is taken.
Each period does a part of it.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.motion_manager.hands.arm_kinematics import ArmKinematics
from valor.robot.model import Model
from valor.whole_body.model.dynamics import ModelJoints

AT_ONCE = 4  # kernel calls in a period
STRIDE = 0.04  # of the way that is tried [s]
LONGEST = 12.0  # of it [s]
POSTURES = 32  # from which a search begins
STEPS = 40  # of a search
ENOUGH = 6  # postures found
BETWEEN = 6  # postures at random, by one of which a way may lead
NEAR = (0.001, 0.003)  # of the goal: found [m, rad]
ARRIVED = (0.003, 0.012)  # likewise, of the way that is tried [m, rad]
PAIRS = 4  # of shapes whose distance is looked at in a period
LOOKS = 0.15  # between postures whose distances are looked at [rad]


@dataclass(frozen=True)
class Start:
    """What a search begins with."""

    position: FloatArray  # (m,) [rad]
    joint_position: FloatArray  # (n,) of the robot's joints [rad]
    stuck: FloatArray  # (m,) 1 of joints that do not move
    tried: bool  # whether the straight way is known to end short


class ReachSearch:
    """Of one arm, one at a time.

    Attributes:
        way: (k, m) postures that lead to the goal, once a search has found it does not get there straight [rad].
        straight: whether the straight way was found to get there.
        barred: whether it has found postures, and no way to any that keeps the arm off the body.
        over: whether there is nothing left to do.
    """

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
        """For an arm; ``arm`` has its target, ``tried`` is a second one for what is searched."""
        self._arm, self._kinematics = arm, tried
        self._nominal, self._speed, self._bounds = nominal, speed, bounds
        self._clearance = _Clearance(model, arm)
        self._work: Iterator[None] = iter(())
        self.way: list[FloatArray] = []
        self.over, self.straight, self.barred = True, False, False

    def begin(self, start: Start) -> None:
        """Search for the arm's target as it is now."""
        k = self._kinematics
        k.place[:], k.turn[:], k.beside[:] = self._arm.place, self._arm.turn, self._arm.beside
        k.carried[:], k.stuck[:] = 0.0, start.stuck
        self.way, self.over, self.straight, self.barred = [], False, False, False
        self._work = self._search(start)

    def stop(self) -> None:
        """Leave it."""
        self.way, self.over, self.straight, self.barred, self._work = [], True, False, False, iter(())

    def advance(self) -> None:
        """A period's part."""
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
        quickest = [posture for _, posture in sorted(found, key=lambda each: each[0])]
        ways = [[posture] for posture in quickest]
        ways += [[between, posture] for between in self._betweens(start) for posture in quickest]
        for way in ways:
            if (yield from self._clear([start.position, *way], start.joint_position)):
                self.way = way
                return
        self.barred = bool(ways)

    def _firsts(self, start: Start, end: FloatArray) -> Iterator[FloatArray]:
        """Postures from which a search begins."""
        lower, upper = self._bounds
        random = np.random.default_rng(20)
        for first in (end, start.position, self._nominal, *random.uniform(lower, upper, (POSTURES, len(lower)))):
            yield np.where(start.stuck, start.position, first)

    def _betweens(self, start: Start) -> Iterator[FloatArray]:
        """Postures by which a way may lead."""
        random = np.random.default_rng(4).uniform(*self._bounds, (BETWEEN, len(self._nominal)))
        for posture in (self._nominal, *random):
            yield np.where(start.stuck, start.position, posture)

    def _try(self, position: FloatArray) -> Iterator[None]:
        """Go straight, in strides."""
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
        """Whether the arm keeps off the body on the way."""
        for one, other in pairwise(way):
            count = max(2, int(np.abs(other - one).max() / LOOKS))
            for share in np.linspace(1.0, 0.0, count, endpoint=False):
                self._clearance.stand(one + share * (other - one), joint_position)
                for pairs in self._clearance.parts:
                    yield
                    if not self._clearance.kept(pairs):
                        return False
        return True


class _Clearance:
    """Whether an arm keeps off the parts of the robot that it must not touch (``self_collision``).

    Attributes:
        parts: pairs of shapes, as many as a period looks at.
    """

    def __init__(self, model: Model, arm: ArmKinematics) -> None:
        table, joints = model.robot.tables.self_collision, ModelJoints(model)
        self._mj, self._data, self._distance = model.mj, mujoco.MjData(model.mj), table.distance
        self._data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._places = joints.places
        self._arm = 7 + np.array([joints.indices.index(i) for i in arm.joints.tolist()], dtype=np.intp)
        pairs = [
            (model.shape(one), model.shape(other))
            for one, other in table.pairs
            if any(arm.carries(model.body(each)) for each in (one, other))
        ]
        self.parts = [pairs[i : i + PAIRS] for i in range(0, len(pairs), PAIRS)]

    def stand(self, position: FloatArray, joint_position: FloatArray) -> None:
        """Look at a posture (m,) of the arm and (n,) of the robot [rad]."""
        self._data.qpos[7:] = joint_position[self._places]
        self._data.qpos[self._arm] = position
        mujoco.mj_kinematics(self._mj, self._data)

    def kept(self, pairs: list[tuple[int, int]]) -> bool:
        """Whether these shapes are no nearer than they may be."""
        most = self._distance
        return all(mujoco.mj_geomDistance(self._mj, self._data, *pair, most, None) >= most for pair in pairs)


def _within(errors: FloatArray, most: tuple[float, float]) -> bool:
    return bool(errors[0] <= most[0] and errors[1] <= most[1])
