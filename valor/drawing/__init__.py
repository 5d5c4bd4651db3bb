"""Off-screen drawing of the robot in its world: pictures, films, simulated camera."""

from dataclasses import dataclass, field

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError

OFFSCREEN = ("libegl1", "libgl1-mesa-dri", "libopengl0")
"""Packages of Debian and Ubuntu for off-screen drawing."""


class RenderingError(ValorError):
    """Off-screen rendering is not available; the text names the packages to install."""


@dataclass(frozen=True)
class Posture:
    """Configuration of the robot and its world at a time."""

    time: float  # robot time [s]
    behavior: str
    pelvis_position: FloatArray  # (3,) [m]
    pelvis_orientation: FloatArray  # (4,) (w, x, y, z)
    joint_position: FloatArray  # (n,) [rad]
    fixture_position: FloatArray = field(default_factory=lambda: np.zeros(0))  # of the world's joints, if known [rad]
