"""The simulated camera: what is seen is where the camera's frame and the pinhole's numbers say."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.limbs import cut
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.poses import Pose
from valor.common.processes import HEAD_CAMERA
from valor.drawing import Posture
from valor.drawing.scene import Scene
from valor.head_camera import service as eye
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.simulation import worlds
from valor.valorctl.instance.instance_setup import Request, plan

ESCHER = RobotDescription.load(ROBOTS / "escher")
SEED = 3
CLEAR = 6  # around the lever there is none of its color [pixels]
TURNS = [(0.0, 0.0), (0.2, 0.1), (-0.25, -0.15)]  # of neck_yaw and neck_pitch [rad]


def camera_in_world(robot: RobotDescription, joints: FloatArray) -> Pose:
    """Of a robot that stands at the world's origin."""
    model = full_model(robot)
    qpos = model.nominal_qpos()
    qpos[model.qpos] = joints[model.joint_indices]
    data = mujoco.MjData(model.mj)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model.mj, data)
    body = data.body(eye.body_of(robot))
    x, y, z = map(float, body.xpos)
    w, a, b, c = map(float, body.xquat)
    return Pose((x, y, z), (w, a, b, c)) @ eye.pose_in_body(robot)


def lever_in_world() -> Pose:
    """The middle of the bar that a hand presses."""
    model = worlds.load("door", SEED, worlds.size_of(ESCHER)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lever = model.body("lever").id
    bar = next(
        geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == lever and model.geom_size[geom, 1] > 0.02
    )
    x, y, z = map(float, data.geom_xpos[bar])
    return Pose((x, y, z))


@pytest.fixture(scope="module")
def door() -> Scene:
    return eye.view(ESCHER, "door", SEED)


@pytest.mark.parametrize(("yaw", "pitch"), TURNS)
def test_a_lever_is_seen_where_it_is(door: Scene, yaw: float, pitch: float) -> None:
    joints = ESCHER.nominal_posture.copy()
    joints[ESCHER.index["neck_yaw"]], joints[ESCHER.index["neck_pitch"]] = yaw, pitch
    standing = np.array([0.0, 0.0, ESCHER.tables.nominal_base_height])
    image = door.draw(Posture(0.0, "stand", standing, np.array([1.0, 0.0, 0.0, 0.0]), joints)).astype(int)
    assert image.shape == (eye.HEIGHT, eye.WIDTH, 3)
    seen = camera_in_world(ESCHER, joints).inverse() @ lever_in_world()
    column, row, depth = eye.intrinsics() @ seen.position
    assert depth > 0.5
    yellow = (image[:, :, 0] > 150) & (image[:, :, 2] < 90) & (image[:, :, 1] > 90)
    rows, columns = np.nonzero(yellow)
    assert rows.size > 20 and math.hypot(rows.mean() - row / depth, columns.mean() - column / depth) < CLEAR


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_it_looks_ahead_and_down_past_all_that_its_body_carries(name: str) -> None:
    robot = RobotDescription.load(ROBOTS / name)
    camera = camera_in_world(robot, np.zeros(len(robot.joints)))
    right, down, ahead = np.array(camera.rotation).T
    np.testing.assert_allclose(ahead, (math.cos(eye.DOWN), 0.0, -math.sin(eye.DOWN)), atol=1e-9)
    np.testing.assert_allclose(right, (0.0, -1.0, 0.0), atol=1e-9)
    assert down[2] < 0.0
    seeing = eye.view(robot, "flat", 0)
    standing = np.array([0.0, 0.0, robot.tables.nominal_base_height])
    image = seeing.draw(Posture(0.0, "stand", standing, np.array([1.0, 0.0, 0.0, 0.0]), robot.nominal_posture))
    seeing.close()
    # Grey ground across the lowest row, and none of the robot's colors.
    assert np.ptp(image[-1].astype(int), axis=1).max() < 30


def test_without_a_head_the_chest_carries_it(tmp_path: Path) -> None:
    robot = cut(ESCHER, tmp_path, "neck")
    assert eye.body_of(robot) == robot.tables.chest
    camera = camera_in_world(robot, robot.nominal_posture)
    chest = camera_in_world(ESCHER, ESCHER.nominal_posture)
    assert 0.0 < camera.position[2] < chest.position[2] and camera.position[0] > 0.05


def test_it_runs_where_it_is_asked_for_in_simulation_alone() -> None:
    assert HEAD_CAMERA not in plan(Request()).profile.processes
    assert plan(Request(camera=True)).settings.asked == (HEAD_CAMERA,)
    with pytest.raises(ConfigurationError, match="--camera: profile hardware has no simulated world"):
        plan(Request(profile="hardware", camera=True))
