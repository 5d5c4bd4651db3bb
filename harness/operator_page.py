"""The operator's page in a browser: what a person reads and presses there.

Playwright drives a Chromium that is on this computer; without either, tests are skipped.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

CHROMIUM = shutil.which("chromium")
ARGUMENTS = (
    "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
PASSING = re.compile("came too late|nobody serves|not acknowledged")  # refusals after which it is pressed again
SIZE = {"width": 1180, "height": 720}
FRAMES = 8  # that a page may draw [1/s]: without a graphics card each costs a core tens of milliseconds
SLOWLY = f"""
{{
  const draw = window.requestAnimationFrame.bind(window);
  let last = 0;
  window.requestAnimationFrame = (act) => {{
    const wait = Math.max(0, last + {1000 // FRAMES} - performance.now());
    return window.setTimeout(() => draw((now) => {{ last = performance.now(); act(now) }}), wait);
  }};
  window.cancelAnimationFrame = (number) => window.clearTimeout(number);
}}
"""
PATIENCE = 150.0  # on a busy computer that draws without a graphics card [s]
AGAIN = 15.0  # after which a person presses again if nothing is seen to happen [s]
VIEW = """() => {
  const camera = window.__viserMutable.camera;
  camera.updateMatrixWorld();
  return [camera.matrixWorldInverse.elements, camera.projectionMatrix.elements,
          window.__viserSceneTree.getState()[""].wxyz];
}"""


class Page:
    """One viewer's page: STOP and state, and the view in a frame."""

    def __init__(self, browser: Any, port: int, **options: Any) -> None:
        self.context = browser.new_context(**{"viewport": SIZE} | options)
        self.context.add_init_script(SLOWLY)
        self.page = self.context.new_page()
        self.page.set_default_timeout(1000.0 * PATIENCE)
        self.requests: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(f"http://127.0.0.1:{port}/")
        self.arrive()

    def arrive(self) -> None:
        """Wait for the view."""
        self.page.frame_locator("#scene").locator("#state").wait_for(state="attached")

    @property
    def view(self) -> Any:
        """The frame with the view."""
        return self.page.locator("#scene").element_handle().content_frame()

    def stop(self) -> None:
        """Click, or tap, where STOP is; nothing may lie over it."""
        box = self.page.locator("#stop").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        assert self.page.evaluate(f"document.elementFromPoint({x}, {y}).id") == "stop"
        touch = self.page.evaluate("navigator.maxTouchPoints") > 0
        self.page.touchscreen.tap(x, y) if touch else self.page.mouse.click(x, y)

    def said(self, words: str) -> None:
        """Wait for a text beside STOP."""
        self.page.locator("header").get_by_text(words).first.wait_for()

    def text(self, place: str) -> str:
        return str(self.view.locator(f"#{place}").inner_text())

    def wait(self, place: str, what: Callable[[str], bool], name: str) -> str:
        deadline = time.monotonic() + PATIENCE
        while not what(text := self.text(place)):
            assert time.monotonic() < deadline, f"{name}: not within {PATIENCE:g} s; {place}: {text}"
            self.page.wait_for_timeout(200)
        return text

    def sees(self, place: str, words: str) -> str:
        return self.wait(place, lambda text: words in text, words)

    def button(self, label: str) -> Any:
        return self.view.get_by_role("button", name=label, exact=True).first

    def press(self, label: str) -> None:
        self.button(label).click()

    def commanded(self, begins: str, ends: str, since: int = 0) -> bool:
        """Whether a command given after number ``since`` has ended so."""
        lines = [line for line in self.text("commands").splitlines()[1:] if _number(line) > since]
        return any(begins in line and ends in line for line in lines)

    def command(self, label: str, begins: str, ends: str) -> None:
        """Press a button until the command that it gives ends so.

        A browser that draws without a graphics card answers so slowly at times that a press counts as late, that the
        button moves away under the mouse (no command is listed), and what has just been started is not found at once;
        then it is pressed again, as a person would.
        """
        given = self.number()
        deadline = time.monotonic() + PATIENCE
        self.press(label)
        again = time.monotonic() + AGAIN
        while True:
            if self.commanded(begins, ends, given):
                return
            lines = [line for line in self.text("commands").splitlines()[1:] if _number(line) > given]
            assert time.monotonic() < deadline, f"{begins} … {ends}: not within {PATIENCE:g} s; {lines}"
            missed = PASSING.search(lines[0]) if lines else time.monotonic() > again
            if missed and self.button(label).is_enabled():
                given = self.number()
                self.press(label)
                again = time.monotonic() + AGAIN
            self.page.wait_for_timeout(500)

    def number(self) -> int:
        return max((_number(line) for line in self.text("commands").splitlines()), default=0)

    def dismiss(self) -> None:
        """The notifications that cover the robot; they also go by themselves, at any moment."""
        self.view.evaluate(
            "document.querySelectorAll('.mantine-Notification-closeButton').forEach((one) => one.click())"
        )

    def take_control(self, name: str, token: str, told: str, button: str = "Take control") -> None:
        """Ask for control until the page says ``told``.

        A slow browser sends the fields behind the button, and a notification goes by itself, seen or not; then it is
        asked again, as a person would: the token is cleared after each press.
        """
        boxes = self.view.get_by_role("textbox")
        said = self.view.get_by_text(told).first
        deadline = time.monotonic() + PATIENCE
        again = 0.0
        while not said.is_visible():
            assert time.monotonic() < deadline, f"{button}: {told}: not within {PATIENCE:g} s; {self.text('state')}"
            if time.monotonic() > again:
                for box, words in ((boxes.nth(0), name), (boxes.nth(1), token)):
                    box.fill(words)
                    box.blur()
                self.page.wait_for_timeout(500)  # the fields are sent a moment behind the last key
                self.press(button)
                again = time.monotonic() + AGAIN
            self.page.wait_for_timeout(100)

    def tab(self, name: str) -> None:
        self.view.get_by_role("tab", name=name).click()

    def select(self, label: str, option: str) -> None:
        """Choose from a list."""
        self.view.get_by_label(label, exact=True).first.click()
        self.view.get_by_role("option", name=option, exact=True).click()

    def selected(self, label: str) -> str:
        return str(self.view.get_by_label(label, exact=True).first.input_value())

    def show_goal(self, side: str, *, shown: bool = True) -> None:
        """Of a hand, where the hand is; or hide it."""
        self.view.get_by_text(f"{side} hand's goal").click()
        state = f"window.__viserSceneTree.getState()['/hand_goal/{side}']?.visibility"
        self.view.wait_for_function(f"{state} === {str(shown).lower()}")

    def drag(self, side: str, place: Any, turn: Any, way: float) -> str:
        """Pull a hand's goal that is shown at (3,) [m] and (3, 3) along one of its arrows, whichever can be seen.

        Returns:
            What is said of it then.
        """
        told, mouse = self.view.get_by_text(f"{side} hand to ("), self.page.mouse
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            for axis in range(3):
                begin, end = (self.at(place + length * turn[:, axis]) for length in (0.16, 0.16 + way))
                mouse.move(*begin)
                self.page.wait_for_timeout(500)
                mouse.down()
                for share in (0.3, 0.6, 1.0):
                    mouse.move(*(a + share * (b - a) for a, b in zip(begin, end, strict=True)))
                    self.page.wait_for_timeout(200)
                mouse.up()
                self.page.wait_for_timeout(2000)
                if told.count():
                    return str(told.first.inner_text())
        raise AssertionError(f"the goal of the {side} hand cannot be dragged")

    def at(self, point: Any) -> tuple[float, float]:
        """Where a point in odom [m] is on the screen."""
        view, projection, (w, x, y, z) = self.view.evaluate(VIEW)
        turn = np.array((
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ))  # fmt: skip
        seen = np.reshape(projection, (4, 4)).T @ np.reshape(view, (4, 4)).T @ (*(turn @ np.array(point)), 1.0)
        across, up = (seen[:2] / seen[3]).tolist()
        box = self.view.locator("canvas").first.bounding_box()
        return box["x"] + 0.5 * (1.0 + across) * box["width"], box["y"] + 0.5 * (1.0 - up) * box["height"]


def _number(line: str) -> int:
    """Of a command, by its line; 0: it is none."""
    found = re.match(r"#(\d+) ", line)
    return int(found[1]) if found else 0


@contextmanager
def chromium() -> Iterator[Any]:
    driver = pytest.importorskip("playwright.sync_api", reason="no Playwright: `make .venv/stock.stamp` installs it")
    if CHROMIUM is None:
        pytest.skip("no Chromium here (Debian: chromium)")
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        yield browser
        browser.close()
