"""From a planner's plan to feet on the ground: the whole way through real processes, plant and model different.

The client is an ordinary ROS 2 node; a foot's place is tf's. The simulator's truth is looked at here alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest
from action_msgs.msg import GoalStatus
from msgspec import structs
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from harness.places import REPOSITORY
from harness.step_system import (
    LIMIT,
    ROBOT,
    Goal,
    Stance,
    Walker,
    error,
    message,
    pose_of,
    put,
    system,
)
from harness.waiting import wait_until
from valor.common.poses import Pose, level
from valor.robot.step_plan import FEET, PlanStep, load

S = FootstepExecutionStatus
SUCCEEDED, ABORTED, CANCELED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED
PLANS = REPOSITORY / "examples" / "plans"
FAR, TURNED = 0.03, math.radians(3.0)  # a foot may end so far from the plan, as the robot believes
TRULY = 2.0  # so many times as far in truth: odometry drifts
EXACT = 1e-9  # [m]
QUICK = PlanStep(foot="left", x=0.0, y=0.0, step_duration=0.6, sway_duration=0.3)
pytestmark = pytest.mark.timeout(900)

Note = Callable[[str, object], None]


def ahead(count: int, length: float = 0.15) -> list[PlanStep]:
    """Steps straight ahead, the feet side by side in the end."""
    ends = [length * (i + 1) for i in range(count - 1)]
    return [
        PlanStep(foot=FEET[i % 2], x=x, y=0.1 - 0.2 * (i % 2))  # type: ignore[arg-type]
        for i, x in enumerate([*ends, ends[-1]])
    ]


def beside(foot: int, sole: Pose) -> tuple[int, Pose]:
    """The other foot, and where its sole stands beside this one's."""
    aside = ROBOT.tables.walking.step_width
    return 1 - foot, sole @ level(0.0, -aside if foot == 0 else aside, 0.0, 0.0)


def check_feet(walker: Walker, wanted: dict[int, Pose], before: Stance, note: Note) -> None:
    """The feet stand where they should, by the robot's belief and in truth.

    Args:
        walker: at rest.
        wanted: of each foot, in odom.
        before: where the feet stood before the plan, from where truth is measured.
        note: keeps a number for the record.
    """
    believed, true = walker.soles(), walker.true_soles()
    for foot, place in wanted.items():
        for how, (far, turned), most in (
            ("believed", error(believed[foot], place), 1.0),
            ("true", error(true[foot], before.to_world @ place), TRULY),
        ):
            note(f"{FEET[foot]}_{how}", f"{far * 100:.1f} cm, {math.degrees(turned):.1f}°")
            print(f"{FEET[foot]} foot, {how}: {far * 100:.1f} cm, {math.degrees(turned):.1f}°")
            assert far < most * FAR, f"the {FEET[foot]} foot, {how}"
            assert turned < most * TURNED, f"the {FEET[foot]} foot, {how}"


def check_indices(goal: Goal, last: int) -> None:
    """The client has heard of every step, and no index went back."""
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
    """Whether the VRC has reported it as a change from outside."""
    report = walker.report
    return report.current_control_mode == "stand" and bool(report.status & ControlModeStatus.EXTERNAL_CHANGE)


def test_up_the_stairs_and_the_loss_of_the_motion_manager(record_property: Note) -> None:
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
        check_feet(walker, dict(planned), before, record_property)
        assert min(sole.position[2] for sole in walker.true_soles()) > 0.27

        walker.mode("step")
        goal = walker.send(message(put(ahead(6, 0.1), walker.stance().middle), QUICK))
        walker.wait(lambda: goal.executing >= 1, "step 1")
        walker.instance.kill("motion_manager")
        wait_until(lambda: goal.result, LIMIT, "the end of a plan of which nobody says anything")
        assert goal.outcome == (ABORTED, S.ERR_CONTROLLER_NOT_READY | S.PREMATURE_HALT)
        assert "no word of the Motion Manager" in walker.text(goal)


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


def test_a_figure_of_eight(walker: Walker, record_property: Note) -> None:
    steps = load(PLANS / "figure_of_eight.yaml").steps
    assert len(steps) == 20
    before = walker.stance()
    planned = put(steps, before.middle)
    goal = walker.send(message(planned, steps))
    assert walker.outcome(goal) == (SUCCEEDED, S.REACHED_GOAL)
    wait_until(lambda: stands_after_the_plan(walker), LIMIT, "mode stand after the plan")
    walker.rest()
    check_feet(walker, dict(planned), before, record_property)
    check_indices(goal, 19)


def test_an_update_in_mid_walk(walker: Walker, record_property: Note) -> None:
    """The planner has drifted, and wants to go elsewhere; two updates before it are none."""
    before = walker.stance()
    planned = put(ahead(30, 0.1), before.middle)
    goal = walker.send(message(planned, QUICK))
    walker.wait(lambda: goal.executing >= 1, "step 1")
    gap = message(planned[20:22], QUICK, first=40)
    assert walker.outcome(walker.send(gap)) == (ABORTED, S.ERR_INVALID_INCONSISTENT_INDICES)
    other_feet = message(planned[1:], QUICK)
    assert walker.outcome(walker.send(other_feet)) == (ABORTED, S.ERR_INCONSISTENT_STEP_PLAN)
    assert goal.result is None

    at, drift = goal.executing, level(0.05, -0.03, 0.0, 0.1)
    path = [
        (foot, drift @ sole @ level(0.05 * i, 0.0, 0.0, 0.0)) for i, (foot, sole) in enumerate(planned[at : at + 8])
    ]
    path.append(beside(*path[-1]))
    update = walker.send(message(path, QUICK, first=at))
    assert walker.outcome(goal) == (ABORTED, S.UPDATED_STEP_PLAN)
    first = int(walker.text(goal).split("from step ")[1].split()[0])  # a newer plan took over from step … on
    assert first > at
    assert walker.outcome(update) == (SUCCEEDED, S.REACHED_GOAL)
    walker.rest()
    merged = [(step.foot.foot_index, pose_of(step)) for step in update.active[-1].feedback.steps]
    assert len(merged) == at + len(path)
    for (one, is_at), (other, was_at) in zip(merged[: first + 1], planned[: first + 1], strict=True):
        assert one == other
        assert math.dist(is_at.position, was_at.position) < EXACT, "what cannot be changed, and the step in common"
    for k in range(first + 1, len(merged)):  # the rest is moved rigidly
        (a, b), (c, d) = ([sole for _, sole in pair] for pair in (merged[k - 1 : k + 1], path[k - 1 - at : k + 1 - at]))
        assert math.dist((a.inverse() @ b).position, (c.inverse() @ d).position) < EXACT
    check_feet(walker, dict(merged), before, record_property)


def test_a_cancel_in_mid_swing(walker: Walker, record_property: Note) -> None:
    before = walker.stance()
    planned = put(ahead(8, 0.2), before.middle)
    goal = walker.send(message(planned, structs.replace(QUICK, step_duration=1.2)))
    walker.wait(lambda: goal.executing >= 2, "step 2")
    walker.wait(lambda: not walker.state().contacts.all(), "a foot in the air", period=0.002)
    walker.cancel(goal)
    assert walker.outcome(goal) == (CANCELED, S.PREMATURE_HALT)
    stopped = next(status for status in walker.status() if status.reason)
    last = stopped.executing_step_index  # 2, unless the machine is slower than a swing
    assert last >= 2, "stopped while a foot swung"
    assert walker.status()[-1].last_performed_step_index == last + 1  # beside it
    walker.rest()
    assert walker.state().behavior == "stand"
    foot, sole = planned[last]
    check_feet(walker, dict([(foot, sole), beside(foot, sole)]), before, record_property)


def test_a_change_of_mode_in_mid_plan(walker: Walker) -> None:
    """The plan is given as seen from a sole. Freeze would topple a robot that steps, and is refused; Stand is not."""
    right = walker.soles()[1]
    planned = put(ahead(20, 0.1), walker.stance().middle)
    seen = [(foot, right.inverse() @ sole) for foot, sole in planned]
    goal = walker.send(message(seen, QUICK, frame="r_sole"))
    walker.wait(lambda: goal.executing >= 0, "step 0")
    for step, (_, sole) in zip(goal.active[-1].feedback.steps, planned, strict=True):
        far, turned = error(pose_of(step), sole)
        assert far < 0.3 * FAR
        assert turned < 0.3 * TURNED
    refused = walker.ros.change_mode("freeze", LIMIT)
    assert refused.status & ControlModeStatus.MODE_REJECTED
    assert refused.current_control_mode == "step"
    at = goal.executing
    walker.wait(lambda: goal.executing > at, "another step")
    walker.mode("stand")
    assert walker.outcome(goal) == (ABORTED, S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT)
    assert "requested by" in walker.text(goal)
    walker.rest()
    assert walker.state().behavior == "stand"


def test_a_soft_stop_in_mid_plan(walker: Walker) -> None:
    goal = walker.send(message(put(ahead(20, 0.1), walker.stance().middle), QUICK))
    walker.wait(lambda: goal.executing >= 1, "step 1")
    walker.mode("soft_stop")
    assert walker.outcome(goal) == (ABORTED, S.EMERGENCY_HALT)
    assert "went to 'soft_stop'" in walker.text(goal)
    walker.rest()
    assert walker.state().behavior == "soft_stop"
    assert walker.status()[-1].last_performed_step_index < 19
    walker.mode("stand")


def test_a_fall_in_mid_plan(walker: Walker) -> None:
    """The last in this system: a robot that has fallen stays so."""
    planned = put(ahead(20, 0.1), walker.stance().middle)
    goal = walker.send(message(planned, QUICK))
    walker.wait(lambda: goal.executing >= 2, "step 2")
    walker.push((0.0, 300.0, 0.0))
    assert walker.outcome(goal) == (ABORTED, S.ERR_FALLEN | S.EMERGENCY_HALT)
    assert "went to 'fall'" in walker.text(goal)
    refused = walker.send(message(planned, QUICK))
    assert walker.outcome(refused) == (ABORTED, S.ERR_INVALID_BEHAVIOR_MODE | S.ERR_FALLEN)
