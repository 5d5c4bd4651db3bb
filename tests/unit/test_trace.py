"""A service's marks over a real Bifrost network: off until somebody listens, on while somebody does."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import bifrost
from harness.bifrost_network import BifrostNetwork, until
from valor.analysis.lanes import Lane
from valor.common import trace as trace_module
from valor.common.trace import Stage, Trace, Tracer, topic
from valor.valorctl.ros_domain import daemon_ports


@pytest.fixture
def network(tmp_path: Path, ros_domain: int) -> Iterator[bifrost.Network]:
    made = BifrostNetwork(tmp_path, daemon_ports(ros_domain))
    made.start_daemon()
    yield made.network
    made.close()


def turn(tracer: Tracer, sequence: int) -> None:
    """Once around a loop."""
    time.sleep(0.001)
    tracer.mark(Stage.AWAIT)
    sum(range(400_000))  # many times what looking for messages costs, which counts as waiting here
    tracer.mark(Stage.SEND_MOTOR, sequence)
    tracer.cycle()


def test_marks_come_while_somebody_listens_and_only_then(
    network: bifrost.Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trace_module, "FLUSH_PERIOD", 0.02)
    with bifrost.Node("service", network=network) as node, bifrost.Node("listener", network=network) as listener:
        tracer = Tracer(node, "service")
        for sequence in range(20):
            turn(tracer, sequence)
        published = listener.discovery.watch("publisher", topic("service"))
        assert not published.peers
        marks = gc.callbacks.copy()
        subscriber = listener.subscriber(topic("service"), Trace, queue=1000)
        heard: list[Trace] = []
        sequence = 20

        def goes_on() -> bool:
            nonlocal sequence
            turn(tracer, sequence)
            sequence += 1
            gc.collect(0)
            heard.extend(received.message for received in subscriber.drain())
            return len(heard) >= 3

        until(goes_on, "three messages")
        lane = Lane.of("service", heard)
        sent = lane.sequence[lane.stages == Stage.SEND_MOTOR]
        assert list(sent) == list(range(int(sent[0]), int(sent[0]) + len(sent)))  # none is missing
        assert sent[0] >= 20
        assert (lane.end >= lane.start).all()
        slept, worked = lane.stages == Stage.AWAIT, lane.stages == Stage.SEND_MOTOR
        assert lane.cpu[slept].sum() < lane.cpu[worked].sum()
        assert lane.collected.size
        assert (lane.collected[:, 1] >= lane.collected[:, 0]).all()
        assert (lane.waited[1:] >= lane.waited[:-1]).all()
        assert lane.cost > 0.0
        subscriber.close()

        def silent() -> bool:
            turn(tracer, 0)
            return gc.callbacks == marks

        until(silent, "tracing ends with its listener")
        until(lambda: not published.peers, "its publisher is gone")
