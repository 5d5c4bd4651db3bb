"""No plan, however broken, makes the robot do what a good one would not: from ROS's message to the queue the gait asks.

A good plan is broken in every way a message can be: it is refused as a whole, with a flag of what was broken and a text
that names the step, and nothing has changed; or each of its steps is a good one and the queue holds exactly those.
"""

import copy
import math
import re
from collections.abc import Callable

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, Step, StepPlan

from harness.examples import examples
from tests.unit.test_footstep_plan import LIMITS, MOVE, REACH, ROBOT, make_plan, plans
from tests.unit.test_motion_manager_footsteps import Bench
from valor.common.messages import Footstep
from valor.common.poses import Pose
from valor.control.steps import SolePose
from valor.control.steps import Step as TakenStep
from valor.footstep_converter.motion_system import footstep
from valor.footstep_converter.plan import PlannedStep, PlanRejectedError, RunningPlan, convert, frame

S = FootstepExecutionStatus
INDICES, INVALID, INCONSISTENT = S.ERR_INVALID_INCONSISTENT_INDICES, S.ERR_INVALID_PLAN, S.ERR_INCONSISTENT_STEP_PLAN


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
def state(bench: Bench) -> tuple[object, ...]:
    queue = bench.queue
    return list(queue.steps), queue.executing, queue.last, queue.state, queue.reason, queue.changes, bench.indices


def hand_over(
    bench: Bench, plan: StepPlan, running: RunningPlan | None = None
) -> list[PlannedStep] | PlanRejectedError | str:
    """A plan on the way that it takes: what the converter handed over, or why it, or the Motion Manager, refused."""
    before = state(bench)
    try:
        if frame(plan).lstrip("/") != "odom":  # what tf does not know is refused by the service, before `convert`
            return PlanRejectedError(INCONSISTENT, 0, "the plan cannot be put in odom")
        steps = convert(plan, LIMITS, running)
    except PlanRejectedError as error:
        assert state(bench) == before
        return error
    reason = bench.send([footstep(step) for step in steps])
    if reason:
        assert state(bench) == before
        return reason
    return steps


def check_refusal(refusal: PlanRejectedError | str, flags: set[int]) -> None:
    """One line that names the step, or what of the plan as a whole is wrong; the flag is one of what was broken."""
    text = str(refusal)
    assert "\n" not in text and text
    assert re.search(r"\bstep -?\d+|start\.(left|right)|the plan |the start feet|the update ", text), text
    if isinstance(refusal, PlanRejectedError):
        assert refusal.status in flags, text


def check_steps(taken: list[TakenStep], asked: list[Step], tolerance: float = 0.0) -> None:
    """What the queue got is what the message states, and nothing else."""
    assert [step.index for step in taken] == [step.step_index for step in asked]
    for step, wanted in zip(taken, asked, strict=True):
        p = wanted.foot.pose.position
        assert step.foot == wanted.foot.foot_index
        np.testing.assert_allclose(step.sole.position, [p.x, p.y, p.z], rtol=0, atol=tolerance)
        assert step.swing_height == (wanted.swing_height or ROBOT.tables.walking.plan_swing_height)
        assert step.swing_duration == (wanted.step_duration or ROBOT.tables.walking.swing_duration)
        assert step.transfer_duration == (wanted.sway_duration or ROBOT.tables.walking.transfer_duration)


def check_feasible(steps: list[TakenStep], before: SolePose) -> None:
    """Each step is finite, and one that the rule allows while the other foot stands."""
    for i, step in enumerate(steps):
        assert step.foot == (steps[0].foot + i) % 2
        numbers = [*step.sole.position, *step.sole.rotation.ravel(), step.swing_height, step.swing_duration]
        assert np.isfinite([*numbers, step.transfer_duration]).all()
        assert not LIMITS.alone(step) and not LIMITS.beside(step, before), step
        before = step.sole


def ready_for(plan: StepPlan) -> Bench:
    """A robot whose feet stand where a plan starts."""
    bench = Bench()
    for foot, start in enumerate((plan.start.left, plan.start.right)):
        p, o = start.pose.position, start.pose.orientation
        bench.soles[foot] = SolePose(
            np.array([p.x, p.y, p.z]), np.array(Pose(orientation=(o.w, o.x, o.y, o.z)).rotation)
        )
    return bench


@example(make_plan([MOVE] * 3), [setting("header.frame_id", "/odom", 0), setting("start.header.frame_id", "/odom", 0)])
@given(plans, st.lists(breaks, max_size=4))
@examples(80)
def test_a_plan_is_good_as_a_whole_or_moves_nothing(plan: StepPlan, broken: list[Break]) -> None:
    bench = ready_for(plan)
    for each in broken:
        each(plan)
    outcome = hand_over(bench, plan)
    if isinstance(outcome, list):
        check_feasible(bench.queue.steps, bench.soles[1 - plan.steps[0].foot.foot_index])
        check_steps(bench.queue.steps, plan.steps)
        bench.finish()
        check_steps(bench.taken, plan.steps)
        return
    check_refusal(outcome, {INDICES, INVALID, INCONSISTENT, S.ERR_EMPTY_PLAN, S.ERR_NON_ZERO_INITIAL_STEP})
    assert broken, "a good plan"
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
        check_feasible(bench.taken, ready_for(plan).soles[1 - plan.steps[0].foot.foot_index])
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
        assert state(bench) == before and not bench.go_on()
        return
    check_feasible(bench.queue.steps, bench.soles[1 - sent[0].foot])
    for index, step in enumerate(bench.queue.steps):
        assert step.index == index
        np.testing.assert_allclose(step.sole.position, sent[index].position_in_odom)
