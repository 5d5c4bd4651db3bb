"""Marks of a service over a real Bifrost network, and the Chrome trace made of them."""

import gc
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import bifrost
from harness.bifrost_network import BifrostNetwork, until
from valor.common import trace as trace_module
from valor.common.trace import Stage, Trace, Tracer, topic
from valor.valorctl.instance.ros_domain import daemon_ports
from valor.valorctl.status.trace_verbs import chrome_events


@pytest.fixture
def network(tmp_path: Path, ros_domain: int) -> Iterator[bifrost.Network]:
    made = BifrostNetwork(tmp_path, daemon_ports(ros_domain))
    made.start_daemon()
    yield made.network
    made.close()


def turn(tracer: Tracer, sequence: int) -> None:
    time.sleep(0.001)
    tracer.mark(Stage.AWAIT)
    sum(range(400_000))  # many times what looking for messages costs, which counts as waiting here
    tracer.mark(Stage.SEND_MOTOR, sequence)
    tracer.cycle()


def test_marks_are_published_to_subscribers_alone(network: bifrost.Network, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace_module, "FLUSH_PERIOD", 0.02)
    with bifrost.Node("service", network=network) as node, bifrost.Node("listener", network=network) as listener:
        tracer = Tracer(node, "service")
        for sequence in range(20):
            turn(tracer, sequence)
        published = listener.discovery.watch("publisher", topic("service"))
        assert not published.peers
        marks = gc.callbacks.copy()
        subscriber = listener.subscriber(topic("service"), Trace, queue=1000)
        arrived: list[Trace] = []
        sequence = 20

        def more() -> bool:
            nonlocal sequence
            turn(tracer, sequence)
            sequence += 1
            gc.collect(0)
            arrived.extend(received.message for received in subscriber.drain())
            return len(arrived) >= 3

        until(more, "three messages")
        events = [event for event in chrome_events("service", 1, arrived) if event["ph"] == "X"]
        sent = [event["args"]["proprioceptor"] for event in events if event["name"] == "send motor"]
        assert sent == list(range(sent[0], sent[0] + len(sent)))  # none is missing
        assert sent[0] >= 20
        used = {
            name: sum(event["args"]["cpu_us"] for event in events if event["name"] == name)
            for name in ("await", "send motor")
        }
        assert used["await"] < used["send motor"]
        assert any(event["name"] == "collect" for event in events)
        assert all(event["dur"] >= 0.0 for event in events)
        subscriber.close()

        def off() -> bool:
            turn(tracer, 0)
            return gc.callbacks == marks

        until(off, "tracing ends with its subscriber")
        until(lambda: not published.peers, "its publisher is gone")


def test_the_chrome_trace_has_a_slice_per_stage_across_messages() -> None:
    def message(*rows: tuple[Stage, float, float, float]) -> Trace:
        stages, at, cpu, sequence = np.array(rows, dtype=float).T.copy()
        return Trace("motion_manager", stages.astype(np.uint8), at, cpu, sequence)

    traces = [
        message((Stage.AWAIT, 1.0, 0.5, 0.0), (Stage.CONTROL, 1.002, 0.501, 0.0), (Stage.COLLECT, 1.0025, 1.0021, 0.0)),
        message((Stage.SEND_MOTOR, 1.003, 0.5015, 7.0)),
    ]
    events = list(chrome_events("motion_manager", 2, traces))
    assert [event["args"]["name"] for event in events if event["ph"] == "M"] == [
        "motion_manager", "loop", "garbage collector",
    ]  # fmt: skip
    slices = [event for event in events if event["ph"] == "X"]
    assert [(event["name"], event["tid"], event["ts"], event["dur"]) for event in slices] == [
        ("control", 1, 1_000_000.0, 2_000.0),
        ("collect", 2, 1_002_100.0, 400.0),
        ("send motor", 1, 1_002_000.0, 1_000.0),
    ]
    assert slices[0]["args"] == {"cpu_us": 1000.0} and slices[2]["args"] == {"cpu_us": 500.0, "proprioceptor": 7}
    assert {event["pid"] for event in events} == {2}
