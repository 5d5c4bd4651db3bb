"""How plans and hands' goals fare, on the link; and what became of each command."""

import contextlib
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from valor_msgs.msg import HandGoalStatus

from harness.emulated_channel import Conditions
from harness.examples import examples
from harness.link_pair import Pair
from harness.places import ROBOTS
from tests.unit.link.test_packed_steps import walk
from valor.link.classes import MessageClass
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.records import Outbox
from valor.link.state import RobotState
from valor.link_operator.goals import CommandHistory
from valor.robot.description import RobotDescription
from valor.ros import packed_steps
from valor.ros.progress import FeedbackMessage, checksum, pack_feedback, pack_hand, unpack_feedback, unpack_hand


def test_a_plans_progress_comes_back_with_its_steps() -> None:
    sent = FeedbackMessage()
    told = sent.feedback
    told.header.frame_id = told.feedback.header.frame_id = "odom"
    told.header.stamp.sec, told.header.stamp.nanosec = 17, 250_000_000
    told.feedback.header.stamp = told.header.stamp
    told.feedback.steps = walk(4)
    told.controller_state, told.queue_size, told.currently_executing_step_index = 2, 3, -1
    told.status.error, told.status.error_msg, told.status.warning_msg = 64, "step 2: too far", "slow"
    packed = packed_steps.pack(told.feedback.steps)
    assert packed is not None
    content = pack_feedback(sent, packed)
    came = unpack_feedback(content, {checksum(packed): told.feedback.steps}, "odom")
    assert came.feedback == told
    assert unpack_feedback(content, {}, "odom").feedback.feedback.steps == [], "steps that have not come are not told"
    assert len(content) < 45


@pytest.mark.parametrize("state", ["idle", "moving", "reached", "out_of_reach", "resisted"])
def test_a_hands_status_comes_back(state: str) -> None:
    sent = HandGoalStatus(time=3_000_000, hand=1, state=state, reason="why", position_error=0.25)
    assert unpack_hand(pack_hand(sent), 1) == sent
    lost = unpack_hand(pack_hand(HandGoalStatus(state="dancing", position_error=float("nan"))), 0)
    assert lost.state == "unknown" and lost.position_error > 60.0


@examples(100)
@given(st.binary(max_size=80))
def test_garbage_raises_the_links_error_alone(data: bytes) -> None:
    with contextlib.suppress(SealError):
        unpack_feedback(data, {}, "odom")
    with contextlib.suppress(SealError):
        unpack_hand(data, 0)


def test_the_fate_of_each_command_is_told_the_newest_first() -> None:
    history = CommandHistory()
    history.sent(1, "flor/l_hand/goal_pose")
    history.sent(2, "trajectory_controllers/left_arm_traj_controller/follow_joint_trajectory")
    history.update(1, "done")
    history.unsent("cmd_vel", "no session")
    told = history.lines(time.monotonic())
    assert told["last_command"].startswith("cmd_vel: not sent: no session")
    assert told["command_2"].startswith("left_arm_traj_controller: pending")
    assert told["command_3"].startswith("goal_pose: done")
    history.end_session("the link began anew")
    history.sent(1, "mode")
    history.update(1, "accepted")
    told = history.lines(time.monotonic())
    assert [told[key].split(",")[0] for key in ("last_command", "command_3", "command_4")] == [
        "mode: accepted", "left_arm_traj_controller: the link began anew", "goal_pose: done",
    ]  # fmt: skip
    for number in range(2, 30):
        history.sent(number, "mode")
    assert len(history.lines(0.0)) == 8


def test_of_how_a_plan_fares_the_newest_comes_and_nothing_that_it_replaces_is_sent_again() -> None:
    layout = Layout(RobotDescription.load(ROBOTS / "escher"))
    still = RobotState(joints=np.zeros(layout.joints.stop - layout.joints.start))
    link = Pair(layout, lambda: still, Conditions(bandwidth=9600.0, delay=0.3), cuts=((5.0, 8.0),))
    link.until(lambda: link.operator.states, 5.0)
    before = 0
    for number in range(20):
        before = link.robot.replace(MessageClass.PROGRESS, bytes((number,)), link.robot_time, before)
        link.run(0.4)
    link.until(lambda: bytes((19,)) in link.answers, 20.0)
    link.run(20.0)
    assert link.answers[-1] == bytes((19,)) and link.answers == sorted(set(link.answers))
    assert len(link.answers) < 20, "in the cut each replaced the one before"


def test_news_of_progress_wait_behind_everything_that_is_urgent() -> None:
    outbox = Outbox()
    for kind in (MessageClass.PROGRESS, MessageClass.ANSWER, MessageClass.STOP):
        outbox.put(kind, b"", 0.0)
    assert [each.kind for each in outbox.due(0.0)] == [MessageClass.STOP, MessageClass.ANSWER, MessageClass.PROGRESS]
