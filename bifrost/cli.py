"""Command line of a Bifrost network: ``topic list|info|echo|hz|pub`` and ``service list|call``.

``topic`` and ``service`` are Typer apps to mount in a larger command line; ``python -m bifrost.cli`` has both. They
join the network that ``BIFROST_NETWORK`` and ``BIFROST_KEYS`` name. Failures are a ``bifrost.Error`` of one line.
"""

import contextlib
import dataclasses
import difflib
import json
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any

import typer

from bifrost.errors import Error, TimeoutError
from bifrost.graph import End, Graph, ServiceInfo, TopicInfo
from bifrost.messages import Message
from bifrost.node import Node, check_name
from bifrost.reflection import from_json, lines, number, to_builtins, type_from_schema
from bifrost.subscriber import Received, Subscriber

DAEMON_TIMEOUT = 2.0  # [s]
_COMPLETION_TIMEOUT = 0.5  # of the daemon, at the Tab key [s]
_QUEUE = 10_000  # messages; more than a second of any topic

# Rich would interpret units in brackets as markup.
topic = typer.Typer(name="topic", help="Show and publish Bifrost topics.", no_args_is_help=True, rich_markup_mode=None)
service = typer.Typer(
    name="service", help="Show and call Bifrost services.", no_args_is_help=True, rich_markup_mode=None
)


@dataclasses.dataclass(frozen=True)
class Catalogue:
    """Descriptions of topics or services from a larger command line, which sets ``catalogue``.

    Attributes:
        columns: additional columns of ``list``: keys of an entry by heading.
        read: returns the entries by name; ``info`` shows them, ``--json`` has them as ``catalogue``.
        advice: end of the error about a name that does not exist, with ``{name}`` for the name.
    """

    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    read: Callable[[], Mapping[str, Mapping[str, Any]]] = dict
    advice: str = ""

    def cells(self, entry: Mapping[str, Any]) -> tuple[str, ...]:
        """Additional cells of a row of ``list``."""
        values = (entry.get(key) for key in self.columns.values())
        return tuple("" if value is None else number(value) for value in values)

    def json(self, entry: Mapping[str, Any] | None) -> dict[str, Any]:
        """Keys to add to a JSON object."""
        return {"catalogue": entry} if self.columns else {}


catalogue = Catalogue()


def _topics(incomplete: str) -> list[str]:
    return _completed(incomplete, lambda graph: graph.topics)


def _services(incomplete: str) -> list[str]:
    return _completed(incomplete, lambda graph: graph.services)


def _completed(incomplete: str, names: Callable[[Graph], Iterable[str]]) -> list[str]:
    """Names that a shell offers."""
    try:
        with _own_node() as node:
            return sorted(name for name in names(node.graph(_COMPLETION_TIMEOUT)) if name.startswith(incomplete))
    except Exception:  # a traceback would end up in the middle of a command line
        return []


def _name(name: str) -> str:
    """A valid name, without ROS' leading slash."""
    name = name.removeprefix("/")
    try:
        check_name("topic", name)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    return name


Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Timeout = Annotated[float, typer.Option(help="Time to wait for the first message [s].", min=0.0)]
TopicName = Annotated[
    str, typer.Argument(metavar="TOPIC", help="Name, as in `topic list`.", autocompletion=_topics, callback=_name)
]
ServiceName = Annotated[
    str, typer.Argument(metavar="SERVICE", help="Name, as in `service list`.", autocompletion=_services, callback=_name)
]


@topic.command("list")
def topic_list(as_json: Json = False) -> None:
    """List topics with type, publishers and number of subscribers."""
    graph = _graph()
    _print_all(graph, graph.topics, ("topic", "type", "published by", "subscribers"), as_json)


@topic.command("info")
def topic_info(name: TopicName, as_json: Json = False) -> None:
    """Show a topic's type and fields, publishers and subscribers."""
    graph = _graph()
    info, entry = graph.topics.get(name), catalogue.read().get(name)
    if info is None:
        raise Error(_missing(graph, "topic", name, "no publisher and no subscriber"))
    if as_json:
        _print_json(graph.as_json(info) | catalogue.json(entry))
        return
    print("\n".join([f"topic {name}", *lines({k: v for k, v in (entry or {}).items() if v is not None}, "  ")]))
    for digest in sorted({digest for end in (*info.publishers, *info.subscribers) for digest in end.hashes}):
        schema = graph.schemas[digest]
        for type_name in sorted(schema.types, key=lambda each: each != schema.name):
            print(f"type {type_name}" + (f" ({digest})" if type_name == schema.name else ""))
            for field, field_type in schema.types[type_name]:
                print(f"  {field}: {field_type}")
    for end in info.publishers:
        latched = ", latched" if end.latched else ""
        print(f"publisher {end.node} (pid {end.pid} on {end.computer}{latched}) at {end.endpoint}")
    for end in info.subscribers:
        print(f"subscriber {end.node} (pid {end.pid} on {end.computer})")


@topic.command("echo")
def topic_echo(
    name: TopicName,
    once: Annotated[bool, typer.Option("--once", help="Print the latest message only.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")] = False,
    timeout: Timeout = 5.0,
) -> None:
    """Print a topic's messages, of any type; numbers that are not finite are null in JSON."""
    with _own_node() as node, _until_interrupted():
        subscriber = node.subscribe_any(name, queue=None if once else _QUEUE)
        received: Received[Message] | None = _first(node, subscriber, timeout)
        while True:
            if received is not None:
                _print_message(received, as_json)
                if once:
                    return
            received = subscriber.receive(timeout=1.0)


@topic.command("hz")
def topic_hz(
    name: TopicName,
    duration: Annotated[
        float | None, typer.Option("--for", help="Measure once, for this time [s]; default: until Ctrl-C.", min=0.1)
    ] = None,
    as_json: Json = False,
    timeout: Timeout = 5.0,
) -> None:
    """Measure a topic's rate by the publisher's stamps, and the delay from stamp to receipt; once a second."""
    for messages, drops in _windows(name, duration, timeout):
        periods = [(b.stamp - a.stamp) / 1e9 for a, b in pairwise(messages)] or [0.0]
        mean = statistics.fmean(periods)
        result = {
            "rate": 1.0 / mean if mean else 0.0,
            "period_mean": mean,
            "period_min": min(periods),
            "period_max": max(periods),
            "period_stddev": statistics.pstdev(periods),
            "delay_median": statistics.median((each.arrived - each.stamp) / 1e9 for each in messages),
            "messages": len(messages),
            "drops": drops,
        }
        if as_json:
            _print_json({"topic": name} | result, one_line=True)
        else:
            print(
                f"{result['rate']:.2f} Hz; period mean {mean * 1e3:.3f} ms, min {result['period_min'] * 1e3:.3f}, "
                f"max {result['period_max'] * 1e3:.3f}, deviation {result['period_stddev'] * 1e3:.3f}; "
                f"delay median {result['delay_median'] * 1e6:.0f} µs; {len(messages)} messages, {drops} dropped",
                flush=True,
            )


@topic.command("pub")
def topic_pub(
    name: TopicName,
    message: Annotated[str, typer.Argument(help="The message's fields as a JSON object.")],
    *,
    rate: Annotated[float, typer.Option(help="Messages per second.", min=0.001, max=10_000.0)] = 1.0,
    count: Annotated[int, typer.Option(help="Number of messages; 0: until Ctrl-C.", min=0)] = 1,
    timeout: Annotated[float, typer.Option(help="Time to wait for a node that has the type [s].", min=0.0)] = 5.0,
) -> None:
    """Publish on a topic that has a publisher or subscriber, with its type, once all subscribers have connected."""

    def typed_end(graph: Graph) -> End | None:
        info = graph.topics.get(name)
        return next((end for end in (*info.publishers, *info.subscribers) if end.hashes), None) if info else None

    sent = 0
    with _own_node() as node, _until_interrupted():
        graph, end = _found(node, "topic", name, timeout, typed_end)
        message_type = type_from_schema(graph.schemas[end.hashes[0]])
        content = from_json(message_type, message)
        publisher = node.publisher(name, message_type, latched=True)  # it counts its subscribers
        deadline = time.monotonic() + timeout
        expected = len(graph.topics[name].subscribers)
        while publisher.subscribers < expected and time.monotonic() < deadline:
            time.sleep(0.01)
        due = time.monotonic()
        while not count or sent < count:
            time.sleep(max(0.0, due - time.monotonic()))
            due += 1.0 / rate
            sent = publisher.publish(content)
    print(f"published {sent} {end.types[0]}")


@service.command("list")
def service_list(as_json: Json = False) -> None:
    """List services with types, servers and number of clients."""
    graph = _graph()
    _print_all(graph, graph.services, ("service", "type", "served by", "clients"), as_json)


@service.command("call")
def service_call(
    name: ServiceName,
    request: Annotated[str, typer.Argument(help="The request's fields as a JSON object.")] = "{}",
    as_json: Json = False,
    timeout: Annotated[float, typer.Option(help="Time to wait for a server and its reply [s].", min=0.0)] = 5.0,
) -> None:
    """Send a request and print the reply."""

    def last_server(graph: Graph) -> End | None:
        info = graph.services.get(name)
        return info.servers[-1] if info and info.servers else None

    with _own_node() as node:
        graph, server = _found(node, "service", name, timeout, last_server)
        types = [type_from_schema(graph.schemas[digest]) for digest in server.hashes]
        reply = to_builtins(node.client(name, *types).call(from_json(types[0], request), timeout))
    if as_json:
        _print_json(reply)
    else:
        print("\n".join(lines(reply)))


def _own_node() -> Node:
    return Node(f"cli_{os.getpid()}")


def _graph() -> Graph:
    with _own_node() as node:
        return node.graph(DAEMON_TIMEOUT)


@contextlib.contextmanager
def _until_interrupted() -> Iterator[None]:
    """End without error at Ctrl-C, or when the reader of a pipe ends."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:  # a larger command line may have a handler
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:
        sys.stdout = None  # or Python would flush it again at exit
    finally:
        signal.signal(signal.SIGINT, before)


def _missing(graph: Graph, kind: str, name: str, reason: str) -> str:
    """Text of the error about a topic or service: ``reason`` if it is known, else similar names."""
    topics = [info.name for info in graph.topics.values() if info.publishers]  # this process may subscribe
    names = {*(topics if kind == "topic" else graph.services), *catalogue.read()}
    if name in names:
        return f"{kind} {name}: {reason}"
    near = sorted(each for each in names if name in each) or difflib.get_close_matches(name, names)
    similar = f"; similar: {', '.join(near[:3])}" if near else ""
    return f"no {kind} {name}{similar}; `{kind} list` shows all{catalogue.advice.format(name=name)}"


def _found(node: Node, kind: str, name: str, timeout: float, find: Callable[[Graph], End | None]) -> tuple[Graph, End]:
    """The graph with an end that is found in it; raises ``TimeoutError``."""
    deadline = time.monotonic() + timeout
    while True:
        graph = node.graph(DAEMON_TIMEOUT)
        if end := find(graph):
            return graph, end
        if time.monotonic() > deadline:
            what = "node with its type" if kind == "topic" else "server"
            raise TimeoutError(_missing(graph, kind, name, f"no {what} within {timeout:g} s"))
        time.sleep(0.02)


def _first(node: Node, subscriber: Subscriber[Message], timeout: float) -> Received[Message]:
    """The first message. Raises TimeoutError with the cause: no daemon, no publisher, or no publication."""
    received = subscriber.receive(timeout=timeout)
    if received is not None:
        return received
    if not node.discovery.connected:
        raise TimeoutError(f"topic {subscriber.topic}: {node.discovery.daemon_silent}")
    if not subscriber.publishers:
        reason = f"no publisher within {timeout:g} s"
        raise TimeoutError(_missing(node.graph(DAEMON_TIMEOUT), "topic", subscriber.topic, reason))
    names = ", ".join(subscriber.publishers)
    raise TimeoutError(f"topic {subscriber.topic}: {names} published nothing within {timeout:g} s")


def _windows(name: str, duration: float | None, timeout: float) -> Iterator[tuple[list[Received[Message]], int]]:
    """Messages and number of drops of each second, or of ``duration`` [s] once."""
    with _own_node() as node, _until_interrupted():
        subscriber = node.subscribe_any(name, queue=_QUEUE)
        _first(node, subscriber, timeout)
        while True:
            drops = subscriber.drops
            messages: list[Received[Message]] = []
            deadline = time.monotonic() + (duration or 1.0)
            while (remaining := deadline - time.monotonic()) > 0.0:
                if (received := subscriber.receive(timeout=remaining)) is not None:
                    messages.append(received)
            if messages:
                yield messages, subscriber.drops - drops
            elif duration is not None:
                raise TimeoutError(f"topic {name}: nothing published within {duration:g} s")
            if duration is not None:
                return


def _print_all(
    graph: Graph, infos: Mapping[str, TopicInfo | ServiceInfo], header: tuple[str, ...], as_json: bool
) -> None:
    """Print all topics or all services."""
    entries = catalogue.read()
    if as_json:
        _print_json([graph.as_json(info) | catalogue.json(entries.get(name)) for name, info in infos.items()])
        return
    rows = [(*header, *catalogue.columns)]
    for name, info in infos.items():
        sources, users = info.ends.values()
        nodes = ", ".join(end.node for end in sources) or "-"
        cells = catalogue.cells(entries.get(name, {}))
        rows.append((name, " ≠ ".join(info.types) or "?", nodes, str(len(users)), *cells))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _print_json(content: Any, one_line: bool = False) -> None:
    """Print JSON; on one line as an element of a stream."""
    print(json.dumps(content, indent=None if one_line else 2, allow_nan=False), flush=True)


def _print_message(received: Received[Message], as_json: bool) -> None:
    fields, name = to_builtins(received.message), type(received.message).__name__
    if as_json:
        envelope = {"type": name, "origin": received.origin, "sequence": received.sequence, "stamp": received.stamp}
        _print_json(envelope | {"message": fields}, one_line=True)
        return
    print(f"--- {name} {received.sequence} of {received.origin}, stamp {received.stamp / 1e9:.6f}")
    print("\n".join(lines(fields)), flush=True)


app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(topic)
app.add_typer(service)


def main() -> int:
    """Run the verbs as a program. Exit status: 0 success, 1 with one line on stderr, 2 wrong usage."""
    try:
        app(prog_name="bifrost")
    except Error as error:
        print(f"bifrost: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
