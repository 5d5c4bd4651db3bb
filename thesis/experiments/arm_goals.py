"""Random arm goals within reach, without self-contact."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.tables import Side

INSIDE = 0.15  # least distance of goals from joint limits [rad]
HEIGHTS = (-0.35, 0.8)  # range of the hand above the base [m]
OUTSIDE = 0.1  # least distance of the hand from the base's middle plane, on its side [m]
AHEAD, BEHIND = 0.1, -0.05  # least x of the hand for goals ahead, largest for goals behind, in the base [m]
STRIDE = 0.1  # largest joint motion between two checked postures of a path [rad]
TRIES = 5000  # per goal


@dataclass(frozen=True)
class ArmGoal:
    """Posture of an arm with m joints.

    Attributes:
        joints: (m,) [rad].
        position: (3,) of the hand in the base's frame [m].
        rotation: (3, 3) of the hand in the base's frame.
    """

    joints: FloatArray
    position: FloatArray
    rotation: FloatArray


class ArmGoals:
    """Sequence of goals determined by a seed."""

    def __init__(self, robot: RobotDescription, seed: int) -> None:
        self._robot, self._rng = robot, np.random.default_rng([seed, 20])
        self._model = full_model(robot, "collision")
        self._data = mujoco.MjData(self._model.mj)

    def draw(self, side: Side, posture: FloatArray, *, ahead: bool | None = None, straight: bool = False) -> ArmGoal:
        """Return the next goal.

        Args:
            side: of the arm.
            posture: (n,) joint positions [rad]; only the arm's change.
            ahead: hand in front of the base (True), behind it (False), or either (None).
            straight: whether the straight joint path from ``posture`` must be free of self-contact as well.

        Raises:
            ValorError: the robot lacks that arm or hand, or ``TRIES`` draws gave no goal.
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
            rotation = data.xmat[base].reshape(3, 3)
            position = rotation.T @ (data.site_xpos[site] - data.xpos[base])
            goal = ArmGoal(joints, position, rotation.T @ data.site_xmat[site].reshape(3, 3))
            if not HEIGHTS[0] < position[2] < HEIGHTS[1] or outwards * position[1] <= OUTSIDE:
                continue
            if ahead is not None and not (position[0] >= AHEAD if ahead else position[0] <= BEHIND):
                continue
            if not straight or self._way_is_free(posture, arm, joints):
                return goal
        raise ValorError(f"goals of an arm: {robot.name} has none of its {side} arm in {TRIES} draws")

    def _way_is_free(self, posture: FloatArray, arm: np.typing.NDArray[np.intp], joints: FloatArray) -> bool:
        start = posture[arm]
        count = int(np.ceil(np.abs(joints - start).max() / STRIDE))
        return all(self._free(posture, arm, start + share * (joints - start)) for share in np.arange(1, count) / count)

    def _free(self, posture: FloatArray, arm: np.typing.NDArray[np.intp], joints: FloatArray) -> bool:
        """Return whether a posture is free of self-contact; ``_data`` has the posture afterwards."""
        model, data = self._model, self._data
        whole = posture.copy()
        whole[arm] = joints
        data.qpos[:] = model.nominal_qpos()
        data.qpos[model.qpos] = whole[model.joint_indices]
        mujoco.mj_forward(model.mj, data)
        return not data.ncon
