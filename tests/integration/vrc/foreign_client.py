"""A ROS 2 program by somebody who has never seen this project: standard messages, public names, no import from it.

It reads the robot's description and state, holds them against each other, moves the right arm by a
FollowJointTrajectory goal and walks by cmd_vel. What it found goes to stdout as JSON; it fails by an exception.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

PROJECT = (
    "bifrost",
    "valor_",
    "motion_manager",
    "comms_manager",
    "footstep_converter",
    "bag_recorder",
    "vigir",
    "tests",
)


class NotInstalled:
    """Imports as on a computer without the project."""

    def find_spec(self, name: str, *_: object) -> None:
        if name.startswith(PROJECT):
            raise ImportError(f"{name} is not installed here")


sys.meta_path.insert(0, NotInstalled())

import rclpy  # noqa: E402
from builtin_interfaces.msg import Duration  # noqa: E402
from control_msgs.action import FollowJointTrajectory  # noqa: E402
from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402
from trajectory_msgs.msg import JointTrajectoryPoint  # noqa: E402

PATIENCE = 200.0  # [s]
ARM = "/trajectory_controllers/right_arm_traj_controller/follow_joint_trajectory"
JOINTS = [f"r_{name}" for name in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow_pitch", "elbow_roll")]
JOINTS += ["r_wrist_pitch", "r_wrist_yaw"]
TARGET = [0.0, -0.2, 0.0, 0.7, 0.0, 0.0, 0.0]


class Client:
    """Keeps the newest of everything."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("somebody")
        self.newest: dict[str, Any] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for name, kind, qos in (
            ("/robot_description", String, latched),
            ("/joint_states", JointState, 10),
            ("/tf", TFMessage, 100),
            ("/tf_static", TFMessage, latched),
            ("/odom", Odometry, 10),
            ("/imu/data", Imu, 10),
        ):
            self.node.create_subscription(kind, name, lambda message, n=name: self.newest.update({n: message}), qos)
        self.cmd_vel = self.node.create_publisher(Twist, "/cmd_vel", 1)
        self.arm = ActionClient(self.node, FollowJointTrajectory, ARM)

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        deadline = time.monotonic() + PATIENCE
        print(f"waiting for {what}; robot time {self.robot_time():.2f} s", file=sys.stderr, flush=True)
        while not (value := condition()):
            if time.monotonic() > deadline:
                odom = self.newest.get("/odom")
                raise TimeoutError(f"not within {PATIENCE:g} s: {what}; the last odometry: {odom}")
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return value

    def robot_time(self) -> float:
        stamp = self.newest["/joint_states"].header.stamp if "/joint_states" in self.newest else None
        return stamp.sec + 1e-9 * stamp.nanosec if stamp else 0.0

    def odometer(self) -> tuple[float, float]:
        position = self.newest["/odom"].pose.pose.position
        return position.x, position.y


def check_state(client: Client) -> dict[str, Any]:
    """What it says fits together."""
    newest = client.newest
    urdf = ElementTree.fromstring(newest["/robot_description"].data)
    moving = {j.get("name") for j in urdf.iter("joint") if j.get("type") != "fixed"}
    joints = newest["/joint_states"]
    assert set(joints.name) == moving, "joint_states and robot_description have other joints"
    assert len(joints.position) == len(joints.velocity) == len(joints.effort) == len(joints.name)
    links = {link.get("name") for link in urdf.iter("link")}
    edges = {t.child_frame_id: t for name in ("/tf_static", "/tf") for t in newest[name].transforms}
    assert links <= {*edges, "odom"}, f"links without a transform: {links - {*edges}}"
    for frame in links:
        chain = [frame]
        while chain[-1] in edges:
            chain.append(edges[chain[-1]].header.frame_id)
            assert len(chain) < 40
        assert chain[-1] == "map", f"{frame} hangs from {chain[-1]}"
    for transform in edges.values():
        q = transform.transform.rotation
        assert abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) < 1e-6
    imu, odom = newest["/imu/data"], newest["/odom"]
    a, base = imu.linear_acceleration, edges["base_link"].transform.translation
    assert imu.header.frame_id in links
    assert abs(math.hypot(a.x, a.y, a.z) - 9.81) < 1.0, "specific force at rest"
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert abs(base.z - odom.pose.pose.position.z) < 0.02, "tf and odom"
    return {
        "joints": len(joints.name),
        "links": len(links),
        "mass": sum(float(m.get("value", "")) for m in urdf.iter("mass")),
    }


def move_arm(client: Client) -> dict[str, Any]:
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = JOINTS
    goal.trajectory.points = [JointTrajectoryPoint(positions=TARGET, time_from_start=Duration(sec=2))]
    client.wait(client.arm.server_is_ready, "the arm's action server")
    sent = client.arm.send_goal_async(goal)
    handle = client.wait(lambda: sent.done() and sent.result(), "an answer to the goal")
    assert handle.accepted
    ended = handle.get_result_async()
    result = client.wait(lambda: ended.done() and ended.result(), "the end of the goal").result

    def there() -> bool:
        state = client.newest["/joint_states"]
        positions = dict(zip(state.name, state.position, strict=True))
        return all(abs(positions[name] - target) < 0.03 for name, target in zip(JOINTS, TARGET, strict=True))

    client.wait(there, "the arm within 0.03 rad")
    return {"error_code": result.error_code, "error_string": result.error_string}


def walk(client: Client, distance: float) -> float:
    twist = Twist()
    twist.linear.x = 0.3
    x, y = client.odometer()

    def gone() -> float:
        now = client.odometer()
        return math.hypot(now[0] - x, now[1] - y)

    timer = client.node.create_timer(0.05, lambda: client.cmd_vel.publish(twist))
    client.wait(lambda: gone() > distance, f"walking {distance} m")
    client.node.destroy_timer(timer)
    client.cmd_vel.publish(Twist())
    return gone()


def main() -> None:
    client = Client()
    client.wait(lambda: len(client.newest) == 6, "every topic")
    found: dict[str, Any] = check_state(client)
    found["arm"] = move_arm(client)
    found["walked"] = walk(client, 0.1)
    found["imported"] = sorted(name for name in sys.modules if name.startswith(PROJECT))
    print(json.dumps(found))
    rclpy.shutdown()


if __name__ == "__main__":
    main()
