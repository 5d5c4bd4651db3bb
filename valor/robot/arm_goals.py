"""Goals for an arm, drawn at random within its reach: postures at which the robot touches nothing of itself."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.tables import Side

INSIDE = 0.15  # from the joints' limits that goals keep [rad]
HEIGHTS = (-0.35, 0.8)  # of the hand above the base [m]
OUTSIDE = 0.1  # of the hand from the base's middle plane, to its own side, at least [m]
AHEAD, BEHIND = 0.1, -0.05  # of the hand from the base, at least and at most, where a goal shall be there [m]
STRIDE = 0.1  # of a joint between two postures on a way that are looked at, at most [rad]
TRIES = 5000  # draws for one goal


@dataclass(frozen=True)
class ArmGoal:
    """A posture of an arm of m joints.

    Attributes:
        joints: (m,) [rad].
        place: (3,) of the hand in the base's frame [m].
        turn: (3, 3) its rotation there.
    """

    joints: FloatArray
    place: FloatArray
    turn: FloatArray


class ArmGoals:
    """A sequence of goals that a seed determines."""

    def __init__(self, robot: RobotDescription, seed: int) -> None:
        self._robot, self._rng = robot, np.random.default_rng([seed, 20])
        self._model = full_model(robot, "collision")
        self._data = mujoco.MjData(self._model.mj)

    def draw(self, side: Side, posture: FloatArray, *, ahead: bool | None = None, straight: bool = False) -> ArmGoal:
        """One goal more.

        Args:
            side: of the arm.
            posture: (n,) where the robot's joints are [rad]; all but the arm's stay.
            ahead: whether the hand shall be in front of the base or behind it; either unless given.
            straight: whether nothing may touch on the joints' straight way from ``posture``, either.

        Raises:
            ValorError: the robot lacks that arm or hand, or has no such goal in very many draws.
        """
        robot, data = self._robot, self._data
        arm = robot.group_indices(f"{side}_arm")
        hand = getattr(robot.tables.hands, side)
        if hand is None or not arm.size:
            raise ValorError(f"goals of an arm: {robot.name} has no {side} arm with a hand")
        lower, upper = robot.lower[arm] + INSIDE, robot.upper[arm] - INSIDE
        base, site = self._model.body(robot.tables.base), self._model.site(hand.site)
        outwards = 1.0 if side == "left" else -1.0
        for _ in range(TRIES):
            joints = self._rng.uniform(lower, upper)
            if not self._free(posture, arm, joints):
                continue
            turn = data.xmat[base].reshape(3, 3)
            place = turn.T @ (data.site_xpos[site] - data.xpos[base])
            goal = ArmGoal(joints, place, turn.T @ data.site_xmat[site].reshape(3, 3))
            if not HEIGHTS[0] < place[2] < HEIGHTS[1] or outwards * place[1] <= OUTSIDE:
                continue
            if ahead is not None and not (place[0] >= AHEAD if ahead else place[0] <= BEHIND):
                continue
            if not straight or self._way_is_free(posture, arm, joints):
                return goal
        raise ValorError(f"goals of an arm: {robot.name} has none of its {side} arm in {TRIES} draws")

    def _way_is_free(self, posture: FloatArray, arm: np.typing.NDArray[np.intp], joints: FloatArray) -> bool:
        start = posture[arm]
        count = int(np.ceil(np.abs(joints - start).max() / STRIDE))
        return all(self._free(posture, arm, start + share * (joints - start)) for share in np.arange(1, count) / count)

    def _free(self, posture: FloatArray, arm: np.typing.NDArray[np.intp], joints: FloatArray) -> bool:
        """Whether the robot touches nothing of itself; ``_data`` is there afterwards."""
        model, data = self._model, self._data
        whole = posture.copy()
        whole[arm] = joints
        data.qpos[:] = model.nominal_qpos()
        data.qpos[model.qpos] = whole[model.joint_indices]
        mujoco.mj_forward(model.mj, data)
        return not data.ncon
