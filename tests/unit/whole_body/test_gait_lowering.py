"""The CoM is lowered where legs would be stretched too far, and not because hips are wide."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from harness.places import ROBOTS
from valor.robot.description import RobotDescription
from valor.whole_body.walking.gait import Gait
from valor.whole_body.walking.swing import SolePose

ROBOT = RobotDescription.load(ROBOTS / "escher")


def lowering(robot: RobotDescription, forward: float, left: float) -> float:
    """Of the CoM for a step from one sole to another [m]."""
    one, other = (SolePose(np.array(place), np.eye(3)) for place in ((0.0, 0.0, 0.0), (forward, left, 0.0)))
    return Gait(robot, 3.5, 0.9)._lowering(one, other)


def widened(width: float) -> RobotDescription:
    """ESCHER with its feet so far apart [m]."""
    walking = msgspec.structs.replace(ROBOT.tables.walking, step_width=width)
    return RobotDescription(ROBOT.folder, msgspec.structs.replace(ROBOT.tables, walking=walking), ruled=False)


def test_a_long_step_lowers_the_com() -> None:
    assert lowering(ROBOT, 0.5, 0.2) > lowering(ROBOT, 0.3, 0.2) >= 0.0


@pytest.mark.parametrize("width", [0.3, 0.5, 0.7])
def test_feet_below_wide_hips_lower_it_no_more_than_eschers(width: float) -> None:
    usual = ROBOT.tables.walking.step_width
    for forward in (0.0, 0.3, 0.5):
        assert lowering(widened(width), forward, width) == pytest.approx(lowering(ROBOT, forward, usual), abs=1e-12)
        assert lowering(widened(width), forward, width + 0.2) >= lowering(widened(width), forward, width)


def test_what_is_lowered_at_most_goes_by_the_leg() -> None:
    size = msgspec.structs.replace(ROBOT.tables.size, leg=ROBOT.tables.size.leg / 2)
    short = RobotDescription(ROBOT.folder, msgspec.structs.replace(ROBOT.tables, size=size), ruled=False)
    assert lowering(short, 3.0, 0.2) == pytest.approx(lowering(ROBOT, 3.0, 0.2) / 2)
