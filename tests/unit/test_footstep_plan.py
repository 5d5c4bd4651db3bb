"""A broken plan never becomes footsteps; a good one becomes exactly the footsteps that it states."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vigir_footstep_planning_msgs.msg import ErrorStatus, Foot, FootstepExecutionStatus, Step, StepPlan

from harness.places import ROBOTS
from valor.common.poses import Pose, level
from valor.footstep_converter.motion_system import footstep
from valor.footstep_converter.plan import TERMS, PlanRejectedError, RunningPlan, convert, stamp
from valor.robot.description import RobotDescription
from valor.robot.footsteps import StepRule
from valor.robot.motion_tables import Footsteps
from valor.robot.soles import outline, overlap

ROBOT = RobotDescription.load(ROBOTS / "escher")
assert ROBOT.tables.footsteps is not None
REACH: Footsteps = ROBOT.tables.footsteps
LIMITS = StepRule(REACH, ROBOT.tables.feet, TERMS)
S = FootstepExecutionStatus


def quaternion(yaw: float, pitch: float = 0.0) -> tuple[float, float, float, float]:
    """(w, x, y, z) of a turn about y, then about z."""
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return cy * cp, -sy * sp, cy * sp, sy * cp


@dataclass(frozen=True)
class Move:
    """A step as seen from the other foot, with its parameters."""

    forward: float
    width: float
    up: float
    turn: float
    pitch: float
    swing_height: float
    step_duration: float
    sway_duration: float


def place(step: Step, x: float, y: float, z: float, q: tuple[float, float, float, float]) -> None:
    position, orientation = step.foot.pose.position, step.foot.pose.orientation
    position.x, position.y, position.z = x, y, z
    orientation.w, orientation.x, orientation.y, orientation.z = q


def make_plan(moves: list[Move], first_foot: int = Foot.LEFT) -> StepPlan:
    """A plan that walks the moves one after the other from somewhere in odom, with start feet given."""
    plan = StepPlan()
    plan.header.frame_id = plan.start.header.frame_id = "odom"
    plan.start.left.foot_index, plan.start.right.foot_index = Foot.LEFT, Foot.RIGHT
    x, y, z, yaw = 1.5, -0.7, 0.1, 0.3
    stance = plan.start.right if first_foot == Foot.LEFT else plan.start.left
    stance.pose.position.x, stance.pose.position.y, stance.pose.position.z = x, y, z
    q = stance.pose.orientation
    q.w, q.x, q.y, q.z = quaternion(yaw)
    for i, move in enumerate(moves):
        step = Step(step_index=i, valid=True)
        step.foot.foot_index = first_foot if i % 2 == 0 else 1 - first_foot
        left = move.width if step.foot.foot_index == Foot.LEFT else -move.width
        x += math.cos(yaw) * move.forward - math.sin(yaw) * left
        y += math.sin(yaw) * move.forward + math.cos(yaw) * left
        z += move.up
        yaw += move.turn
        place(step, x, y, z, quaternion(yaw, move.pitch))
        step.swing_height, step.step_duration, step.sway_duration = (
            move.swing_height, move.step_duration, move.sway_duration,
        )  # fmt: skip
        plan.steps.append(step)
    return plan


MOVE = Move(0.2, 0.22, 0.0, 0.0, 0.0, 0.08, 0.8, 0.4)


def within(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


def apart(move: Move) -> bool:
    """Return whether a sole, left or right, that moves so from the other's place is not on it."""
    places = [
        level(move.forward, width, 0.0, move.turn) @ Pose(orientation=quaternion(0.0, move.pitch))
        for width in (move.width, -move.width)
    ]
    foot = ROBOT.tables.feet.left  # the right one is as large
    stands = outline((0.0, 0.0), np.eye(3), foot)
    return not any(overlap(stands, outline(place.position, place.rotation, foot)) for place in places)


moves = st.builds(
    Move, forward=within(-REACH.max_backward, min(REACH.max_forward, REACH.max_distance)),
    width=within(REACH.min_width, min(REACH.max_width, REACH.max_distance)), up=within(-REACH.max_down, REACH.max_up),
    turn=within(-REACH.max_yaw, REACH.max_yaw),
    pitch=within(-REACH.max_tilt, REACH.max_tilt).map(lambda tilt: 0.99 * tilt),
    swing_height=within(0.0, REACH.max_swing_height),
    step_duration=st.just(0.0) | within(REACH.min_swing_duration, REACH.max_swing_duration),
    sway_duration=st.just(0.0) | within(REACH.min_transfer_duration, REACH.max_transfer_duration),
).filter(lambda move: math.hypot(move.forward, move.width) < REACH.max_distance and apart(move))  # fmt: skip
plans = st.builds(make_plan, st.lists(moves, min_size=1, max_size=6), st.sampled_from([Foot.LEFT, Foot.RIGHT]))


@given(plans)
def test_a_good_plan_converts_exactly(plan: StepPlan) -> None:
    for planned, step in zip(convert(plan, LIMITS), plan.steps, strict=True):
        sent, pose = footstep(planned), step.foot.pose
        assert (sent.step_index, sent.foot) == (step.step_index, step.foot.foot_index)
        assert sent.position_in_odom.tolist() == [pose.position.x, pose.position.y, pose.position.z]
        q = pose.orientation
        np.testing.assert_allclose(sent.orientation_in_odom, [q.w, q.x, q.y, q.z], rtol=0, atol=1e-12)
        durations = (step.step_duration, step.sway_duration)
        assert (sent.swing_height, sent.swing_duration, sent.transfer_duration) == (step.swing_height, *durations)


EXCESSES: dict[str, tuple[str, float, float]] = {
    "forward": ("forward of the other foot", -REACH.max_backward, REACH.max_forward),
    "width": ("width between the feet", REACH.min_width, REACH.max_width),
    "up": ("height above the other foot", -REACH.max_down, REACH.max_up),
    "turn": ("turned from the other foot", -REACH.max_yaw, REACH.max_yaw),
    "pitch": ("tilt of the sole", -REACH.max_tilt, REACH.max_tilt),
    "swing_height": ("swing_height", 0.0, REACH.max_swing_height),
    "step_duration": ("step_duration", REACH.min_swing_duration, REACH.max_swing_duration),
    "sway_duration": ("sway_duration", REACH.min_transfer_duration, REACH.max_transfer_duration),
}


@given(st.data(), st.sampled_from(sorted(EXCESSES)), st.integers(0, 3), st.floats(1e-3, 1.0), st.booleans())
def test_a_step_beyond_any_limit_is_refused_and_named(
    data: st.DataObject, what: str, at: int, excess: float, above: bool
) -> None:
    text, low, high = EXCESSES[what]
    parameters = vars(MOVE) | {what: high + excess if above else low - min(excess, 0.9 * abs(low) + 0.05)}
    if parameters[what] == 0.0:
        parameters[what] = -excess  # a duration of 0 is the robot's default
    steps = [MOVE] * 4
    steps[at] = Move(**parameters)
    with pytest.raises(PlanRejectedError) as refused:
        convert(make_plan(steps, data.draw(st.sampled_from([Foot.LEFT, Foot.RIGHT]))), LIMITS)
    assert text in str(refused.value) and f"step {at} " in str(refused.value)
    assert (refused.value.status, refused.value.error) == (S.ERR_INVALID_PLAN, ErrorStatus.ERR_INVALID_STEP)


def twice_the_same_foot(plan: StepPlan) -> None:
    plan.steps[2].foot.foot_index = plan.steps[1].foot.foot_index


def set_to(path: str, value: object) -> Callable[[StepPlan], None]:
    """Break a plan at ``path``, such as ``steps[1].foot.foot_index``."""

    def breaks(plan: StepPlan) -> None:
        *parents, name = path.replace("[", ".").replace("]", "").split(".")
        thing: object = plan
        for parent in parents:
            thing = thing[int(parent)] if parent.isdigit() else getattr(thing, parent)  # type: ignore[index]
        setattr(thing, name, value)

    return breaks


INCONSISTENT, INDICES, INVALID = (S.ERR_INCONSISTENT_STEP_PLAN, S.ERR_INVALID_INCONSISTENT_INDICES, S.ERR_INVALID_PLAN)
# fmt: off
BREAKS = [
    (set_to("steps", []), S.ERR_EMPTY_PLAN, "no steps"),
    (set_to("header.frame_id", "map"), INCONSISTENT, "start feet are in frame 'odom', the plan in 'map'"),
    (set_to("header.frame_id", ""), INCONSISTENT, "the plan has no frame"),
    (set_to("steps[1].header.frame_id", "map"), INCONSISTENT, r"step 1 \(right\): in frame 'map'"),
    (set_to("steps[1].foot.header.frame_id", "l_sole"), INCONSISTENT, r"step 1 \(right\): in frame 'l_sole'"),
    (set_to("start.header.frame_id", "map"), INCONSISTENT, "start feet are in frame 'map'"),
    (set_to("start.right.foot_index", Foot.LEFT), INCONSISTENT, r"start.right has foot index 0"),
    (set_to("start.right.pose.position.x", math.nan), INVALID, "start.right: position"),
    (set_to("steps[0].step_index", 1), S.ERR_NON_ZERO_INITIAL_STEP, "begins with step 1"),
    (set_to("steps[2].step_index", 1), INDICES, "step 1 at the position of step 2"),
    (set_to("steps[1].foot.foot_index", 2), INVALID, r"step 1 \(no foot\): foot index 2"),
    (set_to("steps[1].valid", False), INVALID, r"step 1 \(right\): marked as not valid by its planner"),
    (set_to("steps[1].colliding", True), INVALID, r"step 1 \(right\): marked as colliding by its planner"),
    (set_to("steps[1].foot.pose.orientation.w", 0.0), INVALID, r"step 1 \(right\): orientation has norm"),
    (twice_the_same_foot, INCONSISTENT, r"step 2 \(right\): the right foot twice in a row"),
]
# fmt: on


@pytest.mark.parametrize(("breaks", "status", "text"), BREAKS, ids=[text for _, _, text in BREAKS])
def test_a_broken_plan_is_refused_with_its_own_flag(breaks: Callable[[StepPlan], None], status: int, text: str) -> None:
    plan = make_plan([MOVE] * 4)
    assert len(convert(plan, LIMITS)) == 4
    breaks(plan)
    with pytest.raises(PlanRejectedError, match=text) as refused:
        convert(plan, LIMITS)
    assert refused.value.status == status
    assert (refused.value.error == ErrorStatus.ERR_INVALID_START) == text.startswith("start.")
    assert "\n" not in str(refused.value)


def test_without_start_feet_the_first_step_is_left_to_the_motion_manager() -> None:
    plan = make_plan([MOVE])
    plan.start.header.frame_id = ""
    plan.steps[0].foot.pose.position.x = 50.0
    assert convert(plan, LIMITS)[0].sole.position[0] == 50.0


@given(plans, st.floats(-3.0, 3.0), st.floats(-10.0, 10.0))
def test_a_plan_in_another_frame_becomes_the_same_steps_in_odom(plan: StepPlan, yaw: float, x: float) -> None:
    frame = level(x, -2.0, 0.3, yaw)
    expected, moved = convert(plan, LIMITS), convert(plan, LIMITS, to_odom=frame)
    for before, after in zip(expected, moved, strict=True):
        np.testing.assert_allclose(after.sole.position, (frame @ before.sole).position, atol=1e-9)
        np.testing.assert_allclose(after.sole.rotation, (frame @ before.sole).rotation, atol=1e-9)


class TestUpdate:
    RUNNING = RunningPlan(convert(make_plan([MOVE] * 6), LIMITS), first_changeable=3)

    def update(self, first: int, count: int = 2) -> StepPlan:
        """The running plan's own steps from ``first`` on, as a plan; they would go on behind its end."""
        plan = make_plan([MOVE] * 12)
        plan.steps = plan.steps[first : first + count]
        return plan

    @pytest.mark.parametrize("first", range(7))
    def test_changes_what_can_be_changed_and_goes_on_behind_the_last(self, first: int) -> None:
        steps = convert(self.update(first, 8 - first), LIMITS, self.RUNNING)
        assert [step.index for step in steps] == list(range(max(first, 3), 8))
        assert [step.index for step in self.RUNNING.updated(steps)] == list(range(8))

    @pytest.mark.parametrize(
        ("first", "count", "first_foot", "changeable", "text"),
        [
            (0, 3, Foot.LEFT, 3, "ends with step 2; the running plan can only be changed from step 3 on"),
            (7, 2, Foot.LEFT, 3, "begins with step 7; expected at most 6"),
            (5, 2, Foot.LEFT, -1, "none of its steps can be changed"),
            (2, 4, Foot.RIGHT, 3, r"step 3 \(left\): expected the right foot, as in the running plan"),
            (3, 4, Foot.RIGHT, 3, r"step 3 \(left\): expected the right foot, as in the running plan"),
            (6, 2, Foot.RIGHT, 3, r"step 6 \(right\): the right foot twice in a row"),
        ],
    )
    def test_that_does_not_fit_is_refused(
        self, first: int, count: int, first_foot: int, changeable: int, text: str
    ) -> None:
        plan = make_plan([MOVE] * 12, first_foot)
        plan.steps = plan.steps[first : first + count]
        with pytest.raises(PlanRejectedError, match=text) as refused:
            convert(plan, LIMITS, RunningPlan(self.RUNNING.steps, first_changeable=changeable))
        assert refused.value.status == (INCONSISTENT if " foot" in text else INDICES)

    @given(st.builds(level, *[st.floats(-3.0, 3.0)] * 4), st.integers(0, 5), st.sampled_from([3, 6]))
    def test_is_moved_as_one_to_the_step_in_common(self, elsewhere: Pose, first: int, changeable: int) -> None:
        """The planner believes the robot elsewhere: what comes of it is the plan as seen from the robot."""
        running = RunningPlan(self.RUNNING.steps, changeable)
        plan = self.update(first, 9 - first)
        expected, moved = convert(plan, LIMITS, running), convert(plan, LIMITS, running, to_odom=elsewhere)
        for before, after in zip(expected, moved, strict=True):
            np.testing.assert_allclose(after.sole.position, before.sole.position, atol=1e-9)
            np.testing.assert_allclose(after.sole.rotation, before.sole.rotation, atol=1e-9)
        kept = running.step(max(first, changeable))
        assert kept is None or moved[0].sole == kept.sole

    def test_what_is_level_stays_level_though_the_step_in_common_is_not(self) -> None:
        plan = self.update(3, 4)
        plan.steps[0].foot.pose.orientation = make_plan([replace(MOVE, pitch=0.1)]).steps[0].foot.pose.orientation
        steps = convert(plan, LIMITS, self.RUNNING)
        assert max(step.sole.tilt for step in steps) < 1e-6
        assert {round(step.sole.position[2], 9) for step in steps} == {0.1}


@pytest.mark.parametrize("age", [30.0, 3600.0, 10.1, -10.1, -3600.0])
def test_a_stamp_of_another_time_is_refused(age: float) -> None:
    now = 5_000 * 10**9
    plan = make_plan([MOVE])
    seconds = 5_000.0 - age
    plan.header.stamp.sec, plan.header.stamp.nanosec = int(seconds), round(seconds % 1 * 1e9)
    with pytest.raises(PlanRejectedError, match="expected at most 10 s, or 0") as reported:
        stamp(plan, now)
    assert reported.value.status == S.ERR_INCONSISTENT_STEP_PLAN
    assert f"{abs(age):.3f} s {'before' if age > 0 else 'after'}" in str(reported.value)
    plan.header.stamp.sec = 4_991
    assert stamp(plan, now) // 10**9 == 4_991
    plan.header.stamp.sec = plan.header.stamp.nanosec = 0
    assert stamp(plan, now) == 0
