"""Joining an instance's Bifrost network: as a process of the table, with the key that is its own, or as a member."""

from __future__ import annotations

import bifrost
from bifrost.network import own_key_file
from valor.common.instance import Instance
from valor.common.topics import SERVICE_TOPICS, TOPICS


def network(instance: Instance, owner: str = "") -> bifrost.Network:
    """The instance's network.

    Args:
        instance: must be up.
        owner: the process of the table that this one is, or ``valorctl``; empty: none, which may subscribe to all
            topics, call all services, and publish what is nobody's.

    Raises:
        bifrost.ConfigurationError: the network file or a key is missing or wrong.
    """
    own_key = own_key_file(instance.owners, owner) if owner else None
    return bifrost.Network.load(instance.network_file, instance.keys, own_key=own_key)


def charter(instance: Instance) -> bifrost.Charter:
    """Every topic and service of the table belongs to those whom the table names."""
    return bifrost.Charter(
        instance.owners,
        {topic.name: topic.publishers for topic in TOPICS},
        {service.name: service.servers for service in SERVICE_TOPICS},
    )
