"""What passes the controllers by: commands that only the Motion System obeys, and what only it knows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from std_msgs.msg import Bool, Empty
from tf2_msgs.msg import TFMessage
from valor_msgs.msg import JointGains
from valor_msgs.msg import MotionState as RosMotionState
from valor_msgs.msg import Rejection as RosRejection

import bifrost
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import HOME, PATIENCE, ROBOT, SUCCESSFUL, Topic, go, publish
from valor.common.messages import HandGoalStatus, MotionState, Rejection
from valor.common.topics import HAND_GOAL_STATUS, MOTION_STATE, MOTOR, REJECTION


class Rejections:
    """What the Motion Manager refuses."""

    def __init__(self, node: bifrost.Node) -> None:
        self._subscriber = REJECTION.subscriber(node, queue=100)
        self._heard: list[Rejection] = []

    def wait_for(self, topic: str, words: str) -> None:
        def there() -> bool:
            self._heard += [received.message for received in self._subscriber.drain()]
            return any(r.topic == topic and words in r.reason for r in self._heard)

        wait_until(there, PATIENCE, f"a refusal on {topic} that says {words!r}")

    def on(self, topic: str) -> list[str]:
        self._heard += [received.message for received in self._subscriber.drain()]
        return [r.reason for r in self._heard if r.topic == topic]


@pytest.fixture
def rejections(node: bifrost.Node) -> Iterator[Rejections]:
    made = Rejections(node)
    wait_until(lambda: made.on("") or made._subscriber.publishers, PATIENCE, "the Motion Manager")
    yield made
    made._subscriber.close()


class MotionStates:
    """The newest MotionState."""

    def __init__(self, node: bifrost.Node) -> None:
        self._subscriber = MOTION_STATE.subscriber(node)

    def newest(self) -> MotionState:
        received = self._subscriber.receive(PATIENCE)
        assert received is not None
        return received.message

    def close(self) -> None:
        self._subscriber.close()


@pytest.fixture
def motion(node: bifrost.Node) -> Iterator[MotionStates]:
    made = MotionStates(node)
    yield made
    made.close()


def gripper_in_base(ros: RosClient) -> np.ndarray:
    """(3,) of the right gripper in base_link, from /tf and /tf_static [m]."""
    moving, fixed = Topic(ros, TFMessage, "/tf"), Topic(ros, TFMessage, "/tf_static", latched=True)
    wait_until(lambda: moving.messages and fixed.messages, PATIENCE, "transforms")
    transforms = {t.child_frame_id: t for m in (fixed.messages[0], moving.messages[-1]) for t in m.transforms}
    moving.close()
    fixed.close()
    frame, point = "r_gripper", np.zeros(3)
    while frame != "base_link":
        transform = transforms[frame]
        t, q = transform.transform.translation, transform.transform.rotation
        axis = np.array((q.x, q.y, q.z))
        turned = point + 2.0 * np.cross(axis, np.cross(axis, point) + q.w * point)
        point = turned + np.array((t.x, t.y, t.z))
        frame = transform.header.frame_id
    return point


def test_a_hand_is_led_to_a_pose_and_let_go(ros: RosClient, node: bifrost.Node, rejections: Rejections) -> None:
    goal = PoseStamped()
    goal.header.frame_id = "base_link"
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = place = (0.4, -0.3, 0.25)
    go(ros, "stand")
    publish(ros, "/flor/r_hand/goal_pose", goal)
    rejections.wait_for("motion_manager/hand_goal", "manipulate behaviors; it is stand")
    go(ros, "stand_manipulate")
    status = HAND_GOAL_STATUS.subscriber(node, queue=1000)
    states: list[HandGoalStatus] = []

    def becomes(state: str) -> bool:
        states.extend(received.message for received in status.drain() if received.message.hand == 1)
        assert not states or states[-1].state != "out_of_reach", states[-1].reason
        return bool(states) and states[-1].state == state

    publish(ros, "/flor/r_hand/goal_pose", goal)
    wait_until(lambda: becomes("moving"), PATIENCE, "the hand to move")
    wait_until(lambda: becomes("reached"), 2 * PATIENCE, "the hand at its goal")
    wait_until(
        lambda: np.linalg.norm(gripper_in_base(ros) - place) < 0.02, PATIENCE, "the hand within 2 cm", period=0.2
    )
    publish(ros, "/flor/r_hand/goal_cancel", Empty())
    wait_until(lambda: becomes("idle"), PATIENCE, "the hand to be let go")
    answer = ros.follow("right_arm", [(3.0, HOME)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    goal.header.frame_id = "kitchen"
    publish(ros, "/flor/r_hand/goal_pose", goal)
    goal.header.frame_id = "base_link"
    goal.pose.position.x = float("nan")
    publish(ros, "/flor/r_hand/goal_pose", goal)
    rejections.wait_for("motion_manager/hand_goal", "not finite")
    status.close()


def test_gains_reach_the_motors_within_their_limits(ros: RosClient, node: bifrost.Node, rejections: Rejections) -> None:
    name = "r_elbow_pitch"
    place = ROBOT.index[name]
    motors = MOTOR.subscriber(node)

    def stiffness() -> float:
        received = motors.receive(PATIENCE)
        assert received is not None
        return float(received.message.stiffness[place])

    go(ros, "stand")
    nominal = stiffness()
    assert nominal == pytest.approx(ROBOT.servo_stiffness[place])
    publish(ros, "/flor/controller/joint_gains", JointGains(names=[name], stiffness=[0.5 * nominal], damping=[10.0]))
    wait_until(lambda: stiffness() == pytest.approx(0.5 * nominal), PATIENCE, "half the stiffness")
    publish(ros, "/flor/controller/joint_gains", JointGains(names=[name], stiffness=[float("nan")], damping=[10.0]))
    rejections.wait_for("motion_manager/joint_gains", "'r_elbow_pitch' is nan")
    publish(ros, "/flor/controller/joint_gains", JointGains(names=[name], stiffness=[nominal], damping=[12.0]))
    wait_until(lambda: stiffness() == pytest.approx(nominal), PATIENCE, "the nominal stiffness")
    motors.close()


def pelvis_goal(height: float, yaw: float = 0.0, frame: str = "support") -> Any:
    goal = PoseStamped()
    goal.header.frame_id = frame
    goal.pose.position.z = height
    goal.pose.orientation.w, goal.pose.orientation.z = math.cos(yaw / 2), math.sin(yaw / 2)
    return goal


def test_the_pelvis_goes_to_a_pose_where_no_controller_leads_it(ros: RosClient, motion: MotionStates) -> None:
    """One writer: in mode manipulate the pelvis is its trajectory controller's."""
    topic, height = "/flor/pelvis_controller/goal_pose", ROBOT.tables.nominal_base_height
    refusals = Topic(ros, RosRejection, "/flor/controller/rejection")

    def refused(words: str) -> bool:
        return any(r.topic == topic and words in r.reason for r in refusals.messages)

    go(ros, "stand")
    publish(ros, topic, pelvis_goal(height - 0.05, yaw=0.1))
    wait_until(
        lambda: motion.newest().pelvis_setpoint == pytest.approx((0, 0, height - 0.05, 0, 0, 0.1), abs=1e-3),
        PATIENCE,
        "the pelvis' set-point",
    )
    wait_until(
        lambda: motion.newest().pelvis_in_support[2] == pytest.approx(height - 0.05, abs=0.02), PATIENCE, "the pelvis"
    )
    publish(ros, topic, pelvis_goal(height, frame="kitchen"))
    wait_until(lambda: refused("frame 'kitchen'; expected 'support'"), PATIENCE, "a refusal of the frame")
    publish(ros, topic, pelvis_goal(math.nan))
    wait_until(
        lambda: any("not finite" in r.reason for r in refusals.messages), PATIENCE, "a refusal of what is not finite"
    )
    go(ros, "manipulate")
    publish(ros, topic, pelvis_goal(height))
    wait_until(lambda: refused("pelvis_traj_controller controls the pelvis"), PATIENCE, "a refusal in manipulate")
    assert motion.newest().pelvis_setpoint[2] == pytest.approx(height - 0.05, abs=2e-3), "the controller holds"
    go(ros, "stand")
    publish(ros, topic, pelvis_goal(height))
    wait_until(
        lambda: motion.newest().pelvis_setpoint == pytest.approx((0, 0, height, 0, 0, 0), abs=1e-3), PATIENCE, "home"
    )
    refusals.close()


def test_soft_stop_and_what_is_said_of_it(ros: RosClient, motion: MotionStates) -> None:
    go(ros, "stand")
    states = Topic(ros, RosMotionState, "/flor/controller/motion_state", latched=True)
    status = Topic(ros, DiagnosticStatus, "/flor/controller/robot_status", latched=True)
    wait_until(lambda: status.messages and status.messages[-1].level == DiagnosticStatus.OK, PATIENCE, "status: OK")
    publish(ros, "/flor/controller/soft_stop", Empty())
    wait_until(lambda: motion.newest().behavior == "soft_stop", PATIENCE, "soft stop")
    wait_until(lambda: states.messages and states.messages[-1].behavior == "soft_stop", PATIENCE, "its state on ROS")
    wait_until(lambda: status.messages[-1].level == DiagnosticStatus.WARN, PATIENCE, "status: WARN")
    state = states.messages[-1]
    assert "soft_stop" in status.messages[-1].message
    assert state.header.frame_id == "" and len(state.joint_setpoint) == len(ROBOT.joints)
    assert list(state.contacts) == [1, 1] and state.bifrost_sequence > 0
    go(ros, "stand")
    states.close()
    status.close()


def test_points_and_contacts_are_there_for_plots_and_for_late_joiners(ros: RosClient) -> None:
    go(ros, "stand")
    points = {name: Topic(ros, PointStamped, f"/flor/state/{name}") for name in ("com", "dcm", "dcm_reference", "cop")}
    feet = [Topic(ros, Bool, f"/flor/{side}_foot/contact", latched=True) for side in "lr"]
    hands = [Topic(ros, Bool, f"/flor/{side}_hand/contact", latched=True) for side in "lr"]
    wait_until(lambda: all(len(topic.messages) > 5 for topic in points.values()), PATIENCE, "points")
    wait_until(lambda: all(topic.messages for topic in (*feet, *hands)), PATIENCE, "contacts")
    places = {name: topic.messages[-1].point for name, topic in points.items()}
    assert {topic.messages[-1].header.frame_id for topic in points.values()} == {"odom"}
    assert 0.6 < places["com"].z < 1.2 and places["cop"].z == 0.0
    for axis in "xy":  # standing still, all four are one above the other
        values = [getattr(place, axis) for place in places.values()]
        assert max(values) - min(values) < 0.03, places
    assert all(topic.messages[-1].data for topic in feet)
    assert not any(topic.messages[-1].data for topic in hands)
    for topic in (*points.values(), *feet, *hands):
        topic.close()
