"""ESCHER's description: what the public models say, what standing needs, and that no number stands twice."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from valor_common.errors import ConfigurationError
from valor_common.model import WHOLE_BODY_GROUPS, Model, controller_model, full_model
from valor_common.robot import RobotDescription

ESCHER = Path(__file__).resolve().parents[2] / "robots" / "escher"
ROBOT = RobotDescription.load(ESCHER)
FULL = full_model(ROBOT, "collision")
CONTROLLER = controller_model(ROBOT)

PI = 3.142
# Left side: lower, upper, effort, speed, whether the right side's limits are mirrored; of the public models.
SIDED = {
    "hip_yaw": (-0.349, 0.785, 150, 12, True),
    "hip_roll": (-0.524, 0.785, 150, 12, True),
    "hip_pitch": (-2.094, 0.524, 200, 12, False),
    "knee_pitch": (0, 2.356, 300, 12, False),
    "ankle_pitch": (-0.960, 0.611, 150, 12, False),
    "ankle_roll": (-0.524, 0.524, 150, 12, False),
    "shoulder_pitch": (-PI, 1.047, 60, 2.094, False),
    "shoulder_roll": (-0.524, PI, 60, 2.094, True),
    "shoulder_yaw": (-2.094, 2.094, 60, 2.094, False),
    "elbow_pitch": (-0.524, 3.665, 60, 2.094, False),
    "elbow_roll": (-2.094, 2.094, 60, 2.094, False),
    "wrist_pitch": (-1.571, 1.571, 60, 2.094, False),
    "wrist_yaw": (-1.571, 1.571, 60, 2.094, False),
    "index_yaw": (-1.571, 0.785, 4, 4.189, True),
    "ring_yaw": (-1.571, 0.785, 4, 4.189, True),
    "thumb_roll": (-1.571, 1.571, 4, 4.189, False),
    "thumb_pitch": (-0.785, 1.571, 4, 4.189, False),
}
# Turning about x or z is mirrored into turning the other way, about y into the same.
LATERAL = ("_yaw", "_roll")
SEGMENTS = {
    ("pelvis",): 12.66,
    ("l_thigh",): 7.10,
    ("l_shin",): 4.89,
    ("l_foot",): 1.80,
    ("chest",): 15.97,
    ("neck_link", "head", "lidar"): 2.68,
}
Vector = npt.NDArray[np.float64]


def configuration(model: Model, **joints: float) -> Vector:
    """The zero pose with some joints elsewhere."""
    qpos: Vector = model.mj.qpos0.copy()
    for name, angle in joints.items():
        qpos[model.mj.joint(name).qposadr[0]] = angle
    return qpos


def forward(model: Model, qpos: Vector) -> mujoco.MjData:
    """Everything that MuJoCo computes at a configuration."""
    data = mujoco.MjData(model.mj)
    data.qpos[:] = qpos
    mujoco.mj_forward(model.mj, data)
    return data


def touching(model: Model, data: mujoco.MjData) -> set[tuple[str, ...]]:
    """Pairs of bodies in contact."""
    mj = model.mj
    return {tuple(sorted(mj.body(mj.geom_bodyid[geom]).name for geom in contact.geom)) for contact in data.contact}


def with_preset(name: str, *sides: str) -> Vector:
    """The nominal posture with one or both arms at a preset."""
    qpos = FULL.nominal_qpos()
    for side in sides:
        for joint, angle in ROBOT.tables.arm_presets[name][side].items():  # type: ignore[index]
            qpos[FULL.mj.joint(joint).qposadr[0]] = angle
    return qpos


def test_has_the_38_joints_of_the_public_models() -> None:
    expected = {f"{side}_{name}" for side, name in itertools.product("lr", SIDED)}
    expected |= {"waist_yaw", "neck_yaw", "neck_pitch", "lidar_roll"}
    assert set(ROBOT.joints) == expected
    assert len(ROBOT.joints) == 38
    assert sorted(itertools.chain(*ROBOT.tables.groups.values())) == sorted(expected)


@pytest.mark.parametrize("name", SIDED)
def test_limits_are_those_of_the_public_models(name: str) -> None:
    lower, upper, effort, speed, mirrored = SIDED[name]
    left, right = ROBOT.tables.joints[f"l_{name}"], ROBOT.tables.joints[f"r_{name}"]
    assert (left.lower, left.upper, left.effort, left.velocity) == (lower, upper, effort, speed)
    expected = (-upper, -lower) if mirrored else (lower, upper)
    assert (right.lower, right.upper, right.effort, right.velocity) == (*expected, effort, speed)


@pytest.mark.parametrize("name", SIDED)
def test_both_sides_have_the_same_drives(name: str) -> None:
    left, right = ROBOT.tables.joints[f"l_{name}"], ROBOT.tables.joints[f"r_{name}"]
    assert (left.servo, left.armature, left.damping, left.control) == (
        right.servo, right.armature, right.damping, right.control,
    )  # fmt: skip


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


def test_joints_turn_as_the_public_models_do() -> None:
    """Signs that a table of symmetric limits cannot show."""
    zero = forward(FULL, FULL.mj.qpos0)
    straight = forward(FULL, configuration(FULL, l_elbow_pitch=math.pi / 2))
    hand, elbow = straight.body("l_hand").xpos, straight.body("l_elbow_link").xpos
    np.testing.assert_allclose((hand - elbow)[:2], 0, atol=1e-6)
    assert hand[2] < elbow[2]
    hand = zero.body("l_hand").xpos
    forward_up = forward(FULL, configuration(FULL, l_shoulder_pitch=-0.5)).body("l_elbow_link").xpos
    assert forward_up[0] > zero.body("l_elbow_link").xpos[0]
    assert forward(FULL, configuration(FULL, l_shoulder_roll=0.5)).body("l_hand").xpos[1] > hand[1]
    assert forward(FULL, configuration(FULL, l_hip_roll=0.5)).body("l_foot").xpos[1] > 0.1
    assert forward(FULL, configuration(FULL, l_hip_pitch=-0.5)).body("l_foot").xpos[0] > 0.1
    assert forward(FULL, configuration(FULL, l_knee_pitch=0.5)).body("l_foot").xpos[0] < -0.1
    assert forward(FULL, configuration(FULL, l_ankle_pitch=-0.5)).site("l_toe").xpos[2] > 0.01
    assert forward(FULL, configuration(FULL, neck_pitch=0.5)).site("gaze").xpos[2] < zero.site("gaze").xpos[2]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_left_and_right_are_mirror_images(seed: int) -> None:
    """A posture and its mirror image put every body, and the CoM, at mirrored places: geometry, masses, axes agree."""
    rng = np.random.default_rng(seed)
    angles = {name: rng.uniform(-1, 1) for name in ROBOT.joints}
    mirrored = {
        {"l_": "r_", "r_": "l_"}.get(name[:2], name[:2]) + name[2:]: -angle if name.endswith(LATERAL) else angle
        for name, angle in angles.items()
    }
    one, other = forward(FULL, configuration(FULL, **angles)), forward(FULL, configuration(FULL, **mirrored))
    flip = np.array([1, -1, 1])
    for i in range(1, FULL.mj.nbody):
        name = FULL.mj.body(i).name
        twin = FULL.body({"l_": "r_", "r_": "l_"}.get(name[:2], name[:2]) + name[2:])
        np.testing.assert_allclose(one.xipos[i], other.xipos[twin] * flip, atol=1e-9, err_msg=name)
        assert FULL.mj.body_mass[i] == FULL.mj.body_mass[twin]
        np.testing.assert_array_equal(FULL.mj.body_inertia[i], FULL.mj.body_inertia[twin])


def test_inertias_are_those_of_solid_bodies() -> None:
    """Radii of gyration between 1 cm and 15 cm, and the triangle inequality, for every body."""
    for i in range(1, FULL.mj.nbody):
        inertia, mass = np.sort(FULL.mj.body_inertia[i]), FULL.mj.body_mass[i]
        assert inertia[0] > 0
        assert inertia[0] + inertia[1] >= inertia[2] * (1 - 1e-6)
        assert 0.005 <= math.sqrt(inertia[2] / mass) <= 0.15, FULL.mj.body(i).name


@pytest.mark.parametrize("model", [FULL, CONTROLLER], ids=["full", "controller"])
def test_nominal_posture_has_the_com_over_the_middle_of_flat_soles(model: Model) -> None:
    data = forward(model, model.nominal_qpos())
    feet = ROBOT.tables.feet
    centers = []
    for foot in (feet.left, feet.right):
        sole = data.site(foot.sole)
        assert abs(sole.xpos[2]) < 1e-3
        np.testing.assert_allclose(sole.xmat.reshape(3, 3)[:, 2], (0, 0, 1), atol=1e-3)
        centers.append(sole.xpos + sole.xmat.reshape(3, 3) @ ((foot.heel + foot.toe) / 2, 0, 0))
    com = data.subtree_com[model.body(ROBOT.tables.base)]
    assert np.linalg.norm(com[:2] - np.mean(centers, axis=0)[:2]) < 0.005
    assert 0.85 < com[2] < 0.87


def test_nominal_posture_is_within_limits_with_room_to_move() -> None:
    moving = np.isfinite(ROBOT.lower)
    nominal = ROBOT.nominal_posture[moving]
    assert (nominal - ROBOT.lower[moving] > 0.05).all()
    assert (ROBOT.upper[moving] - nominal > 0.05).all()


def test_ankles_hold_the_robot_up_without_control() -> None:
    ankles = sum(ROBOT.tables.joints[name].servo.stiffness for name in ("l_ankle_pitch", "r_ankle_pitch"))
    assert ankles > 1.5 * 75.9 * 9.81 * 0.86


def test_nothing_touches_in_the_zero_and_nominal_postures() -> None:
    for qpos in (FULL.mj.qpos0, FULL.nominal_qpos()):
        assert touching(FULL, forward(FULL, qpos)) == set()


@pytest.mark.parametrize("preset", ROBOT.tables.arm_presets)
@pytest.mark.parametrize("sides", [("left",), ("right",), ("left", "right")], ids="+".join)
def test_arm_presets_touch_nothing(preset: str, sides: tuple[str, ...]) -> None:
    assert touching(FULL, forward(FULL, with_preset(preset, *sides))) == set()


@pytest.mark.parametrize("limb", ["arm", "hand"])
def test_presets_are_complete_within_limits_and_mirrored(limb: str) -> None:
    presets = {"arm": ROBOT.tables.arm_presets, "hand": ROBOT.tables.hand_presets}[limb]
    assert {"arm": {"home", "forward", "side", "up", "fold"}, "hand": {"open", "close"}}[limb] <= set(presets)
    for preset, sides in presets.items():
        assert set(sides) == {"left", "right"}
        for side, posture in sides.items():
            assert list(posture) == ROBOT.tables.groups[f"{side}_{limb}"]
            for name, angle in posture.items():
                joint = ROBOT.tables.joints[name]
                assert joint.lower is not None
                assert joint.upper is not None
                assert joint.lower <= angle <= joint.upper, (preset, name)
        for name, angle in sides["left"].items():
            mirrored = -angle if name.endswith(LATERAL) else angle
            assert sides["right"]["r_" + name[2:]] == mirrored


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_closes_towards_its_palm(side: Literal["left", "right"]) -> None:
    s = side[0]

    def fingers(preset: str) -> dict[str, Vector]:
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


def test_the_arm_cannot_pass_through_the_chest() -> None:
    qpos = configuration(FULL, l_shoulder_yaw=-1.5, l_elbow_pitch=0.3, l_shoulder_roll=-0.5)
    assert ("chest", "l_forearm") in touching(FULL, forward(FULL, qpos))


@pytest.mark.parametrize("model", [FULL, CONTROLLER], ids=["full", "controller"])
def test_models_carry_the_numbers_of_robot_yaml(model: Model) -> None:
    mj = model.mj
    for name in model.joints:
        joint, table = mj.joint(name), ROBOT.tables.joints[name]
        dof = joint.dofadr[0]
        assert mj.dof_armature[dof] == table.armature
        assert mj.dof_damping[dof] == table.damping
        assert bool(joint.limited[0]) == (table.lower is not None)
        if table.lower is not None:
            np.testing.assert_allclose(joint.range, (table.lower, table.upper))
    assert mj.opt.timestep == ROBOT.tables.physics_step


@pytest.mark.parametrize("model", [FULL, CONTROLLER], ids=["full", "controller"])
def test_addresses_lead_to_the_joints(model: Model) -> None:
    for place, name in enumerate(model.joints):
        joint = model.mj.joint(name)
        assert np.arange(model.mj.nq)[model.qpos][place] == joint.qposadr[0]
        assert np.arange(model.mj.nv)[model.dof][place] == joint.dofadr[0]
        assert np.array(ROBOT.joints)[model.joint_indices][place] == name


def test_controller_model_moves_the_whole_body_joints_only() -> None:
    expected = [name for group in WHOLE_BODY_GROUPS for name in ROBOT.tables.groups[group]]
    assert sorted(CONTROLLER.joints) == sorted(expected)
    assert CONTROLLER.mj.nv == 6 + 27
    assert isinstance(CONTROLLER.dof, slice)  # views, not copies, in the control loop
    assert isinstance(CONTROLLER.joint_indices, slice)


def test_controller_model_weighs_what_the_full_one_does() -> None:
    """With the welded joints at nominal, the mass matrix is the full one's without their rows."""
    full, reduced = forward(FULL, FULL.nominal_qpos()), forward(CONTROLLER, CONTROLLER.nominal_qpos())
    M, m = np.zeros((FULL.mj.nv,) * 2), np.zeros((CONTROLLER.mj.nv,) * 2)
    mujoco.mj_fullM(FULL.mj, full, M)
    mujoco.mj_fullM(CONTROLLER.mj, reduced, m)
    rows = [*range(6), *(FULL.mj.joint(name).dofadr[0] for name in CONTROLLER.joints)]
    np.testing.assert_allclose(M[np.ix_(rows, rows)], m, atol=1e-9)


def variant(folder: Path, change: Callable[[dict[str, object], str], str]) -> RobotDescription:
    """A copy of ESCHER's folder; ``change(tables, xml)`` alters the tables in place and returns the model."""
    tables = yaml.safe_load((ESCHER / "robot.yaml").read_text())
    (folder / "model.xml").write_text(change(tables, (ESCHER / "model.xml").read_text()))
    (folder / "robot.yaml").write_text(yaml.safe_dump(tables, sort_keys=False))
    return RobotDescription.load(folder)


def test_welded_joints_stay_at_their_nominal_angles(tmp_path: Path) -> None:
    def turn_head(tables: dict[str, object], xml: str) -> str:
        tables["nominal_posture"] |= {"neck_yaw": 0.4, "neck_pitch": -0.3, "lidar_roll": 1.0, "l_thumb_roll": 0.7}
        return xml

    robot = variant(tmp_path, turn_head)
    full, reduced = full_model(robot), controller_model(robot)
    one, other = forward(full, full.nominal_qpos()), forward(reduced, reduced.nominal_qpos())
    for body in ("lidar", "l_thumb", "head"):
        np.testing.assert_allclose(one.body(body).xipos, other.body(body).xipos, atol=1e-9)
        np.testing.assert_allclose(one.body(body).xmat, other.body(body).xmat, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, x: x.replace('name="l_knee_pitch"', 'name="l_knee"'), r"joints: .*'l_knee', 'l_knee_pitch'"),
        (lambda t, x: x.replace("<freejoint", "<!-- <freejoint").replace('base"/>', 'base"/> -->'), "one free joint"),
        (lambda t, x: x.replace('angle="radian"', 'angle="degree"'), "expected radian"),
        (lambda t, x: x[:-30], "model.xml"),
        (lambda t, x: x.replace('site name="l_sole"', 'site name="sole"'), "no site 'l_sole'.*feet.left.sole"),
        (lambda t, x: t["link_frames"].update(gaze="eye") or x, "no body or site 'eye'.*link_frames.gaze"),
        (lambda t, x: t.update(chest="torso") or x, "no body 'torso'.*chest"),
    ],
)  # fmt: skip
def test_a_model_that_does_not_fit_its_tables_is_refused_in_one_line(
    tmp_path: Path, change: Callable[[dict[str, object], str], str], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message) as error:
        full_model(variant(tmp_path, change))
    assert "\n" not in str(error.value)
