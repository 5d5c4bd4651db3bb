"""Plants whose arms are not what their nominal tables say: play, friction and masses drawn from a seed."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
from msgspec import structs

from valor.calibration.dynamics import links
from valor.robot import arm_calibration
from valor.robot.arm_calibration import ArmCalibration
from valor.robot.description import RobotDescription
from valor.robot.tables import Gear
from valor.simulation.actuators import Gears
from valor.simulation.plant import Plant

WORN = "worn"  # profile
FACTORS = (0.5, 2.0)  # of friction, play and damping
MASS = 0.25  # share by which a link's mass is off, at most
COM = 0.02  # along each axis [m]


def worn(robot: RobotDescription, profile: str, seed: int) -> RobotDescription:
    """The robot with a profile ``WORN``: another, with friction and play of each of its arms' joints drawn anew."""
    table = robot.tables.actuators[profile]
    gears, rng = Gears.of(robot, table), np.random.default_rng([seed, 31])
    drawn = dict(table.gears)
    for group in ("left_arm", "right_arm"):
        for name in robot.tables.group(group):
            i = robot.index[name]
            friction, play = rng.uniform(*FACTORS, 2)
            drawn[name] = Gear(
                friction=friction * float(gears.friction[i]),
                backlash=play * 2.0 * float(gears.half_backlash[i]),
                feed_forward=bool(gears.feed_forward[i]),
                strength=float(gears.strength[i]),
            )
    profiles = robot.tables.actuators | {WORN: structs.replace(table, gears=drawn)}
    return RobotDescription(robot.folder, structs.replace(robot.tables, actuators=profiles))


def wear(plant: Plant, seed: int) -> None:
    """Draw masses, centres of mass and viscous friction of the arms anew; before the first step."""
    model, rng = plant.model, np.random.default_rng([seed, 32])
    mj = model.mj
    for group in ("left_arm", "right_arm"):
        joints = tuple(model.robot.tables.group(group))
        for name in joints:
            mj.dof_damping[mj.joint(name).dofadr] *= rng.uniform(*FACTORS)
        for body in links(model, joints):
            factor = 1.0 + rng.uniform(-MASS, MASS)
            mj.body_mass[body] *= factor
            mj.body_inertia[body] *= factor
            mj.body_ipos[body] += rng.uniform(-COM, COM, 3)
    mujoco.mj_setConst(mj, plant.data)
    plant.data.qpos[:] = model.nominal_qpos()
    mujoco.mj_forward(mj, plant.data)


def calibrated(robot: RobotDescription, arms: dict[str, ArmCalibration], folder: Path) -> RobotDescription:
    """The robot in a folder of its own, with what was found of its arms in it."""
    shutil.copytree(robot.folder, folder)
    made = RobotDescription(folder, robot.tables)
    arm_calibration.write(made, arm_calibration.joined(made, arms))
    return made
