"""Latency of messages through the Valor ROS Controller on a live system.

Starts the whole system with ``valorctl up``, then measures three pathways. The thesis package's
``valorctl experiment pathway-latency`` does so from a bag, with the floor of the transports.

    state             Proprioceptor sent ─► /joint_states of the same robot time received
    mode change       action goal sent ─► its result received (accepted); ─► /flor/controller/mode received (reported)
    joint command     JointTrajectory sent ─► JointSetpoints sent ─► Motor sent ─► joint measured to move

Both clocks are the computer's monotonic one. The load of the machine stands beside the numbers: on a shared machine
medians can be trusted, the tails measure the neighbours.

    .venv/bin/python benchmarks/pathways.py [--seconds 20] [--changes 40] [--commands 40]
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import bifrost
from benchmarks.live_system import started
from benchmarks.tables import Columns, table
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription

INSTANCE = "pathways"
PATIENCE = 20.0  # [s]
SETTLING = 5.0  # after `up` [s]
PAUSE = 0.35  # between two mode changes or commands [s]
JOINT, CONTROLLER = "l_wrist_yaw", "left_arm_traj_controller"
SPEED, SWING = 1.0, 0.2  # of the commanded motion [rad/s], [rad]
STARTED = 0.001  # a command that has gone so far has begun: what balance adds to it is less [rad]
MOVED = 0.005  # a joint that has gone so far moves [rad]
MODE_ACTION = "/mode_controllers/control_mode_controller/change_control_mode"

Samples = list[float]  # [s]


class Ears:
    """A ROS 2 node that notes when things come; everything in one thread."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.action import ActionClient
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory
        from vigir_humanoid_control_msgs.action import ChangeControlMode
        from vigir_humanoid_control_msgs.msg import ControlModeStatus

        rclpy.init()
        self.node = rclpy.create_node("pathways", enable_rosout=False, start_parameter_services=False)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.states: list[tuple[int, int]] = []  # (stamp of robot time, arrival) [ns]
        self.reports: list[tuple[int, Any]] = []
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(JointState, "/joint_states", self._note(self.states), 5)
        self.node.create_subscription(
            ControlModeStatus,
            "/flor/controller/mode",
            lambda report: self.reports.append((time.monotonic_ns(), report)),
            latched,
        )
        self.mode = ActionClient(self.node, ChangeControlMode, MODE_ACTION)
        self.command = self.node.create_publisher(
            JointTrajectory, f"/trajectory_controllers/{CONTROLLER}/joint_trajectory", 1
        )

    @staticmethod
    def _note(arrivals: list[tuple[int, int]]) -> Callable[[Any], None]:
        def note(message: Any) -> None:
            stamp = message.header.stamp
            arrivals.append((stamp.sec * 10**9 + stamp.nanosec, time.monotonic_ns()))

        return note

    def spin(self, until: Callable[[], bool], timeout: float, what: str = "") -> None:
        """Hear what comes; without ``what`` the time-out is the end."""
        deadline = time.monotonic() + timeout
        while not until():
            left = deadline - time.monotonic()
            if left <= 0.0:
                if what:
                    sys.exit(f"not within {timeout:g} s: {what}")
                return
            self.executor.spin_once(timeout_sec=min(left, 0.05))

    def rest(self, seconds: float) -> None:
        """Hear what comes while robot time, which a loaded machine slows down, goes on for so long."""
        self.spin(lambda: bool(self.states), PATIENCE, "/joint_states")
        end = self.states[-1][0] + round(seconds * 1e9)
        self.spin(lambda: self.states[-1][0] > end, PATIENCE, f"{seconds:g} s of robot time")

    def change(self, client: Any, mode: str) -> tuple[int, int, Any]:
        """Send a goal and wait for its result: (sent, received) [ns] and the result."""
        from vigir_humanoid_control_msgs.action import ChangeControlMode

        self.spin(client.server_is_ready, PATIENCE, "an action server")
        sent = time.monotonic_ns()
        accepting = client.send_goal_async(ChangeControlMode.Goal(mode_request=mode))
        self.spin(accepting.done, PATIENCE, "an answer to a goal")
        ending = accepting.result().get_result_async()
        self.spin(ending.done, PATIENCE, "a result")
        return sent, time.monotonic_ns(), ending.result().result.result


@dataclass
class Row:
    """One line of the table."""

    pathway: str
    samples: Samples
    thesis: str

    def of_several(self, figure: Callable[[Samples], float]) -> str:
        """A figure [ms] that one sample has not."""
        return f"{figure(self.samples) * 1e3:.2f}" if len(self.samples) > 1 else ""

    @property
    def median(self) -> float:
        """[s]."""
        return float(np.median(self.samples))


COLUMNS: Columns[Row] = (
    ("pathway", lambda row: row.pathway),
    ("median", lambda row: f"{row.median * 1e3:.2f}"),
    ("95 %", lambda row: row.of_several(lambda samples: float(np.quantile(samples, 0.95)))),
    ("max", lambda row: row.of_several(max)),
    ("count", lambda row: str(len(row.samples))),
    ("thesis", lambda row: row.thesis),
)


def measure_state(ears: Ears, node: bifrost.Node, seconds: float) -> Samples:
    """Proprioceptor sent to the joint states of the same time received."""
    proprioceptor = PROPRIOCEPTOR.subscriber(node, queue=2000)
    ears.spin(lambda: False, 1.0)
    sent: dict[int, int] = {}
    proprioceptor.drain()
    ears.states.clear()
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        ears.spin(lambda: False, 0.5)
        sent.update((received.message.time, received.stamp) for received in proprioceptor.drain())
    proprioceptor.close()
    return [(arrival - sent[stamp]) * 1e-9 for stamp, arrival in ears.states if stamp in sent]


@dataclass
class _Told:
    """True once the topic has reported that a mode was accepted; ``at`` is the time of it [ns]."""

    ears: Ears
    mode: str
    at: int = 0

    def __call__(self) -> bool:
        for arrival, report in self.ears.reports:
            if report.status == report.MODE_ACCEPTED and report.current_control_mode == self.mode:
                self.at = arrival
                return True
        return False


def measure_modes(ears: Ears, changes: int) -> tuple[Samples, Samples]:
    """Goal sent to result received, and to the report received."""
    accepted: Samples = []
    reported: Samples = []
    for mode in itertools.islice(itertools.cycle(("stand_manipulate", "stand")), changes):
        ears.reports.clear()
        sent, received, status = ears.change(ears.mode, mode)
        if status.status != status.MODE_ACCEPTED:
            sys.exit(f"{mode}: status {status.status}, current {status.current_control_mode}")

        told = _Told(ears, mode)
        ears.spin(told, PATIENCE, f"a report of {mode}")
        accepted.append((received - sent) * 1e-9)
        reported.append((told.at - sent) * 1e-9)
        ears.rest(PAUSE)
    return accepted, reported


def measure_commands(
    ears: Ears, node: bifrost.Node, robot: RobotDescription, commands: int
) -> tuple[Samples, Samples, Samples]:
    """Reference sent to set-points sent, to Motor sent; and Motor to the joint that moves."""
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    ears.change(ears.mode, "stand_manipulate")
    ears.spin(lambda: ears.command.get_subscription_count() > 0, PATIENCE, "a subscriber of the trajectories")
    joint, names = robot.index[JOINT], list(robot.tables.groups["left_arm"])
    home = [float(robot.nominal_posture[robot.index[name]]) for name in names]
    setpoints = JOINT_SETPOINTS.subscriber(node, queue=2000)
    motors = MOTOR.subscriber(node, queue=2000)
    states = PROPRIOCEPTOR.subscriber(node, queue=2000)
    to_setpoint: Samples = []
    to_motor: Samples = []
    to_joint: Samples = []
    for sign in itertools.islice(itertools.cycle((1, -1)), commands):
        ears.rest(SWING / SPEED + PAUSE)
        setpoints.drain()
        last_motor, last_state = motors.drain()[-1].message, states.drain()[-1].message
        target = list(home)
        target[names.index(JOINT)] += SWING if sign > 0 else 0.0
        point = JointTrajectoryPoint(positions=target, time_from_start=Duration(nanosec=round(1e9 * SWING / SPEED)))
        message = JointTrajectory(joint_names=names, points=[point])
        sent = time.monotonic_ns()
        ears.command.publish(message)
        ears.rest(SWING / SPEED)
        first = next((r.stamp for r in setpoints.drain() if _speed(r.message) > 0.1), None)
        motions = [
            (r.stamp, abs(r.message.position[joint] - last_motor.position[joint]))
            for r in motors.drain()
            if r.stamp > sent
        ]
        started = next((stamp for stamp, distance in motions if distance > STARTED), None)
        led = next((stamp for stamp, distance in motions if distance > MOVED), None)
        measured = [
            (r.stamp, abs(r.message.joint_position[joint] - last_state.joint_position[joint])) for r in states.drain()
        ]
        moved = next((stamp for stamp, distance in measured if stamp > sent and distance > MOVED), None)
        if first is None or started is None or led is None or moved is None:
            continue  # the first command may find the arm elsewhere
        to_setpoint.append((first - sent) * 1e-9)
        to_motor.append((started - sent) * 1e-9)
        to_joint.append((moved - led) * 1e-9)
    return to_setpoint, to_motor, to_joint


def _speed(message: JointSetpoints) -> float:
    return abs(float(message.velocity[message.names.index(JOINT)])) if JOINT in message.names else 0.0


def measure(options: argparse.Namespace) -> list[Row]:
    """Everything, in one run."""
    with tempfile.TemporaryDirectory(prefix="valor-") as folder:
        instance = Instance(INSTANCE, options.home or Path(folder))
        with started(instance, *options.up) as node:
            os.environ.update(instance.environment())
            robot = RobotDescription.load(instance.settings().robot)
            ears = Ears()
            time.sleep(SETTLING)
            state = measure_state(ears, node, options.seconds)
            accepted, reported = measure_modes(ears, options.changes)
            to_setpoint, to_motor, to_joint = measure_commands(ears, node, robot, options.commands)
    return [
        Row("state: Proprioceptor → /joint_states", state, "40 ms"),
        Row("mode: commanded → accepted", accepted, ""),
        Row("mode: commanded → reported", reported, "49 ms"),
        Row("joint: reference → JointSetpoints", to_setpoint, ""),
        Row("joint: reference → Motor", to_motor, ""),
        Row("joint: Motor → Proprioceptor moves", to_joint, "335 ms in all"),
    ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of state")
    parser.add_argument("--changes", type=int, default=40, help="of the control mode")
    parser.add_argument("--commands", type=int, default=40, help="of a joint")
    parser.add_argument("--home", type=Path, help="of the instance, where a deployment has been joined")
    parser.add_argument("--json", type=Path, help="file for the samples [s], by pathway")
    parser.add_argument("up", nargs="*", help="options of `valorctl up`, after --")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    try:
        rows = measure(options)
    except ValorError as error:
        sys.exit(str(error))
    if options.json is not None:
        options.json.write_text(json.dumps({row.pathway: row.samples for row in rows}))
    console = Console(width=130)
    title = f"Pathways [ms], load {load:.1f} before and {os.getloadavg()[0]:.1f} after, {os.cpu_count()} cores"
    console.print(table(title, COLUMNS, (row for row in rows if row.samples), left=["pathway"]))


if __name__ == "__main__":
    main()
