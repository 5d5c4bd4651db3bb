"""Which joints of the legs are the knees, whatever they are called and whichever way they turn."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.model import Model, full_model

_SAMPLES = 32  # over a joint's range


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
    """Of each leg the joint that changes most, over its range, how far the last joint is from the first."""
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    found = [_knee(model, data, robot.tables.group(f"{side}_leg")) for side in ("left", "right")]
    return Knees(np.array([robot.index[name] for name, _ in found]), np.array([sign for _, sign in found]))


def _knee(model: Model, data: mujoco.MjData, leg: list[str]) -> tuple[str, float]:
    """Its name, and which way it bends."""
    joints = sorted(leg, key=lambda name: int(model.mj.joint(name).bodyid[0]))
    longest, knee, sign = -1.0, "", 1.0
    for name in joints:
        place = model.robot.index[name]
        lower, upper = max(model.robot.lower[place], -np.pi), min(model.robot.upper[place], np.pi)
        angles = np.linspace(lower, upper, _SAMPLES)
        lengths = []
        for angle in angles:
            data.qpos[:] = model.nominal_qpos()
            data.qpos[model.mj.joint(name).qposadr[0]] = angle
            mujoco.mj_kinematics(model.mj, data)
            lengths.append(float(np.linalg.norm(data.joint(joints[-1]).xanchor - data.joint(joints[0]).xanchor)))
        if (change := max(lengths) - min(lengths)) > longest:
            bent, straight = angles[int(np.argmin(lengths))], angles[int(np.argmax(lengths))]
            longest, knee, sign = change, name, 1.0 if bent > straight else -1.0
    return knee, sign
