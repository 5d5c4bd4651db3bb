"""THOR's description: what is published of it, and the signs of its joints."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.unit.test_robots import ALL, FULL, configuration, forward

ROBOT, MODEL = ALL["thor"], FULL["thor"]
LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee_pitch", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow_pitch", "wrist_roll", "wrist_yaw", "hand_roll")


def test_has_34_joints_with_roll_yaw_roll_wrists_and_grippers_of_two() -> None:
    expected = {f"{side}_{name}" for side in "lr" for name in (*LEG, *ARM, "f0_j0", "f1_j0")}
    expected |= {"waist_yaw", "neck_yaw", "neck_pitch", "lidar_roll"}
    assert set(ROBOT.joints) == expected
    assert len(ROBOT.joints) == 34
    axes = [MODEL.mj.jnt_axis[MODEL.mj.joint(f"l_{name}").id].tolist() for name in ARM[-3:]]
    assert axes == [[1, 0, 0], [0, 0, 1], [1, 0, 0]]


def test_weighs_65_kg_and_is_1_78_m_tall() -> None:
    assert MODEL.mj.body_subtreemass[MODEL.body("pelvis")] == pytest.approx(65.0, abs=1e-6)
    data = forward(MODEL, MODEL.mj.qpos0)
    head = [i for i in range(MODEL.mj.ngeom) if MODEL.mj.geom_bodyid[i] == MODEL.body("head")]
    top = max(data.geom_xpos[i][2] + MODEL.mj.geom_size[i][2] for i in head)
    assert top == pytest.approx(1.78, abs=0.02)


def test_legs_and_soles_have_the_published_lengths() -> None:
    data = forward(MODEL, MODEL.mj.qpos0)
    hip, knee, ankle = (data.body(name).xpos for name in ("l_thigh", "l_shin", "l_foot"))
    assert hip[1] == pytest.approx(0.094)
    assert hip[2] - knee[2] == pytest.approx(0.379)
    assert knee[2] - ankle[2] == pytest.approx(0.380)
    assert data.site("l_sole").xpos[2] == pytest.approx(0.0, abs=1e-9)
    foot = ROBOT.tables.feet.left
    assert (foot.toe - foot.heel, 2 * foot.half_width) == pytest.approx((0.230, 0.125))


def test_arms_are_dynamixels() -> None:
    """Positions are all that they take."""
    joints = ROBOT.tables.joints
    assert {joints[f"{side}_{name}"].control for side in "lr" for name in ARM} == {"position"}
    assert {joints[f"{side}_{name}"].control for side in "lr" for name in LEG} == {"force"}


def test_joints_turn_as_eschers_do() -> None:
    zero = forward(MODEL, MODEL.mj.qpos0)
    straight = forward(MODEL, configuration(MODEL, l_elbow_pitch=math.pi / 2))
    hand, elbow = straight.body("l_hand").xpos, straight.body("l_elbow_link").xpos
    np.testing.assert_allclose((hand - elbow)[:2], 0, atol=1e-6)
    assert hand[2] < elbow[2]
    assert (
        forward(MODEL, configuration(MODEL, l_shoulder_roll=0.5)).body("l_hand").xpos[1] > zero.body("l_hand").xpos[1]
    )
    assert forward(MODEL, configuration(MODEL, l_hip_roll=0.5)).body("l_foot").xpos[1] > 0.1
    assert forward(MODEL, configuration(MODEL, l_hip_pitch=-0.5)).body("l_foot").xpos[0] > 0.1
    assert forward(MODEL, configuration(MODEL, l_knee_pitch=0.5)).body("l_foot").xpos[0] < -0.1
    assert forward(MODEL, configuration(MODEL, l_ankle_pitch=-0.5)).site("l_toe").xpos[2] > 0.01


def test_fingers_meet_when_the_gripper_closes() -> None:
    def gap(angle: float) -> float:
        data = forward(MODEL, configuration(MODEL, l_f0_j0=angle, l_f1_j0=angle))
        return float(np.linalg.norm(data.body("l_finger_0").xipos - data.body("l_finger_1").xipos))

    upper = ROBOT.tables.joints["l_f0_j0"].upper
    assert upper == 2.685
    assert gap(0.0) > 0.1
    assert gap(1.745) < 0.08  # both straight ahead
    assert gap(0.0) > gap(0.6) > gap(1.2) > gap(1.7)
