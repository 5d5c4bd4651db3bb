"""Which joints of the legs are the knees, whatever they are called and whichever way they turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

_SAMPLES = 32  # over a joint's range
_LEAST = 0.01  # that a knee changes the leg's length by [m]
_ALIKE = 0.02  # ends of a range at which the leg is as bent, of that change


@dataclass(frozen=True)
class Knees:
    """Left and right.

    Attributes:
        places: (2,) in every joint vector.
        signs: (2,) 1 where a larger angle bends the leg, −1 where a smaller one does.
    """

    places: npt.NDArray[np.intp]
    signs: FloatArray

    def flexion(self, position: FloatArray) -> FloatArray:
        """(…, 2) of joint positions (…, n), the more the leg is bent the larger [rad]; 0 where the joint's angle is."""
        flexion: FloatArray = self.signs * position[..., self.places]
        return flexion


@lru_cache(maxsize=8)
def knees(robot: RobotDescription) -> Knees:
    """Of a robot, looked for in its nominal posture."""
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    legs = [robot.tables.group(f"{side}_leg") for side in ("left", "right")]
    limits = {name: (robot.lower[robot.index[name]], robot.upper[robot.index[name]]) for leg in legs for name in leg}
    found = [knee(model.mj, data, {name: limits[name] for name in leg}) for leg in legs]
    return Knees(np.array([robot.index[name] for name, _ in found]), np.array([sign for _, sign in found]))


def knee(mj: mujoco.MjModel, data: mujoco.MjData, leg: Mapping[str, tuple[float, float]]) -> tuple[str, float]:
    """The joint of a leg that changes most, over its range, how far the last joint is from the first.

    Args:
        mj: of the robot.
        data: ``qpos`` has the posture of the other joints; it is as it was afterwards.
        leg: joint → lower and upper limit [rad].

    Returns:
        Its name, and 1 where a larger angle bends the leg, −1 where a smaller one does; of one that bends both ways as
        far, the way that takes the shank back.

    Raises:
        ConfigurationError: none of them bends the leg.
    """
    joints = sorted(leg, key=lambda name: int(mj.joint(name).bodyid[0]))
    most, found = _LEAST, ("", 1.0)
    for name in joints:
        place = int(mj.joint(name).qposadr[0])
        before = float(data.qpos[place])
        ways = []
        for angle in np.linspace(max(leg[name][0], -np.pi), min(leg[name][1], np.pi), _SAMPLES):
            data.qpos[place] = angle
            mujoco.mj_kinematics(mj, data)
            ways.append(data.joint(joints[-1]).xanchor - data.joint(joints[0]).xanchor)
        data.qpos[place] = before
        lengths = np.linalg.norm(ways, axis=1)
        if (change := float(np.ptp(lengths))) > most:
            most, found = change, (name, _sign(lengths, np.array(ways)[:, 0]))
    if not found[0]:
        raise ConfigurationError("no joint bends the leg; expected a knee")
    return found


def _sign(lengths: FloatArray, ahead: FloatArray) -> float:
    """Which way a leg bends that is so long at angles from the lower limit to the upper one, its end so far ahead."""
    low, high = float(lengths[0]), float(lengths[-1])
    if abs(high - low) > _ALIKE * float(np.ptp(lengths)):
        return 1.0 if high < low else -1.0
    return 1.0 if ahead[-1] < ahead[0] else -1.0
