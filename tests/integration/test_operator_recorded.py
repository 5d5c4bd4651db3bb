"""The operator's page on a recording, by its command and in a browser."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.operator_page import PATIENCE, Page
from harness.station_bag import written

pytestmark = pytest.mark.timeout(1200)
COMMAND = (sys.executable, "-m", "valor.valorctl", "view", "--bag")


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    bag = written(tmp_path_factory.mktemp("bag"))
    with subprocess.Popen([*COMMAND, str(bag), "--robot", "escher"], stdout=subprocess.PIPE, text=True) as view:
        assert view.stdout is not None
        said = view.stdout.readline()
        assert said.startswith("page: http://127.0.0.1:"), said
        yield int(said.rsplit(":", 1)[1].strip("/\n"))
        view.terminate()
        assert view.wait(60.0) == 0


def test_what_is_no_bag_or_names_no_robot_is_refused_with_a_word(tmp_path: Path) -> None:
    for bag, word in ((tmp_path / "none.mcap", "No such file"), (written(tmp_path), "expected --robot")):
        refused = subprocess.run([*COMMAND, str(bag)], capture_output=True, text=True, timeout=PATIENCE, check=False)
        assert refused.returncode == 1
        assert word in refused.stderr
        assert refused.stderr.count("\n") == 1


def test_a_recording_is_played_stepped_and_drawn_and_nothing_can_be_commanded(browser: Any, port: int) -> None:
    page = Page(browser, port)
    assert "Nothing can be commanded" in page.text("recording")
    assert page.page.locator("iframe").count() == 0
    for label in ("stand", "Take control", "Approve and execute"):
        assert page.page.get_by_role("button", name=label).count() == 0, label
    page.sees("state", "walk")  # at the end it stands
    page.page.get_by_role("button", name="Play", exact=True).wait_for()
    page.picture("recording")
    for _ in range(3):
        page.press("A frame back")
    page.page.get_by_text("3.90 of 4.0 s").wait_for()
    page.page.locator("input").locator("visible=true").first.fill("2")
    page.page.keyboard.press("Enter")
    page.sees("state", "stand")
    page.page.get_by_text("2.00 of 4.0 s").wait_for()
    page.page.get_by_role("combobox", name="event").click()
    page.page.get_by_role("option", name="1. 2.50 s, mark: the knee is seen").click()
    page.page.get_by_text("2.50 of 4.0 s").wait_for()
    page.context.close()
