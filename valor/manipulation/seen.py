"""Observation of a fixture in a simulated world: its true pose at the start, with an error from the seed.

The error is uniform within ``PLACE`` along each axis and ``TURN`` of the heading. Odometry's drift is not corrected.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common.poses import Pose, level
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.simulation import worlds
from valor.simulation.worlds.fixtures import Door, Valve

PLACE = 0.01  # [m]
TURN = 0.02  # [rad]
_STREAM = 3  # random stream, in addition to the simulation's


@dataclass(frozen=True)
class SeenDoor:
    """``frame`` of ``Door`` in odom; dimensions in that frame [m]."""

    frame: Pose
    handle_height: float
    lever: float
    hinge: float


@dataclass(frozen=True)
class SeenValve:
    """``frame`` of ``Valve`` in odom; ``spoke``: angle at the start [rad]."""

    frame: Pose
    height: float
    radius: float
    spokes: int
    spoke: float


def door(robot: RobotDescription, seed: int) -> SeenDoor:
    """Observation in the world ``door``."""
    world = worlds.WORLDS["door"]
    assert isinstance(world, Door)
    return SeenDoor(_seen(robot, world.pose(worlds.stream(seed)), seed), world.handle_height, world.lever, world.hinge)


def valve(robot: RobotDescription, seed: int) -> SeenValve:
    """Observation in the world ``valve``."""
    world = worlds.WORLDS["valve"]
    assert isinstance(world, Valve)
    stream = worlds.stream(seed)
    pose = world.pose(stream)
    return SeenValve(_seen(robot, pose, seed), world.height, world.radius, world.spokes, world.spoke(stream))


def _seen(robot: RobotDescription, fixture: Pose, seed: int) -> Pose:
    x, y, z, yaw = np.random.default_rng([seed, _STREAM]).uniform(-1.0, 1.0, 4).tolist()
    ahead = _odom(robot).inverse() @ fixture
    px, py, pz = ahead.position
    return level(px + PLACE * x, py + PLACE * y, pz + PLACE * z, ahead.yaw + TURN * yaw)


def _odom(robot: RobotDescription) -> Pose:
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    mujoco.mj_kinematics(model.mj, data)
    feet = (robot.tables.feet.left, robot.tables.feet.right)
    x, y, z = np.mean([data.site_xpos[model.site(foot.sole)] for foot in feet], axis=0).tolist()
    return Pose((x, y, z))
