"""Random cuts of the link between real processes: what became of each command, as its operator and the robot saw it.

``python -m benchmarks.link_cuts OUT [--cuts 100] [--seed 0]``: a robot of its own. While the emulated link is cut again
and again for 0.05 to 8 s, an operator's client sends modes, hands' goals, velocities and plans of two steps.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import re
import threading
import time
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from benchmarks.link import show
from harness.system import RosClient, running
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.common.linking import robot_ports
from valor.link.classes import BY_KIND, Kind
from valor.link.emulate import Emulator
from valor.link.emulator import DRC_FAST, DRC_SLOW
from valor.valorctl.ros_domain import reserve

CUT = (0.05, 8.0)  # how long one is; evenly in its logarithm [s]
BETWEEN = (0.3, 2.0)  # two cuts [s]
SEND = (0.1, 0.6)  # between two commands [s]
LASTS, STREAMED = (BY_KIND[kind].deadline or 0.0 for kind in (Kind.COMMAND, Kind.STREAM))
MARGIN = 0.5  # from when a ROS client says or does something until another one has it [s]
TOLD = LASTS + 30.0  # within which the operator is told what became of a command [s]
NEXT = {"stand": ("stand_manipulate", "step"), "step": ("stand",), "stand_manipulate": ("stand", "manipulate"),
        "manipulate": ("stand", "stand_manipulate")}  # fmt: skip
MODE = "mode_controllers/control_mode_controller/change_control_mode"
PLAN = "robot_controllers/footstep_controller/execute_step_plan"
HAND, VELOCITY = "flor/l_hand/goal_pose", "cmd_vel"
FATE = re.compile(r"goal_pose: (.*), \d+ s ago")
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class Sent:
    """A command; times are monotonic [s].

    Attributes:
        what: action or topic.
        key: by which a message is known again on the robot's side; 0: a goal, of which one is open at a time.
        fate: what the operator was told; empty: nothing.
        obeyed: when it was seen beside the robot.
    """

    what: str
    key: float
    at: float
    fate: str = ""
    obeyed: list[float] = field(default_factory=list)


class Both:
    """Both sides of the link; times are monotonic [s].

    Attributes:
        sent: all commands.
        modes: when the robot said which mode it is in.
        shown: when the operator was shown which mode, and how old it is at most.
        unknown: what was seen beside the robot that nobody had sent.
    """

    def __init__(self, robot: RosClient, operator: RosClient) -> None:
        self._operator = operator
        self.sent: list[Sent] = []
        self.modes: list[tuple[float, str]] = []
        self.shown: list[tuple[float, str, float]] = []
        self.unknown = 0
        self._goals: set[bytes] = set()
        make = operator.node.create_publisher
        self._publishers = {HAND: operator._call(make, PoseStamped, HAND, 10),
                            VELOCITY: operator._call(make, Twist, VELOCITY, 1)}  # fmt: skip
        self._clients = {name: operator._call(ActionClient, operator.node, kind, name)
                         for name, kind in ((MODE, ChangeControlMode), (PLAN, ExecuteStepPlan))}  # fmt: skip
        for client, kind, topic, take, qos in (
            (robot, ControlModeStatus, "flor/controller/mode", self._report, LATCHED),
            (robot, GoalStatusArray, f"{MODE}/_action/status", partial(self._begun, MODE), LATCHED),
            (robot, GoalStatusArray, f"{PLAN}/_action/status", partial(self._begun, PLAN), LATCHED),
            (robot, PoseStamped, HAND, lambda m: self._obeyed(HAND, m.pose.position.x), 10),
            (robot, Twist, VELOCITY, lambda m: self._obeyed(VELOCITY, m.linear.x), 10),
            (operator, DiagnosticStatus, "link/status", self._status, LATCHED),
        ):
            client._call(client.node.create_subscription, kind, topic, take, qos)

    def ready(self) -> bool:
        """Whether all have found each other."""
        found = all(client.server_is_ready() for client in self._clients.values())
        return found and all(each.get_subscription_count() for each in self._publishers.values()) and bool(self.shown)

    def true(self) -> str:
        """The robot's mode."""
        return self.modes[-1][1] if self.modes else ""

    def _report(self, message: ControlModeStatus) -> None:
        self.modes.append((time.monotonic(), message.current_control_mode))

    def _begun(self, what: str, message: GoalStatusArray) -> None:
        """Goals that the robot has accepted."""
        for each in message.status_list:
            if (goal := bytes(each.goal_info.goal_id.uuid)) not in self._goals:
                self._goals.add(goal)
                self._obeyed(what, 0.0)

    def _obeyed(self, what: str, key: float) -> None:
        found = next((each for each in reversed(self.sent) if each.what == what and each.key == key), None)
        if found is None:
            self.unknown += 1
        else:
            found.obeyed.append(time.monotonic())

    def _status(self, message: DiagnosticStatus) -> None:
        values, now = {pair.key: pair.value for pair in message.values}, time.monotonic()
        if "mode_age" in values:
            self.shown.append((now, values["mode"], float(values["mode_age"])))
        hands = [each for each in self.sent if each.what == HAND]
        if not hands or now - hands[-1].at < 2 * MARGIN:  # it may not have been counted yet
            return
        told = [match[1] for value in values.values() if (match := FATE.fullmatch(value))]
        for fate, each in zip(told, reversed(hands), strict=False):
            if not fate.startswith("on its way"):
                each.fate = fate

    def open(self, what: str) -> bool:
        """Whether nothing is known yet of what became of the last one."""
        last = next((each for each in reversed(self.sent) if each.what == what), None)
        return last is not None and not last.fate and time.monotonic() - last.at < TOLD

    def publish(self, what: str, key: float) -> None:
        """A message that is known again by a number."""
        message = Twist() if what == VELOCITY else PoseStamped()
        if what == VELOCITY:
            message.linear.x = key
        else:
            message.header.frame_id = "pelvis"
            message.pose.position.x, message.pose.position.y = key, 0.35
            message.pose.orientation.w = 1.0
        self.sent.append(Sent(what, key, time.monotonic()))
        self._publishers[what].publish(message)

    def ask(self, what: str, goal: Any) -> None:
        """A goal; what becomes of it is noted."""
        self.sent.append(one := Sent(what, 0.0, time.monotonic()))

        def accepted(future: Any) -> None:
            future.result().get_result_async().add_done_callback(ended)

        def ended(future: Any) -> None:
            one.fate = f"status {future.result().status}"

        self._operator._call(lambda: self._clients[what].send_goal_async(goal).add_done_callback(accepted))


def two_steps() -> ExecuteStepPlan.Goal:
    """On the spot."""
    goal = ExecuteStepPlan.Goal()
    goal.step_plan.header.frame_id = "base_footprint"
    for index, side in enumerate((1, -1)):
        step = Step(step_index=index, valid=True)
        step.foot.foot_index = index
        step.foot.pose.position.y, step.foot.pose.orientation.w = 0.12 * side, 1.0
        goal.step_plan.steps.append(step)
    return goal


def cut(emulator: Emulator, chance: random.Random, cuts: int, over: threading.Event) -> list[float]:
    """Cut again and again; how long each was [s]."""
    lengths = []
    for _ in range(cuts):
        over.wait(chance.uniform(*BETWEEN))
        lengths.append(math.exp(chance.uniform(*map(math.log, CUT))))
        emulator.cut = True
        over.wait(lengths[-1])
        emulator.cut = False
    return lengths


def operate(both: Both, chance: random.Random, over: threading.Event) -> None:
    """Command until it is over."""
    number, hand_at = 0, -math.inf
    while not over.wait(chance.uniform(*SEND)):
        number += 1
        what, now = chance.choice((MODE, PLAN, HAND, VELOCITY)), time.monotonic()
        if what == MODE and not both.open(MODE) and not both.open(PLAN) and both.true() in NEXT:
            both.ask(MODE, ChangeControlMode.Goal(mode_request=chance.choice(NEXT[both.true()])))
        elif what == PLAN and not both.open(PLAN) and both.true() == "step":
            both.ask(PLAN, two_steps())
        elif what == HAND and now - hand_at > 3 * MARGIN:
            hand_at = now
            both.publish(HAND, 0.3 + 1e-6 * number)
        elif what == VELOCITY:
            both.publish(VELOCITY, 1e-6 * number)


def strange(both: Both) -> int:
    """How often a mode was shown that was not the robot's at any time within its age."""
    when = [at for at, _ in both.modes]
    count = 0
    for at, mode, age in both.shown:
        first = max(bisect_right(when, at - age - MARGIN) - 1, 0)
        count += mode not in {name for _, name in both.modes[first : bisect_right(when, at + MARGIN)]}
    return count


def report(both: Both, lengths: list[float]) -> None:
    """Print the table."""
    rows = []
    for name, what, lasts in (("modes", MODE, LASTS), ("plans of two steps", PLAN, LASTS),
                              ("hands' goals", HAND, LASTS), ("velocities", VELOCITY, STREAMED)):  # fmt: skip
        each = [one for one in both.sent if one.what == what]
        late = sum(at - one.at > lasts + MARGIN for one in each for at in one.obeyed[:1])
        silent = "–" if what == VELOCITY else sum(not one.fate for one in each)
        rows.append([name, len(each), sum(bool(one.obeyed) for one in each),
                     sum(len(one.obeyed) > 1 for one in each), late, silent])  # fmt: skip
    show(f"{len(lengths)} cuts, {sum(lengths):.0f} s in all, the longest {max(lengths):.1f} s",
         ["", "sent", "obeyed", "twice", "late", "of unknown fate"], rows)  # fmt: skip
    print(f"obeyed that nobody sent: {both.unknown}; modes shown {len(both.shown)} times, "
          f"{strange(both)} of them not the robot's within their age; "
          f"the greatest age {max(age for _, _, age in both.shown):.1f} s")  # fmt: skip


def cut_while_commanded(out: Path, cuts: int, seed: int) -> tuple[Both, list[float]]:
    """What was seen, and how long the cuts were [s]."""
    emulator, chance, over = Emulator((0, 0), DRC_SLOW, DRC_FAST), random.Random(seed), threading.Event()
    with (
        reserve("link_cuts_operator") as theirs,
        running("link_cuts", out, "--no-bag", "--link", f"{theirs.domain}:{emulator.listening}") as system,
    ):
        emulator.to = robot_ports(Instance("link_cuts", out).settings())
        environment = system.join()
        robot, operator = (
            RosClient(each, joint_states=False)
            for each in (environment, environment | {"ROS_DOMAIN_ID": str(theirs.domain)})
        )
        try:
            both = Both(robot, operator)
            wait_until(both.ready, 60.0, "both sides to have found each other")
            wait_until(lambda: both.true() == "stand", 60.0, "the robot to stand")
            operating = threading.Thread(target=operate, args=(both, random.Random(seed + 1), over))
            operating.start()
            try:
                lengths = cut(emulator, chance, cuts, over)
            finally:
                over.set()
                operating.join()
            wait_until(lambda: not any(both.open(what) for what in (MODE, PLAN, HAND)), 2 * TOLD, "all to be told")
        finally:
            operator.close()
            robot.close()
    emulator.close()
    return both, lengths


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cuts", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}")
    both, lengths = cut_while_commanded(asked.out.absolute(), asked.cuts, asked.seed)
    report(both, lengths)
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
