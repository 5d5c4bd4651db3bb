"""MotionStates to be looked at, not obeyed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bifrost import codec
from valor.common.messages import MotionState

_EMPTY = {"str": "", "int": 0, "float": 0.0, "float64[]": np.zeros(3), "uint8[]": np.zeros(2, np.uint8)}
_FIELDS = codec(MotionState).schema.types[MotionState.__name__]


def motion_state(position: tuple[float, float] = (0.0, 0.0), heading: float = 0.0, **fields: Any) -> MotionState:
    """A robot that walks at a place [m] with a heading [rad]; everything else is zero unless given."""
    content: dict[str, Any] = {name: _EMPTY[type_name] for name, type_name in _FIELDS}
    content |= {
        "behavior": "walk",
        "pelvis_position_in_odom": np.array([*position, 0.8]),
        "pelvis_orientation_in_odom": np.array([math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)]),
    }
    return MotionState(**(content | fields))
