"""Type of vectors and matrices, each declaration of which gives the shape; arrays of ROS messages."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def sequence(values: npt.NDArray[Any]) -> array.array[Any]:
    """Array of numbers or bytes that rclpy's setters accept without a check of each element."""
    return array.array("B" if values.dtype == np.uint8 else "d", values.tobytes())
