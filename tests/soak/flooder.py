"""One that floods: ``python -m tests.soak.flooder bifrost|ros SECONDS``, as fast as one loop goes, once it is heard."""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

import bifrost
from valor.common import membership
from valor.common.instance import Instance
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS
from valor.robot.description import RobotDescription

PATIENCE = 20.0  # until all subscribers have connected [s]


def await_heard(node: bifrost.Node, *publishers: bifrost.Publisher[Any]) -> None:
    """Wait until latched publishers, which alone know, have all the subscribers that there are of their topics.

    Raises:
        TimeoutError: somebody does not connect.
    """
    topics = node.graph().topics
    deadline = time.monotonic() + PATIENCE
    for each in publishers:
        while each.subscribers < len(topics[each.topic].subscribers):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{each.topic}: {each.subscribers} of its subscribers after {PATIENCE:g} s")
            time.sleep(0.01)


def over_bifrost(instance: Instance, seconds: float) -> int:
    """Set-points for all joints; returns how many."""
    robot = RobotDescription.load(instance.settings().robot)
    zeros = np.zeros(len(robot.joints))
    message = JointSetpoints(0, list(robot.joints), zeros, zeros, zeros)
    with bifrost.Node("flooder", network=membership.network(instance, "valor_ros_controller")) as node:
        publisher = node.publisher(JOINT_SETPOINTS.name, JointSetpoints, latched=True)
        await_heard(node, publisher)
        until, sent = time.monotonic() + seconds, 0
        while time.monotonic() < until:
            publisher.publish(message)
            sent += 1
    return sent


def over_ros(instance: Instance, seconds: float) -> int:
    """Trajectories of an arm and modes that there are none of; returns how many."""
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    from valor.valorctl.ros_client import RosClient

    with RosClient(instance) as ros:
        arm = ros.publisher(JointTrajectory, "/trajectory_controllers/right_arm_traj_controller/joint_trajectory", 1)
        other = ros.publisher(String, "/chatter", 0)
        until, sent = time.monotonic() + seconds, 0
        while time.monotonic() < until:
            arm.publish(JointTrajectory(joint_names=["nobody"]))
            other.publish(String(data="flood"))
            sent += 1
    return sent


if __name__ == "__main__":
    here = Instance.from_environment()
    print({"bifrost": over_bifrost, "ros": over_ros}[sys.argv[1]](here, float(sys.argv[2])))
