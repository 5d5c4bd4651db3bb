"""Robot state with named fields, and its conversion to the codec's vector."""

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.link.codec import Frame
from valor.link.fields import BEHAVIORS, BY_NAME, MODES, UNKNOWN, Layout, from_smallest_three, smallest_three

VELOCITY_AGE = BY_NAME["velocity_age"]
_NAMES = {"mode": MODES, "requested_mode": MODES, "behavior": BEHAVIORS}
# Largest values that are not infinite; the age of a velocity is not flagged when it saturates.
_AGES = {"mode_age": np.inf, "behavior_age": np.inf, "velocity_age": VELOCITY_AGE.high - VELOCITY_AGE.bound}


@dataclass
class RobotState:
    """Robot state; fields, units and bounds as in ``fields.py``. Received ages are upper bounds."""

    joints: FloatArray  # (n,) [rad]
    clock: int = 0
    stamp: int = 0
    base_position: FloatArray = field(default_factory=lambda: np.zeros(3))
    base_orientation: FloatArray = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))  # w, x, y, z in odom
    base_velocity: FloatArray = field(default_factory=lambda: np.zeros(3))
    base_turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    foot_forces: FloatArray = field(default_factory=lambda: np.zeros(6))  # left, right [N]
    foot_torques: FloatArray = field(default_factory=lambda: np.zeros(6))  # left, right [N·m]
    mode: str = UNKNOWN
    requested_mode: str = UNKNOWN
    mode_status: int = 0
    mode_age: float = np.inf  # when the frame was encoded [s]
    behavior: str = UNKNOWN
    behavior_age: float = np.inf
    velocity_age: float = np.inf  # of the latest velocity that the robot's end published, likewise [s]
    contacts: int = 0
    fault_level: int = 3
    faults: int = 0
    step: int = -1
    clamped: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))  # (N,) if received

    def vector(self, layout: Layout) -> FloatArray:
        """(N,) for the codec."""
        values = np.zeros(layout.size)
        components, largest = smallest_three(self.base_orientation)
        told: dict[str, Any] = {
            "base_orientation": components, "base_largest": largest,
            **{name: _index(getattr(self, name), names) for name, names in _NAMES.items()},
            "velocity_age": min(self.velocity_age, VELOCITY_AGE.high),  # usually saturated: no clamped flag
        }  # fmt: skip
        for name, place in layout.fields.items():
            values[place] = told[name] if name in told else getattr(self, name)
        values[layout.joints] = self.joints
        return values

    @classmethod
    def of(cls, frame: Frame, layout: Layout) -> Self:
        """State of a decoded frame."""
        told = {name: frame.values[place] for name, place in layout.fields.items()}
        largest = round(float(told.pop("base_largest")[0]))
        orientation = from_smallest_three(told.pop("base_orientation"), largest)
        fields: dict[str, Any] = {}
        for name, value in told.items():
            if name in _NAMES:
                fields[name] = _NAMES[name][round(float(value[0]))]
            elif name in _AGES:
                far = bool(frame.clamped[layout.fields[name]].any()) or value[0] > _AGES[name]
                fields[name] = np.inf if far else float(value[0]) + BY_NAME[name].bound
            else:
                fields[name] = value if len(value) > 1 else round(float(value[0]))
        joints = frame.values[layout.joints]
        return cls(joints=joints, base_orientation=orientation, clamped=frame.clamped, **fields)


def _index(name: str, names: tuple[str, ...]) -> int:
    return names.index(name) if name in names else 0
