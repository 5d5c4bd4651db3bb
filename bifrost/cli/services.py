"""The verbs ``service list|call``."""

from __future__ import annotations

import time
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
)
from bifrost.errors import NoServerError
from bifrost.graph import End, Graph, ServiceInfo
from bifrost.node import Node
from bifrost.plain import from_builtins, to_builtins
from bifrost.reflection import type_from_schema

service = typer.Typer(
    name="service", help="See and call what is served on Bifrost.", no_args_is_help=True, rich_markup_mode=None
)

ServiceName = Annotated[
    str,
    typer.Argument(metavar="SERVICE", help="Its name, as `service list` shows it.", autocompletion=completion.services),
]


@service.command("list")
def service_list(context: typer.Context, as_json: Json = False) -> None:
    """List every service, its types, and who serves it."""
    catalogue = Catalogue.of(context)
    with own_node() as node:
        graph = node.graph(DAEMON_TIMEOUT)
    if as_json:
        print_json([_service_json(graph, info) | catalogue.json(info.name) for info in graph.services.values()])
        return
    rows = []
    for info in graph.services.values():
        types = sorted({" -> ".join(end.types) for end in (*info.servers, *info.clients)})
        servers = ", ".join(end.node for end in info.servers) or "-"
        rows.append((info.name, " ≠ ".join(types), servers, str(len(info.clients)), *catalogue.cells(info.name)))
    print_table(("service", "type", "served by", "clients", *catalogue.columns), rows)


@service.command("call")
def service_call(
    name: ServiceName,
    request: Annotated[str, typer.Argument(help="The request's fields as a JSON object.")] = "{}",
    as_json: Json = False,
    timeout: Annotated[float, typer.Option(help="For a server and its reply [s].", min=0.0)] = 5.0,
) -> None:
    """Send a request and print the reply."""
    fields = message_fields(request, "REQUEST")
    with own_node() as node:
        graph, server = _server(node, name, timeout)
        types = [type_from_schema(graph.schemas[digest]) for digest in server.hashes]
        client = node.client(name, *types)
        reply = client.call(from_builtins(types[0], fields), timeout)
    if as_json:
        print_json(to_builtins(reply))
    else:
        print("\n".join(lines(to_builtins(reply))))


def _server(node: Node, name: str, timeout: float) -> tuple[Graph, End]:
    """The newest server of a service, waited for."""
    deadline = time.monotonic() + timeout
    while True:
        graph = node.graph(DAEMON_TIMEOUT)
        info = graph.services.get(name)
        if info and info.servers:
            return graph, info.servers[-1]
        if time.monotonic() > deadline:
            raise NoServerError(f"service {name}: no server within {timeout:g} s")
        time.sleep(0.02)


def _service_json(graph: Graph, info: ServiceInfo) -> dict[str, Any]:
    ends = (*info.servers, *info.clients)
    return {
        "name": info.name,
        "schemas": schemas_json(graph, ends),
        "servers": [end_json(end) for end in info.servers],
        "clients": [end_json(end) for end in info.clients],
    }
