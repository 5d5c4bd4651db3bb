"""Arms of a simulated robot, wanted by several at once: who loses one is told why, by what he asked with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.instance import RunningInstance
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
    STATUS_ABORTED,
    SUCCESSFUL,
    VRC,
    Topic,
    ask,
    go,
    send,
    stamp,
)
from valor.common.messages import BehaviorRequest
from valor.common.topics import BEHAVIOR

BASE = "/trajectory_controllers/right_arm_traj_controller"
MODE_COMMAND = "/flor/controller/mode_command"
JOINT = "r_elbow_pitch"
LONG = 100.0  # a goal ends within it only if it loses the arm, however late a busy computer lets the other one ask [s]
PERIOD = 10_000_000  # of a stream [ns of robot time]


def trajectory(target: dict[str, float], seconds: float, velocities: dict[str, float] | None = None) -> Any:
    """A JointTrajectory of one point."""
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    nanoseconds = round(seconds * 1e9)
    point = JointTrajectoryPoint(
        positions=list(target.values()),
        velocities=[(velocities or {}).get(name, 0.0) for name in target] if velocities is not None else [],
        time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
    )
    return JointTrajectory(joint_names=list(target), points=[point])


def hand_goal() -> Any:
    from geometry_msgs.msg import PoseStamped

    goal = PoseStamped()
    goal.header.frame_id = "base_link"
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = (0.4, -0.3, 0.25)
    return goal


@dataclass
class Desk:
    """Publishes, and hears what comes back."""

    ros: RosClient
    node: bifrost.Node
    publishers: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        from valor_msgs.msg import HandGoalStatus, Rejection

        self.refused = Topic(self.ros, Rejection, "/flor/controller/rejection", latched=True)
        self.hand = Topic(self.ros, HandGoalStatus, "/flor/r_hand/goal_status", latched=True)

    def publish(self, topic: str, message: Any) -> None:
        if topic not in self.publishers:
            self.publishers[topic] = self.ros.node.create_publisher(type(message), topic, 1)
            wait_until(self.publishers[topic].get_subscription_count, PATIENCE, f"the VRC to listen to {topic}")
        self.publishers[topic].publish(message)

    def wait_refused(self, topic: str, words: str) -> None:
        def told() -> bool:
            return any(r.topic == topic and words in r.reason for r in self.refused.messages)

        wait_until(told, PATIENCE, f"a refusal on {topic} that says {words!r}")

    def lead_hand(self) -> None:
        self.publish("/flor/r_hand/goal_pose", hand_goal())

    def wait_hand(self, state: str, words: str = "") -> None:
        def told() -> bool:
            said = self.hand.messages
            return bool(said) and said[-1].state == state and words in said[-1].reason

        wait_until(told, PATIENCE, f"the hand to be {state} {words!r}")

    def release_hand(self) -> None:
        from std_msgs.msg import Empty

        self.publish("/flor/r_hand/goal_cancel", Empty())
        self.wait_hand("idle")

    def behavior(self, name: str) -> None:
        client = BEHAVIOR.client(self.node)
        assert client.call(BehaviorRequest(name), timeout=PATIENCE).accepted
        client.close()

    def switch_off(self) -> None:
        from controller_manager_msgs.srv import SwitchController

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
        for publisher in self.publishers.values():
            self.ros.destroy(self.ros.node.destroy_publisher, publisher)


@pytest.fixture
def desk(manipulating: RosClient, node: bifrost.Node) -> Iterator[Desk]:
    made = Desk(manipulating, node)
    yield made
    made.close()


def change_mode(mode: str) -> Callable[[Desk], object]:
    """Ask for a mode, and see that it is granted."""

    def take(desk: Desk) -> None:
        status = desk.ros.change_mode(mode)
        assert status.status == ACCEPTED, (status, [r.reason for r in desk.refused.messages][-3:])

    return take


def soft_stop(desk: Desk) -> None:
    from std_msgs.msg import Empty

    desk.publish("/flor/controller/soft_stop", Empty())


TAKES: dict[str, tuple[Callable[[Desk], object], str]] = {
    "a hand goal": (Desk.lead_hand, "the right arm follows a hand goal, until that is canceled"),
    "a trajectory": (
        lambda desk: desk.publish(f"{BASE}/joint_trajectory", trajectory(HOME, 3.0)),
        "preempted by new incoming action",
    ),
    "a goal": (lambda desk: send(desk.ros, HOME, 3.0), "preempted by new incoming action"),
    "mode stand": (change_mode("stand"), "control mode stand"),
    "mode stop": (change_mode("stop"), "control mode stop"),
    "soft stop": (soft_stop, "control mode soft_stop"),
    "another commander": (lambda desk: desk.behavior("stand"), "control mode stand"),
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
            desk.publish(f"{BASE}/joint_trajectory", trajectory(HOME, 3.0))
            desk.wait_refused(f"{BASE}/joint_trajectory", words)
            assert manipulating.change_mode("stop").status == ACCEPTED
            desk.wait_hand("idle", "let go")
        recover(manipulating, desk)
    desk.publish(f"{BASE}/joint_trajectory", trajectory(FORWARD, LONG))
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
    from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

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
    desk.publish(MODE_COMMAND, VigirControlModeCommand(requested_control_mode="x" * 200_000))
    wait_until(lambda: ros.reports[-1].status == REJECTED | INVALID_MODE, PATIENCE, "the refusal of a long name")
    assert len(ros.reports[-1].requested_control_mode) < 100
    late = Topic(ros, type(desk.refused.messages[-1]), "/flor/controller/rejection", latched=True)
    wait_until(lambda: any("no such mode" in r.reason for r in late.messages), PATIENCE, "it, by who joins late")
    late.close()


def test_a_stream_of_trajectories_is_followed_and_logged_once(
    manipulating: RosClient, desk: Desk, system: RunningInstance
) -> None:
    """As MoveIt Servo sends them: a hundred a second, each a point for the next moment, in motion."""
    ros = manipulating
    assert ros.follow("right_arm", [(2.0, HOME)]).result.error_code == SUCCESSFUL
    topic = f"{BASE}/joint_trajectory"
    lines = system.log(VRC).count("\n")
    refusals = len(desk.refused.messages)
    sent: list[tuple[float, float]] = []
    seen: list[tuple[float, float]] = []
    amplitude, rate = 0.15, 2 * pi / 2.0

    def now() -> int:
        assert ros.joint_state is not None
        return stamp(ros.joint_state)

    begin = following = now()
    while (time := now()) < begin + 4 * 10**9:
        if time >= following:
            following = time + PERIOD
            t = (time - begin) * 1e-9 + 0.02
            place, velocity = amplitude * (1 - cos(rate * t)) / 2, amplitude * rate * sin(rate * t) / 2
            desk.publish(topic, trajectory(HOME | {JOINT: HOME[JOINT] + place}, 0.02, {JOINT: velocity}))
            sent.append((t, HOME[JOINT] + place))
            seen.append((t, ros.joint_positions()[JOINT]))
        wait_until(lambda t=time: now() > t, PATIENCE, "the robot's clock", period=0.001)  # type: ignore[misc]
    (times, wanted), measured = np.array(sent).T, np.array(seen)[:, 1]
    assert len(sent) > 100
    # Nobody waits for the sender, nor for the VRC: on a busy computer both are late, and for moments neither goes on.
    late = (np.interp(times - delay, times, wanted) for delay in np.linspace(0.0, 0.5, 26))
    off = min(np.percentile(np.abs(measured - each), 75) for each in late)
    assert off < 0.2 * amplitude, "the arm does not follow"
    assert np.ptp(measured) > 0.8 * amplitude
    refused = [each.reason for each in desk.refused.messages[refusals:]]
    assert not [why for why in refused if not why.startswith("stale")], refused  # a busy computer holds the VRC up
    assert system.log(VRC).count("\n") - lines <= 3
    # Where it stops in mid-motion, the arm comes to rest.
    desk.publish(topic, trajectory(HOME | {JOINT: ros.joint_positions()[JOINT] + 0.01}, 0.05, {JOINT: 0.2}))
    wait_until(lambda: abs(ros.joint_state.velocity[ros.joint_state.name.index(JOINT)]) < 0.02, PATIENCE, "rest")  # type: ignore[union-attr]
    for i in range(100):  # each another reason
        desk.publish(topic, trajectory(HOME | {JOINT: 9.0 + i}, 0.02))
        time = now()
        wait_until(lambda t=time: now() > t, PATIENCE, "the robot's clock", period=0.001)  # type: ignore[misc]
    desk.wait_refused(topic, "its limits are")
    assert system.log(VRC).count("\n") - lines <= 15
    ros.follow("right_arm", [(2.0, HOME)])


def test_wrenches_odometry_and_poses_can_be_joined_by_their_stamps(ros: RosClient) -> None:
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from nav_msgs.msg import Odometry

    names = [f"/flor/{limb}/force_torque_sensor" for limb in ("l_foot", "r_foot", "l_hand", "r_hand")]
    topics = [Topic(ros, WrenchStamped, name) for name in names]
    topics += [Topic(ros, Odometry, "/odom"), Topic(ros, PoseStamped, "/flor/state/pelvis_pose_world")]
    wait_until(lambda: all(len(topic.messages) > 100 for topic in topics), PATIENCE, "states")
    stamps = [{stamp(message) for message in topic.messages} for topic in topics]
    for topic in topics:
        topic.close()
    common = set.intersection(*stamps)
    assert len(common) > 0.8 * min(len(each) for each in stamps)
