"""What of a robot is drawn."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from valor.common.arrays import FloatArray


@dataclass(frozen=True)
class Posture:
    """The whole robot at one moment."""

    time: float  # robot time [s]
    behavior: str
    pelvis_position: FloatArray  # (3,) [m]
    pelvis_orientation: FloatArray  # (4,) (w, x, y, z)
    joint_position: FloatArray  # (n,) [rad]
    fixture_position: FloatArray = field(default_factory=lambda: np.zeros(0))  # of the world's joints, if known [rad]
