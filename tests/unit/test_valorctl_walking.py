"""`walk`: rejection of impossible requests, and the return to the line."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec.structs import replace
from vigir_footstep_planning_msgs.msg import Step, StepPlan

from harness.motion_states import motion_state
from harness.places import REPOSITORY, ROBOTS
from valor.common.errors import ConfigurationError, ValorError
from valor.common.poses import middle
from valor.drawing import RenderingError
from valor.footstep_converter.plan import convert
from valor.robot.description import RobotDescription
from valor.robot.footsteps import StepRule
from valor.robot.motion_tables import Footsteps
from valor.robot.step_plan import FEET, PlanStep, load, plan_to
from valor.valorctl.demos import demonstration
from valor.valorctl.drive.walking import SIDEWAYS, TURNING, CourseLine, WalkRequest, _Run
from valor.valorctl.terminal.console import InterruptedBySignalError, Interruption, Progress


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({"forward": math.nan, "seconds": 1.0}, "--vx nan: expected a finite number"),
        ({"forward": 0.1, "distance": math.inf}, "--distance inf: expected a finite number"),
        ({"forward": 0.1, "seconds": 0.0}, "--for 0: expected more than 0"),
        ({"turn": 0.1, "distance": 1.0}, "--distance 1: expected --vx or --vy"),
        ({"forward": 0.1, "turn": 0.1, "seconds": 1.0, "straight": True}, "--straight keeps the heading"),
        ({"forward": 0.1}, "--for or --distance"),
        ({"seconds": 1.0}, "no velocity: expected --vx, --vy or --wz other than 0"),
    ],
)
def test_impossible_requests_are_rejected(order: dict[str, Any], words: str) -> None:
    with pytest.raises(ValorError, match=words):
        WalkRequest(**order)


@pytest.mark.parametrize("robot", ["escher", "thor"])
def test_velocities_above_the_limits_are_rejected(robot: str) -> None:
    limits = RobotDescription.load(ROBOTS / robot).tables.walking
    order = WalkRequest(limits.max_forward_speed, -limits.max_lateral_speed, limits.max_turn_rate, seconds=1.0)
    order.require_within(limits, robot)
    for beyond, words in (
        ({"forward": limits.max_forward_speed + 0.01}, f"to {limits.max_forward_speed:g} m/s"),
        ({"forward": -limits.max_backward_speed - 0.01}, f"-{limits.max_backward_speed:g} to"),
        ({"left": limits.max_lateral_speed + 0.01}, f"--vy {limits.max_lateral_speed + 0.01:g}: {robot} walks at"),
        ({"turn": -limits.max_turn_rate - 0.01}, f"{limits.max_turn_rate:g} rad/s"),
    ):
        with pytest.raises(ValorError, match=words):
            WalkRequest(**dict[str, Any](beyond), seconds=1.0).require_within(limits, robot)


@given(
    heading=st.floats(-3.0, 3.0), forward=st.floats(-0.3, 0.5), left=st.floats(-0.2, 0.2),
    offset=st.floats(-1.0, 1.0), off=st.floats(-0.5, 0.5),
)  # fmt: skip
def test_a_robot_aside_returns_to_its_line(
    heading: float, forward: float, left: float, offset: float, off: float
) -> None:
    """A point without dynamics ends on the line with its first heading, within the sideways limit."""
    if math.hypot(forward, left) < 0.05:
        return
    line = CourseLine(motion_state(position=(1.0, 2.0), heading=heading), forward, left)
    direction = heading + math.atan2(left, forward)
    along = np.array([math.cos(direction), math.sin(direction)])
    normal = np.array([-along[1], along[0]])
    place, psi = np.array([1.0, 2.0]) + offset * normal, heading + off
    for _ in range(600):
        state = motion_state(position=(place[0], place[1]), heading=psi)
        x, y, turn = line.steer(state)
        velocity = np.array([x * math.cos(psi) - y * math.sin(psi), x * math.sin(psi) + y * math.cos(psi)])
        assert velocity @ along == pytest.approx(math.hypot(forward, left))
        assert abs(velocity @ normal) <= SIDEWAYS + 1e-9
        assert abs(turn) <= TURNING
        place, psi = place + 0.1 * velocity, psi + 0.1 * turn
    way, beside = line.place(motion_state(position=(place[0], place[1]), heading=psi))
    assert abs(beside) < 0.01
    assert abs(line.turned(motion_state(position=(place[0], place[1]), heading=psi))) < 0.01
    assert way == pytest.approx(60.0 * math.hypot(forward, left), rel=1e-3)


def test_a_walk_ends_when_robot_time_restarts() -> None:
    run = _Run(WalkRequest(forward=0.3, seconds=60.0), motion_state(time=50 * 10**9))
    walked = [motion_state((0.3 * i, 0.0), time=(50 + i) * 10**9) for i in range(4)]
    run.consider([*walked, motion_state(time=10**9), motion_state(time=2 * 10**9)])
    assert run.over
    result = run.result()
    assert result.duration == 3.0 and result.distance == pytest.approx(0.9) and "restarted" in result.reason


# Footstep plans from files and from the planner of `step`.
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
def test_examples_are_valid_plans(file: Path) -> None:
    assert len(PLANS) == 10
    steps = load(file).steps
    assert len(convert(message(steps), StepRule(TABLE, ROBOT.tables.feet))) == len(steps)


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
        assert "expected at most 50" in str(error)
        assert math.hypot(x, y) > 0.5
        return
    if not steps:
        assert math.hypot(x, y) < 1e-6
        return
    taken = convert(message(steps, width), StepRule(limits, ROBOT.tables.feet))
    feet = {step.foot: step.sole for step in taken[-2:]}
    end = middle(feet[0], feet[1])
    assert math.dist(end.position, (x, y, 0.0)) < 1e-9 and abs(math.remainder(end.yaw - yaw, math.tau)) < 1e-9
    assert math.dist(feet[0].position, feet[1].position) == pytest.approx(width)


@pytest.mark.parametrize("goal", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (1e300, 0.0, 0.0), (50.0, 0.0, 0.0)])
def test_an_impossible_goal_is_rejected(goal: tuple[float, float, float]) -> None:
    with pytest.raises(ValorError, match=r"expected finite|exceeds a plan of \d+ steps"):
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
def test_an_invalid_file_is_rejected_in_one_line(tmp_path: Path, text: str, error: str) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        load(file)
    assert error in str(refused.value) and "\n" not in str(refused.value)


# Demonstrations of which a part fails.
def written(file: Path) -> list[Path]:
    file.write_bytes(b"picture")
    return [file]


def without_opengl() -> list[Path]:
    raise RenderingError("no off-screen OpenGL here")


def test_a_picture_that_fails_does_not_prevent_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, last = tmp_path / "first.png", tmp_path / "last.png"
    failures = demonstration.Failures()
    drawings = [("a", lambda: written(first)), ("b", without_opengl), ("c", lambda: written(last))]
    made = demonstration.draw(drawings, failures, Progress(), Interruption())
    assert made == [first, last]
    demonstration.list_files([tmp_path / "absent.mcap", *made], Progress())
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [str(first), str(last)]
    with pytest.raises(RenderingError, match="no off-screen OpenGL here"):
        failures.raise_first()


def test_the_first_failure_is_reported_and_an_interruption_ends_at_once() -> None:
    failures = demonstration.Failures()
    with pytest.raises(InterruptedBySignalError), failures.kept():
        raise InterruptedBySignalError(2)
    failures.raise_first()  # none
    for text in ("the robot fell", "no walk in the bag"):
        with failures.kept():
            raise ValorError(text)
    with pytest.raises(ValorError, match="the robot fell"):
        failures.raise_first()
