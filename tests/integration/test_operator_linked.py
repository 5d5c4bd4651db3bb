"""The operator's page behind the degraded link, in a browser: what it shows, and what becomes of what is pressed."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from harness.operator_page import PATIENCE, Page
from harness.system import RosClient, running
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.common.linking import robot_ports
from valor.common.viewing import page_port
from valor.link.classes import BY_KIND, Kind
from valor.link.emulate import Emulator
from valor.link.emulator import DRC_FAST, DRC_SLOW
from valor.valorctl.ros_domain import reserve

pytestmark = pytest.mark.timeout(1200)
LASTS = BY_KIND[Kind.COMMAND].deadline or 0.0  # [s]


@dataclass
class Linked:
    """Attributes: ``robot`` is a client in the robot's domain, to see what is true."""

    page: Page
    robot: RosClient
    emulator: Emulator

    def true(self) -> str:
        """The control mode that is."""
        return str(self.robot.reports[-1].current_control_mode) if self.robot.reports else ""


@pytest.fixture(scope="module")
def linked(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Linked]:
    """A robot that stands, the emulated link, and the page behind it with its operator."""
    home = tmp_path_factory.mktemp("home")
    emulator = Emulator((0, 0), DRC_SLOW, DRC_FAST)
    with reserve("operator_linked_test") as theirs:
        options = ("--no-bag", "--view", "--link", f"{theirs.domain}:{emulator.listening}")
        with running("linked", home, *options) as system:
            instance = Instance(system.name, home)
            emulator.to = robot_ports(instance.settings())
            robot = RosClient(system.join(), joint_states=False)
            try:
                page = Page(browser, page_port(instance.settings()))
                page.take_control("Ann", instance.operator_token.read_text(), "Ann operates")
                page.dismiss()
                page.sees("state", "control mode fresh")
                yield Linked(page, robot, emulator)
            finally:
                robot.close()
    emulator.close()


def test_a_mode_is_changed_by_a_button_and_shown(linked: Linked) -> None:
    page = linked.page
    wait_until(lambda: linked.true() == "stand", PATIENCE, "the robot to stand")
    page.command("stand_manipulate", "control mode stand_manipulate", "done")
    assert linked.true() == "stand_manipulate"
    page.wait("state", lambda text: text.startswith("stand_manipulate") and "control mode fresh" in text, "the mode")
    assert page.text("state").startswith(linked.true())


def test_what_is_pressed_during_a_cut_is_told_of_and_not_done_after_it(linked: Linked) -> None:
    page, robot = linked.page, linked.robot
    reports = len(robot.reports)
    given = page.number()
    linked.emulator.cut = True
    began = time.monotonic()
    page.press("manipulate")
    page.wait("commands", lambda text: page.commanded(f"#{given + 1} ", "refused"), "what became of it")
    page.wait("state", lambda text: re.search(r"control mode [\d.]+ s old", text) is not None, "that the mode is old")
    page.sees("news", "not acknowledged before its deadline")
    wait_until(lambda: time.monotonic() > began + LASTS + 1.0, PATIENCE, "the cut to be longer than the deadline")
    linked.emulator.cut = False
    page.sees("state", "control mode fresh")
    told = {each.current_control_mode for each in robot.reports[reports:]}
    asked = {each.requested_control_mode for each in robot.reports[reports:]}
    assert told <= {"stand_manipulate"} and "manipulate" not in asked
    assert page.text("state").startswith("stand_manipulate")


def test_after_the_cut_it_is_obeyed_again_and_the_pad_says_that_velocities_come_through(linked: Linked) -> None:
    page = linked.page
    page.command("stand", "control mode stand:", "done")
    wait_until(lambda: linked.true() == "stand", PATIENCE, "the robot to stand")
    page.command("walk", "control mode walk:", "done")
    page.page.get_by_text("no velocity has come through lately").wait_for()
    forward = page.button("forward")
    forward.hover()
    page.page.mouse.down()
    try:
        page.page.get_by_text(re.compile(r"a velocity came through \d\.\d s ago")).wait_for()
    finally:
        page.page.mouse.up()


def test_its_stop_goes_through_the_link(linked: Linked) -> None:
    linked.page.press("Stop, through the link")
    wait_until(lambda: linked.true() == "soft_stop", PATIENCE, "the robot to stop")
    linked.page.wait("state", lambda text: text.startswith("soft_stop"), "the stop to be shown")
