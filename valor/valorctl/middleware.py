"""Fast DDS' configuration of an instance that other computers reach, those that are named.

``deploy/fastdds.xml`` keeps ROS 2 on the loopback interface. For peers this is opened by as much as they need: the
interfaces by which this computer reaches them join it, and it announces itself to them by unicast, for networks that
carry no multicast. On the peers' side nothing is needed but the ROS domain: whoever is announced to, answers.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Collection, Sequence
from xml.etree import ElementTree

from valor.common.errors import ConfigurationError
from valor.common.resources import middleware_profile

LOOPBACK = "127.0.0.1"
PARTICIPANTS = 32
"""ROS processes of a computer that are looked for: each takes a port of its own, from the domain's first on."""
_HOST = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9.-]{0,252})")
_NAMESPACE = "http://www.eprosima.com"


def addresses(peers: Sequence[str]) -> tuple[str, ...]:
    """The IPv4 addresses of computers, by their names or addresses.

    Raises:
        ConfigurationError: names the one that is none, or is not reached from here.
    """
    found: list[str] = []
    for peer in peers:
        if not _HOST.fullmatch(peer):
            raise ConfigurationError(f"--peers {peer[:64]!r}: expected a computer's name or IPv4 address")
        try:
            address = socket.gethostbyname(peer)
        except OSError as error:
            raise ConfigurationError(f"--peers {peer}: {error.strerror or error}") from None
        if address.startswith("127."):
            raise ConfigurationError(f"--peers {peer}: is this computer ({address}); expected others")
        interface(address)
        if address not in found:
            found.append(address)
    return tuple(found)


def interface(peer: str) -> str:
    """The address of this computer that a peer's packets come to.

    Raises:
        ConfigurationError: there is no way to the peer.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((peer, 9))  # sends nothing
        except OSError as error:
            raise ConfigurationError(f"--peers {peer}: is not reached from here: {error.strerror}") from None
        return str(probe.getsockname()[0])


def profile(peers: Collection[str]) -> str:
    """The configuration, as Fast DDS reads it.

    Args:
        peers: their IPv4 addresses.

    Raises:
        ConfigurationError: a peer is not reached from here.
    """
    ElementTree.register_namespace("", _NAMESPACE)
    root = ElementTree.parse(middleware_profile()).getroot()
    transport, participant = (_one(root, name) for name in ("transport_descriptor", "rtps"))
    allowed = _one(transport, "interfaceWhiteList")
    for address in sorted({interface(peer) for peer in peers}):
        ElementTree.SubElement(allowed, _tag("address")).text = address
    ElementTree.SubElement(transport, _tag("maxInitialPeersRange")).text = str(PARTICIPANTS)
    builtin = ElementTree.SubElement(participant, _tag("builtin"))
    locators = ElementTree.SubElement(builtin, _tag("initialPeersList"))
    for peer in (LOOPBACK, *peers):
        locator = ElementTree.SubElement(ElementTree.SubElement(locators, _tag("locator")), _tag("udpv4"))
        ElementTree.SubElement(locator, _tag("address")).text = peer
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _tag(name: str) -> str:
    return f"{{{_NAMESPACE}}}{name}"


def _one(where: ElementTree.Element, name: str) -> ElementTree.Element:
    found = where.find(f".//{_tag(name)}")
    assert found is not None, name
    return found
