#!/usr/bin/env python3
"""Stand, free the arms, reach with the right one, look aside, and come back: an ordinary ROS 2 client of the robot.

It knows public names and messages only, and no robot: which joints an arm has it asks the controller manager, how far
and how fast they turn it reads in /robot_description. Start it where the robot's ROS 2 side can be heard (same
ROS_DOMAIN_ID):

    python stand_and_reach.py [--json FILE] [--postures FILE]

An arm whose joints are not called as usual is told two postures, by joint [rad]: ``{"forward": {…}, "aside": {…}}``.

``perform`` is the whole motion; ``Robot`` shows how each part of it is done over ROS 2.

Exit status: 0 when every joint ended within 0.02 rad of its goal; 1 otherwise, with a line on standard error;
130 when interrupted, after the running motion is canceled.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any
from xml.etree import ElementTree

import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.srv import ListControllers
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from streams import Streams, lines  # beside this file
from trajectory_msgs.msg import JointTrajectoryPoint
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus

MODE_TOPIC = "flor/controller/mode"
MODE_ACTION = "mode_controllers/control_mode_controller/change_control_mode"
CONTROLLERS = "controller_manager/list_controllers"
TRAJECTORY_ACTION = "trajectory_controllers/{}/follow_joint_trajectory"
ARM, NECK = "right_arm_traj_controller", "neck_traj_controller"

Posture = dict[str, float]  # joint positions [rad]
Point = tuple[float, Posture]  # of a trajectory: when at the earliest [s], and where

# Postures by how a joint's name ends. What is not named is 0; what a robot has no such joint for is left out.
FORWARD: Posture = {"shoulder_pitch": -0.7, "shoulder_roll": -0.15, "elbow_pitch": 0.3, "wrist_pitch": 0.2}
ASIDE = {"shoulder_pitch": -0.9, "shoulder_roll": -0.6, "shoulder_yaw": -0.3, "elbow_pitch": 0.9, "elbow_roll": 0.4}
LOOK_ASIDE: Posture = {"yaw": -0.5, "pitch": 0.25}
LOOK_AHEAD: Posture = {}
REACH = ("shoulder_pitch", "elbow_pitch")  # without these, an arm does not reach

TOLERANCE = 0.02  # [rad]
SPEED = 0.5  # most of a joint's speed limit, on average between two points
MARGIN = 0.02  # to a joint's stops [rad]
SETTLE = 0.7  # of robot time, from a goal's end until the final joint positions are taken [s]
AVERAGE = 0.3  # of robot time, over which they are averaged [s]
PATIENCE = 20.0  # with topics and actions to appear, with answers, with a change of mode [s]
CANCEL = 3.0  # [s]
SLOWEST = 0.1  # real-time factor below which a motion is given up

say = partial(print, flush=True)  # at once, in a pipe too


class ClientError(Exception):
    """Why it did not work, in one line."""


@dataclass
class ModeChange:
    """One change of control mode."""

    mode: str
    latency: float  # from request to result [s]


@dataclass
class Motion:
    """One trajectory, and where the joints were after it."""

    name: str
    error_code: int
    seconds: float  # from goal to result [s]
    worst_joint: str
    max_error: float  # [rad]
    errors: dict[str, float]  # by joint [rad]
    pelvis_displacement: float  # largest horizontal, while it moved [cm]


@dataclass(frozen=True)
class Limits:
    """Of a joint."""

    lower: float  # [rad]
    upper: float  # [rad]
    velocity: float  # [rad/s]


def perform(robot: Robot, told: dict[str, Posture]) -> tuple[list[ModeChange], list[Motion]]:
    """The whole motion, a line a step; ``told``: what to reach for where joints' names do not say it."""
    robot.connect()
    say(f"connected; control mode {robot.mode}")
    changes: list[ModeChange] = []
    motions: list[Motion] = []

    def change(mode: str) -> None:
        changes.append(robot.change_mode(mode))
        say(f"control mode {mode} after {1e3 * changes[-1].latency:.0f} ms")

    def follow(name: str, controller: str, *points: Point) -> None:
        if not points[0][1]:
            return  # a robot without a neck looks nowhere
        motions.append(motion := robot.follow(name, controller, list(points)))
        say(
            f"{name}: done in {motion.seconds:.1f} s, largest error {motion.max_error:.4f} rad ({motion.worst_joint}), "
            f"pelvis moved {motion.pelvis_displacement:.2f} cm"
        )

    arm, neck = robot.joints_of(ARM), robot.joints_of(NECK)
    if not arm:
        raise ClientError(f"{CONTROLLERS} knows no {ARM}: the robot has no arm to reach with")
    usual = all(any(joint.endswith(end) for joint in arm) for end in REACH)
    if not (reach := {"forward": FORWARD, "aside": ASIDE} if usual else told):
        raise ClientError(f"{ARM} moves {', '.join(arm)}: to reach, it needs {' and '.join(REACH)}, or --postures")
    if robot.mode != "stand":
        change("stand")
    home = robot.settled(arm)
    change("stand_manipulate")
    forward, aside = (robot.posture(arm, reach[name]) for name in ("forward", "aside"))
    follow("right arm forward, then aside", ARM, (2.5, forward), (4.5, aside))
    follow("neck looks at the hand", NECK, (1.5, robot.posture(neck, LOOK_ASIDE)))
    follow("right arm home", ARM, (2.0, forward), (4.5, home))
    follow("neck ahead", NECK, (1.5, robot.posture(neck, LOOK_AHEAD)))
    change("stand")
    return changes, motions


class Robot:
    """The robot as this client hears it: its newest mode, and where it has been since the start."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # an interrupted motion is canceled first
        self.node = rclpy.create_node("stand_and_reach")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.mode: str | None = None
        self.limits: dict[str, Limits] = {}  # by joint
        self.pelvis: list[tuple[float, float]] = []  # in odom [m]
        self.streams = Streams(self.node)  # /joint_states and /clock
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(ControlModeStatus, MODE_TOPIC, self._hear_mode, latched)
        self.node.create_subscription(String, "robot_description", self._hear_description, latched)
        self.node.create_subscription(Odometry, "odom", self._hear_odometry, qos_profile_sensor_data)
        self.modes = ActionClient(self.node, ChangeControlMode, MODE_ACTION)
        self.controllers = self.node.create_client(ListControllers, CONTROLLERS)
        self.actions = {
            name: ActionClient(self.node, FollowJointTrajectory, TRAJECTORY_ACTION.format(name)) for name in (ARM, NECK)
        }

    def _hear_mode(self, status: ControlModeStatus) -> None:
        self.mode = status.current_control_mode

    def _hear_description(self, description: String) -> None:
        for joint in ElementTree.fromstring(description.data).iterfind("joint"):
            if (limit := joint.find("limit")) is not None:
                lower, upper = float(limit.get("lower", "-inf")), float(limit.get("upper", "inf"))
                self.limits[joint.get("name", "")] = Limits(lower, upper, float(limit.get("velocity", "inf")))

    def _hear_odometry(self, odometry: Odometry) -> None:
        position = odometry.pose.pose.position
        self.pelvis.append((position.x, position.y))

    def wait(self, condition: Callable[[], Any], timeout: float, otherwise: str) -> None:
        """Let messages in until the condition holds.

        Raises:
            ClientError: not within ``timeout`` [s]; its text is ``otherwise``.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                raise ClientError(otherwise)
            self._executor.spin_once(timeout_sec=0.05)

    def wait_robot_time(self, duration: float) -> None:
        """Let messages in for a stretch of robot time [s]; of wall time where nobody publishes /clock."""
        began = self.streams.clock
        if began is None:
            end = time.monotonic() + duration
            self.wait(lambda: time.monotonic() >= end, duration + 1.0, "")
        else:
            stopped = f"/clock stopped at {began:.2f} s"
            self.wait(lambda: (self.streams.clock or began) - began >= duration, duration / SLOWEST + 5.0, stopped)

    def connect(self) -> None:
        """Wait for every topic and action that is needed.

        Raises:
            ClientError: names those that are absent.
        """
        needs: dict[str, Callable[[], Any]] = {
            f"topic {MODE_TOPIC}": lambda: self.mode is not None,
            "topic /joint_states": lambda: self.streams.states,
            "topic /odom": lambda: self.pelvis,
            "topic /robot_description": lambda: self.limits,
            f"service {CONTROLLERS}": self.controllers.service_is_ready,
            f"action {MODE_ACTION}": self.modes.server_is_ready,
        }
        self._await(needs)

    def _await(self, needs: dict[str, Callable[[], Any]]) -> None:
        try:
            self.wait(lambda: all(present() for present in needs.values()), PATIENCE, "")
        except ClientError:
            absent = ", ".join(name for name, present in needs.items() if not present())
            advice = "is the robot up, and ROS_DOMAIN_ID the robot's?"
            raise ClientError(f"not there within {PATIENCE:g} s: {absent}; {advice}") from None

    def joints_of(self, controller: str) -> list[str]:
        """The joints that a trajectory controller moves; none where there is no such controller.

        Raises:
            ClientError: nobody says, the controller takes no goals, or a joint of it has no limits.
        """
        asked = self.controllers.call_async(ListControllers.Request())
        self.wait(asked.done, PATIENCE, f"{CONTROLLERS}: no answer within {PATIENCE:g} s")
        interfaces = {each.name: each.required_command_interfaces for each in asked.result().controller}
        if controller not in interfaces:
            return []
        self._await({f"action of {controller}": self.actions[controller].server_is_ready})
        joints = [name.removesuffix("/position") for name in interfaces[controller] if name.endswith("/position")]
        if absent := [joint for joint in joints if joint not in self.limits]:
            raise ClientError(f"/robot_description has no limits of {', '.join(absent)}")
        return joints

    def posture(self, joints: list[str], named: Posture) -> Posture:
        """Every joint's position: as named by the end of its name, else 0; between its stops."""
        positions = {}
        for joint in joints:
            limits = self.limits[joint]
            wanted = next((angle for end, angle in named.items() if joint.endswith(end)), 0.0)
            positions[joint] = min(max(wanted, limits.lower + MARGIN), limits.upper - MARGIN)
        return positions

    def change_mode(self, mode: str) -> ModeChange:
        """Ask for a control mode and wait until the robot is in it."""
        began = time.monotonic()
        ended = self._act(self.modes, ChangeControlMode.Goal(mode_request=mode), MODE_ACTION, PATIENCE)
        latency = time.monotonic() - began
        status = ended.result.result
        if status.status != ControlModeStatus.MODE_ACCEPTED or status.current_control_mode != mode:
            raise ClientError(
                f"control mode {mode!r} not reached: status {status.status}, in {status.current_control_mode!r}"
            )
        # The action's result may overtake the topic that the next refusal would be judged by.
        self.wait(lambda: self.mode == mode, PATIENCE, f"{MODE_TOPIC} still says {self.mode!r}, not {mode!r}")
        return ModeChange(mode, latency)

    def follow(self, name: str, controller: str, points: list[Point]) -> Motion:
        """Move a controller's joints along a trajectory and measure where they end."""
        joints, asked = list(points[0][1]), points[-1][1]
        points = self._in_time([(0.0, self._positions(self.streams.states[-1], joints)), *points])
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = joints
        for (when, positions), speed in list(zip(points, velocities(points), strict=True))[1:]:
            goal.trajectory.points.append(
                JointTrajectoryPoint(
                    positions=[positions[joint] for joint in joints],
                    velocities=[speed[joint] for joint in joints],
                    time_from_start=Duration(seconds=when).to_msg(),
                )
            )
        way = len(self.pelvis) - 1
        began = time.monotonic()
        ended = self._act(self.actions[controller], goal, name, points[-1][0] / SLOWEST + 10.0)
        took = time.monotonic() - began
        result = ended.result
        if ended.status != GoalStatus.STATUS_SUCCEEDED or result.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
            raise ClientError(f"{name}: error {result.error_code}: {result.error_string or 'no reason given'}")
        settled = self.settled(joints)
        farthest = max(math.dist(self.pelvis[way], place) for place in self.pelvis[way:])
        errors = {joint: abs(settled[joint] - asked[joint]) for joint in joints}
        worst = max(errors, key=lambda joint: errors[joint])
        return Motion(name, result.error_code, took, worst, errors[worst], errors, 100.0 * farthest)

    def _in_time(self, points: list[Point]) -> list[Point]:
        """The points, later where a joint would have to be faster than it should."""
        timed = points[:1]
        for (last, before), (when, positions) in pairwise(points):
            slowest = max(abs(positions[joint] - before[joint]) / self.limits[joint].velocity for joint in positions)
            timed.append((timed[-1][0] + max(when - last, slowest / SPEED), positions))
        return timed

    def settled(self, joints: list[str]) -> Posture:
        """Mean joint positions, once the joints have come to rest."""
        self.wait_robot_time(SETTLE)
        self.streams.states.clear()
        self.wait_robot_time(AVERAGE)
        self.wait(lambda: self.streams.states, PATIENCE, "/joint_states went silent")
        rows = [self._positions(state, joints) for state in self.streams.states]
        return {joint: fmean(row[joint] for row in rows) for joint in joints}

    @staticmethod
    def _positions(state: JointState, joints: list[str]) -> Posture:
        positions = dict(zip(state.name, state.position, strict=True))
        return {joint: positions[joint] for joint in joints}

    def _act(self, client: ActionClient, goal: Any, name: str, timeout: float) -> Any:
        """Send a goal and wait for its end: terminal status and result. One that is given up is canceled."""
        sent = client.send_goal_async(goal)
        self.wait(sent.done, PATIENCE, f"{name}: no answer to the goal within {PATIENCE:g} s")
        handle = sent.result()
        if not handle.accepted:
            raise ClientError(f"{name}: goal rejected")
        ended = handle.get_result_async()
        try:
            self.wait(ended.done, timeout, f"{name}: no result within {timeout:g} s")
        except (ClientError, KeyboardInterrupt):
            canceled = handle.cancel_goal_async()
            self.wait(canceled.done, CANCEL, f"{name}: gave up, and no answer to its cancellation")
            raise
        return ended.result()

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()


def velocities(points: list[Point]) -> list[dict[str, float]]:
    """Joint velocities at the points of a trajectory [rad/s]: none at its ends and where a joint turns back."""
    still = dict.fromkeys(points[0][1], 0.0)
    between = []
    for (t0, a), (t1, b), (t2, c) in zip(points, points[1:], points[2:], strict=False):
        slopes = {joint: ((b[joint] - a[joint]) / (t1 - t0), (c[joint] - b[joint]) / (t2 - t1)) for joint in still}
        # The harmonic mean keeps the spline between its points (Fritsch and Butland, 1984).
        between.append({joint: 2 * u * v / (u + v) if u * v > 0 else 0.0 for joint, (u, v) in slopes.items()})
    return [still, *between, still]


def report(changes: list[ModeChange], motions: list[Motion], streams: Streams, json_file: Path | None) -> None:
    """Show what was measured, and write it where that is wanted.

    Raises:
        ClientError: a joint ended too far from its goal.
        OSError: it could not be written.
    """
    measured = streams.measured()
    say(f"\n{'motion':<32}{'error [rad]':>12}{'pelvis [cm]':>13}")
    for each in motions:
        say(f"{each.name:<32}{each.max_error:>12.4f}{each.pelvis_displacement:>13.2f}")
    say("\n".join(["", *lines(measured)]))
    if json_file:
        content = {"mode_changes": [*map(asdict, changes)], "motions": [*map(asdict, motions)], "streams": measured}
        json_file.write_text(json.dumps(content, indent=2) + "\n")
    for each in motions:
        if not each.max_error <= TOLERANCE:
            off = f"{each.worst_joint} ended {each.max_error:.4f} rad off its goal"
            raise ClientError(f"{each.name}: {off}; within {TOLERANCE:g} expected")


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the measurements there")
    parser.add_argument("--postures", type=Path, metavar="FILE", help="read what to reach for there")
    arguments = parser.parse_args(rclpy.utilities.remove_ros_args(sys.argv)[1:])
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with closing(Robot()) as robot:
            told = json.loads(arguments.postures.read_text()) if arguments.postures else {}
            report(*perform(robot, told), robot.streams, arguments.json)
    except (ClientError, OSError, ValueError) as error:
        print(f"stand_and_reach: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stand_and_reach: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
