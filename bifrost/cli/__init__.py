"""The verbs ``topic list|info|echo|hz|bw|delay|pub`` and ``service list|call``: the network as a person sees it.

``topic`` and ``service`` are Typer apps to mount in a larger command line; ``python -m bifrost.cli`` has both. They
join the network that ``BIFROST_NETWORK`` and ``BIFROST_KEYS`` name. What they raise is a ``bifrost.Error`` of one line.
"""

from bifrost.cli.services import service
from bifrost.cli.topics import topic

__all__ = ["service", "topic"]
