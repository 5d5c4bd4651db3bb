"""The robot's links and frames, as tf needs them, and its description for other tools of ROS.

They come from the MuJoCo model, which is compiled in a process of its own: after that this service has no more use for
MuJoCo, whose memory it would keep. From the tree every link's transform to its parent is one rotation of its hinge, so
no forward kinematics is needed but that of the legs, for ``base_footprint``.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

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
            [sys.executable, "-m", "valor.valor_ros_controller.kinematic_tree", str(robot.folder)],
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


def read(robot: RobotDescription) -> KinematicTree:
    """The tree of a robot's model; imports MuJoCo.

    Raises:
        ConfigurationError: the model cannot be read, or a link has several joints.
    """
    import mujoco

    from valor.robot.model import full_model
    from valor.valor_ros_controller.urdf import robot_description

    mj = full_model(robot, "all").mj
    tables = robot.tables
    base = tables.base
    names = {target: frame for frame, target in tables.link_frames.items()}
    links = []
    for i in range(1, mj.nbody):
        body = mj.body(i)
        if body.name == base:
            continue
        count, first = int(mj.body_jntnum[i]), int(mj.body_jntadr[i])
        if count > 1 or (count and mj.jnt_type[first] != mujoco.mjtJoint.mjJNT_HINGE):
            raise ConfigurationError(f"{robot.model_file}: body {body.name!r}: expected at most one joint, a hinge")
        links.append(
            Link(
                body.name,
                mj.body(int(mj.body_parentid[i])).name,
                tuple(body.pos.tolist()),
                tuple(body.quat.tolist()),
                mj.joint(first).name if count else "",
                tuple(mj.jnt_axis[first].tolist()) if count else (0.0, 0.0, 1.0),
                tuple(mj.jnt_pos[first].tolist()) if count else (0.0, 0.0, 0.0),
            )
        )
    bodies = {link.name for link in links} | {base}
    frames = []
    for site in map(mj.site, range(mj.nsite)):
        if site.name in names or site.name in _named_sites(robot):
            link = mj.body(int(mj.site_bodyid[site.id])).name
            frame = names.get(site.name, site.name)
            frames.append(Frame(frame, site.name, link, tuple(site.pos.tolist()), tuple(site.quat.tolist())))
    for frame, target in tables.link_frames.items():
        if target in bodies and target not in (frame, base):
            frames.append(Frame(frame, target, target, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    tree = KinematicTree(base, names.get(base, base), links, frames, urdf="")
    return msgspec.structs.replace(tree, urdf=robot_description(robot, tree, mj))


def _named_sites(robot: RobotDescription) -> set[str]:
    """The sites that measurements refer to."""
    tables = robot.tables
    feet, hands = tables.feet, tables.hands
    return {tables.imu.site, feet.left.sole, feet.right.sole, hands.left.site, hands.right.site}


def main() -> int:
    """Print the tree of the robot in the folder named by the one argument, as JSON."""
    try:
        tree = read(RobotDescription.load(Path(sys.argv[1])))
    except ConfigurationError as error:
        print(error, file=sys.stderr)
        return 1
    sys.stdout.write(json.dumps(msgspec.to_builtins(tree)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
