"""A live system that a benchmark starts, drives and stops."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import PushRequest
from valor.common.topics import PUSH

VALORCTL = Path(sys.executable).with_name("valorctl")
SETTLING = 3.0  # from the servos' posture to the controller's, after `up` [robot time, s]


def valorctl(instance: Instance, *arguments: str) -> str:
    """One verb for an instance; returns what it says.

    Raises:
        ValorError: it failed.
    """
    environment = os.environ | {"VALOR_HOME": str(instance.folder.parent), "VALOR_INSTANCE": instance.name}
    command = [str(VALORCTL), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValorError(f"valorctl {' '.join(arguments)}: {(done.stderr or done.stdout).strip()}")
    return done.stdout.strip()


@contextmanager
def started(instance: Instance, *options: str) -> Iterator[bifrost.Node]:
    """A system of ``valorctl up`` with options, and a node in its network; taken down behind.

    Raises:
        ValorError: it does not start.
    """
    valorctl(instance, "up", *options)
    try:
        with bifrost.Node("benchmark", network=bifrost.Network.load(instance.network_file, instance.keys)) as node:
            yield node
    finally:
        valorctl(instance, "down")


def push(node: bifrost.Node, impulse: tuple[float, float, float]) -> None:
    """Push the chest for 0.1 s [N·s].

    Raises:
        ValorError: it is refused.
    """
    client = PUSH.client(node)
    reply = client.call(PushRequest(impulse_in_world=np.array(impulse), duration=0.1), timeout=10.0)
    if not reply.accepted:
        raise ValorError(f"push refused: {reply.reason}")
