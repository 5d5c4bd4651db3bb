"""What the robot measures, and where it is, on ROS."""

from __future__ import annotations

import numpy as np
import pytest

import bifrost
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import PATIENCE, ROBOT, Topic, stamp
from valor.common.messages import Proprioceptor
from valor.common.topics import PROPRIOCEPTOR


def test_joint_states_and_imu_are_what_the_proprioceptor_says(ros: RosClient, node: bifrost.Node) -> None:
    from sensor_msgs.msg import Imu, JointState

    senses = PROPRIOCEPTOR.subscriber(node, queue=10_000)
    states, imu = Topic(ros, JointState, "/joint_states"), Topic(ros, Imu, "/imu/data")
    measured: dict[int, Proprioceptor] = {}

    def gathered() -> bool:
        measured.update((received.message.time, received.message) for received in senses.drain())
        return len(states.messages) > 250 and len(imu.messages) > 250

    wait_until(gathered, PATIENCE, "a second of joint states")
    states.close()
    imu.close()
    senses.close()
    matched = [(state, measured[stamp(state)]) for state in states.messages if stamp(state) in measured]
    assert len(matched) > 0.8 * len(states.messages), "stamps are not those of Proprioceptor"
    for state, sense in matched:
        assert list(state.name) == list(ROBOT.joints)
        assert np.array_equal(state.position, sense.joint_position)
        assert np.array_equal(state.velocity, sense.joint_velocity)
        assert np.array_equal(state.effort, sense.joint_effort)
    steps = np.diff(sorted(stamp(state) for state in states.messages)) * 1e-9 * ROBOT.tables.control_rate
    # A busy computer leaves some out.
    assert np.quantile(steps, 0.25) == pytest.approx(2.0), "every second Proprioceptor"
    for message in imu.messages:
        if (known := measured.get(stamp(message))) is not None:
            q = message.orientation
            assert [q.w, q.x, q.y, q.z] == known.imu_orientation.tolist()
    assert imu.messages[0].header.frame_id == "imu_link"


def test_tf_odometry_and_clock(ros: RosClient) -> None:
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock
    from tf2_msgs.msg import TFMessage

    fixed, moving = Topic(ros, TFMessage, "/tf_static", latched=True), Topic(ros, TFMessage, "/tf")
    odom, clock = Topic(ros, Odometry, "/odom"), Topic(ros, Clock, "/clock")
    topics = (fixed, moving, odom, clock)
    wait_until(lambda: all(topic.messages for topic in topics), PATIENCE, "tf, odometry and clock")
    parents = {
        transform.child_frame_id: transform.header.frame_id
        for message in (fixed.messages[0], moving.messages[0])
        for transform in message.transforms
    }
    for frame in ("l_sole", "r_gripper", "gaze", "torso", "imu_link", "pelvis", "base_footprint"):
        chain = [frame]
        while chain[-1] in parents:
            chain.append(parents[chain[-1]])
            assert len(chain) < 30, f"a loop above {frame}"
        assert chain[-1] == "map", f"{frame} hangs from {chain[-1]}"
    height = odom.messages[-1].pose.pose.position.z
    assert 0.5 < height < 1.2
    footprint = next(t for t in moving.messages[-1].transforms if t.child_frame_id == "base_footprint")
    assert abs(footprint.transform.translation.z) < 0.1
    assert clock.messages[-1].clock.sec * 10**9 + clock.messages[-1].clock.nanosec > 0
    for topic in topics:
        topic.close()
