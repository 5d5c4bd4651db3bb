"""Roles by topology and geometry: as in ESCHER's and THOR's files, regardless of names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from harness.generated_robot import Build
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import written
from valor.robot.description import RobotDescription
from valor.robot_setup.new import draft_robot
from valor.robot_setup.robot_yaml import groups
from valor.robot_setup.skeleton import Skeleton, find_skeleton
from valor.robot_setup.source import Source


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_roles_and_soles_are_those_of_the_robots_own_file(name: str) -> None:
    tables = RobotDescription.load(ROBOTS / name).tables
    content = draft_robot(ROBOTS / name / "model.xml", name)
    seen, soles = content.robot, content.geometry.soles
    # The lidar rotates on the head; in the model alone it is the end of the neck.
    expected = {group: list(joints) for group, joints in tables.groups.items() if group != "lidar"}
    expected["neck"] += tables.groups["lidar"]
    assert groups(seen) == expected and (seen.name(seen.pelvis), seen.name(seen.chest)) == (tables.base, tables.chest)
    for side in ("left", "right"):
        assert seen.name(seen.legs[side].end) == getattr(tables.feet, side).body
        assert tables.hands is not None and seen.name(seen.arms[side].end) == getattr(tables.hands, side).body
        own = getattr(tables.feet, side)
        edges = (soles[side].heel, soles[side].toe, soles[side].half_width)
        assert edges == pytest.approx((own.heel, own.toe, own.half_width), abs=1e-3)


def places(robot: Skeleton) -> dict[str, list[list[float]]]:
    """Return group → positions of its joints as drawn."""
    found = {f"{side}_leg": leg.joints for side, leg in robot.legs.items()} | {"torso": robot.waist}
    found |= {f"{side}_arm": arm.joints for side, arm in robot.arms.items()} | {"neck": robot.neck}
    return {
        group: np.round(robot.source.data.xanchor[joints] @ robot.forward, 6).tolist()
        for group, joints in found.items()
    }


@pytest.mark.parametrize(
    "built",
    [
        Build(waist="zy", mirrored=True),
        Build(waist="zy", knee=-1, shuffled=True),
        Build(waist="zy", root="chest", together=True),
        Build(waist="zy", named=False, drive="none"),
        Build(waist="zy", root="chest", heading=-np.pi / 2),
    ],
    ids=["mirrored", "knees and controls", "one body", "names", "along y"],
)
def test_the_same_body_has_the_same_roles_however_it_is_built(built: Build, tmp_path: Path) -> None:
    seen, plain = (
        places(find_skeleton(Source(written(each, tmp_path / name))))
        for each, name in ((built, "built"), (Build(waist="zy"), "plain"))
    )
    if built.waist and built.root == "chest":
        seen["torso"].sort(), plain["torso"].sort()
    assert seen == plain
