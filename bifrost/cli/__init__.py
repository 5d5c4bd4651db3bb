"""The verbs ``topic list|info|echo|hz|bw|delay|pub`` and ``service list|call``: the network as a person sees it.

``topic`` and ``service`` are Typer apps to mount in a larger command line; ``python -m bifrost.cli`` has both. They
join the network that ``BIFROST_NETWORK`` and ``BIFROST_KEYS`` name, and show what a ``Catalogue`` that they are mounted
with says of a topic or service. What they raise is a ``bifrost.Error`` of one line.
"""

from bifrost.cli.services import service
from bifrost.cli.terminal import Catalogue
from bifrost.cli.topics import topic

__all__ = ["Catalogue", "service", "topic"]
