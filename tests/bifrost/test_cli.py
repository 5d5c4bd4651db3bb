"""The command line's verbs, against real peers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import bifrost
from bifrost.cli import Catalogue
from bifrost.cli.__main__ import app
from harness.bifrost_network import (
    Answer,
    BifrostNetwork,
    Question,
    Sample,
    connected,
    sample,
    until,
)


@pytest.fixture(autouse=True)
def joined(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The verbs run in this process, in the test's network."""
    network = request.getfixturevalue("net" if "net" in request.fixturenames else "bare_network")
    monkeypatch.setenv("BIFROST_NETWORK", str(network.file))
    monkeypatch.setenv("BIFROST_KEYS", str(network.keys))


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


def test_names_of_what_is_there_are_completed(net: BifrostNetwork) -> None:
    net.peer("publish", "lab/sample", "200")
    node = net.node("serving")
    node.server("lab/ask", Question, Answer, lambda question, origin: Answer("", 0))
    node.subscriber("attic/sample", Sample)
    registered(net, "publish_peer", "serving")
    until(lambda: completed("topic", "hz", "lab/") == ["lab/sample"], "the topic is offered")
    until(lambda: completed("topic", "echo", "") == ["attic/sample", "lab/sample"], "all topics are offered")
    until(lambda: completed("service", "call", "l") == ["lab/ask"], "the service is offered")


def test_a_larger_command_lines_catalogue_stands_beside_what_there_is(net: BifrostNetwork) -> None:
    net.peer("publish", "lab/sample", "200")
    registered(net, "publish_peer")
    entries = {"lab/sample": {"rate_hz": 200.0, "may_publish": ["publish_peer"], "queue": None}}
    catalogue = Catalogue({"Hz": "rate_hz"}, lambda: entries)

    def told(*arguments: str) -> str:
        result = CliRunner().invoke(app, ["topic", *arguments], obj=catalogue, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.output

    head, row = told("list").splitlines()
    assert (head.split()[-1], row.split()[-1]) == ("Hz", "200")
    assert told("info", "lab/sample").startswith(
        "topic lab/sample\n  rate_hz: 200\n  may_publish: [publish_peer]\ntype"
    )
    assert json.loads(told("list", "--json"))[0]["catalogue"] == entries["lab/sample"]
    assert json.loads(told("info", "lab/sample", "--json"))["catalogue"] == entries["lab/sample"]


def test_nothing_is_completed_where_no_daemon_answers(bare_network: BifrostNetwork) -> None:
    assert completed("topic", "hz", "") == []


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

    def counted() -> Any:
        """Once both have told the daemon."""
        told = run_json("topic", "info", "lab/sample")
        ends = (*told["publishers"], *told["subscribers"])
        return told if all(end.get("messages") for end in ends) else None

    told = until(counted, "messages are counted at both ends")
    assert told["schemas"] == topic["schemas"]
    assert (told["subscribers"][0]["drops"], told["subscribers"][0]["rejected"]) == (0, 0)
    assert " messages, 0 dropped, 0 refused" in run("topic", "info", "lab/sample")

    echoed = run_json("topic", "echo", "lab/sample", "--once")
    assert (echoed["type"], echoed["origin"]) == ("Sample", "publish_peer")
    assert echoed["message"] == bifrost.to_builtins(sample(echoed["message"]["count"]))
    text = run("topic", "echo", "lab/sample", "--once")
    assert text.startswith("--- Sample ") and "\nvalues: [" in text

    rate = run_json("topic", "hz", "lab/sample", "--for", "0.5")
    assert rate["messages"] > 2 and rate["rate"] == pytest.approx(1.0 / rate["period_mean"])
    assert "Hz; period mean" in run("topic", "hz", "lab/sample", "--for", "0.2")
    delay = run_json("topic", "delay", "lab/sample", "--for", "0.5")
    assert 0.0 < delay["delay_min"] <= delay["delay_median"] <= delay["delay_p99"] <= delay["delay_max"] < 5.0
    assert "delay mean" in run("topic", "delay", "lab/sample", "--for", "0.2")
    width = run_json("topic", "bw", "lab/sample", "--for", "0.5")
    frame = len("lab/sample") + 1 + 34 + len("publish_peer") + len(bifrost.codec(Sample).encode(sample(1000)))
    assert width["bytes_mean"] == pytest.approx(frame, abs=4)  # digits of the count
    assert "a message" in run("topic", "bw", "lab/sample", "--for", "0.2")


def test_numbers_that_json_does_not_know(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    message = Sample(1, "", np.array([np.nan, np.inf, 1.0]), np.zeros(0, np.uint8))
    process = subprocess.Popen(
        [sys.executable, "-m", "bifrost.cli", "topic", "echo", "lab/sample", "--json", "--timeout", "20"],
        env=net.environment(),
        stdout=subprocess.PIPE,
        text=True,
    )
    output = process.stdout
    assert output is not None
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.extend(output))
    reader.start()

    def echoed() -> bool:
        publisher.publish(message)
        return len(lines) >= 3

    until(echoed, "three messages are echoed", 30.0)
    process.send_signal(signal.SIGINT)
    try:
        assert process.wait(20) == 0  # interrupting is how it ends
    finally:
        process.kill()
        reader.join(20.0)
        output.close()
    assert json.loads(lines[0], parse_constant=pytest.fail)["message"]["values"] == [None, None, 1.0]


def test_drops_and_refusals_are_seen_from_another_shell(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("listener").subscriber("lab/sample", Sample, queue=5, drop="oldest")
    connected(publisher, subscriber)
    for count in range(100):
        publisher.publish(sample(count))
    until(lambda: subscriber.drops == 95, "the oldest are dropped")

    def seen() -> bool:
        [end] = run_json("topic", "info", "lab/sample")["subscribers"]
        return bool(end.get("drops") == 95)

    until(seen, "the drops are in topic info")


def test_publishing_from_the_command_line(net: BifrostNetwork) -> None:
    listener = net.peer("subscribe", "lab/sample", "100")
    registered(net, "subscribe_peer")
    fields = json.dumps(bifrost.to_builtins(sample(5)))
    sent = run_json("topic", "pub", "lab/sample", fields, "--count", "3", "--rate", "100")
    assert sent == {"topic": "lab/sample", "type": "Sample", "messages": 3}
    heard = [listener.line() for _ in range(3)]
    assert [(line["count"], line["sequence"], line["drops"]) for line in heard] == [(5, 1, 0), (5, 2, 0), (5, 3, 0)]
    assert "published 1 Sample" in run("topic", "pub", "lab/sample", fields)
    assert listener.line()["sequence"] == 1  # of another publisher


def test_services(net: BifrostNetwork) -> None:
    net.peer("serve", "lab/ask")
    client = net.node("asker").client("lab/ask", Question, Answer)
    assert client.wait_for_server(10.0)
    registered(net, "serve_peer", "asker")
    [service] = run_json("service", "list")
    assert service["name"] == "lab/ask"
    assert [end["types"] for end in service["servers"]] == [["Question", "Answer"]]
    assert run("service", "list").splitlines()[1].split()[:4] == ["lab/ask", "Question", "->", "Answer"]

    reply = run_json("service", "call", "lab/ask", '{"action": "open", "argument": 1}')
    assert reply == {"text": f"open for cli_{os.getpid()}", "handled": 1}
    assert "handled: 2" in run("service", "call", "lab/ask", '{"action": "open", "argument": 1.5}')


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("topic", "echo", "lab/none", "--timeout", "0.2"), "topic lab/none: no publisher within 0.2 s"),
        (("topic", "hz", "lab/quiet", "--timeout", "0.5"), "topic lab/quiet: quiet published nothing within 0.5 s"),
        (("topic", "info", "lab/none"), "topic lab/none: nobody publishes or subscribes to it"),
        (("service", "call", "lab/none", "--timeout", "0.2"), "service lab/none: no server within 0.2 s"),
        (("service", "call", "lab/ask", '{"action": 1}'), "Question.argument is missing"),
        (
            ("topic", "pub", "lab/none", "{}", "--timeout", "0.2"),
            "topic lab/none: nobody who knows its type within 0.2 s",
        ),
        (("topic", "pub", "lab/quiet", '{"count": 1}'), "Sample.label is missing"),
        (("service", "call", "lab/ask", '{"action": "raise", "argument": 0}'), "lab/ask: ValueError: no such valve"),
    ],
)
def test_what_cannot_be_done_is_one_line(net: BifrostNetwork, arguments: tuple[str, ...], message: str) -> None:
    net.node("quiet").publisher("lab/quiet", Sample)
    if "lab/ask" in arguments:
        net.peer("serve", "lab/ask")
    with pytest.raises(bifrost.Error) as caught:
        run(*arguments)
    assert str(caught.value) == message


def test_exit_status_and_stderr(net: BifrostNetwork) -> None:
    def verb(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "bifrost.cli", *arguments],
            env=net.environment() | environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    missing = verb("topic", "list", BIFROST_KEYS="/nowhere")
    assert (missing.returncode, missing.stdout) == (1, "")
    assert missing.stderr == "bifrost: /nowhere: no such folder of Bifrost keys\n"
    assert verb("topic", "shout").returncode == 2
    assert verb("service", "call", "lab/ask", "{").returncode == 2
    twice = verb("topic", "pub", "lab/ask", '{"count": 1, "count": 2}')
    assert twice.returncode == 2
    assert "a field is there twice" in twice.stderr


def test_without_a_daemon(bare_network: BifrostNetwork) -> None:
    with pytest.raises(bifrost.TimeoutError, match=r"bifrostd at tcp://.* does not answer"):
        run("topic", "list")
    with pytest.raises(bifrost.TimeoutError, match=r"bifrostd at tcp://.* does not answer"):
        run("topic", "echo", "lab/sample", "--timeout", "0.1")
