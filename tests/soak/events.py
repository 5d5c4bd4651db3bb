"""What happens to the system while the robot does something: a table of events, each with its weight."""

from __future__ import annotations

import os
import random
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import psutil

import bifrost
from tests.soak.rig import Rig
from valor.common import messages, topics
from valor.common.instance import Instance
from valor.common.messages import BalanceWeights, JointGains, JointSetpoints, PelvisSetpoint, VelocityCommand
from valor.common.topics import BALANCE_WEIGHTS, FAULT, JOINT_GAINS, JOINT_SETPOINTS, PELVIS, VELOCITY
from valor.robot.description import RobotDescription

STOPS = (0.2, 7.0)  # [s]
FLOOD = 1.0  # once it is received [s]
STARVATION = 3.0  # [s]
NAN = float("nan")
UNPLUGGED = 1.5  # [s]
PAIRS = (
    ("motion_manager", "comms_manager"), ("motion_manager", "valor_ros_controller"), ("motion_manager", "bifrostd"),
    ("bifrostd", "bag_recorder"),
)  # fmt: skip
UNITS = ("legs/1", "imu", "hdt/left_arm", "force_torque/1")

Happen = Callable[[Rig, random.Random, str], list[str]]


@dataclass(frozen=True)
class Event:
    happen: Happen  # with the rig, chance and the process; returns faults
    weight: float  # relative frequency
    kind: str = ""  # as in ``checks.outcomes``
    process: str = ""  # or unit
    other: str = ""  # second process

    @property
    def hit(self) -> tuple[str, ...]:
        return tuple(name for name in (self.process, self.other) if name)


def _kill(rig: Rig, rng: random.Random, process: str) -> list[str]:
    rig.send(process, signal.SIGKILL)
    return []


def _stop(rig: Rig, rng: random.Random, process: str, seconds: float) -> list[str]:
    rig.send(process, signal.SIGSTOP)
    pid = rig.pids()[process]
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)
    return []


def _flood(rig: Rig, rng: random.Random, how: str) -> list[str]:
    command = [sys.executable, "-m", "tests.soak.events", how, str(FLOOD)]
    done = subprocess.run(command, env=rig.system.environment, capture_output=True, text=True, timeout=60, check=False)
    return [] if done.returncode == 0 else [f"the flood ended with {done.returncode}: {done.stderr[-300:]}"]


def _starve(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """Four busy loops a core."""
    count = 4 * (os.cpu_count() or 1)
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    time.sleep(STARVATION)
    for loop in loops:
        loop.kill()
        loop.wait()
    return []


def _garbage(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """Random bytes to every port that a process listens on."""
    for pid in rig.pids().values():
        for connection in psutil.Process(pid).net_connections("tcp"):
            if connection.status != psutil.CONN_LISTEN:
                continue
            try:
                with socket.create_connection(connection.laddr[:2], timeout=5.0) as port:
                    for _ in range(rng.randrange(1, 4)):
                        port.sendall(rng.randbytes(rng.randrange(1, 4000)))
            except OSError:
                pass  # cut off in the middle: quite right
    return []


def _malformed(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    joints = list(rig.robot.joints)
    state = rig.tap.state
    assert state is not None
    now = state.time
    bad = np.full(len(joints), NAN)
    short = np.zeros(2)
    network = topics.network(rig.instance, "valor_ros_controller")
    with bifrost.Node("liar", network=network) as node:
        setpoints = node.publisher(JOINT_SETPOINTS.name, JointSetpoints, latched=True)
        velocity = node.publisher(VELOCITY.name, VelocityCommand, latched=True)
        pelvis = node.publisher(PELVIS.name, PelvisSetpoint, latched=True)
        gains = node.publisher(JOINT_GAINS.name, JointGains, latched=True)
        weights = node.publisher(BALANCE_WEIGHTS.name, BalanceWeights, latched=True)
        await_subscribers(node, setpoints, velocity, pelvis, gains, weights)
        for _ in range(10):
            setpoints.publish(JointSetpoints(now, joints, bad, bad, bad))
            setpoints.publish(JointSetpoints(now, joints, short, short, short))
            setpoints.publish(JointSetpoints(now, ["nobody"] * 3, np.zeros(3), np.zeros(3), np.zeros(3)))
            setpoints.publish(JointSetpoints(-(2**63), joints, bad, bad, bad))
            velocity.publish(VelocityCommand(now, NAN, rng.uniform(-1e300, 1e300), float("inf")))
            pelvis.publish(PelvisSetpoint(now, np.full(6, NAN), np.full(6, 1e308)))
            pelvis.publish(PelvisSetpoint(2**62, short, short))
            gains.publish(JointGains(joints, bad, -np.ones(len(joints))))
            weights.publish(BalanceWeights(["com", "nobody"], np.array([-1.0, NAN])))
    return []


def _full_disk(rig: Rig, rng: random.Random, process: str) -> list[str]:
    """No file of the recorder may grow, then there is room again."""
    recorder = psutil.Process(rig.pids()[process])
    _, hard = recorder.rlimit(psutil.RLIMIT_FSIZE)
    recorder.rlimit(psutil.RLIMIT_FSIZE, (700, hard))
    time.sleep(STARVATION)
    degraded = any(each["name"] == process and each["state"] == "degraded" for each in rig.system.status()["services"])
    recorder.rlimit(psutil.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    return [] if degraded else [f"{process} is ready while its disk is full"]


def _none(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    time.sleep(rng.uniform(0.5, 2.0))
    return []


def _kill_both(rig: Rig, rng: random.Random, process: str, other: str) -> list[str]:
    """Within a millisecond, in any order."""
    for name in rng.sample((process, other), 2):
        rig.send(name, signal.SIGKILL)
    return []


def _unplug(rig: Rig, rng: random.Random, unit: str) -> list[str]:
    """A device, and plug it in again."""
    device, _, name = unit.partition("/")
    with bifrost.Node("soak_bench", network=topics.network(rig.instance)) as node:
        fault = FAULT.client(node)
        fault.wait_for_server(5.0)
        reply = fault.call(messages.FaultRequest(device, name or device, "unplugged", UNPLUGGED), timeout=5.0)
    if not reply.accepted:
        return [f"fault refused: {reply.reason}"]
    time.sleep(UNPLUGGED)
    return []


def events(processes: Sequence[str]) -> dict[str, Event]:
    table = {
        "nothing": Event(_none, 2.0),
        "malformed messages": Event(_malformed, 3.0),
        "garbage bytes": Event(_garbage, 3.0),
        "flood over Bifrost": Event(_flood, 1.5, process="bifrost"),
        "flood over ROS": Event(_flood, 1.5, process="ros"),
        "starved of CPU": Event(_starve, 0.5),
        "disk full": Event(_full_disk, 0.5, process="bag_recorder"),
    }
    costly = {"comms_manager", "device_emulators"}  # the robot is on the floor afterwards
    for name in processes:
        weight = 0.2 if name in costly else 1.0
        table[f"kill {name}"] = Event(_kill, weight, "kill", name)
        table |= {f"stop {name} {each:g} s": Event(partial(_stop, seconds=each), 0.3, "stop", name) for each in STOPS}
    for first, second in PAIRS:
        table[f"kill {first} and {second}"] = Event(partial(_kill_both, other=second), 0.3, "kill", first, second)
    if "device_emulators" in processes:
        table |= {f"unplug {unit}": Event(_unplug, 0.5, "unplug", unit) for unit in UNITS}
    return table


PATIENCE = 20.0  # until all subscribers have connected [s]


def await_subscribers(node: bifrost.Node, *publishers: bifrost.Publisher[Any]) -> None:
    """Wait until latched publishers have all subscribers of their topics."""
    topics = node.graph().topics
    deadline = time.monotonic() + PATIENCE
    for each in publishers:
        while each.subscribers < len(topics[each.topic].subscribers):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{each.topic}: {each.subscribers} of its subscribers after {PATIENCE:g} s")
            time.sleep(0.01)


def over_bifrost(instance: Instance, seconds: float) -> None:
    robot = RobotDescription.load(instance.settings().robot)
    zeros = np.zeros(len(robot.joints))
    message = JointSetpoints(0, list(robot.joints), zeros, zeros, zeros)
    with bifrost.Node("flooder", network=topics.network(instance, "valor_ros_controller")) as node:
        publisher = node.publisher(JOINT_SETPOINTS.name, JointSetpoints, latched=True)
        await_subscribers(node, publisher)
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            publisher.publish(message)


def over_ros(instance: Instance, seconds: float) -> None:
    """Trajectories of an arm and modes that there are none of."""
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    from valor.valorctl.drive.ros_client import RosClient

    with RosClient(instance) as ros:
        arm = ros.publisher(JointTrajectory, "/trajectory_controllers/right_arm_traj_controller/joint_trajectory", 1)
        other = ros.publisher(String, "/chatter", 0)
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            arm.publish(JointTrajectory(joint_names=["nobody"]))
            other.publish(String(data="flood"))


if __name__ == "__main__":
    here = Instance.from_environment()
    {"bifrost": over_bifrost, "ros": over_ros}[sys.argv[1]](here, float(sys.argv[2]))
