"""Forward kinematics of the hands against the simulator's, and the errors of thesis 5.4 where they are known."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness import analysis_bag
from harness.places import ROBOTS
from thesis.analysis.end_effector import Hand, HandTrack, PoseError, Poses
from thesis.analysis.timeline import Motion, Timeline
from thesis.errors import ResultError
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

ROBOT = RobotDescription.load(ROBOTS / "escher")
ARM = ROBOT.tables.groups["right_arm"]
NOMINAL = {joint: float(ROBOT.nominal_posture[ROBOT.index[joint]]) for joint in ARM}
REACH = NOMINAL | {joint: goal for joint, goal in analysis_bag.GOALS.items() if joint in ARM}


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> HandTrack:
    path = tmp_path_factory.mktemp("bag") / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    timeline = Timeline([Motion("reach", 1.0, 3.5, REACH), Motion("back", 3.5, 4.9, NOMINAL)])
    file = path.with_suffix(".json")
    timeline.save(file)
    assert Timeline.load(file) == timeline
    return HandTrack.of(Recording(Bag(path), ROBOT), timeline, "right")


def postures(count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    joints = ROBOT.nominal_posture + 0.3 * rng.standard_normal((count, len(ROBOT.joints)))
    turn = rng.standard_normal((count, 4))
    return joints, rng.standard_normal((count, 3)), turn / np.linalg.norm(turn, axis=1, keepdims=True)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_is_where_the_simulator_has_it(side: str) -> None:
    joints, position, orientation = postures(5)
    chest, hand = Hand(ROBOT, side).in_odom(joints, position, orientation)  # type: ignore[arg-type]
    model = full_model(ROBOT)
    data = mujoco.MjData(model.mj)
    site = getattr(ROBOT.tables.hands, side).site
    for i in range(5):
        data.qpos[:3], data.qpos[3:7] = position[i], orientation[i]
        data.qpos[model.qpos] = joints[i, model.joint_indices]
        mujoco.mj_forward(model.mj, data)
        np.testing.assert_allclose(hand.position[i], data.site(site).xpos, atol=1e-12)
        np.testing.assert_allclose(hand.rotation[i].ravel(), data.site(site).xmat, atol=1e-12)
        np.testing.assert_allclose(chest.position[i], data.body(ROBOT.tables.chest).xpos, atol=1e-12)


def test_on_a_fixed_base_the_legs_do_not_matter() -> None:
    joints, position, orientation = postures(4)
    moved = joints.copy()
    legs = [ROBOT.index[joint] for group in ("left_leg", "right_leg", "torso") for joint in ROBOT.tables.groups[group]]
    moved[:, legs] += 0.4
    hand = Hand(ROBOT, "right")
    np.testing.assert_allclose(hand.in_chest(moved).position, hand.in_chest(joints).position, atol=1e-12)
    chest, floating = hand.in_odom(joints, position, orientation)
    np.testing.assert_allclose(hand.in_chest(joints).inside(chest).rotation, floating.rotation, atol=1e-12)


def test_a_rotation_error_is_given_by_its_angles() -> None:
    still = np.eye(3)[None]
    c, s = np.cos(0.3), np.sin(0.3)
    yawed = np.array([[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]])
    error = PoseError.of(Poses(np.array([[3.0, 4.0, 0.0]]), yawed), Poses(np.zeros((1, 3)), still))
    np.testing.assert_allclose(error.orientation, [[0.0, 0.0, 0.3]], atol=1e-12)
    assert error.distance.tolist() == [5.0]


def test_with_a_base_that_stays_the_hand_arrives(track: HandTrack) -> None:
    """The robot of the bag hangs by its pelvis: nothing floats."""
    reach = track.motions[0]
    rest = track.settled(reach)
    assert rest.sum() == pytest.approx(30, abs=2)
    np.testing.assert_allclose(track.base_error.position, 0.0, atol=1e-3)  # the waist gives a little
    assert track.command_error.distance[0] > 0.3  # the goal is far away at first
    assert track.command_error.distance[rest].max() < 1e-6
    assert 1e-3 < track.tracking_error.distance.max() < 0.1  # on the way it lags behind
    assert track.tracking_error.distance[rest].max() < 0.02
    parts = track.base_error.position + track.tracking_error.position + track.command_error.position
    np.testing.assert_allclose(track.total_error.position, parts, atol=1e-12)
    assert set(track.behavior) <= {"stand", "stand_manipulate"}


def test_an_arm_that_nothing_moved_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    with pytest.raises(BagError, match="no motion moved the left arm"):
        HandTrack.of(Recording(Bag(path), ROBOT), Timeline([Motion("reach", 1.0, 2.0, REACH)]), "left")
    path.with_suffix(".json").write_text('{"motions": [{"name": 3}]}')
    with pytest.raises(ResultError, match=r"Expected `str`, got `int`"):
        Timeline.load(path.with_suffix(".json"))


SWAY = np.array((0.06, -0.04, 0.03))  # of the pelvis, from its place before the arm moved [m]


def swaying(time: float) -> tuple[FloatArray, float]:
    """The pelvis gives way while the arm is out, and turns."""
    share = float(np.interp(time, (1.0, 2.5, 3.5, 4.9), (0.0, 1.0, 1.0, 0.0)))
    return share * SWAY, 0.2 * share
