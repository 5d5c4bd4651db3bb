"""The kinematic tree and URDF of a robot's MuJoCo model; ``python -m`` with the robot's folder prints them as JSON."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
import mujoco

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import Frame, KinematicTree, Link
from valor.robot.model import full_model
from valor.robot.urdf import MeshUri, robot_description


def read(robot: RobotDescription, mesh_uri: MeshUri = Path.as_uri) -> KinematicTree:
    """The tree of a robot's model.

    Args:
        robot: its description.
        mesh_uri: how the URDF names an absolute path of a mesh.

    Raises:
        ConfigurationError: the model cannot be read, or a link has several joints.
    """
    mj = full_model(robot, "all").mj
    tables = robot.tables
    base = tables.base
    named = set(tables.link_frames.values()) | _measured_sites(robot)
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
        if site.name in named:
            link = mj.body(int(mj.site_bodyid[site.id])).name
            frame = robot.frame_of(site.name)
            frames.append(Frame(frame, site.name, link, tuple(site.pos.tolist()), tuple(site.quat.tolist())))
    for frame, target in tables.link_frames.items():
        if target in bodies and target not in (frame, base):
            frames.append(Frame(frame, target, target, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    tree = KinematicTree(base, robot.frame_of(base), links, frames, urdf="")
    return msgspec.structs.replace(tree, urdf=robot_description(robot, tree, mj, mesh_uri))


def _measured_sites(robot: RobotDescription) -> set[str]:
    """The sites that measurements refer to."""
    tables = robot.tables
    hands = {hand.site for _, hand in tables.hands.present()}
    return {tables.imu.site, tables.feet.left.sole, tables.feet.right.sole} | hands


def main() -> int:
    """Print the tree of the robot in the folder named by the one argument, as JSON."""
    try:
        tree = read(RobotDescription.load(Path(sys.argv[1])))
    except ConfigurationError as error:
        print(error, file=sys.stderr)
        return 1
    sys.stdout.buffer.write(msgspec.json.encode(tree))
    return 0


if __name__ == "__main__":
    sys.exit(main())
