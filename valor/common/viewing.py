"""Ports of an instance's page and of the view within it, on the loopback interface alone."""

from valor.common.instance import Settings

LOOPBACK = "127.0.0.1"
FIRST_PORT = 8080


def page_port(settings: Settings) -> int:
    """Port of the page; instances on one computer have different blocks of ports."""
    return FIRST_PORT + 2 * settings.block


def scene_port(settings: Settings) -> int:
    """Port of the view within the page."""
    return page_port(settings) + 1


def url(port: int) -> str:
    """URL on this computer, or at the end of a tunnel."""
    return f"http://{LOOPBACK}:{port}/"


def own_names(port: int) -> frozenset[str]:
    """Host headers of a browser on this computer, or at the end of a tunnel."""
    return frozenset(f"{host}:{port}" for host in (LOOPBACK, "localhost", "[::1]"))
