"""What holds for every robot of ``robots/``: mirror symmetry, standing, what may touch, no number that stands twice."""

import re
from pathlib import Path

import msgspec
import mujoco
import numpy as np
import pytest

from harness.generated_robot import Build
from harness.places import ROBOTS
from harness.waiting import some
from tests.unit.robot_setup.builds import made
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.table import Table
from valor.control.tuning_tables import Disturbance, FallDetection, Tuning
from valor.robot.checks.folder import asymmetries
from valor.robot.checks.stance import Stance
from valor.robot.description import RobotDescription
from valor.robot.model import Model, controller_model, full_model
from valor.robot.motion_tables import Footsteps, PelvisMotion, SelfCollision, Walking
from valor.robot.size import ESCHER, Size, completed, factors
from valor.robot.tables import WHOLE_BODY_GROUPS
from valor.valorctl.robots import robot_check

ALL = {file.parent.name: RobotDescription.load(file.parent) for file in sorted(ROBOTS.glob("*/robot.yaml"))}
FULL = {name: full_model(robot, "collision") for name, robot in ALL.items()}
CONTROLLER = {name: controller_model(robot) for name, robot in ALL.items()}
MODELS = [*FULL.values(), *CONTROLLER.values()]
IDS = [*(f"{name}-full" for name in FULL), *(f"{name}-controller" for name in CONTROLLER)]

# Turning about x or z is mirrored into turning the other way, about y into the same.
LATERAL = ("_yaw", "_roll")


def configuration(model: Model, **joints: float) -> FloatArray:
    qpos: FloatArray = model.mj.qpos0.copy()
    for name, angle in joints.items():
        qpos[model.mj.joint(name).qposadr[0]] = angle
    return qpos


def forward(model: Model, qpos: FloatArray) -> mujoco.MjData:
    data = mujoco.MjData(model.mj)
    data.qpos[:] = qpos
    mujoco.mj_forward(model.mj, data)
    return data


def other_side(name: str) -> str:
    """The joint's or body's twin; itself, if it is in the middle."""
    return {"l_": "r_", "r_": "l_"}.get(name[:2], name[:2]) + name[2:]


@pytest.mark.parametrize("limb", ["arm", "hand"])
@pytest.mark.parametrize("robot", ALL.values(), ids=ALL.keys())
def test_presets_are_complete_within_limits_and_mirrored(robot: RobotDescription, limb: str) -> None:
    presets = getattr(robot.tables, f"{limb}_presets")
    assert {"arm": {"home", "forward", "side", "up", "fold"}, "hand": {"open", "close"}}[limb] <= set(presets)
    for preset, sides in presets.items():
        assert set(sides) == {"left", "right"}
        for side, posture in sides.items():
            assert list(posture) == robot.tables.groups[f"{side}_{limb}"]
            for name, angle in posture.items():
                joint = robot.tables.joints[name]
                assert joint.lower is not None and joint.upper is not None
                assert joint.lower <= angle <= joint.upper, (preset, name)
        for name, angle in sides["left"].items():
            assert sides["right"][other_side(name)] == (-angle if name.endswith(LATERAL) else angle)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
def test_models_carry_the_numbers_of_robot_yaml(model: Model) -> None:
    mj, tables = model.mj, model.robot.tables
    for name in model.joints:
        joint, table = mj.joint(name), tables.joints[name]
        dof = joint.dofadr[0]
        assert mj.dof_armature[dof] == table.armature and mj.dof_damping[dof] == table.damping
        assert bool(joint.limited[0]) == (table.lower is not None)
        if table.lower is not None and table.upper is not None:
            np.testing.assert_allclose(joint.range, (table.lower, table.upper))
    assert mj.opt.timestep == tables.physics_step


@pytest.mark.parametrize("name", ALL)
def test_controller_model_moves_the_whole_body_joints_only(name: str) -> None:
    robot, model = ALL[name], CONTROLLER[name]
    expected = [joint for group in WHOLE_BODY_GROUPS for joint in robot.tables.groups[group]]
    assert sorted(model.joints) == sorted(expected) and model.mj.nv == 6 + 27
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


# Mirror symmetry of the sides of a robot: differences are measured and reported, but are no faults.
@pytest.mark.parametrize("name", sorted(file.parent.name for file in ROBOTS.glob("*/robot.yaml")))
def test_included_robots_are_exact_mirror_images(name: str) -> None:
    assert list(asymmetries(Stance(RobotDescription.load(ROBOTS / name)), 1e-9, 1e-9)) == []


@pytest.mark.parametrize("name", ALL)
def test_joints_of_both_sides_have_the_same_drive(name: str) -> None:
    """All numbers of a joint and its twin but for its limits, which are mirrored with its axis."""
    joints = {each: msgspec.to_builtins(joint) for each, joint in ALL[name].tables.joints.items()}
    for each, joint in joints.items():
        different = {key for key, value in joints[other_side(each)].items() if value != joint[key]}
        assert different <= {"lower", "upper"}, (each, different)


def test_mirrored_axes_make_no_difference(tmp_path: Path) -> None:
    robot = made(Build(mirrored=True, knee=-1), tmp_path)
    assert list(asymmetries(Stance(robot), 1e-5, 1e-6)) == []


def test_differences_are_reported_by_name(tmp_path: Path) -> None:
    robot = made(Build(), tmp_path)
    model, table = robot.model_file.read_text(), robot.file.read_text()
    thigh = some(re.search(r'<body name="left_thigh".*?<inertial mass="([0-9.]+)"', model, re.DOTALL))
    heavier = model[: thigh.start(1)] + str(float(thigh[1]) * 1.2) + model[thigh.end(1) :]
    robot.model_file.write_text(heavier)
    robot.file.write_text(re.sub(r"(  right_knee_\S+ .*?effort: )[0-9.]+", r"\g<1>150", table))
    findings = robot_check.examine(robot.folder)
    notes, reported = findings.notes(), list(asymmetries(Stance(findings.require_none())))
    assert set(notes) <= {*reported, notes[-1]}
    assert any("left_hip_z" in line and "kg" in line for line in reported)
    assert any(line.startswith("effort of left_knee") and "150" in line for line in reported)
    assert not any("right_ankle" in line for line in reported)


# Defaults of another size: ESCHER's, as a robot of that size would have them.
QUARTER = factors(Size(leg=ESCHER.leg / 4, mass=ESCHER.mass / 10), 0.07425 / 2)


def robot(folder: Path, *changes: tuple[str, str]) -> RobotDescription:
    text = (ROBOTS / "escher" / "robot.yaml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "robot.yaml").write_text(text)
    (folder / "model.xml").symlink_to(ROBOTS / "escher" / "model.xml")
    return RobotDescription.load(folder)


def test_eschers_are_the_defaults_to_the_last_bit() -> None:
    escher = RobotDescription.load(ROBOTS / "escher")
    tables, tuning = escher.tables, escher.read(Tuning)
    assert (tables.walking, tables.pelvis, tables.footsteps) == (Walking(), PelvisMotion(), Footsteps())
    assert tables.self_collision == SelfCollision(pairs=tables.self_collision.pairs)
    assert tuning == Tuning()
    assert set(factors(ESCHER, 0.07425).values()) == {1.0}


@pytest.mark.parametrize(
    ("kind", "key", "expected"),
    [
        (Walking, "swing_duration", 0.3), (Walking, "touchdown_force", 3.0), (Walking, "foot_stiffness", 1200.0),
        (Footsteps, "min_width", 0.075), (PelvisMotion, "max_turn_rate", 0.8), (Disturbance, "edge_margin", 0.015),
        (FallDetection, "tilt", None),
    ],
)  # fmt: skip
def test_defaults_go_by_their_dimension(kind: type[Table], key: str, expected: float | None) -> None:
    assert completed(kind, {}, QUARTER).get(key) == (None if expected is None else pytest.approx(expected))


def test_what_is_said_stays_as_it_is_and_what_is_no_table_too() -> None:
    assert completed(Walking, {"swing_duration": 0.6}, QUARTER)["swing_duration"] == 0.6
    assert completed(Walking, [1], QUARTER) == [1]


def test_a_robots_tables_are_of_its_size(tmp_path: Path) -> None:
    small = robot(
        tmp_path, ("leg: 0.82", "leg: 0.205"), ("half_width: 0.07425", "half_width: 0.019"),
        ("footsteps: {}", "footsteps: { max_up: 0.1 }"),
    )  # fmt: skip
    footsteps = some(small.tables.footsteps)
    assert (footsteps.max_up, footsteps.max_down) == (0.1, 0.05)
    assert footsteps.min_width == pytest.approx(0.15 * 0.019 / 0.07425)
    assert small.tables.walking.swing_duration == pytest.approx(0.3)
    assert small.read(Tuning).disturbance.recovery_swing_duration == pytest.approx(0.15)


def test_footsteps_that_are_not_there_stay_so(tmp_path: Path) -> None:
    assert robot(tmp_path, ("footsteps: {}", "")).tables.footsteps is None


def test_what_a_default_does_not_fit_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"footsteps.min_width: got 0.15; expected less than max_width, 0.12"):
        robot(tmp_path, ("footsteps: {}", "footsteps: { max_width: 0.12 }"))


# THOR's description: its published dimensions and axes.
ROBOT, MODEL = ALL["thor"], FULL["thor"]
LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee_pitch", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow_pitch", "wrist_roll", "wrist_yaw", "hand_roll")


def test_has_34_joints_with_roll_yaw_roll_wrists_and_grippers_of_two() -> None:
    expected = {f"{side}_{name}" for side in "lr" for name in (*LEG, *ARM, "f0_j0", "f1_j0")}
    expected |= {"waist_yaw", "neck_yaw", "neck_pitch", "lidar_roll"}
    assert set(ROBOT.joints) == expected and len(ROBOT.joints) == 34
    axes = [MODEL.mj.jnt_axis[MODEL.mj.joint(f"l_{name}").id].tolist() for name in ARM[-3:]]
    assert axes == [[1, 0, 0], [0, 0, 1], [1, 0, 0]]


def test_mass_and_lengths_are_the_published_ones() -> None:
    assert MODEL.mj.body_subtreemass[MODEL.body("pelvis")] == pytest.approx(65.0, abs=1e-6)
    data = forward(MODEL, MODEL.mj.qpos0)
    head = [i for i in range(MODEL.mj.ngeom) if MODEL.mj.geom_bodyid[i] == MODEL.body("head")]
    top = max(data.geom_xpos[i][2] + MODEL.mj.geom_size[i][2] for i in head)
    assert top == pytest.approx(1.78, abs=0.02)
    hip, knee, ankle = (data.body(name).xpos for name in ("l_thigh", "l_shin", "l_foot"))
    assert hip[1] == pytest.approx(0.094) and hip[2] - knee[2] == pytest.approx(0.379)
    assert knee[2] - ankle[2] == pytest.approx(0.380)
    assert data.site("l_sole").xpos[2] == pytest.approx(0.0, abs=1e-9)
    foot = ROBOT.tables.feet.left
    assert (foot.toe - foot.heel, 2 * foot.half_width) == pytest.approx((0.230, 0.125))


def test_fingers_meet_when_the_gripper_closes() -> None:
    def gap(angle: float) -> float:
        data = forward(MODEL, configuration(MODEL, l_f0_j0=angle, l_f1_j0=angle))
        return float(np.linalg.norm(data.body("l_finger_0").xipos - data.body("l_finger_1").xipos))

    upper = ROBOT.tables.joints["l_f0_j0"].upper
    assert upper == 2.685
    assert gap(0.0) > 0.1
    assert gap(1.745) < 0.08  # both straight ahead
    assert gap(0.0) > gap(0.6) > gap(1.2) > gap(1.7)
