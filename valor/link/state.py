"""The robot's state as people name it, to and from the vector that the codec sends."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.link.codec import Frame
from valor.link.fields import BEHAVIORS, BY_NAME, MODES, UNKNOWN, Layout
from valor.link.orientation import smaller, whole

VELOCITY_AGE = BY_NAME["velocity_age"]


def _zeros(size: int) -> FloatArray:
    return np.zeros(size)


@dataclass
class RobotState:
    """What a frame says; fields, units and bounds are those of ``fields.py``.

    Attributes:
        joints: (n,) [rad].
        base_orientation: (4,) pelvis in odom: w, x, y, z.
        foot_forces: (6,) left, right [N].
        foot_torques: (6,) left, right [N·m].
        mode_age: of the mode when the frame was made; received ages are upper bounds [s].
        velocity_age: of the newest velocity that the robot's end passed on, when the frame was made [s].
        clamped: (N,) of the layout; empty unless received.
    """

    joints: FloatArray
    clock: int = 0
    stamp: int = 0
    base_position: FloatArray = field(default_factory=lambda: _zeros(3))
    base_orientation: FloatArray = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))
    base_velocity: FloatArray = field(default_factory=lambda: _zeros(3))
    base_turn: FloatArray = field(default_factory=lambda: _zeros(3))
    foot_forces: FloatArray = field(default_factory=lambda: _zeros(6))
    foot_torques: FloatArray = field(default_factory=lambda: _zeros(6))
    mode: str = UNKNOWN
    requested_mode: str = UNKNOWN
    mode_status: int = 0
    mode_age: float = np.inf
    behavior: str = UNKNOWN
    behavior_age: float = np.inf
    velocity_age: float = np.inf
    contacts: int = 0
    fault_level: int = 3
    faults: int = 0
    step: int = -1
    clamped: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def vector(self, layout: Layout) -> FloatArray:
        """(N,) for the codec."""
        values = np.zeros(layout.size)
        components, largest = smaller(self.base_orientation)
        told: dict[str, Any] = {
            "base_orientation": components, "base_largest": largest,
            "mode": _place(self.mode, MODES), "requested_mode": _place(self.requested_mode, MODES),
            "behavior": _place(self.behavior, BEHAVIORS),
            "velocity_age": min(self.velocity_age, VELOCITY_AGE.high),  # mostly none is sent: not worth a flag
        }  # fmt: skip
        for name, place in layout.fields.items():
            values[place] = told[name] if name in told else getattr(self, name)
        values[layout.joints] = self.joints
        return values

    @classmethod
    def of(cls, frame: Frame, layout: Layout) -> RobotState:
        """What a frame says."""
        told = {name: frame.values[place] for name, place in layout.fields.items()}
        largest = round(float(told.pop("base_largest")[0]))
        orientation = whole(told.pop("base_orientation"), largest)
        vectors = {name: value for name, value in told.items() if len(value) > 1}
        numbers = {name: float(value[0]) for name, value in told.items() if len(value) == 1}
        beyond = {name: bool(frame.clamped[layout.fields[name]].any()) for name in ("mode_age", "behavior_age")}
        beyond["velocity_age"] = numbers["velocity_age"] > VELOCITY_AGE.high - VELOCITY_AGE.bound
        ages = {name: np.inf if far else numbers[name] + BY_NAME[name].bound for name, far in beyond.items()}
        numbers = {name: value for name, value in numbers.items() if name not in ages}
        whole_numbers = {name: round(value) for name, value in numbers.items()}
        names = {
            name: kinds[whole_numbers.pop(name)]
            for name, kinds in (("mode", MODES), ("requested_mode", MODES), ("behavior", BEHAVIORS))
        }
        return cls(
            joints=frame.values[layout.joints],
            base_orientation=orientation,
            clamped=frame.clamped,
            **vectors,  # type: ignore[arg-type]
            **ages,  # type: ignore[arg-type]
            **whole_numbers,  # type: ignore[arg-type]
            **names,
        )


def _place(name: str, names: tuple[str, ...]) -> int:
    return names.index(name) if name in names else 0
