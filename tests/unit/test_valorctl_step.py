"""Plans from files and from the small planner are plans that the robot takes."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec.structs import replace
from vigir_footstep_planning_msgs.msg import Step, StepPlan

from harness.places import REPOSITORY, ROBOTS
from valor.common.errors import ConfigurationError, ValorError
from valor.common.poses import Pose, level, middle
from valor.footstep_converter.plan import convert
from valor.robot.description import RobotDescription
from valor.robot.footsteps import StepRule
from valor.robot.motion_tables import Footsteps
from valor.robot.step_plan import FEET, PlanStep, load
from valor.robot.step_planner import plan_to
from valor.valorctl import step_picture
from valor.valorctl.stepping import intention

ROBOT = RobotDescription.load(ROBOTS / "escher")
_footsteps = ROBOT.tables.footsteps
assert _footsteps is not None
TABLE = _footsteps
PLANS = sorted((REPOSITORY / "examples" / "plans").glob("*.yaml"))
HALF = 0.5 * ROBOT.tables.walking.step_width


def message(steps: list[PlanStep], width: float = 2 * HALF) -> StepPlan:
    """The plan for a robot whose feet stand side by side around odom's origin."""
    plan = StepPlan()
    plan.header.frame_id = plan.start.header.frame_id = "odom"
    plan.start.right.foot_index = 1
    plan.start.left.pose.position.y, plan.start.right.pose.position.y = width / 2, -width / 2
    for index, each in enumerate(steps):
        step = Step(step_index=index, valid=True, swing_height=each.swing_height)
        step.step_duration, step.sway_duration = each.step_duration, each.sway_duration
        step.foot.foot_index = FEET.index(each.foot)
        p, q = step.foot.pose.position, step.foot.pose.orientation
        p.x, p.y, p.z = each.sole.position
        q.w, q.x, q.y, q.z = each.sole.orientation
        plan.steps.append(step)
    return plan


@pytest.mark.parametrize("file", PLANS, ids=lambda file: file.stem)
def test_every_example_is_a_good_plan(file: Path) -> None:
    steps = load(file).steps
    assert len(convert(message(steps), StepRule(TABLE, ROBOT.tables.feet))) == len(steps)


def test_there_are_ten_examples() -> None:
    assert len(PLANS) == 10


coordinates = st.floats(-2.0, 2.0)
SHORT = (replace(TABLE, max_forward=0.36, max_backward=0.18, max_width=0.36, max_distance=0.252), 0.2126)
"""Of a robot on short legs that stands wide, and the width of its steps [m]."""


@pytest.mark.parametrize(("limits", "width"), [(TABLE, 2 * HALF), SHORT], ids=["escher", "short legs"])
@example(x=0.0, y=0.25, yaw=-3.0)  # to the left while turning to the right
@example(x=0.604, y=0.0, yaw=0.0)
@given(coordinates, coordinates, st.floats(-math.pi, math.pi))
def test_the_planner_ends_exactly_at_its_goal_within_the_limits(
    limits: Footsteps, width: float, x: float, y: float, yaw: float
) -> None:
    try:
        steps = plan_to((x, y, yaw), limits, replace(ROBOT.tables.walking, step_width=width))
    except ValorError as error:
        assert "a plan has at most 50" in str(error)
        assert math.hypot(x, y) > 0.5
        return
    if not steps:
        assert math.hypot(x, y) < 1e-6
        return
    taken = convert(message(steps, width), StepRule(limits, ROBOT.tables.feet))
    feet = {step.foot: step.sole for step in taken[-2:]}
    end = middle(feet[0], feet[1])
    assert math.dist(end.position, (x, y, 0.0)) < 1e-9
    assert abs(math.remainder(end.yaw - yaw, math.tau)) < 1e-9
    assert math.dist(feet[0].position, feet[1].position) == pytest.approx(width)


@pytest.mark.parametrize("goal", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (1e300, 0.0, 0.0), (50.0, 0.0, 0.0)])
def test_a_goal_that_cannot_be_is_refused(goal: tuple[float, float, float]) -> None:
    with pytest.raises(ValorError, match=r"expected finite|farther than a plan of \d+ steps"):
        plan_to(goal, TABLE, ROBOT.tables.walking)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("steps: []", "steps: expected a list of length >= 1"),
        ("{", "plan.yaml:2:1: "),
        ("steps: [{foot: middle, x: 0, y: 0}]", "steps.0.foot: expected left or right, got 'middle'"),
        ("steps: [{foot: left, x: .nan, y: 0}]", "steps.0.x: expected a finite number, got nan"),
        ("steps: [{foot: left, x: 0, y: 0, toe: 1}]", "steps.0.toe: unknown key"),
        ("12", "(whole file): expected a mapping, got 12"),
    ],
)
def test_a_broken_file_is_refused_in_one_line(tmp_path: Path, text: str, error: str) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        load(file)
    assert error in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    start = (level(0.0, HALF, 0.0, 0.0), level(0.0, -HALF, 0.0, 0.0))
    steps = [(FEET.index(step.foot), step.sole) for step in load(PLANS[0]).steps]
    file = tmp_path / "plan.png"
    step_picture.draw(file, ROBOT.tables.feet, start, steps, (Pose(), Pose()))
    assert file.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValorError, match="cannot be written"):
        step_picture.draw(tmp_path / "none" / "plan.png", ROBOT.tables.feet, start, steps, None)


def test_what_is_about_to_be_done_is_told_from_where_the_robot_stands() -> None:
    steps = plan_to((-3.0, 0.0, 0.0), TABLE, ROBOT.tables.walking)
    assert intention(steps, (-3.0, 0.0, 0.0), relative=False).startswith(f"{len(steps)} steps: 3.00 m back (from here")
    assert "--relative" in intention(steps, (-3.0, 0.0, 0.0), relative=False)
    told = intention(steps, (1.0, -0.2, math.radians(-30.0)), relative=True)
    assert "1.00 m ahead, 0.20 m to the right, 30° right" in told
    assert "odom" not in told
