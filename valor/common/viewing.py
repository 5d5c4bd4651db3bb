"""Where an instance's page is served: by itself on the loopback interface alone; beyond it over TLS.

Its ports follow from the instance's block of ports. Where it is served is decided by whoever starts it, and stands in a
file of the instance's.
"""

from __future__ import annotations

import ipaddress
import socket
from pathlib import Path

import msgspec

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.common.table import Table, checked

LOOPBACK = "127.0.0.1"
FIRST_PORT = 8080
RECORDED_PORT = 8580  # of the page on a recording, unless another is asked for


class Viewing(Table):
    """Where the page is served.

    Attributes:
        host: address or name of the interface.
        certificate: PEM file of certificate and key, where the page is served beyond this computer.
    """

    host: str = LOOPBACK
    certificate: Path | None = None

    @property
    def secured(self) -> bool:
        """Over TLS, for those alone who show a token."""
        return not is_loopback(self.host)

    @classmethod
    def of(cls, instance: Instance) -> Viewing:
        """As it was decided; unless it was, on the loopback interface.

        Raises:
            ConfigurationError: the file is not readable.
        """
        try:
            return checked(cls, msgspec.json.decode(instance.viewing_file.read_text()))
        except FileNotFoundError:
            return cls()
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{instance.viewing_file}: {' '.join(str(error).split())}") from None

    def url(self, port: int) -> str:
        """Of a page there, as another computer would call it."""
        if not self.secured:
            return f"http://{LOOPBACK}:{port}/"
        return f"https://{bracketed(socket.gethostname() if _is_any(self.host) else self.host)}:{port}/"


def is_loopback(host: str) -> bool:
    """Whether nobody but this computer's own users reaches it."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def bracketed(host: str) -> str:
    """As in a URL."""
    return f"[{host}]" if ":" in host else host


def page_port(settings: Settings) -> int:
    """Of the page. Two instances on one computer have different blocks of ports."""
    return FIRST_PORT + 2 * settings.block


def stop_port(settings: Settings) -> int:
    """Of its stop button."""
    return page_port(settings) + 1


def own_names(port: int) -> frozenset[str]:
    """What a browser on this computer, or at the end of a tunnel, calls a server on the loopback interface."""
    return frozenset(f"{host}:{port}" for host in (LOOPBACK, "localhost", "[::1]"))


def free_port() -> int:
    """One of the loopback interface's that nobody has."""
    with socket.create_server((LOOPBACK, 0)) as probe:
        return int(probe.getsockname()[1])


def _is_any(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
