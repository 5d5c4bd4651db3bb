"""What the verbs have in common: a node, the end by Ctrl-C, messages as a person writes them, and as one reads them."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any

import typer

from bifrost.directory import Count
from bifrost.graph import End, Graph
from bifrost.node import Node

DAEMON_TIMEOUT = 2.0  # [s]

Json = Annotated[bool, typer.Option("--json", help="As JSON.")]


@dataclasses.dataclass(frozen=True)
class Catalogue:
    """What a larger command line knows of topics or services besides; the verbs find it as Click's context object.

    Attributes:
        columns: what ``list`` shows of an entry: keys by their headings.
        read: what is known of each by its name, as JSON; ``info`` shows it, ``--json`` has it as ``catalogue``.
    """

    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    read: Callable[[], Mapping[str, Mapping[str, Any]]] = dict

    @functools.cached_property
    def entries(self) -> Mapping[str, Mapping[str, Any]]:
        """Read when they are needed."""
        return self.read()

    @classmethod
    def of(cls, context: typer.Context) -> Catalogue:
        """The one that a command was mounted with, else an empty one."""
        return context.find_object(cls) or cls()

    def cells(self, name: str) -> tuple[str, ...]:
        """Of a line of ``list``."""
        values = (self.entries.get(name, {}).get(key) for key in self.columns.values())
        return tuple("" if value is None else _number(value) for value in values)

    def json(self, name: str) -> dict[str, Any]:
        """To add to an object."""
        return {"catalogue": self.entries.get(name)} if self.columns else {}

    def lines(self, name: str) -> Iterator[str]:
        """Of ``info``."""
        yield from lines({key: value for key, value in self.entries.get(name, {}).items() if value is not None}, "  ")


@contextlib.contextmanager
def own_node() -> Iterator[Node]:
    with Node(f"cli_{os.getpid()}") as node:
        yield node


@contextlib.contextmanager
def until_interrupted() -> Iterator[None]:
    """Ctrl-C, or a reader that has seen enough, is how a person ends these."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:  # a larger command line may have its own
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:
        sys.stdout = None  # nobody reads: do not try again at exit
    finally:
        signal.signal(signal.SIGINT, before)


def message_fields(text: str, parameter: str) -> Any:
    """JSON of a message; an object that says a field twice is refused."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        fields = dict(pairs)
        if len(fields) != len(pairs):
            raise ValueError("a field is there twice")
        return fields

    try:
        return json.loads(text, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise typer.BadParameter(f"expected a JSON object: {error}", param_hint=parameter) from None


def end_json(end: End, count: Count | None = None) -> dict[str, Any]:
    described: dict[str, Any] = {
        "node": end.node,
        "pid": end.pid,
        "computer": end.computer,
        "types": list(end.types),
        "hashes": list(end.hashes),
        "endpoint": end.endpoint or None,
        "latched": end.latched,
    }
    if count is not None:
        described |= {"messages": count.messages, "drops": count.drops, "rejected": count.rejected}
    return described


def schemas_json(graph: Graph, ends: Sequence[End]) -> dict[str, Any]:
    """The schemas of topics' or services' ends, by hash."""
    digests = sorted({digest for end in ends for digest in end.hashes})
    return {digest: {"name": graph.schemas[digest].name, "types": graph.schemas[digest].types} for digest in digests}


def print_json(content: Any, one_line: bool = False) -> None:
    print(json.dumps(content, indent=None if one_line else 2, allow_nan=False), flush=True)


def lines(value: Any, indent: str = "") -> Iterator[str]:
    """A message as YAML-like lines: flat lists in one line, six digits a number."""
    for name, field in value.items():
        if isinstance(field, dict):
            yield f"{indent}{name}:"
            yield from lines(field, indent + "  ")
        elif isinstance(field, list) and any(isinstance(element, dict) for element in field):
            yield f"{indent}{name}:"
            for index, element in enumerate(field):
                yield f"{indent}  [{index}]"
                yield from lines(element, indent + "    ")
        elif isinstance(field, list):
            yield f"{indent}{name}: [{', '.join(_number(element) for element in field)}]"
        else:
            yield f"{indent}{name}: {_number(field)}"


def _number(value: Any) -> str:
    if value is None:
        return "nan"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def print_table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    for row in (header, *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
