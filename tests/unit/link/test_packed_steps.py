"""Steps of a plan on the link: they come back to half a millimetre, steady ones take few bytes, garbage is refused."""

import contextlib
import math

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step

from harness.examples import examples
from harness.places import ROBOTS
from valor.link.errors import SealError
from valor.robot.description import RobotDescription
from valor.ros import packed_steps
from valor.ros.link_messages import MessageCodec

DEFLATED = MessageCodec(RobotDescription.load(ROBOTS / "escher"))
PLACES = st.floats(-100.0, 100.0)


def step(index: int, place: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.0) -> Step:
    """A step of the left foot, or the right one, with an odd index."""
    made = Step(step_index=index, valid=True, step_duration=0.8, sway_duration=0.4, swing_height=0.06)
    made.foot.foot_index, made.foot.header.frame_id = index % 2, "odom"
    position, turn = made.foot.pose.position, made.foot.pose.orientation
    position.x, position.y, position.z = place
    turn.w, turn.z = math.cos(yaw / 2), math.sin(yaw / 2)
    return made


def walk(steps: int, curve: float = 0.0) -> list[Step]:
    """Forward, 0.28 m a step [m, rad a step]."""
    made, x, y, yaw = [], 0.0, 0.0, 0.0
    for index in range(steps):
        yaw += curve
        x, y = x + 0.28 * math.cos(yaw), y + 0.28 * math.sin(yaw)
        aside = 0.12 * (1 - 2 * (index % 2))
        made.append(step(index, (x - aside * math.sin(yaw), y + aside * math.cos(yaw), 0.0), yaw))
    return made


@examples(100)
@given(st.lists(st.tuples(PLACES, PLACES, PLACES, st.floats(-math.pi, math.pi)), max_size=8))
def test_steps_come_back(told: list[tuple[float, float, float, float]]) -> None:
    sent = [step(index, (x, y, z), yaw) for index, (x, y, z, yaw) in enumerate(told)]
    packed = packed_steps.pack(sent)
    assert packed is not None
    came = packed_steps.unpack(packed)
    assert len(came) == len(sent)
    for ours, theirs in zip(sent, came, strict=True):
        assert (theirs.step_index, theirs.foot.foot_index, theirs.valid) == (
            ours.step_index, ours.foot.foot_index, True,
        )  # fmt: skip
        assert theirs.foot.header == ours.foot.header
        p, q = ours.foot.pose.position, theirs.foot.pose.position
        assert max(abs(p.x - q.x), abs(p.y - q.y), abs(p.z - q.z)) <= 0.5 * packed_steps.POSITION + 1e-9
        a, b = ours.foot.pose.orientation, theirs.foot.pose.orientation
        assert abs(a.w * b.w + a.z * b.z) > 1.0 - 1e-6
        assert abs(theirs.step_duration - 0.8) < 1e-3 and abs(theirs.swing_height - 0.06) < 1e-3


def test_ten_metres_fit_into_what_a_command_may_take() -> None:
    for curve, most in ((0.0, 150), (0.05, 400)):
        goal = ExecuteStepPlan.Goal()
        goal.step_plan.header.frame_id, goal.step_plan.steps = "odom", walk(38, curve)
        assert len(DEFLATED.pack(goal)) < most and len(serialize_message(goal)) > 5000


def test_what_is_more_than_numbers_travels_as_it_is() -> None:
    goal = ExecuteStepPlan.Goal()
    goal.step_plan.steps = walk(3)
    goal.step_plan.steps[1].data = [1, 2, 3]
    assert packed_steps.pack(goal.step_plan.steps) is None
    assert serialize_message(DEFLATED.unpack(DEFLATED.pack(goal), ExecuteStepPlan.Goal)) == serialize_message(goal)
    goal.step_plan.steps = [step(0, (math.nan, 0.0, 0.0))]
    assert packed_steps.pack(goal.step_plan.steps) is None, "what is refused there is refused there, not here"


@examples(200)
@given(st.binary(max_size=120))
def test_garbage_raises_the_links_error_alone(data: bytes) -> None:
    with contextlib.suppress(SealError):
        packed_steps.unpack(data)
    with contextlib.suppress(SealError):
        DEFLATED.unpack(data, ExecuteStepPlan.Goal)
