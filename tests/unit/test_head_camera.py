"""The simulated stereo camera: what is seen is where frame, pinhole and depth say."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.limbs import cut
from harness.places import ROBOTS
from tests.unit.test_lidar import STAIRS, standing, surfaces
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.poses import Pose
from valor.common.processes import HEAD_CAMERA
from valor.drawing import Posture
from valor.head_camera import multisense as eye
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.simulation import worlds
from valor.valorctl.instance.instance_setup import Request, plan

ESCHER = RobotDescription.load(ROBOTS / "escher")
SEED = 3
CLEAR = 8  # around the lever there is none of its color [pixels]
TURNS = [(0.0, 0.0), (0.2, 0.1), (-0.25, -0.15)]  # of neck_yaw and neck_pitch [rad]


def camera_in_world(robot: RobotDescription, joints: FloatArray) -> Pose:
    """Pose of the camera in the world, of a robot that stands at its origin."""
    model = full_model(robot)
    qpos = model.nominal_qpos()
    qpos[model.qpos] = joints[model.joint_indices]
    data = mujoco.MjData(model.mj)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model.mj, data)
    camera = robot.tables.camera
    assert camera is not None
    body = data.body(camera.body)
    x, y, z = map(float, body.xpos)
    w, a, b, c = map(float, body.xquat)
    return Pose((x, y, z), (w, a, b, c)) @ eye.pose_in_body(camera)


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


def posture(robot: RobotDescription, joints: FloatArray) -> Posture:
    """Posture of a robot that stands at the world's origin."""
    place = np.array([0.0, 0.0, robot.tables.nominal_base_height])
    return Posture(0.0, "stand", place, np.array([1.0, 0.0, 0.0, 0.0]), joints)


@pytest.fixture(scope="module")
def door() -> eye.Multisense:
    return eye.Multisense(ESCHER, "door", SEED)


@pytest.mark.parametrize(("yaw", "pitch"), TURNS)
def test_a_lever_is_seen_where_it_is(door: eye.Multisense, yaw: float, pitch: float) -> None:
    joints = ESCHER.nominal_posture.copy()
    joints[ESCHER.index["neck_yaw"]], joints[ESCHER.index["neck_pitch"]] = yaw, pitch
    picture = door.look(posture(ESCHER, joints))
    image = picture.image.astype(int)
    assert image.shape == (eye.HEIGHT, eye.WIDTH, 3)
    seen = camera_in_world(ESCHER, joints).inverse() @ lever_in_world()
    column, row, depth = eye.intrinsics() @ seen.position
    assert depth > 0.5
    yellow = (image[:, :, 0] > 150) & (image[:, :, 2] < 90) & (image[:, :, 1] > 90)
    rows, columns = np.nonzero(yellow)
    assert rows.size > 20 and math.hypot(rows.mean() - row / depth, columns.mean() - column / depth) < CLEAR
    assert np.median(picture.depth()[yellow]) == pytest.approx(depth, abs=0.02)


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_it_looks_ahead_and_down_past_all_that_its_body_carries(name: str) -> None:
    robot = RobotDescription.load(ROBOTS / name)
    camera = robot.tables.camera
    assert camera is not None
    right, down, ahead = np.array(camera_in_world(robot, np.zeros(len(robot.joints))).rotation).T
    np.testing.assert_allclose(ahead, (math.cos(camera.pitch), 0.0, -math.sin(camera.pitch)), atol=1e-9)
    np.testing.assert_allclose(right, (0.0, -1.0, 0.0), atol=1e-9)
    assert down[2] < 0.0
    sensor = eye.Multisense(robot, "flat", 0)
    picture = sensor.look(posture(robot, robot.nominal_posture))
    # Grey ground across the lowest row, and none of the robot's colors.
    assert np.ptp(picture.image[-1].astype(int), axis=1).max() < 30
    assert np.nanmin(picture.depth()) > 1.0
    sensor.close()


def test_its_points_lie_on_the_stairs_with_their_colors() -> None:
    joints = ESCHER.nominal_posture
    sensor = eye.Multisense(ESCHER, "stairs", 0)
    points = sensor.look(posture(ESCHER, joints)).points()
    sensor.close()
    STAIRS.scan(standing(STAIRS))
    seen = np.column_stack([points["x"], points["y"], points["z"]]).astype(float)
    camera = camera_in_world(ESCHER, joints)
    found = seen @ np.array(camera.rotation).T + camera.position
    steps = eye.STEPS * eye.FOCAL_LENGTH * eye.BASELINE
    assert len(found) > 0.7 * eye.WIDTH * eye.HEIGHT and seen[:, 2].max() <= eye.FARTHEST
    reach = 0.5 * seen[:, 2] ** 2 / steps * np.linalg.norm(seen, axis=1) / seen[:, 2]  # of half a step along the ray
    assert (surfaces(STAIRS, found) <= reach + 0.004).all()
    for height in (0.0, 0.1, 0.2, 0.3):
        level = found[(np.abs(found[:, 2] - height) < 0.05) & (seen[:, 2] < 4.0), 2]
        assert level.size > 500 and np.percentile(np.abs(level - height), 95) < 0.015
    colors = points["rgb"].view("<u4")
    yellow = ((colors >> 16 & 255) > 150) & ((colors & 255) < 90)  # the edges
    assert yellow.sum() > 500 and (found[yellow, 2] > 0.05).all()


def test_what_is_not_matched_has_no_depth() -> None:
    true = np.array([[1000.0, 50.0, 42.0, 2.0, 0.34, 0.33, 0.02]], np.float32)
    picture = eye.Picture(np.zeros((1, true.size, 3), np.uint8), eye.matched(1.0 / true))
    depth = picture.depth()[0]
    assert np.isfinite(depth).tolist() == [False, False, True, True, True, False, False]
    assert depth[2:5] == pytest.approx(true[0, 2:5], rel=0.03) and depth[3] == pytest.approx(2.0, abs=0.003)
    assert picture.millimetres()[0].tolist() == [round(1000 * float(np.nan_to_num(z))) for z in depth]
    assert picture.depth().dtype.str == "<f4" and picture.millimetres().dtype.str == "<u2"


def test_it_runs_where_it_is_asked_for_in_simulation_alone(tmp_path: Path) -> None:
    assert HEAD_CAMERA not in plan(Request()).profile.processes
    assert plan(Request(sensors=("camera",))).settings.asked == (HEAD_CAMERA,)
    hardware = Request(sensors=("camera",), profile="hardware")
    headless = Request(sensors=("camera",), robot=str(cut(ESCHER, tmp_path, "neck").folder))
    for request, fault in ((hardware, "no simulated world"), (headless, "expected `camera` in")):
        with pytest.raises(ConfigurationError, match=f"--sensors camera: .*{fault}"):
            plan(request)
