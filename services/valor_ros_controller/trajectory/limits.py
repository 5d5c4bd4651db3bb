"""Limits of a controller's joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class JointLimits:
    """Names, units and limits of a controller's n joints, in the controller's order."""

    names: tuple[str, ...]
    units: tuple[str, ...]  # of position, each rad or m
    lower: FloatArray  # (n,)
    upper: FloatArray  # (n,)
    velocity: FloatArray  # (n,) [1/s]
