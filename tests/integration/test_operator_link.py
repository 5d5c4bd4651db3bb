"""The operator's page behind an emulated link: what is shown has its age, what is pressed in a cut is not done."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from harness.operator_page import PATIENCE, Page
from harness.system import RosClient, running
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.common.linking import robot_ports
from valor.common.messages import ModeStatus
from valor.common.viewing import page_port
from valor.link.classes import BY_KIND, Kind
from valor.link.emulate import Emulator
from valor.link.emulator import DRC_FAST, DRC_SLOW
from valor.link.schedule import random_windows
from valor.valorctl.ros_domain import reserve

pytestmark = pytest.mark.timeout(1200)
SEED = 5
GREY = """() => [...document.querySelectorAll("#state span")].some((each) =>
  each.innerText.startsWith("joints ") && getComputedStyle(each).color === "rgb(154, 154, 154)")"""
LASTS = BY_KIND[Kind.COMMAND].deadline or 0.0


@dataclass
class Behind:
    """A robot behind the link, and the page before it.

    Attributes:
        instance: of both.
        emulator: the link.
        robot: a client in the robot's domain, to see what is true.
    """

    instance: Instance
    emulator: Emulator
    robot: RosClient

    def true(self) -> str:
        """The mode that is."""
        return str(self.robot.reports[-1].current_control_mode) if self.robot.reports else ""

    @contextmanager
    def cut(self, page: Page) -> Iterator[None]:
        """Nothing passes; begins when the page says so, ends when it says that the robot is heard again."""
        self.emulator.cut = True
        try:
            page.sees("state", "the robot is silent")
            yield
        finally:
            self.emulator.cut = False
        page.wait("state", lambda text: "the robot is heard" in text and age(text) < LASTS / 2, "it is heard again")


def age(text: str) -> float:
    """Of the joints, as the page tells it [s]."""
    told = re.search(r"joints (\d+(?:\.\d)?) s old", text)
    return float(told[1]) if told else 0.0


@pytest.fixture(scope="module")
def behind(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Behind]:
    home = tmp_path_factory.mktemp("home")
    emulator = Emulator((0, 0), DRC_SLOW, DRC_FAST, windows=random_windows(SEED, 3600.0), seed=SEED)
    with reserve("link_page_operator") as theirs:
        link = f"{theirs.domain}:{emulator.listening}"
        with running("link_page", home, "--no-bag", "--view", "--link", link) as system:
            instance = Instance("link_page", home)
            emulator.to = robot_ports(instance.settings())
            robot = RosClient(system.join(), joint_states=False)
            try:
                yield Behind(instance, emulator, robot)
            finally:
                robot.close()
    emulator.close()


@pytest.fixture(scope="module")
def page(browser: Any, behind: Behind) -> Page:
    page = Page(browser, page_port(behind.instance.settings()))
    page.take_control("Ann", behind.instance.operator_token.read_text(), "Ann operates")
    page.dismiss()
    return page


def test_a_mode_is_changed_through_it(page: Page, behind: Behind) -> None:
    page.wait("state", lambda text: "the robot is heard" in text and "behavior stand " in text, "it is heard")
    page.command("stand_manipulate", "control mode stand_manipulate", "done")
    assert behind.true() == "stand_manipulate"
    page.sees("state", "behavior stand_manipulate")
    page.picture("link_mode")


def test_what_is_pressed_in_a_cut_is_refused_and_not_done_after_it(page: Page, behind: Behind) -> None:
    reports = len(behind.robot.reports)
    with behind.cut(page):
        text = page.wait("state", lambda text: age(text) > 2.0, "the joints' age is the link's")
        assert "stand_manipulate" in text, "what was known last is still shown"
        page.page.wait_for_function(GREY)
        given = page.number()
        page.press("stand")

        def refused(text: str) -> bool:
            lines = [line for line in text.splitlines() if re.match(r"#\d+ .*control mode stand:", line)]
            return any(int(line[1 : line.index(" ")]) > given and "refused" in line for line in lines)

        page.wait("commands", refused, "it is given up")
        page.picture("link_cut")
        page.wait("state", lambda text: age(text) > 1.5 * LASTS, "the cut is longer than a command lasts")
    page.command("stand_manipulate", "control mode stand_manipulate", "done")  # behind all that could still come
    assert {str(each.current_control_mode) for each in behind.robot.reports[reports:]} <= {"stand_manipulate"}


def test_after_a_cut_the_mode_that_is_shown_is_the_one_that_is(page: Page, behind: Behind) -> None:
    with behind.cut(page):
        assert behind.robot.change_mode("stand", PATIENCE).status & ModeStatus.MODE_ACCEPTED  # by somebody beside it
        assert "behavior stand_manipulate" in page.text("state")
    page.sees("state", "behavior stand ")
    page.wait("state", lambda text: text.split()[0] == "stand", "the mode that is")
    assert behind.true() == "stand"


def test_the_stop_goes_through_it(page: Page, behind: Behind) -> None:
    page.press("Stop, through the link")
    wait_until(lambda: behind.true() == "soft_stop", PATIENCE, "the robot to stop")
    page.sees("state", "behavior soft_stop")
    page.picture("link_stop")
