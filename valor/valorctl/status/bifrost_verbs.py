"""``topic`` and ``service``: Bifrost's verbs in the instance's network, with descriptions from ``topics.py``."""

import os
from typing import Any

import typer

from bifrost import cli
from valor.common.instance import Instance, Settings
from valor.common.topics import CONTROL_RATE, SERVICE_TOPICS, TOPICS
from valor.robot.description import RobotDescription

_GROUPS = {"topic": cli.topic, "service": cli.service}


def command(name: str, instance_name: str | None) -> Any:
    """The group of verbs, in the network of the named instance, or of the environment's."""
    cli.catalogue = catalogue(name, instance_name)
    instance = Instance.from_environment(instance_name)
    os.environ |= {"BIFROST_NETWORK": str(instance.network_file), "BIFROST_KEYS": str(instance.keys)}
    return typer.main.get_group(_GROUPS[name])


def catalogue(name: str, instance_name: str | None) -> cli.Catalogue:
    """Descriptions from the table of topics or services."""
    environment = f'eval "$(valorctl env{Instance.option(Instance.from_environment(instance_name).name)})"'
    verb = "echo" if name == "topic" else "type"
    advice = f"; if it is a ROS {name}: `{environment}; ros2 {name} {verb} /{{name}}`"
    if name == "service":
        return cli.Catalogue({"description": "description"}, _services, advice)
    columns = {"Hz": "rate_hz", "description": "description"}
    return cli.Catalogue(columns, lambda: _topics(Instance.from_environment(instance_name).settings()), advice)


def _services() -> dict[str, dict[str, Any]]:
    return {row.name: {"description": row.description, "may_serve": list(row.servers)} for row in SERVICE_TOPICS}


def _topics(settings: Settings) -> dict[str, dict[str, Any]]:
    control_rate = RobotDescription.load(settings.robot, settings.control_rate).tables.control_rate
    return {
        row.name: {
            "description": row.description,
            "rate_hz": control_rate if row.rate == CONTROL_RATE else row.rate,  # None: on change or on demand
            "may_publish": list(row.publishers),
            "record_every": row.record_every,
            "queue": row.queue,
            "latched": row.latched,
        }
        for row in TOPICS
    }
