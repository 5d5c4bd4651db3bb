"""What holds for every robot of ``robots/``: mirror symmetry, standing, what may touch, no number that stands twice."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.robot.checks import Stance
from valor.robot.description import RobotDescription
from valor.robot.model import Model, controller_model, full_model
from valor.robot.symmetry import asymmetries
from valor.robot.tables import WHOLE_BODY_GROUPS

ALL = {file.parent.name: RobotDescription.load(file.parent) for file in sorted(ROBOTS.glob("*/robot.yaml"))}
FULL = {name: full_model(robot, "collision") for name, robot in ALL.items()}
CONTROLLER = {name: controller_model(robot) for name, robot in ALL.items()}
MODELS = [*FULL.values(), *CONTROLLER.values()]
IDS = [*(f"{name}-full" for name in FULL), *(f"{name}-controller" for name in CONTROLLER)]

every_model = pytest.mark.parametrize("model", MODELS, ids=IDS)
every_full_model = pytest.mark.parametrize("model", FULL.values(), ids=FULL.keys())
every_robot = pytest.mark.parametrize("robot", ALL.values(), ids=ALL.keys())

# Turning about x or z is mirrored into turning the other way, about y into the same.
LATERAL = ("_yaw", "_roll")


def configuration(model: Model, **joints: float) -> FloatArray:
    """The zero pose with some joints elsewhere."""
    qpos: FloatArray = model.mj.qpos0.copy()
    for name, angle in joints.items():
        qpos[model.mj.joint(name).qposadr[0]] = angle
    return qpos


def forward(model: Model, qpos: FloatArray) -> mujoco.MjData:
    """Everything that MuJoCo computes at a configuration."""
    data = mujoco.MjData(model.mj)
    data.qpos[:] = qpos
    mujoco.mj_forward(model.mj, data)
    return data


def touching(model: Model, data: mujoco.MjData) -> set[tuple[str, ...]]:
    """Pairs of bodies in contact."""
    mj = model.mj
    return {tuple(sorted(mj.body(mj.geom_bodyid[geom]).name for geom in contact.geom)) for contact in data.contact}


def with_preset(model: Model, name: str, *sides: str) -> FloatArray:
    """The nominal posture with one or both arms at a preset."""
    qpos = model.nominal_qpos()
    for side in sides:
        for joint, angle in model.robot.tables.arm_presets[name][side].items():  # type: ignore[index]
            qpos[model.mj.joint(joint).qposadr[0]] = angle
    return qpos


def other_side(name: str) -> str:
    """The joint's or body's twin; itself, if it is in the middle."""
    return {"l_": "r_", "r_": "l_"}.get(name[:2], name[:2]) + name[2:]


@every_robot
def test_every_joint_is_in_one_group(robot: RobotDescription) -> None:
    grouped = [joint for joints in robot.tables.groups.values() for joint in joints]
    assert sorted(grouped) == sorted(robot.joints)


@every_robot
def test_both_sides_have_the_same_drives_and_mirrored_limits(robot: RobotDescription) -> None:
    joints = robot.tables.joints
    for name, joint in joints.items():
        twin = joints[other_side(name)]
        for field in ("servo", "armature", "damping", "control", "effort", "velocity"):
            assert getattr(joint, field) == getattr(twin, field), (name, field)
        if joint.lower is not None and joint.upper is not None:
            expected = (-joint.upper, -joint.lower) if name.endswith(LATERAL) else (joint.lower, joint.upper)
            assert (twin.lower, twin.upper) in (expected, (joint.lower, joint.upper)), name


@every_robot
def test_left_and_right_are_mirror_images(robot: RobotDescription) -> None:
    """In mirrored postures every joint, and what hangs from it, is at a mirrored place: geometry, masses, axes agree.

    As well as `valorctl robot check` tells no difference: half a percent of the leg, one of the mass.
    """
    assert list(asymmetries(Stance(robot))) == []


@every_full_model
def test_inertias_are_those_of_solid_bodies(model: Model) -> None:
    """Radii of gyration between 5 mm and 15 cm, and the triangle inequality, for every body."""
    for i in range(1, model.mj.nbody):
        inertia, mass = np.sort(model.mj.body_inertia[i]), model.mj.body_mass[i]
        assert inertia[0] > 0
        assert inertia[0] + inertia[1] >= inertia[2] * (1 - 1e-4), model.mj.body(i).name  # five digits in the file
        assert 0.005 <= math.sqrt(inertia[2] / mass) <= 0.15, model.mj.body(i).name


@every_model
def test_nominal_posture_has_the_com_over_the_middle_of_flat_soles(model: Model) -> None:
    data = forward(model, model.nominal_qpos())
    feet = model.robot.tables.feet
    centers = []
    for foot in (feet.left, feet.right):
        sole = data.site(foot.sole)
        assert abs(sole.xpos[2]) < 1e-3
        np.testing.assert_allclose(sole.xmat.reshape(3, 3)[:, 2], (0, 0, 1), atol=1e-3)
        centers.append(sole.xpos + sole.xmat.reshape(3, 3) @ ((foot.heel + foot.toe) / 2, 0, 0))
    com = data.subtree_com[model.body(model.robot.tables.base)]
    assert np.linalg.norm(com[:2] - np.mean(centers, axis=0)[:2]) < 0.005


@every_model
def test_walking_knows_how_long_the_legs_are(model: Model) -> None:
    """``hip_height`` is that of the nominal posture; ``leg_reach`` leaves the knee bent."""
    table, data = model.robot.tables.walking, forward(model, model.nominal_qpos())
    hip, knee, ankle = (data.body(name).xpos for name in ("l_thigh", "l_shin", "l_foot"))
    assert table.hip_height == pytest.approx(hip[2] - ankle[2], abs=0.01)
    straight = np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle)
    assert table.hip_height < table.leg_reach < 0.95 * straight


@every_robot
def test_nominal_posture_is_within_limits_with_room_to_move(robot: RobotDescription) -> None:
    moving = np.isfinite(robot.lower)
    hands = [joint for side in ("left", "right") for joint in robot.tables.groups[f"{side}_hand"]]
    moving[[robot.index[joint] for joint in hands]] = False
    nominal = robot.nominal_posture[moving]
    assert (nominal - robot.lower[moving] > 0.05).all()
    assert (robot.upper[moving] - nominal > 0.05).all()
    finite = np.isfinite(robot.lower)
    assert (robot.nominal_posture[finite] >= robot.lower[finite]).all()
    assert (robot.nominal_posture[finite] <= robot.upper[finite]).all()


@every_full_model
def test_ankles_hold_the_robot_up_without_control(model: Model) -> None:
    robot = model.robot
    base = model.body(robot.tables.base)
    height = forward(model, model.nominal_qpos()).subtree_com[base][2]
    ankles = sum(robot.tables.joints[name].servo.stiffness for name in ("l_ankle_pitch", "r_ankle_pitch"))
    assert ankles > 1.5 * model.mj.body_subtreemass[base] * 9.81 * height


@every_robot
def test_servos_are_damped_enough_for_the_torque_lag(robot: RobotDescription) -> None:
    lag = robot.tables.actuators["hardware"].torque_lag
    assert (robot.servo_damping > lag * robot.servo_stiffness).all()


@every_full_model
def test_nothing_touches_in_the_zero_and_nominal_postures(model: Model) -> None:
    for qpos in (model.mj.qpos0, model.nominal_qpos()):
        assert touching(model, forward(model, qpos)) == set()


@pytest.mark.parametrize("sides", [("left",), ("right",), ("left", "right")], ids="+".join)
@every_full_model
def test_arm_presets_touch_nothing(model: Model, sides: tuple[str, ...]) -> None:
    for preset in model.robot.tables.arm_presets:
        assert touching(model, forward(model, with_preset(model, preset, *sides))) == set(), preset


@pytest.mark.parametrize("limb", ["arm", "hand"])
@every_robot
def test_presets_are_complete_within_limits_and_mirrored(robot: RobotDescription, limb: str) -> None:
    presets = getattr(robot.tables, f"{limb}_presets")
    assert {"arm": {"home", "forward", "side", "up", "fold"}, "hand": {"open", "close"}}[limb] <= set(presets)
    for preset, sides in presets.items():
        assert set(sides) == {"left", "right"}
        for side, posture in sides.items():
            assert list(posture) == robot.tables.groups[f"{side}_{limb}"]
            for name, angle in posture.items():
                joint = robot.tables.joints[name]
                assert joint.lower is not None
                assert joint.upper is not None
                assert joint.lower <= angle <= joint.upper, (preset, name)
        for name, angle in sides["left"].items():
            assert sides["right"][other_side(name)] == (-angle if name.endswith(LATERAL) else angle)


@every_full_model
def test_the_arm_cannot_pass_through_the_chest(model: Model) -> None:
    qpos = configuration(model, l_shoulder_yaw=-1.5, l_elbow_pitch=0.3, l_shoulder_roll=-0.5)
    assert {("chest", "l_forearm"), ("chest", "l_hand")} & touching(model, forward(model, qpos))


@every_model
def test_models_carry_the_numbers_of_robot_yaml(model: Model) -> None:
    mj, tables = model.mj, model.robot.tables
    for name in model.joints:
        joint, table = mj.joint(name), tables.joints[name]
        dof = joint.dofadr[0]
        assert mj.dof_armature[dof] == table.armature
        assert mj.dof_damping[dof] == table.damping
        assert bool(joint.limited[0]) == (table.lower is not None)
        if table.lower is not None and table.upper is not None:
            np.testing.assert_allclose(joint.range, (table.lower, table.upper))
    assert mj.opt.timestep == tables.physics_step


@every_model
def test_addresses_lead_to_the_joints(model: Model) -> None:
    for place, name in enumerate(model.joints):
        joint = model.mj.joint(name)
        assert np.arange(model.mj.nq)[model.qpos][place] == joint.qposadr[0]
        assert np.arange(model.mj.nv)[model.dof][place] == joint.dofadr[0]
        assert np.array(model.robot.joints)[model.joint_indices][place] == name


@pytest.mark.parametrize("name", ALL)
def test_controller_model_moves_the_whole_body_joints_only(name: str) -> None:
    robot, model = ALL[name], CONTROLLER[name]
    expected = [joint for group in WHOLE_BODY_GROUPS for joint in robot.tables.groups[group]]
    assert sorted(model.joints) == sorted(expected)
    assert model.mj.nv == 6 + 27
    assert isinstance(model.dof, slice)  # views, not copies, in the control loop
    assert isinstance(model.joint_indices, slice)


@pytest.mark.parametrize("name", ALL)
def test_controller_model_weighs_what_the_full_one_does(name: str) -> None:
    """With the welded joints at nominal, the mass matrix is the full one's without their rows."""
    full_one, controller = FULL[name], CONTROLLER[name]
    full, reduced = forward(full_one, full_one.nominal_qpos()), forward(controller, controller.nominal_qpos())
    M, m = np.zeros((full_one.mj.nv,) * 2), np.zeros((controller.mj.nv,) * 2)
    mujoco.mj_fullM(full_one.mj, full, M)
    mujoco.mj_fullM(controller.mj, reduced, m)
    rows = [*range(6), *(full_one.mj.joint(joint).dofadr[0] for joint in controller.joints)]
    np.testing.assert_allclose(M[np.ix_(rows, rows)], m, atol=1e-9)
