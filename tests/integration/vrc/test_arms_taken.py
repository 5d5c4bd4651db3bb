"""Arms of a simulated robot, wanted by several at once: who loses one is told why, by what he asked with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from controller_manager_msgs.srv import SwitchController
from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Empty
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from valor_msgs.msg import HandGoalStatus, Rejection
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import (
    ACCEPTED,
    FORWARD,
    HOME,
    INVALID_GOAL,
    INVALID_MODE,
    INVALID_TRANSITION,
    PATIENCE,
    REJECTED,
    ROBOT,
    STATUS_ABORTED,
    SUCCESSFUL,
    Topic,
    ask,
    go,
    publish,
    send,
    stamp,
)

BASE = "/trajectory_controllers/right_arm_traj_controller"
MODE_COMMAND = "/flor/controller/mode_command"
LEFT_HOME = ROBOT.tables.arm_presets["home"]["left"]
LONG = 100  # a goal ends within it only if it loses the arm, however late a busy computer lets the other one ask [s]


def trajectory(target: dict[str, float], seconds: int) -> Any:
    """A JointTrajectory of one point."""
    point = JointTrajectoryPoint(positions=list(target.values()), time_from_start=Duration(sec=seconds))
    return JointTrajectory(joint_names=list(target), points=[point])


def hand_goal() -> Any:
    goal = PoseStamped()
    goal.header.frame_id = "base_link"
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = (0.4, -0.3, 0.25)
    return goal


@dataclass
class Desk:
    """Publishes, and hears what comes back."""

    ros: RosClient

    def __post_init__(self) -> None:
        self.refused = Topic(self.ros, Rejection, "/flor/controller/rejection", latched=True)
        self.hand = Topic(self.ros, HandGoalStatus, "/flor/r_hand/goal_status", latched=True)

    def wait_refused(self, topic: str, words: str) -> None:
        def told() -> bool:
            return any(r.topic == topic and words in r.reason for r in self.refused.messages)

        wait_until(told, PATIENCE, f"a refusal on {topic} that says {words!r}")

    def lead_hand(self) -> None:
        publish(self.ros, "/flor/r_hand/goal_pose", hand_goal())

    def wait_hand(self, state: str, words: str = "") -> None:
        def told() -> bool:
            said = self.hand.messages
            return bool(said) and said[-1].state == state and words in said[-1].reason

        wait_until(told, PATIENCE, f"the hand to be {state} {words!r}")

    def release_hand(self) -> None:
        publish(self.ros, "/flor/r_hand/goal_cancel", Empty())
        self.wait_hand("idle")

    def switch_off(self) -> None:
        answer = ask(
            self.ros,
            SwitchController,
            "/controller_manager/switch_controller",
            deactivate_controllers=["right_arm_traj_controller"],
            strictness=2,
        )
        assert answer.ok, answer.message

    def close(self) -> None:
        for topic in (self.refused, self.hand):
            topic.close()


@pytest.fixture
def desk(manipulating: RosClient) -> Iterator[Desk]:
    made = Desk(manipulating)
    yield made
    made.close()


def change_mode(mode: str) -> Callable[[Desk], object]:
    """Ask for a mode, and see that it is granted."""

    def take(desk: Desk) -> None:
        status = desk.ros.change_mode(mode)
        assert status.status == ACCEPTED, (status, [r.reason for r in desk.refused.messages][-3:])

    return take


def soft_stop(desk: Desk) -> None:
    publish(desk.ros, "/flor/controller/soft_stop", Empty())


TAKES: dict[str, tuple[Callable[[Desk], object], str]] = {
    "a hand goal": (Desk.lead_hand, "the right arm follows a hand goal, until that is canceled"),
    "mode stand": (change_mode("stand"), "control mode stand"),
    "soft stop": (soft_stop, "control mode soft_stop"),
    "a freeze": (change_mode("freeze right_arm"), "right_arm is frozen"),
    "a switch": (Desk.switch_off, "switched by a client"),
}


def recover(ros: RosClient, desk: Desk) -> None:
    desk.release_hand()
    go(ros, "stand")
    go(ros, "stand_manipulate")


def test_whoever_loses_the_arm_is_told_at_once(manipulating: RosClient, desk: Desk) -> None:
    for taker, (take, words) in TAKES.items():
        handle = send(manipulating, FORWARD, LONG)
        take(desk)
        answer = manipulating._wait(manipulating._call(handle.get_result_async), PATIENCE, f"the loss to {taker}")
        assert (answer.status, answer.result.error_code) == (STATUS_ABORTED, INVALID_GOAL), taker
        assert words in answer.result.error_string, (taker, answer.result.error_string)
        if taker == "a hand goal":  # it keeps the arm, and says so
            desk.wait_hand("moving")
            answer = manipulating.follow("right_arm", [(3.0, HOME)])
            assert words in answer.result.error_string
            publish(desk.ros, f"{BASE}/joint_trajectory", trajectory(HOME, 3))
            desk.wait_refused(f"{BASE}/joint_trajectory", words)
            assert manipulating.change_mode("stop").status == ACCEPTED
            desk.wait_hand("idle", "released")
        elif taker == "a freeze":  # the other arm goes on, the legs cannot be frozen
            assert words in manipulating.follow("right_arm", [(3.0, HOME)]).result.error_string
            assert manipulating.follow("left_arm", [(1.0, LEFT_HOME)]).result.error_code == SUCCESSFUL
            assert manipulating.change_mode("freeze left_leg").status == REJECTED | INVALID_MODE
            desk.wait_refused(MODE_COMMAND, "the legs carry the robot")
            assert manipulating.change_mode("freeze none").status == ACCEPTED
        recover(manipulating, desk)
    publish(desk.ros, f"{BASE}/joint_trajectory", trajectory(FORWARD, LONG))
    desk.lead_hand()
    wait_until(
        lambda: sum("the right arm follows a hand goal" in r.reason for r in desk.refused.messages) > 1,
        PATIENCE,
        "the sender of a trajectory to be told, too",
    )
    desk.wait_hand("moving")
    go(manipulating, "stand")
    desk.wait_hand("idle", "the behavior is stand")


def test_what_is_not_yet_possible_is_waited_for_and_what_is_not_is_told(ros: RosClient, desk: Desk) -> None:
    go(ros, "stand")
    assert ros.change_mode("stand_prep").status == ACCEPTED
    began = len(ros.reports)
    assert ros.change_mode("stand", timeout=PATIENCE).status == ACCEPTED, "stand_prep was not waited for"
    assert any(report.status & 8 for report in ros.reports[began:])
    result = ros.change_mode("none")
    assert result.status == REJECTED | INVALID_TRANSITION
    desk.wait_refused(MODE_COMMAND, "not allowed from stand; from there: freeze, manipulate")
    go(ros, "walk")
    assert ros.change_mode("stop").status == ACCEPTED
    assert ros.change_mode("freeze").status == REJECTED | INVALID_TRANSITION
    desk.wait_refused(MODE_COMMAND, "not allowed from stop in behavior walk; from there: soft_stop, stand")
    go(ros, "stand")
    publish(desk.ros, MODE_COMMAND, VigirControlModeCommand(requested_control_mode="x" * 200_000))
    wait_until(lambda: ros.reports[-1].status == REJECTED | INVALID_MODE, PATIENCE, "the refusal of a long name")
    assert len(ros.reports[-1].requested_control_mode) < 100
    late = Topic(ros, type(desk.refused.messages[-1]), "/flor/controller/rejection", latched=True)
    wait_until(lambda: any("unknown mode" in r.reason for r in late.messages), PATIENCE, "it, by who joins late")
    late.close()


def test_wrenches_odometry_and_poses_can_be_joined_by_their_stamps(ros: RosClient) -> None:
    names = [f"/flor/{limb}/force_torque_sensor" for limb in ("l_foot", "r_foot", "l_hand", "r_hand")]
    topics = [Topic(ros, WrenchStamped, name) for name in names]
    topics += [Topic(ros, Odometry, "/odom"), Topic(ros, PoseStamped, "/flor/state/pelvis_pose_world")]
    wait_until(lambda: all(len(topic.messages) > 100 for topic in topics), PATIENCE, "states")
    stamps = [{stamp(message) for message in topic.messages} for topic in topics]
    for topic in topics:
        topic.close()
    common = set.intersection(*stamps)
    assert len(common) > 0.8 * min(len(each) for each in stamps)
