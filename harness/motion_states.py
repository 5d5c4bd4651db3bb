"""Messages of a Motion Manager, made up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bifrost import codec
from valor.common.messages import JointMode, MotionState, Motor
from valor.robot.description import RobotDescription

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


def motor(robot: RobotDescription, mode: JointMode | np.ndarray = JointMode.POSITION, **fields: Any) -> Motor:
    """The nominal posture in a mode; everything else is zero unless given."""
    n = len(robot.joints)
    content: dict[str, Any] = {name: np.zeros(n) for name in ("velocity", "effort", "stiffness", "damping")}
    content |= {"time": 0, "sequence": 1, "proprioceptor_sequence": 1, "behavior": "stand", "writer": 1}
    content |= {"mode": np.full(n, mode, np.uint8) if isinstance(mode, JointMode) else mode}
    return Motor(**(content | {"position": robot.nominal_posture.copy()} | fields))
