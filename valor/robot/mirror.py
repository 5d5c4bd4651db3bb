"""The left side and the right one: joint positions of the mirror image of a posture."""

from functools import lru_cache

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

_LEFT, _RIGHT = "left_", "right_"  # prefixes of group names


@lru_cache(maxsize=8)
def counterparts(robot: RobotDescription) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return of each joint (n,) the counterpart, by its index in the groups, and the sign of its angle.

    An axis (x, y, z) is a pseudo-vector; its image in the sagittal plane is (−x, y, −z).
    """
    groups, indices = robot.tables.groups, np.arange(len(robot.joints))
    for name, left in groups.items():
        if name.startswith(_LEFT):
            right = robot.tables.group(_RIGHT + name.removeprefix(_LEFT))
            if len(left) != len(right):
                what = f"{len(left)} joints, its counterpart {len(right)}; expected equal numbers"
                raise robot.error(["groups", name], what)
            one, other = ([robot.index[joint] for joint in side] for side in (left, right))
            indices[one], indices[other] = other, one
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    mujoco.mj_kinematics(model.mj, data)
    axes = np.array([data.joint(name).xaxis for name in robot.joints])
    signs = np.where((axes * (-1.0, 1.0, -1.0) * axes[indices]).sum(1) < 0.0, -1.0, 1.0)
    return indices, signs


def mirrored(robot: RobotDescription, position: FloatArray) -> FloatArray:
    """Return the joint positions (…, n) of the mirror image [rad]. Raises ConfigurationError: the sides differ."""
    indices, signs = counterparts(robot)
    image: FloatArray = signs * position[..., indices]
    return image
