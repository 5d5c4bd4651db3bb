"""The robot's links and frames, as tf needs them, and its description for other tools of ROS.

They come from the MuJoCo model, which ``load`` compiles in a process of its own: a service that has no other use for
MuJoCo would keep its memory. From the tree every link's transform to its parent is one rotation of its hinge, so
no forward kinematics is needed but that of the legs, for ``base_footprint``.
"""

from __future__ import annotations

import subprocess
import sys

import msgspec

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription

Quaternion = tuple[float, float, float, float]  # w, x, y, z


class Link(msgspec.Struct, frozen=True):
    """A body, in its parent's frame at joint angle 0."""

    name: str
    parent: str
    position: tuple[float, float, float]  # [m]
    orientation: Quaternion
    joint: str  # the hinge between them; empty: fixed
    axis: tuple[float, float, float]  # of the hinge, in the link, unit length
    anchor: tuple[float, float, float]  # of the hinge, in the link [m]


class Frame(msgspec.Struct, frozen=True):
    """A named frame fixed to a link."""

    name: str
    target: str  # body or site of the model
    link: str
    position: tuple[float, float, float]  # [m]
    orientation: Quaternion


class KinematicTree(msgspec.Struct, frozen=True):
    """Links, parents first, the base not among them, and frames fixed to links."""

    base: str
    base_frame: str  # name of the base's frame in ROS
    links: list[Link]
    frames: list[Frame]
    urdf: str  # the robot's description (``urdf``)

    @classmethod
    def load(cls, robot: RobotDescription) -> KinematicTree:
        """Read the robot's model, in a process that then ends.

        Raises:
            ConfigurationError: the model cannot be read, or a link has several joints.
        """
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
        """The ROS frame of a body or site of the model."""
        return next((frame.name for frame in self.frames if frame.target == target), target)
