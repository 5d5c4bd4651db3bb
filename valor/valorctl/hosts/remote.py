"""What OpenSSH does between hosts: it carries one order to `valorctl` there.

The order's deadline is by the clock of the host that receives it, which states that clock first: TCP delivers what was
sent into a cut after the cable is plugged in again.
"""

import contextlib
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from valor.common.errors import ConfigurationError
from valor.common.instance import Host, Settings
from valor.valorctl.instance.supervision import SupervisorError

CONNECT_TIMEOUT = 5.0  # TCP and key exchange [s]
MARGIN = 5.0  # from an order's deadline until the process that carries it is killed [s]
UNREACHABLE = 255  # exit status of ssh itself
OPTIONS = {
    "BatchMode": "yes",
    "ConnectTimeout": f"{CONNECT_TIMEOUT:g}",
    "ServerAliveInterval": "1",
    "ServerAliveCountMax": "3",
    "StreamLocalBindUnlink": "yes",
    "ExitOnForwardFailure": "yes",
    "ControlMaster": "no",
    "ControlPath": "none",
    "ForwardAgent": "no",
    "ForwardX11": "no",
}


class HostError(SupervisorError):
    """A host rejected an order or failed to execute it; names the host."""


class GoneError(HostError):
    """A host is not reachable by ssh."""


class Greeting(msgspec.Struct):
    """First line from the host that receives an order: its clocks [s]."""

    monotonic: float
    wall: float


class Order(msgspec.Struct):
    """One JSON line on stdin of ``valorctl host order``."""

    verb: str
    instance: str
    arguments: dict[str, Any]
    until: float = 0.0  # deadline by the receiver's monotonic clock, set by ``send`` [s]


class Reply(msgspec.Struct):
    """Result of an order."""

    result: Any = None
    error: str = ""
    ahead: float = 0.0  # how far the host's wall clock is ahead, less the delay of its greeting; set by ``send`` [s]


def command(settings: Settings, host: Host, *more: str) -> list[str]:
    """The ssh command for a host, with further options; raises ``ConfigurationError`` if there is no ssh client."""
    if (program := shutil.which("ssh")) is None:
        raise ConfigurationError("ssh: no such program; expected OpenSSH's client: apt install openssh-client")
    config = Path(settings.ssh.config).expanduser()
    file = ["-F", str(config)] if settings.ssh.config and config.exists() else []
    options = [word for name, value in OPTIONS.items() for word in ("-o", f"{name}={value}")]
    return [program, *file, *options, "-T", *more, host.ssh or host.address]


def gone(host: Host, errors: str) -> GoneError:
    """The error of a host that ssh does not reach, with the last line that ssh printed."""
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    where = host.ssh or host.address
    why = lines[-1] if lines else "ssh ended without a message"
    return GoneError(f"host {host.name} ({host.address}) is unreachable: {why}; check `ssh {where} true`")


@contextlib.contextmanager
def carrier(settings: Settings, host: Host) -> Iterator[subprocess.Popen[bytes]]:
    """Run ``valorctl host order`` on a host, or in a process of this computer if the host is this one."""
    if host.name == settings.here:
        words = [sys.executable, "-m", "valor.valorctl", "host", "order"]
    else:
        words = [*command(settings, host), f"{settings.ssh.valorctl} host order"]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, bufsize=0, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True) as process:
        try:
            yield process
        finally:
            process.kill()


def send(process: subprocess.Popen[bytes], settings: Settings, host: Host, order: Order, timeout: float) -> float:
    """Await the greeting, write the order with its deadline; returns how far the host's clock is ahead [s]."""
    assert process.stdin is not None and process.stdout is not None and process.stderr is not None
    line = process.stdout.readline()
    received = time.time()
    if not line:
        raise ended(settings, host, process.wait(), process.stderr.read())
    try:
        greeting = msgspec.json.decode(line, type=Greeting)
    except msgspec.DecodeError:
        what = f"its shell printed {line[:80].decode(errors='replace')!r}; expected a shell that prints nothing"
        raise HostError(f"{host.name}: {what} without a terminal") from None
    content = msgspec.structs.replace(order, until=greeting.monotonic + timeout)
    with contextlib.suppress(BrokenPipeError):  # without a reply `execute` reports that
        process.stdin.write(msgspec.json.encode(content) + b"\n")
    return greeting.wall - received


def execute(settings: Settings, host: Host, order: Order, timeout: float) -> Reply:
    """Have a host execute an order; raises ``GoneError`` if it is unreachable, ``HostError`` after a failure."""
    with carrier(settings, host) as process:
        timer = threading.Timer(timeout + MARGIN, process.kill)
        timer.start()
        try:
            ahead = send(process, settings, host, order, timeout)
            output, errors = process.communicate()
        finally:
            timer.cancel()
    try:
        reply = msgspec.json.decode(output, type=Reply)
    except msgspec.DecodeError:
        raise ended(settings, host, process.returncode, errors) from None
    if reply.error:
        raise HostError("\n".join(f"{host.name}: {line}" for line in reply.error.splitlines()))
    reply.ahead = ahead
    return reply


def execute_all(settings: Settings, orders: Mapping[str, Order], timeout: float) -> dict[str, Reply | HostError]:
    """Have hosts execute orders at the same time; returns by host its reply or the error."""
    hosts = {host.name: host for host in settings.hosts}
    with ThreadPoolExecutor(max(1, len(orders))) as pool:
        replies = {name: pool.submit(execute, settings, hosts[name], order, timeout) for name, order in orders.items()}
    found: dict[str, Reply | HostError] = {}
    for name, reply in replies.items():
        try:
            found[name] = reply.result()
        except HostError as error:
            found[name] = error
    return found


def require(answers: Mapping[str, Reply | HostError]) -> dict[str, Reply]:
    """The answers, if every host sent one. Raises ``HostError``: one line for each host that did not."""
    if errors := [str(answer) for answer in answers.values() if isinstance(answer, HostError)]:
        raise HostError("\n".join(errors))
    return {name: answer for name, answer in answers.items() if isinstance(answer, Reply)}


def ended(settings: Settings, host: Host, status: int, errors: bytes) -> HostError:
    """The error of a host whose process ended without a reply."""
    text = errors.decode(errors="replace")
    if status == UNREACHABLE and host.name != settings.here:
        return gone(host, text)
    if status < 0:
        return HostError(f"{host.name}: no reply in time")
    last = (text.strip().splitlines() or ["no message"])[-1]
    what = f"`{settings.ssh.valorctl} host order` ended with exit status {status}: {last}"
    return HostError(f"{host.name}: {what}; expected valorctl to run there: `ssh.valorctl` in the deployment's file")
