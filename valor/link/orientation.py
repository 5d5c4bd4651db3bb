"""A unit quaternion as its three smaller components and which one is missing."""

from __future__ import annotations

from typing import Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.link.fields import COMPONENT


def smaller(quaternion: Any) -> tuple[FloatArray, int]:
    """(3,) components in order without the largest, whose place is returned, with the sign that makes it positive.

    Args:
        quaternion: (4,) w, x, y, z; of any norm; what is none of finite norm counts as no turn.
    """
    q = np.asarray(quaternion, dtype=float)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < 1e-9:
        return np.zeros(3), 0
    return without(q / norm, int(np.argmax(np.abs(q))))


def without(q: FloatArray, largest: int) -> tuple[FloatArray, int]:
    """As ``smaller``, of a unit quaternion, with the component to leave out given."""
    sign = -1.0 if q[largest] < 0.0 else 1.0
    return np.clip(np.delete(q, largest) * sign, -COMPONENT, COMPONENT), largest


def whole(components: FloatArray, largest: int) -> FloatArray:
    """(4,) the unit quaternion; the inverse of ``smaller``."""
    q = np.insert(components, largest, np.sqrt(max(0.0, 1.0 - float(components @ components))))
    unit: FloatArray = q / np.linalg.norm(q)
    return unit
