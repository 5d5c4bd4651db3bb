"""What a shell completes the names of topics and services to: what there is now, and nothing where nobody can tell."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable

from bifrost.graph import Graph
from bifrost.node import Node

TIMEOUT = 0.5  # of the daemon; nobody waits longer for the Tab key [s]


def topics(incomplete: str) -> list[str]:
    """Those that somebody publishes or subscribes to."""
    return _known(incomplete, lambda graph: (t.name for t in graph.topics.values() if t.publishers or t.subscribers))


def services(incomplete: str) -> list[str]:
    """Those that somebody serves."""
    return _known(incomplete, lambda graph: (service.name for service in graph.services.values() if service.servers))


def _known(incomplete: str, names: Callable[[Graph], Iterable[str]]) -> list[str]:
    try:
        with Node(f"completion_{os.getpid()}") as node:
            return sorted(name for name in names(node.graph(TIMEOUT)) if name.startswith(incomplete))
    except Exception:  # a traceback in the middle of somebody's command line helps nobody
        return []
