"""What makers' files contain: oblique hips, gears and rods, toes, impossible inertias, meshes of several formats."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from harness.generated_robot import Build, mjcf
from harness.places import ROBOTS
from harness.waiting import some
from valor.common.errors import ConfigurationError
from valor.robot.checks.folder import examine
from valor.robot.description import RobotDescription
from valor.robot.model_tree import read
from valor.robot_setup.meshes import converted
from valor.robot_setup.new import draft_robot
from valor.robot_setup.posture import SIDE_LEAN, Stance
from valor.robot_setup.robot_yaml import RobotDraft, groups

Root = ElementTree.Element


def drafted(build: Build, folder: Path, change: Callable[[Root], None]) -> RobotDraft:
    """Return the draft of a changed model, whose folder has no faults."""
    root = ElementTree.fromstring(mjcf(build))
    change(root)
    return checked(ElementTree.tostring(root, encoding="unicode"), folder, "maker.xml")


def checked(text: str, folder: Path, name: str) -> RobotDraft:
    (folder / name).write_text(text)
    draft = draft_robot(folder / name, "generated")
    (folder / "robot").mkdir()
    draft.write(folder / "robot")
    examine(folder / "robot").require_none()
    return draft


def named(root: Root, tag: str, start: str) -> Root:
    return next(each for each in root.iter(tag) if each.get("name", "").startswith(start))


def drive(root: Root, joint: str, instead: str | None = None) -> None:
    """Add a motor to a joint, or move there that of another joint."""
    actuators = some(root.find("actuator"))
    if instead is None:
        ElementTree.SubElement(actuators, "motor", joint=joint, ctrlrange="-20 20")
    else:
        next(each for each in actuators if each.get("joint", "").startswith(instead)).set("joint", joint)


def test_a_leg_is_measured_from_an_oblique_hip(tmp_path: Path) -> None:
    build = Build(hip="yxz")

    def change(root: Root) -> None:
        for side, tilt in (("left", 0.57), ("right", -0.57)):
            named(root, "joint", f"{side}_hip_y").set("axis", f"0 0.82 {tilt}")

    assert drafted(build, tmp_path, change).stance.leg_length == pytest.approx(build.leg, rel=0.01)


def test_a_motor_geared_to_a_knee_is_replaced_by_the_knee(tmp_path: Path) -> None:
    def change(root: Root) -> None:
        equality = some(root.find("equality"))
        for side in ("left", "right"):
            knee = named(root, "joint", f"{side}_knee").get("name", "")
            rotor = ElementTree.SubElement(named(root, "body", f"{side}_thigh"), "body", name=f"{side}_rotor")
            ElementTree.SubElement(rotor, "inertial", mass="0.01", pos="0 0 0", diaginertia="1e-5 1e-5 1e-5")
            ElementTree.SubElement(rotor, "joint", name=f"{side}_motor", axis="0 1 0", range="-9 9")
            ElementTree.SubElement(equality, "joint", joint1=knee, joint2=f"{side}_motor", polycoef="0 -0.5 0 0 0")
            drive(root, f"{side}_motor", instead=knee)

    draft = drafted(Build(), tmp_path, change)
    assert [name for name in groups(draft.robot)["left_leg"] if "knee" in name]
    assert not draft.robot.passive.hinges[draft.robot.source.joints.index("left_motor")]


def test_a_motor_whose_rod_moves_the_shin_is_replaced_by_the_knee(tmp_path: Path) -> None:
    def change(root: Root) -> None:
        for side in ("left", "right"):
            drive(root, f"{side}_crank", instead=f"{side}_knee")

    draft = drafted(Build(linkage=True), tmp_path, change)
    assert len(groups(draft.robot)["right_leg"]) == 6 and not draft.robot.passive.loops
    assert any("driven directly in place of left_crank" in note for note in draft.robot.source.notes)


def test_driven_toes_are_welded(tmp_path: Path) -> None:
    def change(root: Root) -> None:
        for side in ("left", "right"):
            drive(root, f"{side}_toe")

    draft = drafted(Build(toes=True), tmp_path, change)
    assert len(groups(draft.robot)["left_leg"]) == 6
    assert [draft.robot.joint_name(joint) for joint in draft.robot.passive.hinges] == ["left_toe", "right_toe"]
    build = Build(toes=True)
    assert draft.geometry.soles["left"].toe > build.heel_toe_half_width[1] + 0.04 * build.leg


def test_a_driven_branch_of_a_leg_is_welded(tmp_path: Path) -> None:
    def change(root: Root) -> None:
        rotor = ElementTree.SubElement(named(root, "body", "left_thigh"), "body", name="fan")
        ElementTree.SubElement(rotor, "inertial", mass="0.01", pos="0 0 0", diaginertia="1e-5 1e-5 1e-5")
        ElementTree.SubElement(rotor, "joint", name="fan", axis="0 1 0")
        drive(root, "fan")

    draft = drafted(Build(), tmp_path, change)
    assert [draft.robot.joint_name(joint) for joint in draft.robot.passive.hinges] == ["fan"]


def test_sprung_joints_are_passive_in_a_model_without_actuators(tmp_path: Path) -> None:
    draft = drafted(Build(toes=True, drive="none"), tmp_path, lambda root: None)
    assert {draft.robot.joint_name(joint) for joint in draft.robot.passive.simulated} == {"left_toe", "right_toe"}


def test_soles_are_what_both_feet_have(tmp_path: Path) -> None:
    def change(root: Root) -> None:
        foot = some(root.find(".//body[@name='right_foot']/geom"))
        x, y, z = foot.get("size", "").split()
        foot.set("size", f"{x} {0.6 * float(y)} {z}")

    soles = drafted(Build(), tmp_path, change).geometry.soles
    assert soles["left"].half_width == soles["right"].half_width == pytest.approx(0.6 * 0.075 * 0.7, abs=1e-3)


def test_very_small_inertias_and_feet_are_written(tmp_path: Path) -> None:
    """Light feet have soft servos, unless the physics' step is shorter."""

    def change(root: Root) -> None:
        for name, inertia in (("antenna", "2e-8 3e-8 5e-8"), ("left_foot", "1e-5 1e-5 1e-5")):
            for body in root.iter("body"):
                if body.get("name", "").replace("right", "left").startswith(name):
                    body[0].set("diaginertia", inertia)

    assert drafted(Build(spring=True), tmp_path, change).geometry.step < 0.001


@pytest.mark.parametrize("mirrored", [False, True])
def test_feet_stand_farther_apart_where_ankle_roll_ends_early(mirrored: bool, tmp_path: Path) -> None:
    build = Build(mirrored=mirrored)

    def stance(inward: float, outward: float) -> Stance:
        """Nominal posture of a robot whose ankles let a leg lean so far inward and outward [rad]."""

        def change(root: Root) -> None:
            for side in ("left", "right"):
                low, high = (inward, outward) if side == "right" and not mirrored else (outward, inward)
                named(root, "joint", f"{side}_ankle_x").set("range", f"{-low} {high}")

        folder = tmp_path / f"{inward}, {outward}"
        folder.mkdir()
        return drafted(build, folder, change).stance

    usual, inward, outward = stance(0.5, 0.5), stance(0.26, 0.5), stance(0.5, SIDE_LEAN - 0.1)
    assert inward.width == pytest.approx(usual.width, abs=1e-3)
    assert outward.width == pytest.approx(usual.width + 0.2 * build.leg, rel=0.01)
    assert outward.step_width == pytest.approx(usual.step_width, abs=1e-3)


def test_rounded_angles_are_within_limits(tmp_path: Path) -> None:
    def change(root: Root) -> None:
        for joint in root.iter("joint"):
            if "_arm_" in joint.get("name", ""):
                joint.set("range", "0.0485123 1.2341834")

    draft = drafted(Build(), tmp_path, change)
    assert min(angle for side in draft.arm_presets["home"].values() for angle in side.values()) < 0.06


def urdf(**changes: str) -> str:
    """Return THOR's URDF with replacements of elements, of each the first."""
    text = read(RobotDescription.load(ROBOTS / "thor")).urdf
    for tag, other in changes.items():
        text = re.sub(rf"<{tag}(?![a-z])[^>]*>", other, text, count=1)
    return text


def test_an_inertia_that_no_body_has_is_replaced(tmp_path: Path) -> None:
    draft = checked(urdf(inertia='<inertia ixx="1" iyy="1" izz="1" ixy="2" ixz="0" iyz="0"/>'), tmp_path, "robot.urdf")
    assert draft.robot.source.notes[0].startswith("Inertias that no rigid body has are replaced")


@pytest.mark.parametrize("mesh", ["package://elsewhere/pelvis.stl", "pelvis.wrl", "broken.dae"])
def test_a_mesh_that_cannot_be_read_is_left_out(mesh: str, tmp_path: Path) -> None:
    for name in ("pelvis.wrl", "broken.dae"):
        (tmp_path / name).write_text("<COLLADA>")
    link = f'<link name="pelvis"><visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    draft = checked(urdf(**{'link name="pelvis"': link}), tmp_path, "robot.urdf")
    assert any(note.startswith("Shapes left out") and mesh in note for note in draft.robot.source.notes)


def test_of_xacro_only_what_is_not_yet_replaced_is_rejected(tmp_path: Path) -> None:
    macro = '<robot name="thor" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:camera name="left"/>'
    checked(urdf(robot=macro), tmp_path, "robot.urdf")
    (tmp_path / "robot.xacro").write_text(urdf(robot=macro.replace("left", "${side}")))
    with pytest.raises(ConfigurationError, match=r"is a xacro file; expected what `xacro robot.xacro` prints$"):
        draft_robot(tmp_path / "robot.xacro", "generated")


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><unit meter="0.01"/></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="f" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>
<vcount>4</vcount><p>0 9 1 9 2 9 3 9</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene><node><translate>0 0 5</translate><rotate>0 0 1 90</rotate>
<node><scale>2 2 2</scale><instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes>
</COLLADA>"""


def test_collada_and_text_stl_are_read(tmp_path: Path) -> None:
    (tmp_path / "square.DAE").write_text(COLLADA)
    (tmp_path / "one.stl").write_text("solid\nfacet\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1e0 0\nendfacet\nendsolid")
    wanted = {
        "square.DAE": {(0, 0, 5), (0, 2, 5), (-2, 2, 5), (-2, 0, 5)},
        "one.stl": {(0, 0, 0), (1, 0, 0), (0, 1, 0)},
    }
    for name, points in wanted.items():
        content = some(converted(tmp_path / name))
        records = np.frombuffer(content[84:], dtype=[("floats", "<f4", (4, 3)), ("more", "<u2")])
        scale = 100 if name == "square.DAE" else 1
        found = {tuple(np.round(scale * each).astype(int)) for each in records["floats"][:, 1:].reshape(-1, 3)}
        assert found == points
