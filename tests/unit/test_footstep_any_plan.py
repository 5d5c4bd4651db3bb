"""No plan, however broken, makes the robot do what a good one would not: from ROS's message to the queue the gait asks.

A good plan is broken in every way a message can be. What comes of it is judged by rules written down here once more,
in NumPy: it is refused as a whole, with a flag of what was broken and a text that names the step, and nothing has
changed; or each of its steps is a good one and the queue holds exactly those.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from vigir_footstep_planning_msgs.msg import Foot, FootstepExecutionStatus, Step, StepPlan

from harness.examples import examples
from tests.unit.test_footstep_plan import LIMITS, MOVE, REACH, ROBOT, make_plan, plans
from tests.unit.test_motion_manager_footsteps import Bench
from valor.common.messages import Footstep
from valor.footstep_converter.motion_system import footstep
from valor.footstep_converter.plan import PlanError, PlannedStep, RunningPlan, convert, frame
from valor.robot.soles import outline, overlap
from valor.whole_body.walking import footsteps
from valor.whole_body.walking.swing import SolePose

S = FootstepExecutionStatus
INDICES, INVALID, INCONSISTENT = S.ERR_INVALID_INCONSISTENT_INDICES, S.ERR_INVALID_PLAN, S.ERR_INCONSISTENT_STEP_PLAN
SLACK = 1e-5  # about a limit, where either answer is right
FEET = (ROBOT.tables.feet.left, ROBOT.tables.feet.right)


# --- what is good, once more ---------------------------------------------------------------------------------------


def rotation(q: np.ndarray) -> np.ndarray:
    """(3, 3) of a quaternion (w, x, y, z)."""
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    matrix: np.ndarray = np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
    return matrix


@dataclass
class Sole:
    """A foot on the ground."""

    foot: int
    place: np.ndarray
    rotation: np.ndarray

    @property
    def yaw(self) -> float:
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])


def flaw(sole: Sole, other: Sole, height: float, swing: float, transfer: float, slack: float) -> bool:
    """Whether a step is not one that the robot may take while its other foot stands at ``other``."""
    numbers = [*sole.place, *sole.rotation.ravel(), height, swing, transfer]
    if not np.isfinite(numbers).all() or sole.foot == other.foot:
        return True
    c, s = math.cos(other.yaw), math.sin(other.yaw)
    x, y, z = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ (sole.place - other.place)
    spans = [
        (x, -REACH.max_backward, REACH.max_forward),
        (y if sole.foot == Foot.LEFT else -y, REACH.min_width, REACH.max_width),
        (math.hypot(x, y), 0.0, REACH.max_distance),
        (z, -REACH.max_down, REACH.max_up),
        (math.remainder(sole.yaw - other.yaw, math.tau), -REACH.max_yaw, REACH.max_yaw),
        (math.acos(np.clip(sole.rotation[2, 2], -1.0, 1.0)), 0.0, REACH.max_tilt),
        (height, 0.0, REACH.max_swing_height),
        (swing or REACH.min_swing_duration, REACH.min_swing_duration, REACH.max_swing_duration),
        (transfer or REACH.min_transfer_duration, REACH.min_transfer_duration, REACH.max_transfer_duration),
    ]
    if any(not low - slack <= value <= high + slack for value, low, high in spans):
        return True
    ones, others = (outline(each.place, each.rotation, FEET[each.foot]) for each in (sole, other))
    return overlap(ones, others)


def bad(plan: StepPlan, before: Sole, first: int, slack: float) -> bool:
    """Whether a plan in odom, that begins with step ``first`` while ``before`` stands, is not good as a whole.

    A frame's leading slash says nothing, but all name it alike.
    """
    frames = [plan.header, plan.start.header, plan.start.left.header, plan.start.right.header]
    frames += [header for step in plan.steps for header in (step.header, step.foot.header)]
    if plan.header.frame_id.lstrip("/") != "odom" or any(
        header.frame_id not in ("", plan.header.frame_id) for header in frames
    ):
        return True
    if not 1 <= len(plan.steps) <= REACH.max_steps:
        return True
    for index, step in enumerate(plan.steps, first):
        p, o = step.foot.pose.position, step.foot.pose.orientation
        q = np.array([o.w, o.x, o.y, o.z])
        norm = float(np.linalg.norm(q))
        if step.step_index != index or step.foot.foot_index not in (0, 1) or not step.valid or step.colliding:
            return True
        if not abs(norm - 1.0) <= 1e-3 + slack:
            return True
        sole = Sole(step.foot.foot_index, np.array([p.x, p.y, p.z]), rotation(q / norm))
        if flaw(sole, before, step.swing_height, step.step_duration, step.sway_duration, slack):
            return True
        before = sole
    return False


# --- how plans break --------------------------------------------------------------------------------------------------

odd = st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 1.0, 1e-30, 1e30])
floats = odd | st.just(1e300) | st.floats(-2.0, 2.0)
float32s = odd | st.floats(-1.0, 4.0, width=32)
integers = st.sampled_from([-(2**31), 2**31 - 1, -1, 0, 1, 2]) | st.integers(-3, 60)
names = st.sampled_from(["", "odom", "map", "/odom", "l_sole", "\n", "odom "])
Break = Callable[[StepPlan], None]


def setting(path: str, value: object, at: int) -> Break:
    """Set what ``path`` leads to; of a step, of the one at ``at``."""

    def breaks(plan: StepPlan) -> None:
        thing: object = plan
        if path.startswith("step."):
            if not plan.steps:
                return
            thing = plan.steps[at % len(plan.steps)]
        *parents, name = path.removeprefix("step.").split(".")
        for parent in parents:
            thing = getattr(thing, parent)
        setattr(thing, name, value)

    return breaks


def rearranging(how: str, at: int, to: int) -> Break:
    """Steps lost, twice, swapped, far too many or none."""

    def breaks(plan: StepPlan) -> None:
        steps = list(plan.steps)
        if not steps:
            return
        i, j = at % len(steps), to % len(steps)
        if how == "lose":
            del steps[i]
        elif how == "twice":
            steps.insert(j, copy.deepcopy(steps[i]))
        elif how == "swap":
            steps[i], steps[j] = steps[j], steps[i]
        elif how == "none":
            steps = []
        else:
            steps *= REACH.max_steps
        plan.steps = steps

    return breaks


def with_value(paths: list[str], values: st.SearchStrategy[object]) -> st.SearchStrategy[Break]:
    return st.builds(setting, st.sampled_from(paths), values, st.integers(0, 9))


breaks = st.one_of(
    with_value([f"step.foot.pose.position.{axis}" for axis in "xyz"], floats),
    with_value([f"step.foot.pose.orientation.{axis}" for axis in "wxyz"], floats),
    with_value(["step.swing_height", "step.step_duration", "step.sway_duration"], float32s),
    with_value(["step.step_index"], integers),
    with_value(["step.foot.foot_index"], st.integers(0, 255)),
    with_value(["step.valid", "step.colliding"], st.booleans()),
    with_value(["step.header.frame_id", "step.foot.header.frame_id", "header.frame_id"], names),
    with_value(["start.header.frame_id", "start.left.header.frame_id", "start.right.header.frame_id"], names),
    with_value(["step.cost", "step.risk"], float32s),  # of no meaning here, and harmless
    with_value(["step.locked", "step.modified"], st.booleans()),
    st.builds(
        rearranging, st.sampled_from(["lose", "twice", "swap", "none", "many"]), st.integers(0, 9), st.integers(0, 9)
    ),
)


# --- what comes of it -------------------------------------------------------------------------------------------------


def stands(bench: Bench, foot: int) -> Sole:
    sole = bench.soles[foot]
    return Sole(foot, sole.position, sole.rotation)


def state(bench: Bench) -> tuple[object, ...]:
    queue = bench.queue
    return list(queue.steps), queue.executing, queue.last, queue.state, queue.reason, queue.changes, bench.indices


def hand_over(bench: Bench, plan: StepPlan, running: RunningPlan | None = None) -> list[PlannedStep] | PlanError | str:
    """A plan on the way that it takes: what the converter handed over, or why it, or the Motion Manager, refused."""
    before = state(bench)
    try:
        if frame(plan).lstrip("/") != "odom":  # what tf does not know is refused by the service, before `convert`
            return PlanError(INCONSISTENT, 0, "the plan cannot be put in odom")
        steps = convert(plan, LIMITS, running)
    except PlanError as error:
        assert state(bench) == before
        return error
    reason = bench.send([footstep(step) for step in steps])
    if reason:
        assert state(bench) == before
        return reason
    return steps


def check_refusal(refusal: PlanError | str, flags: set[int]) -> None:
    """One line that names the step, or what of the plan as a whole is wrong; the flag is one of what was broken."""
    text = str(refusal)
    assert "\n" not in text
    assert text
    assert re.search(r"\bstep -?\d+|start\.(left|right)|the plan |the start feet|the update ", text), text
    if isinstance(refusal, PlanError):
        assert refusal.status in flags, text


def check_steps(taken: list[footsteps.Step], asked: list[Step], tolerance: float = 0.0) -> None:
    """What the queue got is what the message says, and nothing else."""
    assert [step.index for step in taken] == [step.step_index for step in asked]
    for step, wanted in zip(taken, asked, strict=True):
        p = wanted.foot.pose.position
        assert step.foot == wanted.foot.foot_index
        np.testing.assert_allclose(step.sole.position, [p.x, p.y, p.z], rtol=0, atol=tolerance)
        assert step.swing_height == (wanted.swing_height or ROBOT.tables.walking.plan_swing_height)
        assert step.swing_duration == (wanted.step_duration or ROBOT.tables.walking.swing_duration)
        assert step.transfer_duration == (wanted.sway_duration or ROBOT.tables.walking.transfer_duration)


def ready_for(plan: StepPlan) -> Bench:
    """A robot whose feet stand where a plan starts."""
    bench = Bench()
    for foot, start in enumerate((plan.start.left, plan.start.right)):
        p, o = start.pose.position, start.pose.orientation
        bench.soles[foot] = SolePose(np.array([p.x, p.y, p.z]), rotation(np.array([o.w, o.x, o.y, o.z])))
    return bench


@example(make_plan([MOVE] * 3), [setting("header.frame_id", "/odom", 0), setting("start.header.frame_id", "/odom", 0)])
@given(plans, st.lists(breaks, max_size=4))
@examples(80)
def test_a_plan_is_good_as_a_whole_or_moves_nothing(plan: StepPlan, broken: list[Break]) -> None:
    bench = ready_for(plan)
    stance = stands(bench, 1 - plan.steps[0].foot.foot_index)
    for each in broken:
        each(plan)
    if plan.steps:
        foot = plan.steps[0].foot.foot_index
        stance = stands(bench, 1 - foot) if foot in (0, 1) else stance
    outcome = hand_over(bench, plan)
    if isinstance(outcome, list):
        assert not bad(plan, stance, 0, SLACK)
        check_steps(bench.queue.steps, plan.steps)
        bench.finish()
        check_steps(bench.taken, plan.steps)
        return
    check_refusal(outcome, {INDICES, INVALID, INCONSISTENT, S.ERR_EMPTY_PLAN, S.ERR_NON_ZERO_INITIAL_STEP})
    assert bad(plan, stance, 0, -SLACK)
    assert not bench.go_on()  # nothing moves


@example(events=2, overtaken=True, first=2, count=5, broken=[])
@given(st.integers(0, 7), st.booleans(), st.integers(0, 9), st.integers(1, 5), st.lists(breaks, max_size=3))
@examples(80)
def test_an_update_is_good_as_a_whole_or_the_running_plan_goes_on(
    events: int, overtaken: bool, first: int, count: int, broken: list[Break]
) -> None:
    """The same steps anew from anywhere, whole or broken, at any moment of a plan of six, which may go on meanwhile."""
    plan = make_plan([MOVE] * 15)
    bench = ready_for(plan)
    update = copy.deepcopy(plan)
    update.steps = update.steps[first : first + count]
    plan.steps = plan.steps[:6]
    accepted = hand_over(bench, plan)
    assert isinstance(accepted, list)
    for _ in range(events):
        if not bench.go_on():
            break
    if not bench.queue.running:
        return
    for each in broken:
        each(update)
    running = RunningPlan(accepted, bench.status.first_changeable_step_index)
    if overtaken:
        bench.go_on()
    outcome = hand_over(bench, update, running)
    if overtaken and not broken and events > 0 and first == events < first + count - 1 < 6:
        assert isinstance(outcome, list)
    bench.finish()
    if isinstance(outcome, list):
        merged = running.updated(outcome)
        assert [step.index for step in bench.taken] == list(range(len(merged)))
        for step, wanted in zip(bench.taken, merged, strict=True):
            np.testing.assert_array_equal(step.sole.position, wanted.sole.position)
        before = stands(ready_for(plan), 1 - plan.steps[0].foot.foot_index)
        for step in bench.taken:
            sole = Sole(step.foot, step.sole.position, step.sole.rotation)
            assert not flaw(sole, before, step.swing_height, step.swing_duration, step.transfer_duration, SLACK)
            before = sole
    else:
        check_refusal(outcome, {INDICES, INVALID, INCONSISTENT, S.ERR_EMPTY_PLAN})
        check_steps(bench.taken, plan.steps)  # as if nobody had asked
    assert bench.status.state == "finished"


numbers = st.lists(floats, min_size=0, max_size=5).map(np.array)


@given(
    st.integers(0, 3),
    st.sampled_from(["step_index", "foot", "position_in_odom", "orientation_in_odom", "swing_height", "swing_duration",
                     "transfer_duration"]),
    st.data(),
)  # fmt: skip
def test_nor_does_what_comes_over_bifrost_from_anybody(at: int, what: str, data: st.DataObject) -> None:
    """The Motion Manager does not rely on the converter."""
    plan = make_plan([MOVE] * 4)
    bench = ready_for(plan)
    sent: list[Footstep] = [footstep(step) for step in convert(plan, LIMITS)]
    value: object = data.draw(
        integers if what in ("step_index", "foot") else numbers if what.endswith("odom") else floats, label=what
    )
    setattr(sent[at], what, value)
    before = state(bench)
    reason = bench.send(sent)
    if reason:
        assert re.search(r"step -?\d+", reason)
        assert state(bench) == before
        assert not bench.go_on()
        return
    stance = stands(bench, 1 - sent[0].foot)
    for index, step in enumerate(bench.queue.steps):
        assert step.index == index
        sole = Sole(step.foot, step.sole.position, step.sole.rotation)
        assert not flaw(sole, stance, step.swing_height, step.swing_duration, step.transfer_duration, SLACK)
        np.testing.assert_allclose(step.sole.position, sent[index].position_in_odom)
        stance = sole
