"""The operator's page without a robot: who operates, what is shown before it moves, what is late, what returns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from harness.held_line import HeldLine
from harness.instance import RunningInstance, fresh_instance
from harness.operator_page import Page
from valor.common.viewing import page_port
from valor.operator_station.body import Body
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

TOKEN = "open sesame"
pytestmark = pytest.mark.timeout(1800)


@pytest.fixture(scope="module")
def instance(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningInstance]:
    with fresh_instance(tmp_path_factory.mktemp("home"), "viewers") as instance:
        instance.instance.operator_token.write_text(TOKEN)
        for name in ("operator_stop", "operator_station"):
            instance.start(name)
        for name in ("operator_stop", "operator_station"):
            instance.wait_ready(name, 240.0)
        yield instance


@pytest.fixture(scope="module")
def line(instance: RunningInstance) -> Iterator[HeldLine]:
    with HeldLine(page_port(instance.settings)) as line:
        yield line


@pytest.fixture(scope="module")
def page(browser: Any, line: HeldLine) -> Page:
    return Page(browser, line.port)


def test_what_was_never_heard_is_said_and_nothing_is_fetched_from_elsewhere(page: Page) -> None:
    text = page.text("state")
    assert "control mode not known" in text
    assert "joints never heard" in text
    assert "nobody operates" in text
    assert all("//127.0.0.1:" in url or url.startswith(("data:", "blob:")) for url in page.requests), page.requests


def test_only_the_token_makes_an_operator(page: Page) -> None:
    page.take_control("Mallory", "wrong", "wrong token")
    assert "nobody operates" in page.text("state")
    page.take_control("Ann", TOKEN, "Ann operates")


def test_a_preset_and_a_dragged_hand_are_shown_and_not_sent_to_nobody(page: Page, instance: RunningInstance) -> None:
    page.tab("Arms")
    page.press("left arm: side")
    page.page.get_by_text("nothing speaks against it").wait_for()
    page.command("Approve and execute", "left arm side", "nobody serves trajectory_controllers/left_arm")
    robot = RobotDescription.load(instance.settings.robot)
    hand = robot.tables.hands.left
    assert hand is not None
    page.show_goal("left")
    page.drag("left", *Body(full_model(robot)).site(hand.site), 0.06)
    page.press("Forget it")


def test_a_click_on_the_floor_is_planned_and_what_waited_in_a_cut_is_late(page: Page, line: HeldLine) -> None:
    page.tab("Drive")
    page.page.get_by_text("click on the floor to plan").click()
    page.page.mouse.click(*page.at((1.0, 0.0, 0.0)))
    page.page.get_by_text("9 steps to (").wait_for()
    line.hold()
    page.press("Walk there")
    page.page.wait_for_timeout(4000)
    line.release()
    page.wait("commands", lambda text: any("9 steps:" in each and "late" in each for each in text.splitlines()), "late")


def test_after_a_reload_the_operator_is_known(page: Page) -> None:
    page.page.reload()
    page.page.locator("#state").wait_for()
    page.sees("state", "Ann operates")
    page.wait("state", lambda text: "gone" not in text, "the operator is back")


def test_a_second_operator_is_refused_then_takes_over_visibly(browser: Any, line: HeldLine, page: Page) -> None:
    other = Page(browser, line.port)
    other.take_control("Bob", TOKEN, "Ann operates, and is told that Bob asks")
    page.sees("state", "Bob asks for control")
    other.press("Take over")
    page.sees("state", "Bob operates")
    other.context.close()
    page.sees("state", "Bob operates (gone")


def test_a_stop_that_reaches_nobody_says_so(page: Page) -> None:
    stop = page.page.frame_locator("iframe[title=stop]")
    stop.get_by_role("button", name="STOP").dispatch_event("pointerdown")
    stop.get_by_text("not confirmed to have stopped: comms_manager is silent").wait_for()


def test_a_station_that_was_killed_comes_back_without_an_operator(page: Page, instance: RunningInstance) -> None:
    instance.kill("operator_station")
    instance.start("operator_station")
    page.sees("state", "nobody operates")
