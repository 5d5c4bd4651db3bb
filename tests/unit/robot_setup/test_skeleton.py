"""Roles by topology and geometry: those that ESCHER's and THOR's files say, whatever things are called."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.generated_robot import Build
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import found
from valor.robot.description import RobotDescription
from valor.robot_setup.new import study
from valor.robot_setup.robot_yaml import groups
from valor.robot_setup.skeleton import Skeleton, skeleton
from valor.robot_setup.source import Source

OWN = pytest.mark.parametrize("name", ["escher", "thor"])


@OWN
def test_joints_are_grouped_as_the_robots_own_file_says(name: str) -> None:
    tables = RobotDescription.load(ROBOTS / name).tables
    seen = groups(skeleton(Source(ROBOTS / name / "model.xml")))
    # A sensor that spins on the head is at the end of the neck for whoever sees the model alone.
    wanted = {group: list(joints) for group, joints in tables.groups.items() if group != "lidar"}
    wanted["neck"] += tables.groups["lidar"]
    assert seen == wanted


@OWN
def test_trunk_and_ends_are_those_of_the_robots_own_file(name: str) -> None:
    tables = RobotDescription.load(ROBOTS / name).tables
    seen = skeleton(Source(ROBOTS / name / "model.xml"))
    assert (seen.name(seen.pelvis), seen.name(seen.chest)) == (tables.base, tables.chest)
    for side in ("left", "right"):
        assert seen.name(seen.legs[side].end) == getattr(tables.feet, side).body
        assert tables.hands is not None
        assert seen.name(seen.arms[side].end) == getattr(tables.hands, side).body


@OWN
def test_soles_are_those_of_the_robots_own_file(name: str) -> None:
    feet = RobotDescription.load(ROBOTS / name).tables.feet
    seen = study(ROBOTS / name / "model.xml", name).content.soles
    for side in ("left", "right"):
        own = getattr(feet, side)
        edges = (seen[side].heel, seen[side].toe, seen[side].half_width)
        assert edges == pytest.approx((own.heel, own.toe, own.half_width), abs=1e-3)


def places(robot: Skeleton) -> dict[str, list[list[float]]]:
    """Group → where its joints are as drawn."""
    found = {f"{side}_leg": leg.joints for side, leg in robot.legs.items()} | {"torso": robot.waist}
    found |= {f"{side}_arm": arm.joints for side, arm in robot.arms.items()} | {"neck": robot.neck}
    return {
        group: np.round(robot.source.data.xanchor[joints] @ robot.forward, 6).tolist()
        for group, joints in found.items()
    }


def test_names_do_not_matter(tmp_path: Path) -> None:
    """ESCHER with every body and joint called otherwise, so that names say nothing of sides."""
    text = (ROBOTS / "escher" / "model.xml").read_text()
    number = itertools.count()
    renamed = re.sub(r'(<(?:body|joint)[^>]*?name=)"[^"]*"', lambda match: f'{match[1]}"n{next(number)}"', text)
    renamed = re.sub(r"<contact>.*</contact>", "", renamed, flags=re.S)
    renamed = re.sub(r"<sensor>.*</sensor>", "", renamed, flags=re.S)
    (tmp_path / "model.xml").write_text(renamed)
    assert places(skeleton(Source(tmp_path / "model.xml"))) == places(skeleton(Source(ROBOTS / "escher" / "model.xml")))


@pytest.mark.parametrize(
    "built",
    [
        Build(waist="zy", root="chest"),
        Build(waist="zy", mirrored=True),
        Build(waist="zy", knee=-1, shuffled=True),
        Build(waist="zy", root="chest", together=True),
        Build(waist="zy", named=False, drive="none"),
        Build(waist="zy", heading=np.pi),
        Build(waist="zy", root="chest", heading=-np.pi / 2),
    ],
    ids=["root", "mirrored", "knees and controls", "one body", "names", "backwards", "along y"],
)
def test_the_same_body_has_the_same_roles_however_it_is_built(built: Build, tmp_path: Path) -> None:
    seen, plain = places(found(built, tmp_path / "built")), places(found(Build(waist="zy"), tmp_path / "plain"))
    if built.waist and built.root == "chest":
        seen["torso"].sort(), plain["torso"].sort()
    assert seen == plain


@examples(25)
@given(
    st.permutations("zxy").map("".join),
    st.text("xyz", max_size=3),
    st.integers(4, 7),
    st.sampled_from(("pelvis", "chest")),
    st.floats(-np.pi, np.pi),
)
def test_any_hips_waist_and_arms_are_seen(
    tmp_path_factory: pytest.TempPathFactory,
    hip: str,
    waist: str,
    arm: int,
    root: Literal["pelvis", "chest"],
    heading: float,
) -> None:
    heading = round(heading / (np.pi / 2)) * np.pi / 2
    seen = found(Build(hip=hip, waist=waist, arm=arm, root=root, heading=heading), tmp_path_factory.mktemp("model"))
    assert [len(leg.joints) for leg in seen.legs.values()] == [6, 6]
    assert [len(limb.joints) for limb in seen.arms.values()] == [arm, arm]
    assert (len(seen.waist), len(seen.neck)) == (len(waist), 2)
    looking = [np.cos(heading), np.sin(heading), 0.0]
    assert seen.forward[:, 0] == pytest.approx(looking, abs=1e-6)
    assert seen.name(seen.legs["left"].end) == "left_foot"
