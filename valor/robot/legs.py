"""Identification of the knees by kinematics, independent of joint names and directions."""

from collections.abc import Mapping, Sequence
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
_LEAST = 0.01  # least change of the leg's length by a knee [m]
_OBLIQUE = 0.5  # least cosine between a pitch joint's axis and the lateral axis
_ALIKE = 0.02  # difference of lengths at both ends of the range, relative to that change, that counts as equal


@dataclass(frozen=True)
class Knees:
    """Left and right knee."""

    indices: npt.NDArray[np.intp]  # (2,) in every joint vector
    signs: FloatArray  # (2,) 1 if a larger angle bends the leg, −1 if a smaller one does

    def flexion(self, position: FloatArray) -> FloatArray:
        """Return the flexion (…, 2) for joint positions (…, n) [rad]; larger if the leg is bent more."""
        flexion: FloatArray = self.signs * position[..., self.indices]
        return flexion


@lru_cache(maxsize=8)
def knees(robot: RobotDescription) -> Knees:
    """Return the knees of a robot, identified in its nominal posture."""
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    legs = [robot.tables.group(f"{side}_leg") for side in ("left", "right")]
    limits = {name: (robot.lower[robot.index[name]], robot.upper[robot.index[name]]) for leg in legs for name in leg}
    found = [knee(model.mj, data, {name: limits[name] for name in leg}) for leg in legs]
    return Knees(np.array([robot.index[name] for name, _ in found]), np.array([sign for _, sign in found]))


def pitch_joints(data: mujoco.MjData, leg: Sequence[str], lateral: FloatArray) -> list[str]:
    """Return of hip, knee and ankle the joint whose axis is nearest to the lateral axis (3,); hip axes may be oblique.

    ``leg``: three joints of the hip, knee, and two of the ankle; ``data``: after kinematics.
    """
    turns = {name: abs(float(data.joint(name).xaxis @ lateral)) for name in leg}
    parts = (leg[:-3], leg[-3:-2], leg[-2:])
    found = [max(part, key=lambda name: turns[name]) for part in parts if part]
    return [name for name in found if turns[name] > _OBLIQUE]


def knee(mj: mujoco.MjModel, data: mujoco.MjData, leg: Mapping[str, tuple[float, float]]) -> tuple[str, float]:
    """Return the joint of a leg whose range changes the distance of its last joint from the first most.

    Also returns 1 if a larger angle bends the leg, −1 if a smaller one does; for a joint that bends equally both ways,
    the direction that moves the shank back. ``leg``: joint → limits [rad]; ``data.qpos`` has the other joints' posture.
    Raises ConfigurationError: no joint bends the leg.
    """
    joints = sorted(leg, key=lambda name: int(mj.joint(name).bodyid[0]))
    most, found = _LEAST, ("", 1.0)
    for name in joints:
        address = int(mj.joint(name).qposadr[0])
        before = float(data.qpos[address])
        offsets = []
        for angle in np.linspace(max(leg[name][0], -np.pi), min(leg[name][1], np.pi), _SAMPLES):
            data.qpos[address] = angle
            mujoco.mj_kinematics(mj, data)
            offsets.append(data.joint(joints[-1]).xanchor - data.joint(joints[0]).xanchor)
        data.qpos[address] = before
        lengths = np.linalg.norm(offsets, axis=1)
        if (change := float(np.ptp(lengths))) > most:
            most, found = change, (name, _sign(lengths, np.array(offsets)[:, 0]))
    if not found[0]:
        raise ConfigurationError("no joint bends the leg; expected a knee")
    return found


def _sign(lengths: FloatArray, ahead: FloatArray) -> float:
    """Return the bending direction from leg lengths, and distances ahead, over the range of angles."""
    low, high = float(lengths[0]), float(lengths[-1])
    if abs(high - low) > _ALIKE * float(np.ptp(lengths)):
        return 1.0 if high < low else -1.0
    return 1.0 if ahead[-1] < ahead[0] else -1.0
