"""Links and frames of a robot for tf, and its URDF.

``load`` compiles the model in a separate process, so that services do not keep MuJoCo's memory.
"""

import subprocess
import sys
from typing import Self

import msgspec

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription

Quaternion = tuple[float, float, float, float]  # w, x, y, z


class Link(msgspec.Struct, frozen=True):
    """Body, in its parent's frame at joint angle 0."""

    name: str
    parent: str
    position: tuple[float, float, float]  # [m]
    orientation: Quaternion
    joint: str  # hinge between them; empty if fixed
    axis: tuple[float, float, float]  # of the hinge, in the link, unit length
    anchor: tuple[float, float, float]  # of the hinge, in the link [m]
    mass: float  # [kg]
    com: tuple[float, float, float]  # in the link [m]


class Frame(msgspec.Struct, frozen=True):
    """Named frame fixed to a link."""

    name: str
    target: str  # body or site of the model
    link: str
    position: tuple[float, float, float]  # [m]
    orientation: Quaternion


class KinematicTree(msgspec.Struct, frozen=True):
    """Links, parents first, without the base; and frames fixed to links."""

    base: str
    base_frame: str  # ROS frame of the base
    links: list[Link]
    frames: list[Frame]
    urdf: str  # of the robot

    @classmethod
    def load(cls, robot: RobotDescription) -> Self:
        """Read the robot's model in a separate process. Raises ConfigurationError if it is invalid."""
        result = subprocess.run(
            [sys.executable, "-m", "valor.robot.model_tree", str(robot.folder)],
            capture_output=True,
            text=True,
            check=False,
        )
        if result.returncode:
            lines = result.stderr.strip().splitlines() or ["no output"]
            raise ConfigurationError(lines[-1])
        return msgspec.json.decode(result.stdout, type=cls)

    def frame_of(self, target: str) -> str:
        """Return the ROS frame of a body or site of the model."""
        return next((frame.name for frame in self.frames if frame.target == target), target)
