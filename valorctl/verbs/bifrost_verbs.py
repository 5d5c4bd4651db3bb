"""``topic`` and ``service``: Bifrost's own verbs, in the instance's network."""

from __future__ import annotations

import os
from typing import Any

import typer

from bifrost import cli
from valor_common.instance import Instance

_GROUPS = {"topic": cli.topic, "service": cli.service}


def command(name: str) -> Any:
    """The group of verbs, set upon the instance's network."""
    instance = Instance.from_environment()
    os.environ |= {"BIFROST_NETWORK": str(instance.network_file), "BIFROST_KEYS": str(instance.keys)}
    return typer.main.get_group(_GROUPS[name])
