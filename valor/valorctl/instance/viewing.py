"""The operator's page and the Foxglove server: verification, announcement, and ``view`` for a running instance."""

import contextlib
import importlib.util
import socket
import time
from collections.abc import Callable

from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import FOXGLOVE_PORT, Instance, Listening, Settings
from valor.common.processes import FOXGLOVE, PROCESSES, VIEW
from valor.common.resources import example_file
from valor.common.viewing import LOOPBACK, page_port, scene_port, url
from valor.valorctl.instance.running import processes_found
from valor.valorctl.instance.supervision import ProcessState, Supervisor, SupervisorError

CHECK_PERIOD = 0.2  # [s]
STOP_TIMEOUT = 5.0  # [s]
AT = "--foxglove-at"
LAYOUT = "layouts/foxglove.json"
_HIGHEST = 65535


def announcement(instance: Instance) -> str:
    """Address of the page, the operator's token, and the tunnel from another computer."""
    settings = instance.settings()
    ports = page_port(settings), scene_port(settings)
    tunnel = " ".join(f"-L {port}:{LOOPBACK}:{port}" for port in ports)
    return (
        f"page: {url(ports[0])}  operator's token: {instance.operator_token.read_text().strip()}\n"
        f"from another computer: ssh -N {tunnel} HOST, then the same address there"
    )


def serve(instance: Instance, check: Callable[[], None], tell: Callable[[str], None]) -> None:
    """Serve the page of an instance until ``check`` raises or the instance is down; ``tell`` receives the announcement.

    Raises ``ValorError``: the instance is not up, or a process of the page does not start.
    """
    serving = [process for process in PROCESSES if process.option == VIEW]
    if any(process.name in processes_found(instance) for process in serving):
        tell(announcement(instance))
        return
    supervisor = Supervisor(instance)
    supervisor.add(serving)
    try:
        for process in serving:
            supervisor.start(process.name)
        tell(announcement(instance))
        while instance.settings_file.exists():
            check()
            infos = supervisor.processes()
            for process in serving:
                if infos[process.name].state in (ProcessState.EXITED, ProcessState.FATAL):
                    raise ValorError(f"{process.name} did not start{supervisor.log_tail(process.name)}")
            time.sleep(CHECK_PERIOD)
    finally:
        with contextlib.suppress(SupervisorError):  # the instance is down
            supervisor.stop([process.name for process in serving], STOP_TIMEOUT)
            supervisor.remove(serving)


def foxglove_address(text: str) -> Listening:
    """Parse ``[HOST:]PORT``, empty for the default on loopback; raises ``ConfigurationError``."""
    if not text:
        return Listening(port=FOXGLOVE_PORT)
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not port.isdecimal() or int(port) > _HIGHEST or (":" in text and not host):
        raise ConfigurationError(f"{AT} {text}: expected [HOST:]PORT, with a port up to {_HIGHEST}, as 8766")
    return Listening(host=host or Listening().host, port=int(port))


def require_foxglove(wanted: Listening) -> None:
    """Verify that the bridge is installed, and can listen. Raises ``ConfigurationError``: states the remedy."""
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


def foxglove_announcement(settings: Settings) -> str | None:
    """The line of `up`; None without a server."""
    if FOXGLOVE not in settings.asked:
        return None
    where = settings.foxglove
    if where.port == 0:
        return "Foxglove: `valorctl status` shows the port"
    return f"Foxglove: open ws://{where.host}:{where.port}, layout {example_file(LAYOUT)}"
