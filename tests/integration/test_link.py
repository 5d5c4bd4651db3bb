"""Robot behind a link of 9,600 bit/s that is cut: a ROS client and the page; no late command is executed."""

from __future__ import annotations

import json
import random
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Step

from harness.emulated_channel import DRC_FAST, DRC_SLOW, random_windows
from harness.link_emulator import Emulator
from harness.operator_page import PATIENCE, Page
from harness.places import ROBOTS
from harness.system import RosClient, System, running
from harness.waiting import wait_until
from valor.common.instance import Instance, Settings
from valor.common.linking import robot_ports
from valor.common.messages import ModeStatus
from valor.common.table import checked
from valor.common.viewing import LOOPBACK, page_port
from valor.link.classes import BY_CLASS, MessageClass
from valor.robot.description import RobotDescription
from valor.valorctl.instance.ros_domain import reserve

CUTS = 2
SEED = 3
DEADLINE = BY_CLASS[MessageClass.COMMAND].deadline or 0.0  # [s]
pytestmark = pytest.mark.timeout(1200)


@dataclass
class Operation:
    """Both sides of the link.

    Attributes:
        robot: a client in the robot's domain, to see what is true.
        operator: a client in the operator's.
        domain: the operator's.
    """

    system: System
    emulator: Emulator
    robot: RosClient
    operator: RosClient
    told: list[Any]
    domain: int

    def values(self) -> dict[str, str]:
        """What ``/link/status`` told last."""
        return {each.key: each.value for each in self.told[-1].values} if self.told else {}

    def shown(self) -> str:
        """The mode that the operator is shown."""
        return str(self.operator.reports[-1].current_control_mode) if self.operator.reports else ""

    def true(self) -> str:
        """The mode that is."""
        return str(self.robot.reports[-1].current_control_mode) if self.robot.reports else ""


@pytest.fixture(scope="module")
def operation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operation]:
    """A robot that stands, the emulated link, and the operator's domain behind it."""
    home = tmp_path_factory.mktemp("home")
    emulator = Emulator((0, 0), DRC_SLOW, DRC_FAST, windows=random_windows(SEED, 3600.0), seed=SEED)
    with reserve("link_operator_test") as theirs:
        domain = theirs.domain
        options = ("--no-bag", "--view", "--link", f"{domain}:{emulator.listening}")
        with running("link_test", home, *options) as system:
            emulator.to = robot_ports(Instance("link_test", home).settings())
            environment = system.join()
            robot = RosClient(environment, joint_states=True)
            operator = RosClient(environment | {"ROS_DOMAIN_ID": str(domain)}, joint_states=True)
            told: list[Any] = []
            latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            operator._call(operator.node.create_subscription, DiagnosticStatus, "link/status", told.append, latched)
            try:
                wait_until(lambda: operator.joint_state, 60.0, "a state through the link")
                yield Operation(system, emulator, robot, operator, told, domain)
            finally:
                operator.close()
                robot.close()
    emulator.close()


def test_the_operator_sees_the_robot_as_it_is_and_how_old_that_is(operation: Operation) -> None:
    true: dict[int, Any] = {}
    robot = operation.robot
    robot._call(robot.node.create_subscription, JointState, "joint_states", lambda m: true.update({_stamp(m): m}), 10)

    def both() -> tuple[Any, Any] | None:
        shown = operation.operator.joint_state
        return (shown, true[_stamp(shown)]) if _stamp(shown) in true else None

    shown, was = wait_until(both, 30.0, "a state of the same time on both sides")
    assert shown.name == was.name
    assert max(abs(a - b) for a, b in zip(shown.position, was.position, strict=True)) <= 0.001 + 1e-9
    wait_until(lambda: _fresh(operation.told, 0), 30.0, "the state's age to be known")
    wait_until(lambda: operation.values()["mode"] == "stand", 30.0, "the mode to be told")
    values = operation.values()
    assert float(values["mode_age"]) >= float(values["state_age"]) > 0.0
    assert operation.shown() == operation.true() == "stand"


def test_modes_arms_and_steps_go_through_it(operation: Operation) -> None:
    client = operation.operator
    assert client.change_mode("stand_manipulate").status & ModeStatus.MODE_ACCEPTED
    arm = _arm(client)
    joint = list(arm)[3]
    result = client.follow("left_arm", [(2.0, arm | {joint: arm[joint] - 0.2})])
    assert result.result.error_code == 0, result.result.error_string
    assert client.change_mode("step").status & ModeStatus.MODE_ACCEPTED
    assert _step(client) & 1, "expected REACHED_GOAL"


def test_what_is_asked_for_during_a_cut_is_not_done_after_it(operation: Operation) -> None:
    chance = random.Random(SEED)
    wait_until(lambda: operation.true() == "stand", 30.0, "the steps to end in stand")
    for number in range(CUTS):
        wait_until(lambda: operation.shown() == operation.true(), 30.0, "the mode to be shown")
        operation.emulator.cut = True
        began, reports = time.monotonic(), len(operation.robot.reports)
        status = operation.operator.change_mode("stand_manipulate")
        assert not status.status & ModeStatus.MODE_ACCEPTED
        assert time.monotonic() - began < 3 * DEADLINE
        time_cut = began + DEADLINE + chance.uniform(0.5, 2.0)
        wait_until(partial(_past, time_cut), 30.0, "the cut to be longer than the deadline")
        assert float(operation.values()["state_age"]) > DEADLINE / 2
        operation.emulator.cut = False
        told = len(operation.told)
        wait_until(partial(_fresh, operation.told, told), 60.0, "states to come again")
        asked = {each.current_control_mode for each in operation.robot.reports[reports:]}
        assert asked <= {"stand"}, f"cut {number}: {asked}"


@pytest.fixture(scope="module")
def page(browser: Any, operation: Operation) -> Page:
    """The page on the operator's side, with an operator."""
    instance = Instance(operation.system.name, Path(operation.system.environment["VALOR_HOME"]))
    page = Page(browser, page_port(instance.settings()))
    page.take_control("Ann", instance.operator_token.read_text(), "Ann operates")
    page.dismiss()
    page.sees("state", "control mode fresh")
    return page


def test_a_mode_is_changed_by_a_button_and_shown(operation: Operation, page: Page) -> None:
    wait_until(lambda: operation.true() == "stand", PATIENCE, "the robot stands")
    page.command("stand_manipulate", "control mode stand_manipulate", "done")
    assert operation.true() == "stand_manipulate"
    page.wait("state", lambda text: text.startswith("stand_manipulate") and "control mode fresh" in text, "the mode")


def test_a_button_pressed_during_a_cut_is_reported_and_not_executed_after_it(operation: Operation, page: Page) -> None:
    reports, given = len(operation.robot.reports), page.number()
    operation.emulator.cut = True
    began = time.monotonic()
    page.press("manipulate")
    page.wait("commands", lambda text: page.commanded(f"#{given + 1} ", "refused"), "the result of the command")
    page.wait("state", lambda text: re.search(r"control mode [\d.]+ s old", text) is not None, "the age of the mode")
    page.sees("news", "not acknowledged before its deadline")
    wait_until(partial(_past, began + DEADLINE + 1.0), PATIENCE, "the cut is longer than the deadline")
    operation.emulator.cut = False
    page.sees("state", "control mode fresh")
    reported = operation.robot.reports[reports:]
    assert {each.current_control_mode for each in reported} <= {"stand_manipulate"}
    assert "manipulate" not in {each.requested_control_mode for each in reported}
    assert page.text("state").startswith("stand_manipulate")


def test_after_the_cut_commands_are_executed_and_the_pad_shows_the_age(operation: Operation, page: Page) -> None:
    page.command("stand", "control mode stand:", "done")
    wait_until(lambda: operation.true() == "stand", PATIENCE, "the robot stands")
    page.command("walk", "control mode walk:", "done")
    page.view.get_by_text("no velocity has come through lately").wait_for()
    page.button("forward").hover()
    page.page.mouse.down()
    try:
        page.view.get_by_text(re.compile(r"a velocity came through \d\.\d s ago")).wait_for()
    finally:
        page.page.mouse.up()


def test_the_stop_of_the_page_goes_through_the_link(operation: Operation, page: Page) -> None:
    page.stop()
    wait_until(lambda: operation.true() == "soft_stop", PATIENCE, "the robot stops")
    page.said("confirmed through the link: stopped")
    page.wait("state", lambda text: text.startswith("soft_stop"), "the stop is shown")
    wait_until(
        lambda: operation.operator.change_mode("stand").status & ModeStatus.MODE_ACCEPTED, PATIENCE, "the robot stands"
    )


def test_the_verb_stops_and_locks_from_the_operators_side(operation: Operation, tmp_path: Path) -> None:
    hosts = [{"name": "desk", "address": LOOPBACK, "operator": True}, {"name": "robot", "address": LOOPBACK}]
    domain = operation.domain
    settings = {"robot": str(ROBOTS / "escher"), "ros_domain_id": domain, "link": {"domain": domain}, "hosts": hosts,
                "here": "desk"}  # fmt: skip
    desk = Instance("desk", tmp_path)
    desk.folder.mkdir(parents=True)
    desk.settings_file.write_text(checked(Settings, settings).json())
    for options, state, answer in (
        ((), "soft_stop", "soft stop sent"),
        (("--freeze",), "freeze", "control mode freeze"),
    ):
        told = json.loads(System("desk", tmp_path).valorctl("stop", *options, "--json").stdout)
        assert told["stopped"] and told["state"] == state
        (path,) = told["paths"]
        assert path["name"] == "link_robot, through the link" and path["answer"] == answer
        wait_until(lambda state=state: operation.true() == state, 20.0, "the robot to stop")  # type: ignore[misc]
    wait_until(lambda: operation.shown() == "freeze", 20.0, "the stop to be shown")


def test_the_slow_channel_carried_no_more_than_it_can(operation: Operation) -> None:
    to, back = operation.emulator.lines[:2]
    assert to.lost + back.lost < 0.2 * (to.passed + back.passed), "the ends keep to their budgets, but for cuts"
    assert int(operation.values()["states"]) > 50


def _stamp(message: Any) -> int:
    """[ms]."""
    return int(1000 * message.header.stamp.sec + message.header.stamp.nanosec // 10**6)


def _past(time_: float) -> bool:
    return time.monotonic() > time_


def _fresh(told: list[Any], since: int) -> bool:
    """Whether one of those from a place on says that the state is."""
    return any(float(pair.value) < 2.0 for each in told[since:] for pair in each.values if pair.key == "state_age")


def _arm(client: RosClient) -> dict[str, float]:
    positions = client.joint_positions()
    return {name: positions[name] for name in RobotDescription.load(ROBOTS / "escher").tables.group("left_arm")}


def _step(client: RosClient) -> int:
    """Two steps on the spot; the result's flags."""
    goal = ExecuteStepPlan.Goal()
    goal.step_plan.header.frame_id = "base_footprint"
    for index, side in enumerate((0, 1)):
        step = Step(step_index=index, valid=True)
        step.foot.foot_index = side
        step.foot.pose.position.x, step.foot.pose.position.y = 0.05, 0.12 * (1 - 2 * side)
        step.foot.pose.orientation.w = 1.0
        goal.step_plan.steps.append(step)
    action = client._call(
        ActionClient, client.node, ExecuteStepPlan, "robot_controllers/footstep_controller/execute_step_plan"
    )
    return int(client._run(action, goal, 90.0).result.status.status)
