"""The verbs ``topic list|info|echo|hz|bw|delay|pub``."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Any

import typer

from bifrost.cli import completion
from bifrost.cli.terminal import (
    DAEMON_TIMEOUT,
    Catalogue,
    Json,
    end_json,
    lines,
    message_fields,
    own_node,
    print_json,
    print_table,
    schemas_json,
    until_interrupted,
)
from bifrost.directory import Count
from bifrost.errors import Error, TimeoutError
from bifrost.graph import End, Graph, TopicInfo
from bifrost.health import counts
from bifrost.messages import Message
from bifrost.node import Node
from bifrost.plain import from_builtins, to_builtins
from bifrost.reflection import type_from_schema
from bifrost.subscriber import Received, Subscriber

_QUEUE = 10_000  # messages; more than a second of anything

# Markup would take the units in brackets for its own.
topic = typer.Typer(name="topic", help="See what is published on Bifrost.", no_args_is_help=True, rich_markup_mode=None)

Timeout = Annotated[float, typer.Option(help="How long to wait for the first message [s].", min=0.0)]
Duration = Annotated[
    float | None, typer.Option("--for", help="Measure this long [s]; else until interrupted.", min=0.1)
]
TopicName = Annotated[
    str,
    typer.Argument(metavar="TOPIC", help="Its name, as `topic list` shows it.", autocompletion=completion.topics),
]


@topic.command("list")
def topic_list(context: typer.Context, as_json: Json = False) -> None:
    """List every topic, its type, publishers and number of subscribers."""
    catalogue = Catalogue.of(context)
    with own_node() as node:
        graph = node.graph(DAEMON_TIMEOUT)
    topics = [info for info in graph.topics.values() if info.publishers or info.subscribers]
    if as_json:
        print_json([_topic_json(graph, info, {}) | catalogue.json(info.name) for info in topics])
        return
    rows = [
        (
            info.name,
            " ≠ ".join(info.types) or "?",
            ", ".join(end.node for end in info.publishers) or "-",
            str(len(info.subscribers)),
            *catalogue.cells(info.name),
        )
        for info in topics
    ]
    print_table(("topic", "type", "published by", "subscribers", *catalogue.columns), rows)


@topic.command("info")
def topic_info(context: typer.Context, name: TopicName, as_json: Json = False) -> None:
    """Show a topic's type with its fields, who is at either end, and what has passed, been dropped and refused there.

    The counts are those that each node told last, a second ago at most.
    """
    catalogue = Catalogue.of(context)
    with own_node() as node:
        graph = node.graph(DAEMON_TIMEOUT)
        told = counts(node.network, name, DAEMON_TIMEOUT)
    info = graph.topics.get(name)
    if info is None:
        raise Error(f"topic {name}: nobody publishes or subscribes to it")
    if as_json:
        print_json(_topic_json(graph, info, told) | catalogue.json(name))
        return
    hashes = sorted({digest for end in (*info.publishers, *info.subscribers) for digest in end.hashes})
    print("\n".join([f"topic {name}", *catalogue.lines(name)]))
    for digest in hashes:
        schema = graph.schemas[digest]
        for type_name in sorted(schema.types, key=lambda each: each != schema.name):
            print(f"type {type_name}" + (f" ({digest})" if type_name == schema.name else ""))
            for field, field_type in schema.types[type_name]:
                print(f"  {field}: {field_type}")
    for end, count in _with_counts("publisher", info.publishers, told):
        latched = ", latched" if end.latched else ""
        passed = f": {count.messages} messages" if count else ""
        print(f"publisher {end.node} (pid {end.pid} on {end.computer}{latched}) at {end.endpoint}{passed}")
    for end, count in _with_counts("subscriber", info.subscribers, told):
        passed = f": {count.messages} messages, {count.drops} dropped, {count.rejected} refused" if count else ""
        print(f"subscriber {end.node} (pid {end.pid} on {end.computer}){passed}")


@topic.command("echo")
def topic_echo(
    name: TopicName,
    once: Annotated[bool, typer.Option("--once", help="One message, the newest, then end.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    timeout: Timeout = 5.0,
) -> None:
    """Print a topic's messages, whatever their type; numbers that are not finite are null in JSON."""
    with own_node() as node, until_interrupted():
        subscriber = node.subscribe_any(name, queue=None if once else _QUEUE)
        received: Received[Message] | None = _first(node, subscriber, timeout)
        while True:
            if received is not None:
                _print_message(received, as_json)
                if once:
                    return
            received = subscriber.receive(timeout=1.0)


@topic.command("hz")
def topic_hz(name: TopicName, duration: Duration = None, as_json: Json = False, timeout: Timeout = 5.0) -> None:
    """Measure how often a topic is published, by the publisher's own stamps; every second, or once with --for."""
    for arrivals, _, drops in _windows(name, duration, timeout):
        messages = [received for received, _ in arrivals]
        periods = [(b.stamp - a.stamp) / 1e9 for a, b in pairwise(messages)]
        if not periods:
            periods = [0.0]
        mean = statistics.fmean(periods)
        result = {
            "rate": 1.0 / mean if mean else 0.0,
            "period_mean": mean,
            "period_min": min(periods),
            "period_max": max(periods),
            "period_stddev": statistics.pstdev(periods),
            "messages": len(messages),
            "drops": drops,
        }
        if as_json:
            print_json({"topic": name} | result, one_line=True)
        else:
            print(
                f"{result['rate']:.2f} Hz; period mean {mean * 1e3:.3f} ms, min {min(periods) * 1e3:.3f}, "
                f"max {max(periods) * 1e3:.3f}, deviation {result['period_stddev'] * 1e3:.3f}; "
                f"{len(messages)} messages, {drops} dropped",
                flush=True,
            )


@topic.command("bw")
def topic_bw(name: TopicName, duration: Duration = None, as_json: Json = False, timeout: Timeout = 5.0) -> None:
    """Measure how many bytes a topic takes; every second, or once with --for."""
    for arrivals, size, drops in _windows(name, duration, timeout):
        messages = [received for received, _ in arrivals]
        span = max(1e-9, (messages[-1].stamp - messages[0].stamp) / 1e9) if len(messages) > 1 else 1.0
        mean = size / max(1, len(messages))
        rate = mean * (len(messages) - 1) / span if len(messages) > 1 else float(size)
        if as_json:
            result = {"topic": name, "bytes_per_second": rate, "bytes_mean": mean}
            print_json(result | {"messages": len(messages), "drops": drops}, one_line=True)
        else:
            print(f"{_bytes(rate)}/s; {_bytes(mean)} a message, {len(messages)} messages", flush=True)


@topic.command("delay")
def topic_delay(name: TopicName, duration: Duration = None, as_json: Json = False, timeout: Timeout = 5.0) -> None:
    """Measure how long messages take from their stamp to here; every second, or once with --for.

    Stamps are of the publisher's computer: the topic must be published on this one.
    """
    for arrivals, _, drops in _windows(name, duration, timeout, one_clock=True):
        delays = sorted((at - received.stamp) / 1e9 for received, at in arrivals)
        result = {
            "delay_mean": statistics.fmean(delays),
            "delay_median": statistics.median(delays),
            "delay_p99": delays[min(len(delays) - 1, int(0.99 * len(delays)))],
            "delay_min": delays[0],
            "delay_max": delays[-1],
            "delay_stddev": statistics.pstdev(delays),
            "messages": len(delays),
            "drops": drops,
        }
        if as_json:
            print_json({"topic": name} | result, one_line=True)
        else:
            print(
                f"delay mean {result['delay_mean'] * 1e6:.0f} µs, median {result['delay_median'] * 1e6:.0f}, "
                f"99 % {result['delay_p99'] * 1e6:.0f}, min {delays[0] * 1e6:.0f}, max {delays[-1] * 1e6:.0f}, "
                f"deviation {result['delay_stddev'] * 1e6:.0f}; {len(delays)} messages, {drops} dropped",
                flush=True,
            )


@topic.command("pub")
def topic_pub(
    name: TopicName,
    message: Annotated[str, typer.Argument(help="The message's fields as a JSON object.")],
    *,
    rate: Annotated[float, typer.Option(help="Messages a second.", min=0.001, max=10_000.0)] = 1.0,
    count: Annotated[int, typer.Option(help="Messages in all; 0: until interrupted.", min=0)] = 1,
    latched: Annotated[bool, typer.Option("--latched", help="Who comes later gets the last message.")] = False,
    as_json: Json = False,
    timeout: Annotated[float, typer.Option(help="For somebody from whom to learn the type [s].", min=0.0)] = 5.0,
) -> None:
    """Publish on a topic that somebody publishes or subscribes to: the type is learned from them.

    Begins when all that subscribe have connected. With --latched it goes on until interrupted.
    """
    fields = message_fields(message, "MESSAGE")
    sent = 0
    with own_node() as node, until_interrupted():
        graph, end = _typed_end(node, name, timeout)
        message_type = type_from_schema(graph.schemas[end.hashes[0]])
        content = from_builtins(message_type, fields)
        publisher = node.publisher(name, message_type, latched=True)
        # One message to a connection that is yet to be made would be heard by nobody.
        deadline = time.monotonic() + timeout
        expected = len(graph.topics[name].subscribers)
        while publisher.subscribers < expected and time.monotonic() < deadline:
            time.sleep(0.01)
        due = time.monotonic()
        while not count or sent < count:
            time.sleep(max(0.0, due - time.monotonic()))
            due += 1.0 / rate
            sent = publisher.publish(content)
        while latched:
            time.sleep(1.0)
    if as_json:
        print_json({"topic": name, "type": end.types[0], "messages": sent})
    else:
        print(f"published {sent} {end.types[0]}")


def _typed_end(node: Node, name: str, timeout: float) -> tuple[Graph, End]:
    """Somebody who publishes or subscribes to a topic and knows its type; waited for."""
    deadline = time.monotonic() + timeout
    while True:
        graph = node.graph(DAEMON_TIMEOUT)
        if info := graph.topics.get(name):
            for end in (*info.publishers, *info.subscribers):
                if end.hashes:
                    return graph, end
        if time.monotonic() > deadline:
            raise TimeoutError(f"topic {name}: nobody who knows its type within {timeout:g} s")
        time.sleep(0.02)


def _first(node: Node, subscriber: Subscriber[Message], timeout: float) -> Received[Message]:
    """The first message.

    Raises:
        TimeoutError: none came; says whether there is a publisher, and a daemon.
    """
    received = subscriber.receive(timeout=timeout)
    if received is not None:
        return received
    if not node.discovery.connected:
        raise TimeoutError(f"topic {subscriber.topic}: {node.discovery.daemon_silent}")
    if not subscriber.publishers:
        raise TimeoutError(f"topic {subscriber.topic}: no publisher within {timeout:g} s")
    names = ", ".join(subscriber.publishers)
    raise TimeoutError(f"topic {subscriber.topic}: {names} published nothing within {timeout:g} s")


def _windows(
    name: str, duration: float | None, timeout: float, one_clock: bool = False
) -> Iterator[tuple[list[tuple[Received[Message], int]], int, int]]:
    """The messages of every second, or of ``duration`` once, each with when it came [ns]; their size [B]; the drops.

    Raises:
        Error: ``one_clock`` is asked for, and the topic is published on another computer.
    """
    with own_node() as node, until_interrupted():
        subscriber = node.subscribe_any(name, queue=_QUEUE)
        _first(node, subscriber, timeout)
        if one_clock:
            publishers = node.graph(DAEMON_TIMEOUT).topics[name].publishers
            here = node.network.computer.name
            for end in publishers:
                if end.computer != here and not node.discovery.clock(end.computer).known:
                    raise Error(f"topic {name}: {end.node} stamps by the clock of {end.computer}, which is not known")
        while True:
            size, drops = subscriber.bytes_received, subscriber.drops
            arrivals: list[tuple[Received[Message], int]] = []
            deadline = time.monotonic() + (duration or 1.0)
            while (remaining := deadline - time.monotonic()) > 0.0:
                received = subscriber.receive(timeout=remaining)
                if received is not None:
                    arrivals.append((received, time.monotonic_ns()))
            if not arrivals and duration is not None:
                raise TimeoutError(f"topic {name}: nothing published within {duration:g} s")
            if arrivals:
                yield arrivals, subscriber.bytes_received - size, subscriber.drops - drops
            if duration is not None:
                return


def _with_counts(kind: str, ends: Sequence[End], told: dict[int, list[Count]]) -> Iterator[tuple[End, Count | None]]:
    """Ends with their counts: those of a node are in the order in which it made them."""
    rest = {node: iter([count for count in counts if count.kind == kind]) for node, counts in told.items()}
    for end in ends:
        yield end, next(rest.get(end.incarnation, iter(())), None)


def _topic_json(graph: Graph, info: TopicInfo, told: dict[int, list[Count]]) -> dict[str, Any]:
    ends = (*info.publishers, *info.subscribers)
    return {
        "name": info.name,
        "types": info.types,
        "schemas": schemas_json(graph, ends),
        "publishers": [end_json(*pair) for pair in _with_counts("publisher", info.publishers, told)],
        "subscribers": [end_json(*pair) for pair in _with_counts("subscriber", info.subscribers, told)],
    }


def _print_message(received: Received[Message], as_json: bool) -> None:
    fields = to_builtins(received.message)
    if as_json:
        envelope = {
            "type": type(received.message).__name__,
            "origin": received.origin,
            "sequence": received.sequence,
            "stamp": received.stamp,
        }
        print_json(envelope | {"message": fields}, one_line=True)
        return
    print(
        f"--- {type(received.message).__name__} {received.sequence} of {received.origin}, "
        f"stamp {received.stamp / 1e9:.6f}"
    )
    print("\n".join(lines(fields)), flush=True)


def _bytes(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.1f} {unit}"
        count /= 1000.0
    return f"{count:.1f} GB"
