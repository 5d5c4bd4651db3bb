"""The operator's page beyond this computer, in a browser: TLS and a token, then all as ever, its stop too."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from typing import Any

import pytest

from harness.instance import RunningInstance, fresh_instance
from harness.operator_page import PATIENCE, SIZE
from valor.common.viewing import LOOPBACK, Viewing, page_port, stop_port
from valor.valorctl import viewing

VIEWER, OPERATOR = "look on", "open sesame"
pytestmark = pytest.mark.timeout(1200)


@pytest.fixture(scope="module")
def instance(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningInstance]:
    with fresh_instance(tmp_path_factory.mktemp("home"), "beyond") as instance:
        for file, token in ((instance.instance.viewer_token, VIEWER), (instance.instance.operator_token, OPERATOR)):
            file.write_text(token)
        viewing.decide(instance.instance, Viewing(host="0.0.0.0"))
        for name in ("operator_stop", "operator_station"):
            instance.start(name)
        for name in ("operator_stop", "operator_station"):
            instance.wait_ready(name, PATIENCE)
        yield instance


def test_where_it_is_and_by_which_certificate_is_told(instance: RunningInstance) -> None:
    told = viewing.announcement(instance.instance)
    assert f":{page_port(instance.settings)}/" in told
    assert "https://" in told and "http://" not in told
    assert "SHA-256: " in told


def test_plain_connections_are_refused_with_a_word(instance: RunningInstance) -> None:
    for port in (page_port(instance.settings), stop_port(instance.settings)):
        line = http.client.HTTPConnection(LOOPBACK, port, timeout=PATIENCE)
        line.request("GET", "/")
        answer = line.getresponse()
        assert answer.status == 426
        assert "TLS alone" in answer.read().decode()


def test_with_a_token_everything_is_as_ever(browser: Any, instance: RunningInstance) -> None:
    context = browser.new_context(viewport=SIZE, ignore_https_errors=True)
    page = context.new_page()
    page.set_default_timeout(1000.0 * PATIENCE)
    page.goto(f"https://{LOOPBACK}:{stop_port(instance.settings)}/")
    page.get_by_text("Show the viewers' token").wait_for()
    page.goto(f"https://{LOOPBACK}:{page_port(instance.settings)}/")
    page.get_by_label("token").fill("wrong")
    page.get_by_role("button").click()
    page.get_by_text("That is no token of this robot's").wait_for()
    page.get_by_label("token").fill(VIEWER)
    page.get_by_role("button").click()
    page.locator("#state").get_by_text("nobody operates").wait_for()
    stop = page.frame_locator("iframe[title=stop]")
    stop.get_by_role("button", name="STOP").dispatch_event("pointerdown")
    stop.get_by_text("not confirmed to have stopped: comms_manager is silent").wait_for()
    context.close()
