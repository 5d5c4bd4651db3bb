"""From a planner's plan to feet on the ground: the whole way through real processes, plant and model different.

The client is an ordinary ROS 2 node; a foot's place is tf's. The simulator's truth is looked at here alone.
"""

import math
from collections.abc import Iterator
from itertools import pairwise

import pytest
from action_msgs.msg import GoalStatus
from msgspec import structs
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from harness.places import REPOSITORY
from harness.waiting import wait_until
from tests.integration.plan_client import Goal
from tests.integration.step_system import LIMIT, ROBOT, Stance, Walker, error, message, put, system
from valor.common.poses import Pose, level
from valor.robot.step_plan import FEET, PlanStep, load

S = FootstepExecutionStatus
SUCCEEDED, ABORTED, CANCELED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED
PLANS = REPOSITORY / "examples" / "plans"
FAR, TURNED = 0.03, math.radians(3.0)  # a foot may end so far from the plan, as the robot believes
TRULY = 2.0  # so many times as far in truth: odometry drifts
QUICK = PlanStep(foot="left", x=0.0, y=0.0, step_duration=0.6, sway_duration=0.3)
pytestmark = pytest.mark.timeout(900)


def ahead(count: int, length: float = 0.15) -> list[PlanStep]:
    """Steps straight ahead, the feet side by side in the end."""
    ends = [length * (i + 1) for i in range(count - 1)]
    return [PlanStep(foot=FEET[i % 2], x=x, y=0.1 - 0.2 * (i % 2)) for i, x in enumerate([*ends, ends[-1]])]


def beside(foot: int, sole: Pose) -> tuple[int, Pose]:
    """The other foot, and where its sole stands beside this one's."""
    aside = ROBOT.tables.walking.step_width
    return 1 - foot, sole @ level(0.0, -aside if foot == 0 else aside, 0.0, 0.0)


def check_feet(walker: Walker, wanted: dict[int, Pose], before: Stance) -> None:
    """The feet of a robot at rest stand at poses in odom, as estimated and in truth, measured from before the plan."""
    estimated, true = walker.soles(), walker.true_soles()
    for foot, place in wanted.items():
        for how, (far, turned), most in (
            ("estimated", error(estimated[foot], place), 1.0),
            ("true", error(true[foot], before.to_world @ place), TRULY),
        ):
            assert far < most * FAR, f"the {FEET[foot]} foot, {how}: {far * 100:.1f} cm"
            assert turned < most * TURNED, f"the {FEET[foot]} foot, {how}: {math.degrees(turned):.1f}°"


def check_indices(goal: Goal, last: int) -> None:
    """The client has received every step, and no index went back."""
    indices = [
        (f.last_performed_step_index, f.currently_executing_step_index, f.first_changeable_step_index)
        for f in goal.active
    ]
    assert all(performed <= executing < changeable for performed, executing, changeable in indices)
    for one, other in pairwise(indices):
        assert all(a <= b for a, b in zip(one, other, strict=True))
    assert {executing for _, executing, _ in indices} >= set(range(last + 1))
    assert {performed for performed, _, _ in indices} >= set(range(last + 1))
    stamps = [(f.header.stamp.sec, f.header.stamp.nanosec) for f in goal.active]
    assert stamps == sorted(stamps)


def stands_after_the_plan(walker: Walker) -> bool:
    """Return whether the VRC has reported it as a change from outside."""
    report = walker.report
    return report.current_control_mode == "stand" and bool(report.status & ControlModeStatus.EXTERNAL_CHANGE)


def test_up_the_stairs_and_the_loss_of_the_motion_manager() -> None:
    """Three steps of 10 cm; on the landing, another plan, in the middle of which nobody controls the robot any more."""
    with system("stairs", world="stairs", actuators="hardware", seed=2) as walker:
        walker.mode("step")
        walker.rest()
        steps = load(PLANS / "stairs.yaml").steps
        before = walker.stance()
        planned = put(steps, before.middle)
        goal = walker.send(message(planned, steps))
        assert walker.outcome(goal) == (SUCCEEDED, S.REACHED_GOAL)
        walker.rest()
        check_feet(walker, dict(planned), before)
        assert min(sole.position[2] for sole in walker.true_soles()) > 0.27

        walker.mode("step")
        goal = walker.send(message(put(ahead(6, 0.1), walker.stance().middle), QUICK))
        walker.wait(lambda: goal.executing >= 1, "step 1")
        walker.instance.kill("motion_manager")
        wait_until(lambda: goal.result, LIMIT, "the end of a plan of which nobody says anything")
        assert walker.plans.outcome(goal)[:2] == (ABORTED, S.ERR_CONTROLLER_NOT_READY | S.PREMATURE_HALT)
        assert "no message of the Motion Manager" in walker.plans.outcome(goal)[2]


@pytest.fixture(scope="module")
def flat() -> Iterator[Walker]:
    with system("steps", actuators="hardware", seed=1) as walker:
        yield walker


@pytest.fixture
def walker(flat: Walker) -> Walker:
    """Ready to take a plan."""
    flat.mode("step")
    flat.rest()
    return flat


def test_a_figure_of_eight(walker: Walker) -> None:
    steps = load(PLANS / "figure_of_eight.yaml").steps
    assert len(steps) == 20
    before = walker.stance()
    planned = put(steps, before.middle)
    goal = walker.send(message(planned, steps))
    assert walker.outcome(goal) == (SUCCEEDED, S.REACHED_GOAL)
    wait_until(lambda: stands_after_the_plan(walker), LIMIT, "mode stand after the plan")
    walker.rest()
    check_feet(walker, dict(planned), before)
    check_indices(goal, 19)


def test_a_cancel_in_mid_swing(walker: Walker) -> None:
    before = walker.stance()
    planned = put(ahead(8, 0.2), before.middle)
    goal = walker.send(message(planned, structs.replace(QUICK, step_duration=1.2)))
    walker.wait(lambda: goal.executing >= 2, "step 2")
    walker.wait(lambda: not walker.state().contacts.all(), "a foot in the air", period=0.002)
    walker.plans.cancel(goal)
    assert walker.outcome(goal) == (CANCELED, S.PREMATURE_HALT)
    stopped = next(status for status in walker.status() if status.reason)
    last = stopped.executing_step_index  # 2, unless the machine is slower than a swing
    assert last >= 2, "stopped while a foot swung"
    assert walker.status()[-1].last_performed_step_index == last + 1  # beside it
    walker.rest()
    assert walker.state().behavior == "stand"
    foot, sole = planned[last]
    check_feet(walker, dict([(foot, sole), beside(foot, sole)]), before)


def test_a_fall_in_mid_plan(walker: Walker) -> None:
    """The last in this system: a robot that has fallen stays so."""
    planned = put(ahead(20, 0.1), walker.stance().middle)
    goal = walker.send(message(planned, QUICK))
    walker.wait(lambda: goal.executing >= 2, "step 2")
    walker.push((0.0, 300.0, 0.0))
    assert walker.outcome(goal) == (ABORTED, S.ERR_FALLEN | S.EMERGENCY_HALT)
    assert "entered 'fall'" in walker.plans.outcome(goal)[2]
    refused = walker.send(message(planned, QUICK))
    assert walker.outcome(refused) == (ABORTED, S.ERR_INVALID_BEHAVIOR_MODE | S.ERR_FALLEN)
