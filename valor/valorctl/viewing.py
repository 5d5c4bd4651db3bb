"""``view``: the operator's page of a running instance or of a recording, and what to say of one that is served."""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from valor.common import whole_file
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import behind
from valor.common.processes import EXIT_CONFIGURATION, OPERATOR_STOP, PROCESSES, SUPERVISED, VIEW, Process
from valor.common.table import plain
from valor.common.viewing import LOOPBACK, Viewing, is_loopback, page_port, stop_port
from valor.valorctl.presence import processes_found

AGAIN = 1.0  # from the end of a process until it is started anew [s]
_GRACE = 5.0  # from SIGTERM to SIGKILL [s]


def place(host: str, certificate: Path | None) -> Viewing:
    """Where the page is wanted.

    Args:
        host: address or name of an interface.
        certificate: PEM file of a certificate and its key; None: a self-made one, where one is needed.

    Raises:
        ConfigurationError: it cannot be served there.
    """
    if is_loopback(host):
        if certificate is not None:
            raise ConfigurationError(f"{certificate}: expected no certificate where {host} alone is listened to")
        return Viewing()
    try:
        with socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            pass
    except OSError as error:
        raise ConfigurationError(f"{host}: {error.strerror or error}; expected an address of this computer") from None
    if certificate is None:
        return Viewing(host=host)
    from valor.door.certificate import context

    context(certificate)
    return Viewing(host=host, certificate=certificate.expanduser().absolute())


def decide(instance: Instance, viewing: Viewing) -> None:
    """Tell those who will serve the page where; with a certificate of our own, if one is needed and none is given.

    Raises:
        ConfigurationError: it cannot be written.
    """
    if viewing.secured and viewing.certificate is None:
        from valor.door.certificate import self_made

        own = instance.folder.parent / "viewing.pem"
        self_made(own, viewing.host)
        viewing = Viewing(host=viewing.host, certificate=own)
    try:
        whole_file.write(instance.viewing_file, msgspec.json.encode(plain(viewing)))
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: {error.strerror}") from None


def announcement(instance: Instance) -> str:
    """Where the page is, and how to become its operator."""
    settings, viewing = instance.settings(), Viewing.of(instance)
    page, stop = page_port(settings), stop_port(settings)
    linked = behind(settings)
    also = "" if linked else f"-L {stop}:{LOOPBACK}:{stop} "
    alone = "" if linked else f"its stop button alone: {viewing.url(stop)}\n"
    operator = f"operator's token: {instance.operator_token.read_text().strip()}"
    if viewing.certificate is None:
        return (
            f"page: {viewing.url(page)}  {operator}\n"
            f"from another computer: ssh -L {page}:{LOOPBACK}:{page} {also}to this one, "
            "and the same address there"
        )
    from valor.door.certificate import fingerprint

    return (
        f"page: {viewing.url(page)}  viewers' token: {instance.viewer_token.read_text().strip()}  {operator}\n"
        f"{alone}certificate, SHA-256: {fingerprint(viewing.certificate)}"
    )


def processes(settings: Settings) -> list[Process]:
    """What serves the page; behind a link the stop goes through it, by the page."""
    wanted = [process for process in PROCESSES if process.option == VIEW]
    return [process for process in wanted if process.name != OPERATOR_STOP or not behind(settings)]


def serve(instance: Instance, viewing: Viewing, check: Callable[[], None], tell: Callable[[str], None]) -> None:
    """Serve the page of an instance until interrupted or the instance is down; what ends is started anew.

    Args:
        instance: must be up.
        viewing: where.
        check: called while it is served; raises to end it.
        tell: is told where the page is.

    Raises:
        ValorError: the instance is not up, or the page cannot be served there.
    """
    serving = processes(instance.settings())
    if any(process.name in processes_found(instance) for process in serving):
        if viewing != Viewing() and viewing.host != Viewing.of(instance).host:
            raise ConfigurationError(f"the page is served already, at {Viewing.of(instance).host}; expected no --host")
        tell(announcement(instance))
        return
    decide(instance, viewing)
    environment = _environment(instance)
    running: dict[str, subprocess.Popen[bytes]] = {}
    ended: dict[str, float] = {}
    tell(announcement(instance))
    try:
        while instance.settings_file.exists():
            check()
            now = time.monotonic()
            for process in serving:
                child = running.get(process.name)
                if child is not None and child.poll() is not None:
                    _require_another_start(instance, process, child.returncode)
                    ended[process.name] = now
                    del running[process.name]
                if process.name not in running and now - ended.get(process.name, -AGAIN) >= AGAIN:
                    running[process.name] = _start(instance, process, environment)
            time.sleep(0.1)
    finally:
        _end(running.values())


def show_recording(bag: Path, robot: str | None, check: Callable[[], None]) -> None:
    """Serve the page on a recording until interrupted.

    Args:
        bag: a file or folder.
        robot: name or folder; None: as the bag says.
        check: called while it is served; raises to end it.

    Raises:
        ValorError: it cannot be shown.
    """
    command = [sys.executable, "-m", "valor.operator_station.recorded", str(bag)]
    with tempfile.TemporaryFile() as said:
        child = subprocess.Popen(
            [*command, *(("--robot", robot) if robot else ())],
            stdin=subprocess.DEVNULL, stderr=said, start_new_session=True,
        )  # fmt: skip
        try:
            while child.poll() is None:
                check()
                time.sleep(0.1)
        finally:
            _end([child])
        if child.returncode <= 0:
            raise ValorError(f"{bag}: somebody has ended the page")
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    raise ValorError(lines[-1] if lines else f"{bag}: the page has ended without a word")


def _end(children: Iterable[subprocess.Popen[bytes]]) -> None:
    children = list(children)
    for child in children:
        child.terminate()
    for child in children:
        try:
            child.wait(_GRACE)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def _require_another_start(instance: Instance, process: Process, status: int) -> None:
    """Raise ``ValorError`` if it would end in the same way again."""
    if status == EXIT_CONFIGURATION:
        lines = (instance.logs / f"{process.name}.log").read_text(errors="replace").splitlines()
        raise ValorError(f"{process.name} did not start: {lines[-1] if lines else 'without a word'}")


def _environment(instance: Instance) -> dict[str, str]:
    import os

    from valor.valorctl import supervisor_config

    made = supervisor_config.environment(instance, sys.executable, os.environ)
    del made[SUPERVISED]  # it is nobody's but the one who called it
    return made


def _start(instance: Instance, process: Process, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    with open(instance.logs / f"{process.name}.log", "ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", process.module],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
