"""10 m by approved steps through the link, under DARPA's schedule: what the operator is shown, against what is so.

``python -m benchmarks.link_walk OUT``: a robot of its own, its recording in OUT, and a picture of when states came.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step

from benchmarks.link import show
from harness.emulated_channel import DRC_FAST, DRC_SLOW, drc_windows
from harness.link_emulator import Emulator
from harness.places import ROBOTS
from harness.system import RosClient, running
from harness.waiting import wait_until
from valor.analysis.reading.bag import Bag
from valor.common.arrays import FloatArray
from valor.common.instance import Instance
from valor.common.linking import robot_ports
from valor.common.messages import ModeStatus
from valor.link.fields import BY_NAME, JOINT_STEP
from valor.robot.description import RobotDescription
from valor.ros.link_messages import MessageCodec
from valor.valorctl.instance.ros_domain import reserve

matplotlib.use("Agg")
import matplotlib.pyplot as plt

LENGTH, WIDTH = 0.25, 0.12  # of a step, and of half the stance [m]
PLANS, STEPS = 4, 10
PATIENCE = 240.0  # for a plan [s]
TOPIC = "robot_controllers/footstep_controller/execute_step_plan"


@dataclass
class Seen:
    """By the operator; times are monotonic [s], stamps robot time [ms]."""

    came: list[tuple[float, float]] = field(default_factory=list)  # of each state when, and how late in robot time [s]
    joints: dict[int, FloatArray] = field(default_factory=dict)  # (n,) positions
    base: dict[int, FloatArray] = field(default_factory=dict)
    links: list[tuple[float, dict[str, str]]] = field(default_factory=list)
    feedback: int = 0


def stamp(message: Any) -> int:
    """Of a header [ms]."""
    return int(1000 * message.header.stamp.sec + message.header.stamp.nanosec // 10**6)


def plan() -> ExecuteStepPlan.Goal:
    """Ten steps ahead of where the feet are, the last beside the one before."""
    goal = ExecuteStepPlan.Goal()
    goal.step_plan.header.frame_id = "base_footprint"
    for index in range(STEPS + 1):
        step = Step(step_index=index, valid=True)
        step.foot.foot_index = index % 2
        step.foot.pose.position.x = LENGTH * min(index + 1, STEPS)
        step.foot.pose.position.y = WIDTH * (1 - 2 * (index % 2))
        step.foot.pose.orientation.w = 1.0
        goal.step_plan.steps.append(step)
    return goal


def watch(robot: RosClient, operator: RosClient, seen: Seen) -> None:
    """Keep what the operator is shown; of a state how much older it is than the robot's newest, in robot time."""

    def joints(message: JointState) -> None:
        newest = robot.joint_state
        late = (stamp(newest) - stamp(message)) / 1e3 if newest is not None else np.nan
        seen.came.append((time.monotonic(), late))
        seen.joints[stamp(message)] = np.array(message.position)

    def base(message: Odometry) -> None:
        p = message.pose.pose.position
        seen.base[stamp(message)] = np.array((p.x, p.y, p.z))

    def link(message: DiagnosticStatus) -> None:
        seen.links.append((time.monotonic(), {pair.key: pair.value for pair in message.values}))

    for kind, topic, take in ((JointState, "joint_states", joints), (Odometry, "odom", base),
                              (DiagnosticStatus, "link/status", link)):  # fmt: skip
        operator._call(operator.node.create_subscription, kind, topic, take, 20)


def walk(operator: RosClient, seen: Seen) -> tuple[int, list[float]]:
    """Approve the plans one after the other; bytes of one, and how long each took [s]."""
    action = operator._call(ActionClient, operator.node, ExecuteStepPlan, TOPIC)
    assert action.wait_for_server(timeout_sec=60.0)
    size = len(MessageCodec(RobotDescription.load(ROBOTS / "escher")).pack(plan()))

    def told(_: Any) -> None:
        seen.feedback += 1

    took = []
    for number in range(PLANS):
        assert operator.change_mode("step").status & ModeStatus.MODE_ACCEPTED
        began = time.monotonic()
        send = partial(action.send_goal_async, plan(), feedback_callback=told)
        handle = operator._wait(operator._call(send), PATIENCE, "the goal to be taken")
        ended = operator._wait(operator._call(handle.get_result_async), PATIENCE, "the plan to end")
        took.append(time.monotonic() - began)
        print(
            f"plan {number + 1}: status {ended.status}, flags {ended.result.status.status}, {took[-1]:.1f} s",
            flush=True,
        )
        assert ended.status == GoalStatus.STATUS_SUCCEEDED
    return size, took


def errors(seen: Seen, bag: Bag) -> list[list[object]]:
    """Of what was shown against what the recording has at the same robot time."""
    joints, odometry = bag["/joint_states"], bag["/odom"]
    true = {stamp(message): np.array(message.position) for message in joints.messages}
    places = {stamp(message): message.pose.pose.position for message in odometry.messages}
    off = [np.abs(shown - true[at]).max() for at, shown in seen.joints.items() if at in true]
    far = [
        np.abs(shown - np.array((places[at].x, places[at].y, places[at].z))).max()
        for at, shown in seen.base.items()
        if at in places
    ]
    bound = BY_NAME["base_position"].bound
    return [
        [name, len(each), f"{1e3 * np.mean(each):.2f}", f"{1e3 * max(each):.2f}", f"{1e3 * most:.2f}"]
        for name, each, most in (("joints, mrad", off, JOINT_STEP / 2), ("base, mm", far, bound))
    ]


def draw(seen: Seen, began: float, windows: list[tuple[float, float]], file: Path) -> None:
    """How old the newest state was, and when the second channel was there."""
    figure, axes = plt.subplots(figsize=(9.0, 2.8), layout="constrained")
    told = [(at - began, float(values["state_age"])) for at, values in seen.links if "state_age" in values]
    axes.plot(*zip(*told, strict=True), lw=0.9, color="tab:blue", label="age of the state, as the operator is told")
    for place, (begins, ends) in enumerate(windows):
        if begins < told[-1][0]:
            axes.axvspan(begins, min(ends, told[-1][0]), color="tab:orange", alpha=0.35, lw=0,
                         label=None if place else "second channel")  # fmt: skip
    axes.set(xlabel="since the schedule began [s]", ylabel="[s]", ylim=(0.0, None), xlim=(told[0][0], told[-1][0]))
    axes.legend(loc="upper right", fontsize=8)
    figure.savefig(file, dpi=110, pil_kwargs={"lossless": True})


def report(seen: Seen, began: float, ended: float, emulator: Emulator, bag: Bag) -> None:
    """Print the tables."""
    shown = [each for each in seen.came if began <= each[0] <= ended]
    times = np.array([each[0] for each in shown])
    late = np.array([each[1] for each in shown])
    a_second = np.histogram(times, bins=np.arange(began, ended, 1.0))[0]
    told = np.array([float(v["state_age"]) for at, v in seen.links if began <= at <= ended and "state_age" in v])
    show("What the operator is shown", ["", "mean", "least or p50", "p99", "worst"], [
        ["states a second", f"{len(times) / (ended - began):.1f}", f"{np.percentile(a_second, 1):.0f}", "–",
         f"{a_second.min()}"],
        ["late when it comes, s of robot time", f"{np.nanmean(late):.2f}", f"{np.nanpercentile(late, 50):.2f}",
         f"{np.nanpercentile(late, 99):.2f}", f"{np.nanmax(late):.2f}"],
        ["age that is told, s", f"{told.mean():.2f}", f"{np.percentile(told, 50):.2f}",
         f"{np.percentile(told, 99):.2f}", f"{told.max():.2f}"],
    ])  # fmt: skip
    show("Errors", ["", "states", "mean", "worst", "bound"], errors(seen, bag))
    keys = sorted({key for _, values in seen.links for key in values if key.startswith(("sent.", "received."))})
    within = [values for at, values in seen.links if began <= at <= ended]
    rows = [[key, f"{np.mean([float(v.get(key, '0').split()[0]) for v in within]):.0f}"] for key in keys]
    show("Bytes a second at the operator's end, slow channel, headers included", ["", "B/s"], rows)
    total = sum(float(row[1]) for row in rows)
    lost, passed = (sum(getattr(line, name) for line in emulator.lines[:2]) for name in ("lost", "passed"))
    print(f"both ways together {8 * total:.0f} bit/s of 9600; the emulated slow line lost {lost} B of {passed}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    out: Path = parser.parse_args().out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    print(f"load {os.getloadavg()[0]:.1f}")
    windows = drc_windows()
    linked = time.monotonic()
    emulator, seen = Emulator((0, 0), DRC_SLOW, DRC_FAST, windows=windows), Seen()
    file = out / "link_walk.mcap"
    with reserve("link_walk_operator") as theirs:
        options = ("--link", f"{theirs.domain}:{emulator.listening}", "--bag", str(file))
        with running("link_walk", out / "home", *options) as system:
            emulator.to = robot_ports(Instance("link_walk", out / "home").settings())
            environment = system.join()
            robot = RosClient(environment)
            operator = RosClient(environment | {"ROS_DOMAIN_ID": str(theirs.domain)})
            try:
                watch(robot, operator, seen)
                wait_until(lambda: len(seen.joints) > 20, 60.0, "states through the link")
                began = time.monotonic()
                size, took = walk(operator, seen)
                ended = time.monotonic()
            finally:
                operator.close()
                robot.close()
    emulator.close()
    bag = Bag(file)
    report(seen, began, ended, emulator, bag)
    places = [message.pose.pose.position for message in bag["/odom"].messages]
    far = np.hypot(places[-1].x - places[0].x, places[-1].y - places[0].y)
    print(f"{far:.2f} m in {PLANS} plans of {STEPS + 1} steps, {size} B each, {sum(took):.0f} s; "
          f"{seen.feedback} times feedback")  # fmt: skip
    draw(seen, linked, windows, out / "link_walk.webp")
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
