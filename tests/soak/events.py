"""What happens to the system while the robot does something: a table of events, each with its weight."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence

import numpy as np
import psutil

import bifrost
from tests.soak.checks import order_kept
from tests.soak.event import Event
from tests.soak.flooder import await_heard
from tests.soak.rare import rare_events
from tests.soak.rig import Rig
from tests.soak.rules import BY_ITSELF
from valor.common import membership
from valor.common.behaviors import Behavior, requested_by
from valor.common.messages import (
    BalanceWeights,
    JointGains,
    JointSetpoints,
    PelvisSetpoint,
    PushRequest,
    VelocityCommand,
)
from valor.common.topics import BALANCE_WEIGHTS, JOINT_GAINS, JOINT_SETPOINTS, PELVIS, PUSH, VELOCITY
from valor.motion_manager.states.transitions import BEHAVIOR_TRANSITIONS
from valor.valorctl import control_mode

LONGEST_STOP = 7.0  # [s]
FLOOD = 1.0  # once it is heard [s]
PUSH_IMPULSE = 8.0  # that a robot on both feet bears from any side [N·s]
STARVATION = 3.0  # [s]
NAN = float("nan")


def _kill(rig: Rig, rng: random.Random, process: str) -> list[str]:
    rig.send(process, signal.SIGKILL)
    return []


def _stop(rig: Rig, rng: random.Random, process: str, seconds: float | None = None) -> list[str]:
    rig.send(process, signal.SIGSTOP)
    pid = rig.pids()[process]
    time.sleep(rng.uniform(0.2, LONGEST_STOP) if seconds is None else seconds)
    os.kill(pid, signal.SIGCONT)
    return []


def _stop_long(rig: Rig, rng: random.Random, process: str) -> list[str]:
    return _stop(rig, rng, process, LONGEST_STOP)


def _flood(rig: Rig, rng: random.Random, how: str) -> list[str]:
    command = [sys.executable, "-m", "tests.soak.flooder", how, str(FLOOD)]
    done = subprocess.run(command, env=rig.system.environment, capture_output=True, text=True, timeout=60, check=False)
    return [] if done.returncode == 0 else [f"the flooder ended with {done.returncode}: {done.stderr[-300:]}"]


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
    """Messages that decode and mean nothing."""
    joints = list(rig.robot.joints)
    state = rig.tap.state
    assert state is not None
    now = state.time
    bad = np.full(len(joints), NAN)
    short = np.zeros(2)
    network = membership.network(rig.instance, "valor_ros_controller")
    with bifrost.Node("liar", network=network) as node:
        setpoints = node.publisher(JOINT_SETPOINTS.name, JointSetpoints, latched=True)
        velocity = node.publisher(VELOCITY.name, VelocityCommand, latched=True)
        pelvis = node.publisher(PELVIS.name, PelvisSetpoint, latched=True)
        gains = node.publisher(JOINT_GAINS.name, JointGains, latched=True)
        weights = node.publisher(BALANCE_WEIGHTS.name, BalanceWeights, latched=True)
        await_heard(node, setpoints, velocity, pelvis, gains, weights)
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


def _wrong_ros(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """Messages that ROS takes and the VRC must not."""
    from builtin_interfaces.msg import Duration
    from geometry_msgs.msg import Twist, Vector3
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    from valor.valorctl.ros_client import RosClient

    arm = rig.robot.tables.groups["left_arm"]
    names: tuple[list[str], ...] = (list(arm), list(arm)[:-1], ["nobody"], [])
    with RosClient(rig.instance) as ros:
        topic = ros.publisher(JointTrajectory, "/trajectory_controllers/left_arm_traj_controller/joint_trajectory", 1)
        twist = ros.publisher(Twist, "/cmd_vel", 0)
        for _ in range(10):
            positions = [rng.choice((NAN, float("inf"), 1e300)) for _ in arm]
            point = JointTrajectoryPoint(positions=positions, time_from_start=Duration(sec=rng.choice((-1, 0, 1))))
            topic.publish(JointTrajectory(joint_names=rng.choice(names), points=[point]))
            twist.publish(Twist(linear=Vector3(x=NAN)))
    return []


def _push(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    impulse = PUSH_IMPULSE * np.array([np.cos(angle), np.sin(angle), 0.0])
    network = membership.network(rig.instance, "valor_ros_controller")
    with bifrost.Node("valorctl", network=network) as node:
        pusher = PUSH.client(node)
        if not pusher.wait_for_server(2.0):
            return []  # nobody pushes a robot on its devices
        reply = pusher.call(PushRequest(impulse, 0.1), timeout=5.0)
    return [] if reply.accepted else [f"push refused: {reply.reason}"]


def _await(rig: Rig, behavior: Behavior, what: str) -> None:
    rig.wait(lambda: rig.behavior is behavior, what)


def _requests(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """Behaviors, legal and not: each is granted only where an edge leads, and then comes about."""
    found = []
    for _ in range(8):
        answered = time.monotonic()
        rig.wait(lambda since=answered: rig.tap.told > since, "a MotionState after the last answer")  # type: ignore[misc]
        before = rig.behavior
        target = rng.choice([each for each in Behavior if each not in (Behavior.FALL, Behavior.GET_UP)])
        reply = rig.ask(target)
        legal = {before, *BEHAVIOR_TRANSITIONS[before], *BY_ITSELF.get(before, ())}
        if reply.accepted:
            if target not in legal:
                found.append(f"{target} granted in {before}, where no edge leads there")
            _await(rig, target, f"{target}, granted in {before}")
        elif not reply.reason:
            found.append(f"{target} refused in {before} without a reason")
    return found


def _quick_requests(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """As quick as they are answered: none is lost, none comes before another."""
    heard = len(rig.tap.changes)
    found: list[str] = []
    granted: list[str] = []
    behavior = rig.behavior
    pair = (Behavior.STAND, Behavior.STAND_MANIPULATE)
    # Elsewhere at last: of what lies between two control periods nobody sees that it came to nothing.
    for target in [*(rng.choice(pair) for _ in range(30)), pair[behavior is pair[0]]]:
        reply = rig.ask(target)
        if reply.accepted and reply.behavior != target:
            found.append(f"{target} granted, and the answer says {reply.behavior}")
        if reply.accepted and target is not behavior:
            granted.append(target)
            behavior = target
    answered = time.monotonic()
    rig.wait(lambda: rig.tap.told > answered, "a MotionState after the last answer")
    seen = [name for name, reason in rig.tap.changes[heard:] if reason == requested_by("soak")]
    if not order_kept(granted, seen):
        found.append(f"granted {granted}, came about {seen}")
    return found


def _modes(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """Control modes over ROS, legal and not: what is reported as reached is."""
    found = []
    for _ in range(3):
        mode = rng.choice([*rig.modes.names, "dance"])
        made = control_mode.change(rig.instance, mode)
        if made.reached:
            rig.wait(lambda: rig.modes.fit(rig.tap.mode, rig.behavior), f"the behavior of mode {mode}", 20.0)
        elif mode == "dance" and made.current == mode:
            found.append("mode dance granted")
    return found


def _adjustments(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    """Pelvis, gains and weights, some beyond what is allowed."""
    joints = list(rig.robot.joints)
    network = membership.network(rig.instance, "valor_ros_controller")
    with bifrost.Node("soak_adjuster", network=network) as node:
        pelvis = PELVIS.publisher(node)
        gains = JOINT_GAINS.publisher(node)
        weights = BALANCE_WEIGHTS.publisher(node)
        place = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(0.6, 0.9), 0.0, 0.0, 0.0])
        for _ in range(50):
            state = rig.tap.state
            assert state is not None
            pelvis.publish(PelvisSetpoint(state.time, place, np.zeros(6)))
            time.sleep(0.02)
        gains.publish(JointGains(joints, np.full(len(joints), rng.uniform(0, 1e4)), np.full(len(joints), 10.0)))
        weights.publish(BalanceWeights(["com"], np.array([rng.uniform(0.0, 1e6)])))
    return []


def _none(rig: Rig, rng: random.Random, _process: str) -> list[str]:
    time.sleep(rng.uniform(0.5, 2.0))
    return []


def events(processes: Sequence[str], own_disk: bool) -> dict[str, Event]:
    """The table, for a profile's processes; a disk is filled only if it is nobody else's."""
    table = {
        "nothing": Event(_none, 2.0),
        "requests": Event(_requests, 4.0, commands=True, on_feet=True),
        "quick requests": Event(_quick_requests, 3.0, commands=True, on_feet=True),
        "modes": Event(_modes, 3.0, commands=True, on_feet=True),
        "adjustments": Event(_adjustments, 2.0, on_feet=True),
        "malformed messages": Event(_malformed, 3.0),
        "wrong ROS messages": Event(_wrong_ros, 2.0),
        "garbage bytes": Event(_garbage, 3.0),
        "flood over Bifrost": Event(_flood, 1.5, process="bifrost"),
        "flood over ROS": Event(_flood, 1.5, process="ros"),
        "push": Event(_push, 2.0, on_feet=True),
        "starved of CPU": Event(_starve, 0.5),
    }
    costly = {"comms_manager", "device_emulators"}  # the robot is on the floor afterwards
    for name in processes:
        weight = 0.2 if name in costly else 1.0
        table[f"kill {name}"] = Event(_kill, weight, "kill", name)
        table[f"stop {name}"] = Event(_stop, 0.5, "stop", name)
        table[f"stop {name} 7 s"] = Event(_stop_long, 0.5, "stop", name)
    return table | rare_events(processes, own_disk)
