"""``--foxglove`` and ``--foxglove-at``: where Foxglove is told to look, and whether that can be."""

from __future__ import annotations

import importlib.util
import socket

from valor.common.errors import ConfigurationError
from valor.common.instance import FOXGLOVE_PORT, Listening, Settings
from valor.common.processes import FOXGLOVE
from valor.common.resources import example_file

AT = "--foxglove-at"
LAYOUT = "layouts/foxglove.json"
_HIGHEST = 65535


def listening(text: str) -> Listening:
    """Where ``[HOST:]PORT`` says; an empty text: at the usual port, for this computer alone.

    Raises:
        ConfigurationError: the text says something else.
    """
    if not text:
        return Listening(port=FOXGLOVE_PORT)
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not port.isdecimal() or int(port) > _HIGHEST or (":" in text and not host):
        raise ConfigurationError(f"{AT} {text}: expected [HOST:]PORT, with a port up to {_HIGHEST}, as 8766")
    return Listening(host=host or Listening().host, port=int(port))


def require(wanted: Listening) -> None:
    """See that the bridge can run, and listen there.

    Raises:
        ConfigurationError: it cannot; says what to do.
    """
    if importlib.util.find_spec("foxglove") is None:
        raise ConfigurationError("--foxglove: foxglove-sdk is not installed here: pip install 'valor[foxglove]'")
    try:
        (family, kind, protocol, _, address), *_ = socket.getaddrinfo(
            wanted.host, wanted.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except OSError as error:
        what = f"{wanted.host}:{wanted.port}: {error.strerror}"
        raise ConfigurationError(f"{what}; expected an address of this computer and a free port: {AT} 8766") from None


def announcement(settings: Settings) -> str | None:
    """For `up`: where to look; None: nowhere."""
    if FOXGLOVE not in settings.asked:
        return None
    where = settings.foxglove
    if where.port == 0:
        return "Foxglove: `valorctl status` says at which port"
    return f"Foxglove: open ws://{where.host}:{where.port}, layout {example_file(LAYOUT)}"
