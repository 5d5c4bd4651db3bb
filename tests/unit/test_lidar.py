"""The simulated lidar: beams meet what is there, where the frame and the angles say."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.limbs import cut
from harness.motion_states import motor
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.lidar.history import History
from valor.lidar.scanner import ACCURACY, BEAMS, FIRST, KNOTS, PERIOD, STEP, Scanner
from valor.lidar.service import POINT, Sweep
from valor.robot.description import RobotDescription
from valor.simulation.plant import Plant, scene
from valor.valorctl.instance.instance_setup import Request, plan

ESCHER = RobotDescription.load(ROBOTS / "escher")
ANGLES = FIRST + STEP * np.arange(BEAMS)
WALLS = [(3.0, 0), (25.0, 1), (40.0, None), (0.05, None)]  # distance from the sensor [m], row of the noise
STAIRS = Scanner(ESCHER, "stairs", 0)
ROLL = ESCHER.index["lidar_roll"]


def standing(scan: Scanner, roll: float = 0.0) -> FloatArray:
    """Configurations of a robot that stands still with its lidar at an angle."""
    one = scan._model.nominal_qpos()
    one[scan.spindle] = roll
    return np.tile(one, (len(KNOTS), 1))


def origin(scan: Scanner) -> FloatArray:
    data = mujoco.MjData(scan._model.mj)
    data.qpos[:] = standing(scan)[0]
    mujoco.mj_kinematics(scan._model.mj, data)
    return np.asarray(data.body("lidar").xpos + scan.lidar.position)


@pytest.mark.parametrize(("distance", "row"), WALLS)
def test_a_wall_is_at_its_distance_with_the_noise_of_its_range(
    monkeypatch: pytest.MonkeyPatch, distance: float, row: int | None
) -> None:
    x, _, z = origin(Scanner(ESCHER, "flat", 0))

    def walled(*arguments: object) -> mujoco.MjSpec:
        spec = scene(*arguments)  # type: ignore[arg-type]
        box = mujoco.mjtGeom.mjGEOM_BOX
        spec.worldbody.add_geom(type=box, size=[0.01, 40.0, 0.5], pos=[x + distance + 0.01, 0.0, z])
        return spec

    monkeypatch.setattr("valor.lidar.scanner.scene", walled)
    scan = Scanner(ESCHER, "flat", 0)
    ahead = np.abs(ANGLES) < 0.2
    ranges = np.array([scan.scan(standing(scan)).ranges[ahead] for _ in range(20)])
    if row is None:
        assert (ranges == (math.inf if distance > 1.0 else -math.inf)).all()
    else:
        error, bound = ranges - distance / np.cos(ANGLES[ahead]), ACCURACY[row]
        assert np.abs(error).max() <= bound + 1e-9 and abs(error.mean()) < 0.05 * bound
        assert error.std() == pytest.approx(bound / 3.0, rel=0.1)


@pytest.mark.parametrize("side", [1, -1])
def test_positive_angles_are_left_and_the_spindle_turns_left_up(side: int) -> None:
    scan = Scanner(ESCHER, "flat", 0)
    ranges = scan.scan(standing(scan, side * math.pi / 2)).ranges
    found = np.isfinite(ranges)
    assert found.sum() > 100 and (np.sign(ANGLES[found]) == -side).all()
    height = origin(scan)[2] - scan.lidar.position[2]
    np.testing.assert_allclose(ranges[found] * np.abs(np.sin(ANGLES[found])), height, atol=ACCURACY[1])
    assert np.isnan(ranges[[0, -1]]).all()  # the head
    assert np.isposinf(ranges).sum() > 100 and not np.isneginf(ranges).any()  # the sky


def surfaces(scan: Scanner, points: FloatArray) -> FloatArray:
    """(k,) distances of points in world from the nearest surface of the world's plane and boxes [m]."""
    mj, data = scan._model.mj, scan._data
    found = []
    for geom in np.flatnonzero(~scan._own[:-1]):
        local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        if mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            found.append(np.abs(local[:, 2]))
        else:
            assert mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
            out = np.abs(local) - mj.geom_size[geom]
            found.append(np.abs(np.linalg.norm(np.maximum(out, 0.0), axis=1) + np.minimum(out.max(axis=1), 0.0)))
    nearest: FloatArray = np.min(found, axis=0)
    return nearest


@given(st.floats(-math.pi, math.pi), st.floats(-1.0, 1.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_points_lie_on_surfaces_of_the_world_while_the_robot_moves(
    roll: float, x: float, turn: float, arms: float
) -> None:
    scan = STAIRS
    moving, time = standing(scan, roll), 1e-9 * KNOTS
    moving[:, 0] = x + 0.5 * time
    moving[:, 3], moving[:, 6] = np.cos(0.5 * turn * (1 + time)), np.sin(0.5 * turn * (1 + time))
    moving[:, scan.spindle] += 12.0 * time
    for joint in ("l_shoulder_pitch", "r_shoulder_pitch"):
        moving[:, scan._model.mj.joint(joint).qposadr[0]] = 3 * arms - 1.5  # in front of the head, too
    made = scan.scan(moving)
    points, beams = made.points(moving[:, :7])
    assert len(points) == len(beams) == np.isfinite(made.ranges).sum()
    assert (surfaces(scan, points) <= ACCURACY[(made.ranges[beams] > 10.0).astype(int).max(initial=0)] + 0.003).all()


def test_between_two_configurations_angles_go_the_shorter_way() -> None:
    history = History()
    for time, quaternion, angle in ((10, 1.0, 3.1), (20, -1.0, -3.1)):
        history.add(time, np.array([0.1 * time, 0, 0, quaternion, 0, 0, 0, angle]))
    assert history.covers(10, 20) and not history.covers(9, 15)
    mixed = history.at(np.array([5, 15, 25]))
    assert mixed[:, 0] == pytest.approx([1.0, 1.5, 2.0]) and np.abs(mixed[:, 3]) == pytest.approx(1.0)
    assert np.cos(mixed[1, 7]) == pytest.approx(-1.0)
    history.add(PERIOD * 100, mixed[0])
    assert not history.covers(10, 20)


def test_a_cloud_is_half_a_turn_with_the_stamp_of_its_last_scan() -> None:
    sweep, clouds = Sweep(), []
    for i, roll in enumerate((2.9, 3.1, -3.1, -0.1, 0.1, 2.0, -3.0)):
        if sweep.turned(roll):
            clouds.append(sweep.cloud("odom"))
        sweep.add(i, np.full((2, 3), i), np.array([4, 9]))
    assert [(cloud.width, cloud.header.stamp.nanosec) for cloud in clouds] == [(4, 3), (4, 5)]
    found = np.frombuffer(bytes(clouds[0].data), POINT)
    assert found["index"].tolist() == [4, 9, 4, 9] and found["y"].tolist() == [2, 2, 3, 3]


@pytest.mark.parametrize("profile", ["ideal", "hardware"])
def test_the_spindle_of_the_simulation_turns_if_the_lidar_runs(profile: str) -> None:
    for spins, speed in ((True, 1.0), (False, 0.0)):
        plant = Plant(ESCHER, "flat", profile, 0, spins=spins)
        plant.actuators.obey(motor(ESCHER))
        plant.step(500)
        angles = [plant.joint_position[ROLL]]
        for _ in range(40):
            plant.step(100)
            angles.append(plant.joint_position[ROLL])
        assert np.unwrap(angles)[-1] - angles[0] == pytest.approx(4.0 * speed, abs=0.02)
        assert np.abs(angles).max() <= math.pi


def test_it_runs_where_it_is_asked_for_in_simulation_alone(tmp_path: Path) -> None:
    assert plan(Request()).settings.asked == ()
    assert plan(Request(sensors=("lidar",))).settings.asked == ("lidar",)
    for request, fault in (
        (Request(sensors=("lidar",), profile="hardware"), "--sensors lidar: profile hardware has no simulated world"),
        (Request(sensors=("radar",)), "--sensors 'radar': expected"),
        (Request(sensors=("lidar",), robot=str(cut(ESCHER, tmp_path, "neck").folder)), "escher has none"),
    ):
        with pytest.raises(ConfigurationError, match=fault):
            plan(request)
