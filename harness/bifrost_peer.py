"""A process for the Bifrost tests: ``publish|latch|subscribe|stall|serve TOPIC [argument]``."""

from __future__ import annotations

import json
import sys
import time

import bifrost
from harness.bifrost_network import Answer, Question, Sample, sample


def say(content: object) -> None:
    """A line of JSON."""
    print(json.dumps(content), flush=True)


def publish(node: bifrost.Node, topic: str, rate: float, latched: bool) -> None:
    """Publish samples at a rate, for ever."""
    publisher = node.publisher(topic, Sample, latched)
    say("ready")
    count = 0
    due = time.monotonic()
    while True:
        count += 1
        publisher.publish(sample(count))
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))


def subscribe(node: bifrost.Node, topic: str, queue: int) -> None:
    """Print what comes, for ever."""
    subscriber = node.subscriber(topic, Sample, queue=queue)
    say("ready")
    while True:
        received = subscriber.receive()
        assert received is not None
        say({"count": received.message.count, "sequence": received.sequence, "drops": subscriber.drops})


def stall(node: bifrost.Node, topic: str, seconds: float) -> None:
    """Ten short queues: all hear somebody, say so, are not read for a while, and so on."""
    subscribers = [node.subscriber(topic, Sample, queue=10) for _ in range(10)]
    say("ready")
    while True:
        now = time.monotonic_ns()
        for subscriber in subscribers:
            while (received := subscriber.receive()) is None or received.stamp < now:
                pass
        say("all have heard")
        time.sleep(seconds)


def serve(node: bifrost.Node, topic: str) -> None:
    """Do as told, for ever."""
    handled = 0

    def handle(question: Question, origin: str) -> Answer:
        nonlocal handled
        if question.action == "count":
            return Answer("count", handled)
        handled += 1
        if question.action == "raise":
            raise ValueError("no such valve")
        if question.action == "sleep":
            say("asleep")
            time.sleep(question.argument)
        return Answer(f"{question.action} for {origin}", handled)

    server = node.server(topic, Question, Answer, handle)
    say("ready")
    while True:
        bifrost.wait([server])
        server.serve()


if __name__ == "__main__":
    role, topic = sys.argv[1:3]
    with bifrost.Node(f"{role}_peer") as own_node:
        if role in ("publish", "latch"):
            publish(own_node, topic, float(sys.argv[3]), role == "latch")
        elif role == "subscribe":
            subscribe(own_node, topic, int(sys.argv[3]))
        elif role == "stall":
            stall(own_node, topic, float(sys.argv[3]))
        else:
            serve(own_node, topic)
