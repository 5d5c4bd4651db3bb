"""What MuJoCo's models write rotations as."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from valor.common.arrays import FloatArray


def matrix(quaternion: Sequence[float] | FloatArray) -> FloatArray:
    """(3, 3) of a quaternion (w, x, y, z)."""
    out = np.empty(9)
    mujoco.mju_quat2Mat(out, np.asarray(quaternion, dtype=float))
    return out.reshape(3, 3)
