"""``topic`` and ``service``: Bifrost's own verbs, in the instance's network."""

from __future__ import annotations

import os
from typing import Any

import typer

from bifrost import cli
from valor.common.instance import Instance

_GROUPS = {"topic": cli.topic, "service": cli.service}


def command(name: str, instance_name: str | None) -> Any:
    """The group of verbs, set upon the network of the instance named (else of the environment's)."""
    instance = Instance.from_environment(instance_name)
    os.environ |= {"BIFROST_NETWORK": str(instance.network_file), "BIFROST_KEYS": str(instance.keys)}
    return typer.main.get_group(_GROUPS[name])
