"""What an operator sees of a fixture in a world, and how far off that is.

The operator sees it once, from where the robot starts: the true place with an error from the seed, uniform within
``PLACE`` along each axis and ``TURN`` of the heading. Odom begins at the middle of the soles; all that odometry then
loses is lost to the operator, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common.poses import Pose, level
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.simulation import worlds
from valor.simulation.worlds.door import Door
from valor.simulation.worlds.valve import Valve

PLACE = 0.01  # [m]
TURN = 0.02  # [rad]
_STREAM = 3  # of the seed, beside the simulation's


@dataclass(frozen=True)
class SeenDoor:
    """``frame`` in odom as ``Door`` has it; the rest, seen from there, as drawings have it [m]."""

    frame: Pose
    handle_height: float
    lever: float
    hinge: float


@dataclass(frozen=True)
class SeenValve:
    """``frame`` in odom as ``Valve`` has it; ``spoke`` as at the start [rad]."""

    frame: Pose
    height: float
    radius: float
    spokes: int
    spoke: float


def door(robot: RobotDescription, seed: int) -> SeenDoor:
    """Of the world ``door``."""
    world = worlds.WORLDS["door"]
    assert isinstance(world, Door)
    return SeenDoor(_seen(robot, world.pose(worlds.stream(seed)), seed), world.handle_height, world.lever, world.hinge)


def valve(robot: RobotDescription, seed: int) -> SeenValve:
    """Of the world ``valve``."""
    world = worlds.WORLDS["valve"]
    assert isinstance(world, Valve)
    stream = worlds.stream(seed)
    pose = world.pose(stream)
    return SeenValve(_seen(robot, pose, seed), world.height, world.radius, world.spokes, world.spoke(stream))


def _seen(robot: RobotDescription, fixture: Pose, seed: int) -> Pose:
    """A place in the world, as it is seen in odom; its height, too, is off."""
    x, y, z, yaw = np.random.default_rng([seed, _STREAM]).uniform(-1.0, 1.0, 4).tolist()
    ahead = _odom(robot).inverse() @ fixture
    px, py, pz = ahead.position
    return level(px + PLACE * x, py + PLACE * y, pz + PLACE * z, ahead.yaw + TURN * yaw)


def _odom(robot: RobotDescription) -> Pose:
    """In the world: between the soles, as a robot starts."""
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    mujoco.mj_kinematics(model.mj, data)
    feet = (robot.tables.feet.left, robot.tables.feet.right)
    x, y, z = np.mean([data.site_xpos[model.site(foot.sole)] for foot in feet], axis=0).tolist()
    return Pose((x, y, z))
