"""MoveIt's configuration holds what MoveIt's own readers ask for: names that are there, types, places of files."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from harness.generated_robot import Build
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import made
from valor.moveit import package
from valor.moveit.collisions import Collisions, posture
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.controllers.configuration import ControllersTable
from valor.valorctl.__main__ import run as main

OURS = sorted(path.parent.name for path in ROBOTS.glob("*/robot.yaml"))
GENERATED = {
    "four joints an arm": Build(mass=20, leg=0.4, waist="zyx", arm=4),
    "no arms": Build(arm=0, neck=False, waist=""),
}
REASONS = {"Adjacent", "Always", "Default", "Never", "User"}  # what the setup assistant knows


class Package:
    """One that was written, as its readers see it."""

    def __init__(self, robot: RobotDescription, folder: Path, samples: int, namespace: str = "") -> None:
        self.robot, self.folder = robot, folder
        folder.mkdir(parents=True)
        self.made = package.write(robot, folder, lambda _: None, samples, namespace=namespace)
        self.urdf = ElementTree.fromstring((folder / "config" / f"{robot.name}.urdf").read_text())
        self.srdf = ElementTree.fromstring((folder / "config" / f"{robot.name}.srdf").read_text().encode())
        self.links = {link.get("name", "") for link in self.urdf.iter("link")}
        self.joints = {joint.get("name", ""): joint for joint in self.urdf.findall("joint")}

    def table(self, name: str) -> dict[str, Any]:
        content: dict[str, Any] = yaml.safe_load((self.folder / "config" / f"{name}.yaml").read_text())
        return content

    def joint_above(self, link: str) -> ElementTree.Element | None:
        """The joint whose child a link is."""
        return next((j for j in self.joints.values() if ends(j)[1] == link), None)

    def group(self, name: str) -> tuple[set[str], set[str]]:
        """Moving joints and links of a group, as RobotModel finds them."""
        element = next(each for each in self.srdf.findall("group") if each.get("name") == name)
        joints, links = set[str](), set[str]()
        for chain in element.findall("chain"):
            link = chain.get("tip_link", "")
            while link != chain.get("base_link"):
                joint = self.joint_above(link)
                assert joint is not None, f"{name}: {chain.attrib} is no chain"
                joints.add(joint.get("name", ""))
                links.add(link)
                link = ends(joint)[0]
        for each in element.findall("joint"):
            joints.add(each.get("name", ""))
            links.add(ends(self.joints[each.get("name", "")])[1])
        for each in element.findall("group"):
            more = self.group(each.get("name", ""))
            joints, links = joints | more[0], links | more[1]
        return {joint for joint in joints if self.joints[joint].get("type") != "fixed"}, links


def ends(joint: ElementTree.Element) -> tuple[str, str]:
    """Links that a joint joins: parent, child."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None
    return parent.get("link", ""), child.get("link", "")


@pytest.fixture(scope="module", params=[*OURS, *GENERATED])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Package:
    folder = tmp_path_factory.mktemp("moveit")
    if request.param in OURS:
        return Package(RobotDescription.load(ROBOTS / request.param), folder / f"{request.param}_moveit_config", 10_000)
    return Package(made(GENERATED[request.param], folder), folder / "generated_moveit_config", 1000)


def test_groups_are_robot_yamls(written: Package) -> None:
    groups = [group.get("name", "") for group in written.srdf.findall("group")]
    assert len(set(groups)) == len(groups)
    for name, joints in written.robot.tables.groups.items():
        if joints:
            assert written.group(name)[0] == set(joints), name
    for side in ("left", "right"):
        chain = written.srdf.find(f"group[@name='{side}_leg']/chain")
        assert chain is not None and chain.get("tip_link") == written.robot.frame_of(f"{side[0]}_sole")
    arms = {f"{side}_arm" for side in ("left", "right")} & set(groups)
    assert ("both_arms" in groups) == (len(arms) == 2)
    if arms:
        moved = set().union(*(written.group(arm)[0] for arm in arms))
        assert written.group("both_arms")[0] == moved
        torso = set(written.robot.tables.group("torso"))
        assert not torso or written.group("upper_body")[0] == moved | torso


def test_named_states_are_whole_and_reachable_and_touch_nothing(written: Package) -> None:
    collisions, robot = Collisions(written.robot), written.robot
    disabled = {pair(each) for each in written.srdf.iter("disable_collisions")}
    named = set()
    for state in written.srdf.findall("group_state"):
        angles = {j.get("name", ""): float(j.get("value", "nan")) for j in state.findall("joint")}
        key = state.get("name"), state.get("group")
        assert set(angles) == written.group(state.get("group", ""))[0], key
        for joint, angle in angles.items():
            i = robot.index[joint]
            assert robot.lower[i] - 1e-6 <= angle <= robot.upper[i] + 1e-6, (key, joint)
        assert not collisions.touching(posture(robot, angles)) - disabled, key
        assert key not in named
        named.add(key)
    assert {("nominal", group) for group, joints in robot.tables.groups.items() if joints} <= named
    for kind, presets in (("arm", robot.tables.arm_presets), ("hand", robot.tables.hand_presets)):
        for preset, sides in presets.items():
            assert {(preset, f"{side}_{kind}") for side in sides} <= named


def test_end_effectors_hang_from_their_arms(written: Package) -> None:
    found = written.srdf.findall("end_effector")
    hands = [side for side in ("left", "right") if written.robot.tables.group(f"{side}_hand")]
    assert len(found) == len(hands)
    for each in found:
        arm, hand = written.group(each.get("parent_group", "")), written.group(each.get("group", ""))
        assert each.get("parent_link") in arm[1]
        assert not arm[0] & hand[0] and not arm[1] & hand[1]


def test_the_robot_stands_in_odom(written: Package) -> None:
    (joint,) = written.srdf.findall("virtual_joint")
    children = {ends(each)[1] for each in written.joints.values()}
    assert {joint.get("child_link")} == written.links - children, "the URDF's root"
    assert (joint.get("type"), joint.get("parent_frame")) == ("floating", "odom")
    assert joint.get("name") not in written.joints
    assert written.srdf.get("name") == written.urdf.get("name") == written.robot.name


def test_links_that_are_not_looked_at_do_not_touch(written: Package) -> None:
    """At configurations that were not tried; and every pair is one of links with shapes, told once."""
    collisions, robot = Collisions(written.robot), written.robot
    pairs = [pair(each) for each in written.srdf.iter("disable_collisions")]
    shaped = {link.get("name") for link in written.urdf.iter("link") if link.find("collision") is not None}
    assert len(set(pairs)) == len(pairs) and {link for each in pairs for link in each} <= shaped
    reasons = {pair(each): each.get("reason") for each in written.srdf.iter("disable_collisions")}
    assert set(reasons.values()) <= REASONS
    never = {each for each, reason in reasons.items() if reason == "Never"}
    apart = {tuple(sorted(each)) for each in robot.tables.self_collision.pairs}
    assert never and not never & apart
    generator = np.random.default_rng(7)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    touched = set()
    for _ in range(2000):
        touched |= collisions.touching(generator.uniform(lower, upper))
    assert touched and len(touched & never) <= (0 if robot.name in OURS else 1)


def test_limits_are_those_that_the_controllers_accept(written: Package) -> None:
    limits, table = CommandedLimits.of_joints(written.robot), written.table("joint_limits")
    assert list(table["joint_limits"]) == list(written.robot.joints)
    for i, each in enumerate(table["joint_limits"].values()):
        assert each == {
            "has_velocity_limits": True,
            "max_velocity": pytest.approx(limits.velocity[i]),
            "has_acceleration_limits": True,
            "max_acceleration": pytest.approx(limits.acceleration[i]),
        }
    for name in ("joint_limits", "kinematics", "pilz_cartesian_limits"):
        assert not list(integers(written.table(name))), "a parameter that is a double must be written as one"


def test_controllers_are_those_of_the_vrc(written: Package) -> None:
    table = written.table("moveit_controllers")
    named = table["moveit_simple_controller_manager"]
    served = ControllersTable.load().of(written.robot).joint_controllers
    assert named["controller_names"] == list(served) == [name for name in named if name != "controller_names"]
    for name, controller in served.items():
        joints = [joint for group in controller.groups for joint in written.robot.tables.group(group)]
        assert sorted(named[name]["joints"]) == sorted(joints)
        assert named[name]["type"] == "FollowJointTrajectory" and named[name]["action_ns"] == "follow_joint_trajectory"
    assert table["moveit_controller_manager"] == "moveit_simple_controller_manager/MoveItSimpleControllerManager"


def test_arms_of_fewer_than_six_joints_are_solved_for_places(written: Package) -> None:
    table = written.table("kinematics")
    limbs = {n for n in written.robot.tables.groups if n.endswith(("_arm", "_leg")) and written.robot.tables.group(n)}
    assert set(table) == limbs
    for name, solver in table.items():
        assert solver.get("position_only_ik", False) == (len(written.robot.tables.group(name)) < 6), name


def test_it_is_a_package(written: Package) -> None:
    """With files where moveit_configs_utils looks for them."""
    folder, name = written.folder, written.robot.name
    manifest = ElementTree.fromstring((folder / "package.xml").read_text())
    assert manifest.findtext("name") == folder.name and manifest.get("format") == "3"
    assert f"project({folder.name})" in (folder / "CMakeLists.txt").read_text()
    assistant = yaml.safe_load((folder / ".setup_assistant").read_text())["moveit_setup_assistant_config"]
    assert assistant["urdf"]["package"] == folder.name
    for key in ("urdf", "srdf"):
        assert (folder / assistant[key]["relative_path"]).is_file()
    for file in (folder / "launch").iterdir():
        tree = ast.parse(file.read_text())
        assert "generate_launch_description" in {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}
        assert f'MoveItConfigsBuilder("{name}", package_name="{folder.name}")' in file.read_text()
    assert yaml.safe_load((folder / "config" / "moveit.rviz").read_text())["Visualization Manager"]
    for file in folder.rglob("*"):
        if file.is_file() and file.suffix != ".stl":
            assert not re.search(r"\$(package|robot|frame|namespace)\b", file.read_text()), file


def test_in_a_namespace_frames_have_its_prefix_and_all_else_is_the_same(tmp_path: Path) -> None:
    robot, space = RobotDescription.load(ROBOTS / "escher"), "lab/escher1"
    alone, inside = (Package(robot, tmp_path / each / "mine", 10, each.strip("_")) for each in ("_", space))
    assert inside.links == {f"{space}/{link}" for link in alone.links}
    assert set(inside.joints) == set(alone.joints), "joint states have no prefix"
    (joint,) = inside.srdf.findall("virtual_joint")
    assert (joint.get("parent_frame"), joint.get("child_link")) == (f"{space}/odom", f"{space}/base_link")
    named = {each for element in inside.srdf.iter() for key, each in element.items() if "link" in key}
    assert named and named <= inside.links
    for group in alone.srdf.findall("group"):
        joints, links = alone.group(name := group.get("name", ""))
        assert inside.group(name) == (joints, {f"{space}/{link}" for link in links})
    for file in (file for file in alone.folder.rglob("*") if file.is_file()):
        there = (inside.folder / file.relative_to(alone.folder)).read_text()
        if file.suffix in (".urdf", ".srdf"):
            there = there.replace(f'"{space}/', '"')
        assert there.replace(f"/{space}", "").replace(f"{space}/", "") == file.read_text(), file
    for launched in (inside.folder / "launch").iterdir():
        assert f'NAMESPACE = "/{space}"' in launched.read_text()
    rviz = yaml.safe_load((inside.folder / "config" / "moveit.rviz").read_text())["Visualization Manager"]
    assert rviz["Global Options"]["Fixed Frame"] == f"{space}/odom"
    assert [each.get("Move Group Namespace") for each in rviz["Displays"]] == [None, f"/{space}"]


def test_meshes_go_with_it(tmp_path: Path) -> None:
    """Two of one name, too."""
    ours = ROBOTS / "escher"
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "robot.yaml").write_text((ours / "robot.yaml").read_text())
    model = (ours / "model.xml").read_text()
    sphere = (Path(package.__file__).parents[1] / "robot" / "sphere.stl").read_bytes()
    for each in ("one", "two"):
        (folder / each).mkdir()
        (folder / each / "arm part.stl").write_bytes(sphere)
    assets = "".join(f'<mesh name="{each}" file="{each}/arm part.stl" scale=".1 .1 .1"/>' for each in ("one", "two"))
    shapes = "".join(f'<geom class="visual" type="mesh" mesh="{each}"/>' for each in ("one", "two"))
    model = model.replace("<asset>", f"<asset>{assets}", 1)
    model = re.sub(r'(<body name="l_forearm"[^>]*>)', rf"\1{shapes}", model)
    (folder / "model.xml").write_text(model)
    written = Package(RobotDescription.load(folder), tmp_path / "mine", 10)
    named = [mesh.get("filename", "") for mesh in written.urdf.iter("mesh")]
    assert len(set(named)) == 2 and written.made.meshes == 2
    for name in named:
        assert (tmp_path / name.removeprefix("package://")).read_bytes() == sphere


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("valor.moveit.collisions.SAMPLES", 10)
    return tmp_path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["valorctl", "robot", "moveit", *arguments])
    try:
        return main()
    except SystemExit as ended:
        return int(ended.code or 0)


def test_what_is_in_the_way_stays(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "escher") == 0
    told = capsys.readouterr().out
    assert "ros2 launch escher_moveit_config move_group.launch.py" in told and "left_arm" in told
    mine = here / "escher_moveit_config" / "config" / "mine.yaml"
    mine.write_text("kept: true")
    assert run(monkeypatch, "escher") == 1 and mine.exists()
    assert "escher_moveit_config: is there already; expected another --out, or --force" in capsys.readouterr().err
    assert run(monkeypatch, "escher", "--force") == 0 and not mine.exists()
    other = here / "other"
    other.mkdir()
    (other / "thesis.txt").touch()
    assert run(monkeypatch, "escher", "--out", "other", "--force") == 1 and (other / "thesis.txt").exists()
    assert "this one has no .setup_assistant" in capsys.readouterr().err
    assert run(monkeypatch, "escher", "--out", "My-Robot") == 1
    assert "package 'My-Robot': expected lower-case letters" in capsys.readouterr().err
    assert run(monkeypatch, "escher", "--namespace", "2nd") == 1
    assert "namespace '2nd': expected letters" in capsys.readouterr().err
    assert run(monkeypatch, "escher", "--namespace", "/lab/one") == 0
    assert "ros2 launch lab_one_moveit_config move_group.launch.py" in capsys.readouterr().out
    assert run(monkeypatch, "eschar") == 1 and "escher" in capsys.readouterr().err
    assert sorted(each.name for each in here.iterdir()) == ["escher_moveit_config", "lab_one_moveit_config", "other"]


def pair(element: ElementTree.Element) -> tuple[str, ...]:
    return tuple(sorted((element.get("link1", ""), element.get("link2", ""))))


def integers(content: Any) -> Iterator[int]:
    """Whole numbers in a table."""
    if isinstance(content, dict):
        for value in content.values():
            yield from integers(value)
    elif isinstance(content, int) and not isinstance(content, bool):
        yield content
