"""MotionStates to be looked at, not obeyed."""

from __future__ import annotations

import math
from typing import Any, get_type_hints

import numpy as np

from bifrost import Uint8Array
from valor.common.messages import MotionState

_EMPTY = {str: "", int: 0, float: 0.0, Uint8Array: np.zeros(2, np.uint8)}
_TYPES = get_type_hints(MotionState)  # without what codecs add to them when they are made


def motion_state(position: tuple[float, float] = (0.0, 0.0), heading: float = 0.0, **fields: Any) -> MotionState:
    """A robot that walks at a place [m] with a heading [rad]; everything else is zero unless given."""
    content = {name: _EMPTY.get(_TYPES[name], np.zeros(3)) for name in MotionState.__struct_fields__}
    content |= {
        "behavior": "walk",
        "pelvis_position_in_odom": np.array([*position, 0.8]),
        "pelvis_orientation_in_odom": np.array([math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)]),
    }
    return MotionState(**(content | fields))
