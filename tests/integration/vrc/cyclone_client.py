"""A client without ROS: CycloneDDS for Python, and the types it needs as IDL would have them.

It reads joint states and robot time, asks for a control mode by topic, sends an arm a goal through the DDS topics that
a ROS action is made of, and waits for its result. What it found goes to stdout as JSON; it fails by an exception.
"""

from __future__ import annotations

import json
import os
import sys
import time
import uuid
from collections.abc import Callable
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import array, float64, int8, int32, sequence, uint8, uint16, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE = 100.0  # [s]
CONFIGURATION = """<CycloneDDS><Domain>
  <General><AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface name="lo"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


def struct(name: str, /, **fields: Any) -> Any:
    """A type of a ROS interface, "package/kind/Name", as its IDL would make it."""
    package, kind, own = name.split("/")
    return make_idl_struct(own, f"{package}::{kind}::dds_::{own}_", fields)


Numbers = sequence[float64]
Time = struct("builtin_interfaces/msg/Time", sec=int32, nanosec=uint32)
Duration = struct("builtin_interfaces/msg/Duration", sec=int32, nanosec=uint32)
Header = struct("std_msgs/msg/Header", stamp=Time, frame_id=str)
Clock = struct("rosgraph_msgs/msg/Clock", clock=Time)
JointState = struct(
    "sensor_msgs/msg/JointState",
    header=Header,
    name=sequence[str],
    position=Numbers,
    velocity=Numbers,
    effort=Numbers,
)
ModeCommand = struct(
    "vigir_humanoid_control_msgs/msg/VigirControlModeCommand", header=Header, requested_control_mode=str
)
ModeStatus = struct(
    "vigir_humanoid_control_msgs/msg/ControlModeStatus",
    header=Header,
    requested_control_mode=str,
    current_control_mode=str,
    status=uint32,
)
Point = struct(
    "trajectory_msgs/msg/JointTrajectoryPoint",
    positions=Numbers,
    velocities=Numbers,
    accelerations=Numbers,
    effort=Numbers,
    time_from_start=Duration,
)
Trajectory = struct(
    "trajectory_msgs/msg/JointTrajectory", header=Header, joint_names=sequence[str], points=sequence[Point]
)
Vector3 = struct("geometry_msgs/msg/Vector3", x=float64, y=float64, z=float64)
Quaternion = struct("geometry_msgs/msg/Quaternion", x=float64, y=float64, z=float64, w=float64)
Transform = struct("geometry_msgs/msg/Transform", translation=Vector3, rotation=Quaternion)
Twist = struct("geometry_msgs/msg/Twist", linear=Vector3, angular=Vector3)
MultiPoint = struct(
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
    transforms=sequence[Transform],
    velocities=sequence[Twist],
    accelerations=sequence[Twist],
    time_from_start=Duration,
)
MultiTrajectory = struct(
    "trajectory_msgs/msg/MultiDOFJointTrajectory",
    header=Header,
    joint_names=sequence[str],
    points=sequence[MultiPoint],
)
Tolerance = struct(
    "control_msgs/msg/JointTolerance", name=str, position=float64, velocity=float64, acceleration=float64
)
ComponentTolerance = struct(
    "control_msgs/msg/JointComponentTolerance",
    joint_name=str,
    component=uint16,
    position=float64,
    velocity=float64,
    acceleration=float64,
)
Goal = struct(
    "control_msgs/action/FollowJointTrajectory_Goal",
    trajectory=Trajectory,
    multi_dof_trajectory=MultiTrajectory,
    path_tolerance=sequence[Tolerance],
    component_path_tolerance=sequence[ComponentTolerance],
    goal_tolerance=sequence[Tolerance],
    component_goal_tolerance=sequence[ComponentTolerance],
    goal_time_tolerance=Duration,
)
Uuid = struct("unique_identifier_msgs/msg/UUID", uuid=array[uint8, 16])
SendGoal = struct("control_msgs/action/FollowJointTrajectory_SendGoal_Request", goal_id=Uuid, goal=Goal)
GoalAnswer = struct("control_msgs/action/FollowJointTrajectory_SendGoal_Response", accepted=bool, stamp=Time)
GetResult = struct("control_msgs/action/FollowJointTrajectory_GetResult_Request", goal_id=Uuid)
Result = struct("control_msgs/action/FollowJointTrajectory_Result", error_code=int32, error_string=str)
ResultAnswer = struct("control_msgs/action/FollowJointTrajectory_GetResult_Response", status=int8, result=Result)


class Client:
    """Readers and writers of what ROS calls topics and services."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, CONFIGURATION)  # kept as long as the participant
        self.participant = DomainParticipant(domain)

    def reader(self, kind: type, name: str, depth: int = 1000, *, latched: bool = False) -> Any:
        qos = self._qos(depth, latched)
        return DataReader(self.participant, Topic(self.participant, name, kind), qos=qos)

    def writer(self, kind: type, name: str) -> Any:
        return DataWriter(self.participant, Topic(self.participant, name, kind), qos=self._qos(10, False))

    @staticmethod
    def _qos(depth: int, latched: bool) -> Qos:
        durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        return Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(depth), durability)


def header() -> Any:
    """Of now."""
    return Header(Time(0, 0), "")


def wait(condition: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"not within {PATIENCE:g} s: {what}")
        time.sleep(0.01)
    return value


def matched(*writers: Any) -> None:
    """Whoever shall hear a writer is there."""
    for writer in writers:
        wait(writer.get_matched_subscriptions, f"a reader of {writer.topic.name}")


def change_mode(client: Client, mode: str) -> str:
    """The control mode that the robot says it is in."""
    status = client.reader(ModeStatus, "rt/flor/controller/mode", latched=True)
    command = client.writer(ModeCommand, "rt/flor/controller/mode_command")
    matched(command)
    command.write(ModeCommand(header(), mode))
    newest = ""

    def there() -> bool:
        nonlocal newest
        for message in status.take(N=1000):
            newest = message.current_control_mode
        return newest == mode

    wait(there, f"mode {mode}")
    return newest


def follow(client: Client, action: str, angles: dict[str, float], seconds: int) -> Any:
    """A goal of a trajectory action, and its result."""
    goals, answers = (
        client.writer(SendGoal, f"rq{action}/_action/send_goalRequest"),
        client.reader(GoalAnswer, f"rr{action}/_action/send_goalReply"),
    )
    asked, results = (
        client.writer(GetResult, f"rq{action}/_action/get_resultRequest"),
        client.reader(ResultAnswer, f"rr{action}/_action/get_resultReply"),
    )
    matched(goals, asked)
    for reader in (answers, results):
        wait(reader.get_matched_publications, f"a writer of {reader.topic.name}")
    name = Uuid(list(uuid.uuid4().bytes))
    point = Point(list(angles.values()), [0.0] * len(angles), [], [], Duration(seconds, 0))
    trajectory = Trajectory(header(), list(angles), [point])
    goals.write(SendGoal(name, Goal(trajectory, MultiTrajectory(header(), [], []), [], [], [], [], Duration(0, 0))))
    (answer,) = wait(lambda: answers.take(N=1), "an answer to the goal")
    assert answer.accepted, "the goal was not taken"
    asked.write(GetResult(name))
    (result,) = wait(lambda: results.take(N=1), "the goal's result")
    return result


def main() -> None:
    action, target = sys.argv[1], json.loads(sys.argv[2])
    client = Client(int(os.environ["ROS_DOMAIN_ID"]))
    joints, clock = client.reader(JointState, "rt/joint_states"), client.reader(Clock, "rt/clock")
    states = [*wait(lambda: joints.take(N=1), "joint states")]
    ticks = wait(lambda: clock.take(N=1), "the clock")
    mode = change_mode(client, "stand_manipulate")
    result = follow(client, action, target, 2)

    def there() -> bool:
        states.extend(joints.take(N=1000))
        now = dict(zip(states[-1].name, states[-1].position, strict=True))
        return all(abs(now[name] - angle) < 0.03 for name, angle in target.items())

    wait(there, "the arm within 0.03 rad")
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in states]
    found = {
        "joints": len(states[-1].name),
        "vectors": sorted({len(v) for s in states for v in (s.name, s.position, s.velocity, s.effort)}),
        "states": len(states),
        "in order": stamps == sorted(stamps),
        "clock": ticks[0].clock.sec,
        "mode": mode,
        "status": result.status,
        "error": [result.result.error_code, result.result.error_string],
        "ros": sorted(name for name in sys.modules if name.startswith("rclpy")),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
