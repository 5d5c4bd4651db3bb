"""ESCHER's description: agreement with the public models.

``test_robots.py`` has the properties of every robot.
"""

import math
from typing import Literal

import numpy as np
import pytest
from msgspec import structs

from tests.unit.test_robots import ALL, configuration, forward
from tests.unit.test_robots import FULL as FULL_MODELS
from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.model import Model, controller_model, full_model

ROBOT = ALL["escher"]
FULL = FULL_MODELS["escher"]

PI = 3.142
# Left side: lower, upper, effort, speed, whether the right side's limits are mirrored; of the public models.
SIDED = {
    "hip_yaw": (-0.349, 0.785, 150, 12, True),
    "knee_pitch": (0, 2.356, 300, 12, False),
    "ankle_roll": (-0.524, 0.524, 150, 12, False),
    "shoulder_pitch": (-PI, 1.047, 60, 2.094, False),
    "shoulder_roll": (-0.524, PI, 60, 2.094, True),
    "elbow_pitch": (-0.524, 3.665, 60, 2.094, False),
    "wrist_pitch": (-1.571, 1.571, 60, 2.094, False),
    "index_yaw": (-1.571, 0.785, 4, 4.189, True),
    "thumb_roll": (-1.571, 1.571, 4, 4.189, False),
}
SEGMENTS = {
    ("pelvis",): 12.66, ("l_thigh",): 7.10, ("l_shin",): 4.89, ("l_foot",): 1.80, ("chest",): 15.97,
    ("neck_link", "head", "lidar"): 2.68,
}  # fmt: skip


@pytest.mark.parametrize("name", SIDED)
def test_limits_are_those_of_the_public_models(name: str) -> None:
    lower, upper, effort, speed, mirrored = SIDED[name]
    left, right = ROBOT.tables.joints[f"l_{name}"], ROBOT.tables.joints[f"r_{name}"]
    assert (left.lower, left.upper, left.effort, left.velocity) == (lower, upper, effort, speed)
    expected = (-upper, -lower) if mirrored else (lower, upper)
    assert (right.lower, right.upper, right.effort, right.velocity) == (*expected, effort, speed)


def test_masses_are_those_of_the_public_models() -> None:
    mj = FULL.mj
    for bodies, mass in SEGMENTS.items():
        assert sum(mj.body(body).mass[0] for body in bodies) == pytest.approx(mass, abs=1e-6), bodies
    arm = mj.body_subtreemass[FULL.body("l_shoulder_pitch_link")]
    assert arm == pytest.approx(8.34, abs=1e-6)
    assert mj.body_subtreemass[FULL.body("pelvis")] == pytest.approx(75.9, abs=1e-6)


def test_lengths_are_those_of_the_public_models() -> None:
    data = forward(FULL, FULL.mj.qpos0)
    at = {FULL.mj.body(i).name: data.xpos[i] for i in range(FULL.mj.nbody)}
    np.testing.assert_allclose(at["l_thigh"], (0, 0.1, 0.9), atol=1e-6)
    np.testing.assert_allclose(at["l_shin"], (0, 0.1, 0.49), atol=1e-6)
    np.testing.assert_allclose(at["l_foot"], (0, 0.1, 0.08), atol=1e-6)
    np.testing.assert_allclose(data.site("l_sole").xpos, (0, 0.1, 0), atol=1e-6)
    np.testing.assert_allclose(at["chest"], (-0.025, 0, 1.3455), atol=1e-6)
    np.testing.assert_allclose(at["l_shoulder_pitch_link"][1:], (0.1275, 1.4534), atol=1e-6)
    assert at["l_shoulder_roll_link"][1] - 0.1275 == pytest.approx(0.163)
    # The forearm points forward in the zero pose.
    np.testing.assert_allclose(at["l_elbow_link"] - at["l_shoulder_roll_link"], (0, 0, -0.3186), atol=1e-6)
    np.testing.assert_allclose(at["l_wrist_link"] - at["l_elbow_link"], (0.2071, 0, 0), atol=1e-6)
    np.testing.assert_allclose(at["l_hand"] - at["l_wrist_link"], (0.0741, 0, 0), atol=1e-6)
    assert at["l_index"][0] - at["l_hand"][0] == pytest.approx(0.2185)
    assert [at[name][2] for name in ("neck_link", "head", "lidar")] == pytest.approx([1.538, 1.5666, 1.6556])
    foot = ROBOT.tables.feet.left
    assert (foot.toe - foot.heel, 2 * foot.half_width) == pytest.approx((0.25, 0.1485))


@pytest.mark.parametrize("model", FULL_MODELS.values(), ids=FULL_MODELS.keys())
def test_signs_of_joints_are_those_of_the_public_models(model: Model) -> None:
    """A table of symmetric limits cannot show them."""
    zero = forward(model, model.mj.qpos0)
    straight = forward(model, configuration(model, l_elbow_pitch=math.pi / 2))
    hand, elbow = straight.body("l_hand").xpos, straight.body("l_elbow_link").xpos
    np.testing.assert_allclose((hand - elbow)[:2], 0, atol=1e-6)
    assert hand[2] < elbow[2]
    hand = zero.body("l_hand").xpos
    forward_up = forward(model, configuration(model, l_shoulder_pitch=-0.5)).body("l_elbow_link").xpos
    assert forward_up[0] > zero.body("l_elbow_link").xpos[0]
    assert forward(model, configuration(model, l_shoulder_roll=0.5)).body("l_hand").xpos[1] > hand[1]
    assert forward(model, configuration(model, l_hip_roll=0.5)).body("l_foot").xpos[1] > 0.1
    assert forward(model, configuration(model, l_hip_pitch=-0.5)).body("l_foot").xpos[0] > 0.1
    assert forward(model, configuration(model, l_knee_pitch=0.5)).body("l_foot").xpos[0] < -0.1
    assert forward(model, configuration(model, l_ankle_pitch=-0.5)).site("l_toe").xpos[2] > 0.01
    assert forward(model, configuration(model, neck_pitch=0.5)).site("gaze").xpos[2] < zero.site("gaze").xpos[2]


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_closes_towards_its_palm(side: Literal["left", "right"]) -> None:
    s = side[0]

    def fingers(preset: str) -> dict[str, FloatArray]:
        """Where the fingers are in the hand's frame, from the gripper site."""
        data = forward(FULL, configuration(FULL, **ROBOT.tables.hand_presets[preset][side]))
        hand = data.body(f"{s}_hand")
        site = data.site(f"{s}_gripper").xpos
        axes = hand.xmat.reshape(3, 3)
        return {name: axes.T @ (data.body(f"{s}_{name}").xipos - site) for name in ("index", "ring", "thumb")}

    opened, closed = fingers("open"), fingers("close")
    inward = -1.0 if side == "left" else 1.0  # of y: the palm faces the other hand
    for name in ("index", "ring"):
        assert inward * (closed[name][1] - opened[name][1]) > 0.03, name
    for name in ("index", "ring", "thumb"):
        assert np.linalg.norm(closed[name][:2]) < np.linalg.norm(opened[name][:2]), name


def test_welded_joints_stay_at_their_nominal_angles() -> None:
    turned = {"neck_yaw": 0.4, "neck_pitch": -0.3, "lidar_roll": 1.0, "l_thumb_roll": 0.7}
    posture = ROBOT.tables.nominal_posture | turned
    robot = RobotDescription(ROBOT.folder, structs.replace(ROBOT.tables, nominal_posture=posture))
    full, reduced = full_model(robot), controller_model(robot)
    one, other = forward(full, full.nominal_qpos()), forward(reduced, reduced.nominal_qpos())
    for body in ("lidar", "l_thumb", "head"):
        np.testing.assert_allclose(one.body(body).xipos, other.body(body).xipos, atol=1e-9)
        np.testing.assert_allclose(one.body(body).xmat, other.body(body).xmat, atol=1e-9)
