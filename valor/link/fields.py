"""Fields of the state on the link, with range and resolution.

A field is quantised to ``step``: its error is at most half a step. Outside its range it is clamped and flagged. The
fields of a group share one probability distribution, selected for every frame.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import REFLEX, Behavior, ControlMode
from valor.robot.description import RobotDescription

UNKNOWN = "unknown"
MODES = (UNKNOWN, *ControlMode)
BEHAVIORS = (UNKNOWN, REFLEX, *Behavior)
JOINT_MARGIN = 0.15  # outside robot.yaml's limits, for joints deflected by load [rad]
COMPONENT = 0.70711  # of a quaternion: the largest that the second largest can be


@dataclass(frozen=True)
class Field:
    """``size`` values, each from ``low`` to ``high``."""

    name: str
    size: int
    low: float
    high: float
    step: float
    unit: str
    group: str
    description: str

    @property
    def bound(self) -> float:
        """Largest error within its range."""
        return self.step / 2


# fmt: off
FIELDS: tuple[Field, ...] = (
    #     name                size   low        high     step    unit   group       description
    Field("clock",               1,  0,         2**36,   1,      "ms",  "time",     "of the link's robot end, when it sent this; monotonic"),
    Field("stamp",               1,  0,         2**36,   1,      "ms",  "time",     "robot time of joints and base"),
    Field("base_position",       3, -200.0,     200.0,   0.004,  "m",   "base",     "pelvis in odom, estimated"),
    Field("base_orientation",    3, -COMPONENT, COMPONENT, 0.0005, "",  "base",     "its quaternion without the largest component, which is positive"),
    Field("base_largest",        1,  0,         3,       1,      "",    "status",   "which component (w, x, y, z) that is"),
    Field("base_velocity",       3, -3.0,       3.0,     0.02,   "m/s", "velocity", "in the pelvis' axes"),
    Field("base_turn",           3, -6.0,       6.0,     0.04,   "rad/s", "velocity", "in the pelvis' axes"),
    Field("foot_forces",         6, -1500.0,    3000.0,  10.0,   "N",   "forces",   "left, right; in the soles"),
    Field("foot_torques",        6, -400.0,     400.0,   4.0,    "N·m", "forces",   "left, right; in the soles"),
    Field("mode",                1,  0,   len(MODES) - 1, 1,     "",    "status",   "the control mode"),
    Field("requested_mode",      1,  0,   len(MODES) - 1, 1,     "",    "status",   "the one asked for"),
    Field("mode_status",         1,  0,         8191,    1,      "",    "status",   "flags of ControlModeStatus"),
    Field("mode_age",            1,  0,         12.8,    0.05,   "s",   "ages",     "since the mode was last heard"),
    Field("behavior",            1,  0, len(BEHAVIORS) - 1, 1,   "",    "status",   "of the Motion Manager"),
    Field("behavior_age",        1,  0,         12.8,    0.05,   "s",   "ages",     "since it was last heard"),
    Field("velocity_age",        1,  0,         3.0,     0.2,    "s",   "ages",     "since the robot's end passed a velocity on; the greatest: that, or more"),
    Field("contacts",            1,  0,         3,       1,      "",    "status",   "1: left foot, 2: right foot"),
    Field("fault_level",         1,  0,         3,       1,      "",    "status",   "of robot_status: ok, warn, error, stale"),
    Field("faults",              1,  0,         255,     1,      "",    "status",   "how many diagnostics are worse than ok"),
    Field("step",                1, -1,         1023,    1,      "",    "status",   "of the plan that executes; -1: none"),
)
# fmt: on
BY_NAME = {field.name: field for field in FIELDS}
JOINT_STEP = 0.002  # [rad]


ENDLESS = 200.0  # range of a joint without limits, in each direction [rad]


def joint_fields(robot: RobotDescription) -> tuple[Field, ...]:
    """One field per joint, in the order and groups of robot.yaml."""
    groups = {joint: name for name in robot.tables.groups for joint in robot.tables.group(name)}
    lower = np.where(np.isfinite(robot.lower), robot.lower - JOINT_MARGIN, -ENDLESS)
    upper = np.where(np.isfinite(robot.upper), robot.upper + JOINT_MARGIN, ENDLESS)
    return tuple(
        Field(name, 1, float(low), float(high), JOINT_STEP, "rad", groups.get(name, "joints"), "position")
        for name, low, high in zip(robot.joints, lower, upper, strict=True)
    )


class Layout:
    """Fields of one robot as vectors over all N values, joints last."""

    def __init__(self, robot: RobotDescription) -> None:
        joints = joint_fields(robot)
        fields = (*FIELDS, *joints)
        self.joint_names = tuple(field.name for field in joints)
        self.step = np.array([field.step for field in fields for _ in range(field.size)])  # (N,)
        self.low = np.array([field.low for field in fields for _ in range(field.size)])  # (N,) smallest values
        high = np.array([field.high for field in fields for _ in range(field.size)])
        counts = np.ceil((high - self.low) / self.step - 1e-9).astype(int) + 1
        self.high = self.low + (counts - 1) * self.step  # (N,) largest values, on the grid of steps
        self.levels: list[int] = counts.tolist()  # of each value
        self.size = len(self.levels)  # N
        self.slices: dict[str, slice] = {}  # of each field and joint
        self.groups: dict[str, list[int]] = {}  # indices of each group
        place = 0
        for field in fields:
            self.slices[field.name] = slice(place, place + field.size)
            self.groups.setdefault(field.group, []).extend(range(place, place + field.size))
            place += field.size
        self.joints = slice(self.size - len(joints), self.size)
        self.fields = {field.name: self.slices[field.name] for field in FIELDS}  # without joints


def smallest_three(quaternion: Any) -> tuple[FloatArray, int]:
    """(3,) components in order without the largest, and its index; the sign makes the largest positive.

    ``quaternion``: (4,) w, x, y, z, of any norm; zero or not finite: counts as the identity.
    """
    q = np.asarray(quaternion, dtype=float)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < 1e-9:
        return np.zeros(3), 0
    return without(q / norm, int(np.argmax(np.abs(q))))


def without(q: FloatArray, largest: int) -> tuple[FloatArray, int]:
    """Like ``smallest_three``, for a unit quaternion and a given component to omit."""
    sign = -1.0 if q[largest] < 0.0 else 1.0
    return np.clip(np.delete(q, largest) * sign, -COMPONENT, COMPONENT), largest


def from_smallest_three(components: FloatArray, largest: int) -> FloatArray:
    """(4,) unit quaternion; inverse of ``smallest_three``."""
    q = np.insert(components, largest, np.sqrt(max(0.0, 1.0 - float(components @ components))))
    unit: FloatArray = q / np.linalg.norm(q)
    return unit
