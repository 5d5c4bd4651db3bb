"""Verbs of the command line, with other processes."""

import json
import os
import signal
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import bifrost
from bifrost import cli
from bifrost.cli import Catalogue, app
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, going_on, sample, until

pytestmark = pytest.mark.portable


@pytest.fixture(autouse=True)
def joined(net: BifrostNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    """The verbs run in this process, in the test's network, without the catalogue of a larger command line."""
    monkeypatch.setattr(cli, "catalogue", Catalogue())
    monkeypatch.setenv("BIFROST_NETWORK", str(net.file))
    monkeypatch.setenv("BIFROST_KEYS", str(net.keys))


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def run_json(*arguments: str) -> Any:
    return json.loads(run(*arguments, "--json"))


def registered(net: BifrostNetwork, *names: str) -> None:
    node = net.node("watching")
    until(lambda: set(names) <= set(node.graph(10.0).nodes), "all have registered")
    node.close()


def completed(*words: str) -> list[str]:
    """What bash offers for the last of the words."""
    environment = {
        "_BIFROST_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(("bifrost", *words)),
        "COMP_CWORD": str(len(words)),
    }
    result = CliRunner().invoke(app, [], env=environment, prog_name="bifrost", complete_var="_BIFROST_COMPLETE")
    assert result.exit_code == 0, result.output
    return result.output.split()


def test_names_are_completed(net: BifrostNetwork) -> None:
    net.peer("publish", "lab/sample", "200")
    node = net.node("serving")
    node.server("lab/ask", Question, Answer, lambda question, origin: Answer("", 0))
    node.subscriber("attic/sample", Sample)
    registered(net, "publish_peer", "serving")
    until(lambda: completed("topic", "hz", "lab/") == ["lab/sample"], "the topic is offered")
    assert completed("topic", "echo", "") == ["attic/sample", "lab/sample"]
    assert completed("service", "call", "l") == ["lab/ask"]


def test_entries_of_a_catalogue_are_shown(net: BifrostNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    net.peer("publish", "lab/sample", "200")
    registered(net, "publish_peer")
    entries = {"lab/sample": {"rate_hz": 200.0, "may_publish": ["publish_peer"], "queue": None}}
    monkeypatch.setattr(cli, "catalogue", Catalogue({"Hz": "rate_hz"}, lambda: entries))
    head, row = run("topic", "list").splitlines()
    assert (head.split()[-1], row.split()[-1]) == ("Hz", "200")
    text = "topic lab/sample\n  rate_hz: 200\n  may_publish: [publish_peer]\ntype"
    assert run("topic", "info", "lab/sample").startswith(text)
    for reported in (run_json("topic", "list")[0], run_json("topic", "info", "lab/sample")):
        assert reported["catalogue"] == entries["lab/sample"]


def test_topics(net: BifrostNetwork) -> None:
    peer = net.peer("publish", "lab/sample", "200")
    listener = net.node("listener").subscriber("lab/sample", Sample)
    assert listener.receive(timeout=60.0)
    registered(net, "publish_peer", "listener")
    listed = until(lambda: [t for t in run_json("topic", "list") if t["subscribers"]], "the subscriber is listed")
    [topic] = listed
    assert (topic["name"], topic["types"]) == ("lab/sample", ["Sample"])
    assert [(end["node"], end["pid"]) for end in topic["publishers"]] == [("publish_peer", peer.pid)]
    assert [end["node"] for end in topic["subscribers"]] == ["listener"]
    assert run("topic", "list").splitlines()[1].split() == ["lab/sample", "Sample", "publish_peer", "1"]

    info = run("topic", "info", "lab/sample")
    assert "  values: float64[]\n" in info
    assert f"publisher publish_peer (pid {peer.pid} on localhost) at tcp://127.0.0.1:" in info

    echoed = run_json("topic", "echo", "lab/sample", "--once")
    assert (echoed["type"], echoed["origin"]) == ("Sample", "publish_peer")
    assert echoed["message"] == bifrost.to_builtins(sample(echoed["message"]["count"]))
    text = run("topic", "echo", "lab/sample", "--once")
    assert text.startswith("--- Sample ") and "\nvalues: [" in text

    rate = run_json("topic", "hz", "lab/sample", "--for", "0.5")
    assert rate["messages"] > 2 and rate["rate"] == pytest.approx(1.0 / rate["period_mean"])
    assert "Hz; period mean" in run("topic", "hz", "lab/sample", "--for", "0.2")
    assert 0.0 < rate["delay_median"] < 5.0


def test_echo_prints_one_json_object_a_line_until_interrupted(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    message = Sample(1, "", np.array([np.nan, np.inf, 1.0]), np.zeros(0, np.uint8))
    process = subprocess.Popen(
        [sys.executable, "-m", "bifrost.cli", "topic", "echo", "lab/sample", "--json", "--timeout", "20"],
        env=net.environment(), stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with process, going_on(lambda: publisher.publish(message)):
        assert process.stdout is not None
        line = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert json.loads(line, parse_constant=pytest.fail)["message"]["values"] == [None, None, 1.0]


def test_publishing_from_the_command_line(net: BifrostNetwork) -> None:
    listener = net.peer("subscribe", "lab/sample", "100")
    registered(net, "subscribe_peer")
    fields = json.dumps(bifrost.to_builtins(sample(5)))
    assert run("topic", "pub", "lab/sample", fields, "--count", "3", "--rate", "100") == "published 3 Sample\n"
    received = [listener.line() for _ in range(3)]
    assert [(line["count"], line["sequence"], line["drops"]) for line in received] == [(5, 1, 0), (5, 2, 0), (5, 3, 0)]
    run("topic", "pub", "lab/sample", fields)
    assert listener.line()["sequence"] == 1  # of another publisher


def test_services(net: BifrostNetwork) -> None:
    net.peer("serve", "lab/ask")
    client = net.node("asker").client("lab/ask", Question, Answer)
    assert client.wait_for_server(10.0)
    registered(net, "serve_peer", "asker")
    [service] = run_json("service", "list")
    assert service["name"] == "lab/ask" and [end["types"] for end in service["servers"]] == [["Question", "Answer"]]
    assert run("service", "list").splitlines()[1].split()[:4] == ["lab/ask", "Question", "->", "Answer"]

    reply = run_json("service", "call", "lab/ask", '{"action": "open", "argument": 1}')
    assert reply == {"text": f"open for cli_{os.getpid()}", "handled": 1}
    assert "handled: 2" in run("service", "call", "lab/ask", '{"action": "open", "argument": 1.5}')


NONE = "no {0} lab/none; `{0} list` shows all"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("topic", "echo", "lab/none", "--timeout", "0.2"), NONE.format("topic")),
        (("topic", "echo", "/lab/none", "--timeout", "0.2"), NONE.format("topic")),
        (("topic", "hz", "quiet", "--timeout", "0.2"), "no topic quiet; similar: lab/quiet; `topic list` shows all"),
        (("topic", "hz", "lab/quiet", "--timeout", "0.5"), "topic lab/quiet: quiet published nothing within 0.5 s"),
        (("topic", "info", "lab/none"), NONE.format("topic")),
        (("topic", "info", "lab/quit"), "no topic lab/quit; similar: lab/quiet; `topic list` shows all"),
        (("service", "call", "lab/none", "--timeout", "0.2"), NONE.format("service")),
        (
            ("service", "call", "lab/ask", '{"action": "open"}'),
            "Question: Object missing required field `argument`; expected an object of action, argument",
        ),
        (("topic", "pub", "lab/none", "{}", "--timeout", "0.2"), NONE.format("topic")),
        (("service", "call", "lab/ask", '{"action": "raise", "argument": 0}'), "lab/ask: ValueError: no such valve"),
    ],
)
def test_errors_are_one_line(net: BifrostNetwork, arguments: tuple[str, ...], message: str) -> None:
    net.node("quiet").publisher("lab/quiet", Sample)
    if "lab/ask" in arguments:
        net.peer("serve", "lab/ask")
    with pytest.raises(bifrost.Error) as caught:
        run(*arguments)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("topic", "info"), "no publisher and no subscriber"),
        (("topic", "echo", "--timeout", "0.2"), "no publisher within 0.2 s"),
        (("topic", "pub", "{}", "--timeout", "0.2"), "no node with its type within 0.2 s"),
    ],
)
def test_a_name_of_the_catalogue_exists_also_without_a_node(
    monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], reason: str
) -> None:
    monkeypatch.setattr(cli, "catalogue", Catalogue({}, lambda: {"lab/none": {}}, "; ask {name}"))
    with pytest.raises(bifrost.Error, match=f"^topic lab/none: {reason}$"):
        run(*arguments[:2], "/lab/none", *arguments[2:])
    with pytest.raises(bifrost.Error, match=r"^no topic lab/no; similar: lab/none; .* shows all; ask lab/no$"):
        run(*arguments[:2], "/lab/no", *arguments[2:])


def test_an_invalid_name_is_wrong_usage(net: BifrostNetwork) -> None:
    result = CliRunner().invoke(app, ["topic", "echo", "//joint states"])
    assert result.exit_code == 2 and "letters, digits" in result.output


def test_exit_status_and_stderr(net: BifrostNetwork) -> None:
    for arguments, status, error in (
        (("topic", "list"), 1, "bifrost: /nowhere: no such folder of Bifrost keys\n"),
        (("topic", "shout"), 2, ""),
    ):
        ended = subprocess.run(
            [sys.executable, "-m", "bifrost.cli", *arguments], env=net.environment() | {"BIFROST_KEYS": "/nowhere"},
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert (ended.returncode, ended.stdout) == (status, "")
        assert ended.stderr == error or not error
