"""STOP: pressed where it is, on a screen and on a phone, with the view alive, killed, stopped, or nothing reachable."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

import bifrost
from harness.operator_page import PATIENCE, Page
from harness.system import System
from harness.waiting import wait_until
from tests.integration.held_line import HeldLine
from valor.common.instance import Instance
from valor.common.topics import MOTION_STATE
from valor.common.viewing import page_port

pytestmark = pytest.mark.timeout(900)
SIZES: dict[str, dict[str, Any]] = {
    "screen": {"viewport": {"width": 1280, "height": 800}},
    "phone": {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True},
}
LONGEST = 1.3  # from a press to what became of it, on a busy computer: the page gives up after 1 s [s]
WATCH = """() => {
  window.told = [];
  const note = () => told.push([performance.now(), document.getElementById("said").textContent]);
  new MutationObserver(note).observe(document.getElementById("said"), { childList: true, subtree: true });
  addEventListener("pointerdown", () => told.push([performance.now(), "pressed"]), true);
  addEventListener("keydown", () => told.push([performance.now(), "pressed"]), true);
  addEventListener("message", ({ data }) => data === "stop" && told.push([performance.now(), "pressed"]), true);
}"""


class Stop:
    """A page whose texts beside STOP are watched, and what the robot does."""

    def __init__(self, page: Page, line: HeldLine, system: System, states: Any) -> None:
        self.page, self.line, self.system, self._states = page, line, system, states
        page.page.evaluate(WATCH)

    def result(self) -> str:
        """What the page says after the stop was pressed; it must say so in time."""
        pressed = "told.findIndex((each) => each[1] === 'pressed')"
        end = f"(each, at) => {pressed} >= 0 && at > {pressed} && /confirmed|NOT/i.test(each[1])"
        self.page.page.wait_for_function(f"told.some({end})")
        began, said, text = self.page.page.evaluate(f"() => [told[{pressed}][0], ...told.find({end})]")
        self.page.page.evaluate("told.length = 0")
        assert said - began < 1000.0 * LONGEST, text
        return str(text)

    def behavior(self) -> str:
        self._states.drain()
        return str(wait_until(lambda: self._states.receive(timeout=1.0), PATIENCE, "MotionState").message.behavior)

    def stopped(self) -> None:
        """The robot has stopped, as the page says; it stands up again."""
        assert self.result().startswith("confirmed: stopped")
        assert self.behavior() == "soft_stop"
        self.system.valorctl("mode", "stand")

    def link(self, words: str) -> None:
        """Wait until the page says that of the connection."""
        self.page.page.locator("#link").get_by_text(words, exact=True).wait_for()

    def station(self, number: signal.Signals) -> None:
        os.kill(self._process()["pid"], number)

    def _process(self) -> dict[str, Any]:
        processes: list[dict[str, Any]] = self.system.status()["services"]
        return next(process for process in processes if process["name"] == "operator_station")


@pytest.fixture(scope="module", params=SIZES)
def stop(request: pytest.FixtureRequest, browser: Any, system: System, node: bifrost.Node) -> Iterator[Stop]:
    instance = Instance(system.name, Path(system.environment["VALOR_HOME"]))
    system.valorctl("mode", "stand")
    with HeldLine(page_port(instance.settings())) as line, closing(MOTION_STATE.subscriber(node)) as states:
        page = Page(browser, line.port, **SIZES[request.param])
        yield Stop(page, line, system, states)
        page.context.close()


def test_it_is_pressed_where_it_is(stop: Stop) -> None:
    stop.link("connected")
    stop.page.stop()
    stop.stopped()


def test_it_stops_when_the_view_is_killed(stop: Stop) -> None:
    stop.station(signal.SIGKILL)
    stop.page.stop()
    stop.stopped()
    stop.link("connected")


def test_it_stops_when_the_view_hangs(stop: Stop) -> None:
    stop.station(signal.SIGSTOP)
    try:
        stop.link("connected; the view below is not running")
        stop.page.stop()
        stop.stopped()
    finally:
        stop.station(signal.SIGCONT)
    stop.link("connected")


@contextmanager
def cut(stop: Stop) -> Iterator[None]:
    stop.line.hold()
    try:
        yield
    finally:
        stop.line.release()
        stop.link("connected")
        stop.system.valorctl("mode", "stand")  # a stop that was sent comes late, and stops


def test_a_stop_that_does_not_arrive_is_reported(stop: Stop) -> None:
    with cut(stop):
        stop.page.stop()
        assert stop.result().startswith("NOT confirmed: no reply")
        stop.link("NO CONNECTION to the robot's computer")
        stop.page.stop()
        assert "has NOT reached the robot" in stop.result()
        assert stop.behavior() == "stand"


@pytest.mark.parametrize("key", ["Space", "Escape"])
@pytest.mark.parametrize("focus", ["page", "view"])
def test_keys_stop_wherever_the_focus_is(stop: Stop, key: str, focus: str) -> None:
    page = stop.page
    if focus == "page":
        page.page.locator("#robot").click()
    else:
        page.dismiss()
        page.view.locator("body").click(position={"x": 20, "y": 250})
        assert page.view.evaluate("document.hasFocus()")
    page.page.evaluate("told.length = 0")
    page.page.keyboard.press(key)
    stop.stopped()
