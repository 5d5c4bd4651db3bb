"""What a flood does to the Motors: how evenly they come while one member sends as much as a loop can.

Starts the whole system with ``valorctl up``; a process of its own listens to Motors, and another one floods one input
after the other. Periods are between Motors, by the Motion Manager's stamps (wall time), and by robot time: how many
control periods the Proprioceptor answered lies behind the one before. Between floods the robot is left alone.

    .venv/bin/python benchmarks/floods.py [--seconds 10] [--only "set-points,nothing"] [--up "--clock realtime"]
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import bifrost
from benchmarks.live_system import SETTLING, started
from valor.common import membership
from valor.common.instance import Instance
from valor.common.messages import (
    BehaviorRequest,
    DeviceStatus,
    JointSetpoints,
    Motor,
)
from valor.common.topics import BEHAVIOR, DEVICES, JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR, STATISTICS

QUICK = 10_000.0  # [Hz]


def _sent(publish: Callable[[], object], seconds: float, rate: float = np.inf) -> int:
    """Send for a while; returns how many."""
    began, count = time.monotonic(), 0
    while (now := time.monotonic() - began) < seconds:
        if count < now * rate:
            publish()
            count += 1
    return count


def set_points(node: bifrost.Node, seconds: float) -> int:
    """``JointSetpoints`` of a robot time long past."""
    nothing = np.zeros(1)
    message = JointSetpoints(time=1, names=["neck_yaw"], position=nothing, velocity=nothing, acceleration=nothing)
    publisher = JOINT_SETPOINTS.publisher(node)
    time.sleep(0.5)  # until it is found
    return _sent(lambda: publisher.publish(message), seconds)


def latest_values(node: bifrost.Node, seconds: float) -> int:
    """``DeviceStatus``, of which the newest alone counts."""
    none = np.zeros(0)
    heard = DeviceStatus(0, [], [], [], none, none, none, none, none, none, "", "")
    publisher = DEVICES.publisher(node)
    time.sleep(0.5)
    return _sent(lambda: publisher.publish(heard), seconds)


def requests(node: bifrost.Node, seconds: float) -> int:
    """Requests for a behavior that is none, without waiting for an answer."""
    client = BEHAVIOR.client(node)
    request = BehaviorRequest(behavior="moonwalk")
    client.call(request, timeout=5.0)
    return _sent(lambda: client.ask(request, timeout=1.0), seconds)


def ros_set_points(node: bifrost.Node, seconds: float) -> int:
    """JointTrajectory at 10 kHz to the VRC, which has no right to lead the arm."""
    import rclpy
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    rclpy.init()
    ros = rclpy.create_node("flooder")
    topic = "/trajectory_controllers/right_arm_traj_controller/joint_trajectory"
    publisher = ros.create_publisher(JointTrajectory, topic, 1)
    point = JointTrajectoryPoint(positions=[0.0])
    point.time_from_start.sec = 1
    message = JointTrajectory(joint_names=["r_elbow_pitch"], points=[point])
    deadline = time.monotonic() + 20.0
    while not publisher.get_subscription_count() and time.monotonic() < deadline:
        time.sleep(0.05)
    return _sent(lambda: publisher.publish(message), seconds, QUICK)


def idle(node: bifrost.Node, seconds: float) -> int:
    """Send nothing."""
    time.sleep(seconds)
    return 0


FLOODS: dict[str, Callable[[bifrost.Node, float], int]] = {
    "nothing": idle,
    "set-points": set_points,
    "latest values": latest_values,
    "requests": requests,
    "ROS set-points": ros_set_points,
}

OWNERS = {"set-points": JOINT_SETPOINTS.owner, "latest values": DEVICES.owner}
"""Whose key a flood is sent with: nobody else is heard."""


def listen(node: bifrost.Node, seconds: float) -> list[bifrost.Received[Motor]]:
    """All Motors of a while."""
    subscriber = MOTOR.subscriber(node, queue=100_000)
    end = time.monotonic() + seconds
    heard: list[bifrost.Received[Motor]] = []
    while (remaining := end - time.monotonic()) > 0.0:
        if (received := subscriber.receive(remaining)) is not None:
            heard.append(received)
    assert subscriber.drops == 0, f"{subscriber.drops} Motors not heard"
    subscriber.close()
    return heard


def row(name: str, node: bifrost.Node, environment: dict[str, str], seconds: float) -> str:
    """Flood, listen; a row of the table."""
    command = [sys.executable, __file__, "--flood", name, "--seconds", str(seconds)]
    flooder = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert flooder.stdout is not None
    if flooder.stdout.readline().strip() != "begins":
        sys.exit(f"{name}: the flooder did not begin")
    heard = listen(node, seconds)
    statistics = STATISTICS["motion_manager"].subscriber(node).receive(timeout=5.0)
    sent = int(flooder.communicate()[0])
    period = np.diff([received.stamp for received in heard]) * 1e-6
    passed = np.diff([received.message.proprioceptor_sequence for received in heard])
    told = statistics.message if statistics else None
    return (
        f"| {name} | {sent / seconds:,.0f} | {len(heard) / seconds:.0f} | {np.median(period):.2f} "
        f"| {np.percentile(period, 99):.2f} | {np.percentile(period, 99.9):.2f} | {period.max():.1f} "
        f"| {np.percentile(passed, 99.9):.0f} | {passed.max()} | {f'{told.state} {told.detail}' if told else ''} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--only", default=",".join(FLOODS))
    parser.add_argument("--up", default="", help="options of valorctl up")
    parser.add_argument("--flood", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.flood:
        instance = Instance.from_environment()
        owner = OWNERS.get(options.flood, "")
        with bifrost.Node("flooder", network=membership.network(instance, owner)) as node:
            print("begins", flush=True)
            print(FLOODS[options.flood](node, options.seconds), flush=True)
        os._exit(0)  # ROS' threads need no leave
    with tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home:
        instance = Instance("floods", Path(home) / "floods")
        with started(instance, "--no-bag", *shlex.split(options.up)) as node:
            PROPRIOCEPTOR.subscriber(node).receive(timeout=20.0)
            time.sleep(SETTLING)
            environment = os.environ | instance.environment()
            print("| flood | sent [1/s] | Motors [1/s] | period [ms]: median | 99 % | 99.9 % | longest "
                  "| in robot time [periods]: 99.9 % | longest | what the Motion Manager says |")  # fmt: skip
            print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
            for name in options.only.split(","):
                print(row(name, node, environment, options.seconds), flush=True)
            state = MOTION_STATE.subscriber(node).receive(timeout=10.0)
            print(f"\nAt the end {state.message.behavior if state else 'silent'}; load {os.getloadavg()[0]:.1f} "
                  f"on {os.cpu_count()} cores.")  # fmt: skip


if __name__ == "__main__":
    main()
