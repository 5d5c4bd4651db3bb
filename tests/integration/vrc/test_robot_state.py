"""What the robot measures, and where it is, on ROS."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_msgs.msg import Imu, JointState

import bifrost
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import PATIENCE, ROBOT, Topic, stamp
from valor.common.messages import Proprioceptor
from valor.common.topics import PROPRIOCEPTOR


def test_joint_states_and_imu_are_what_the_proprioceptor_says(ros: RosClient, node: bifrost.Node) -> None:
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
