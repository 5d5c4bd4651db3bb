"""What a host does by order of another one: ``valorctl host order`` reads one order on stdin and replies on stdout."""

import contextlib
import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec

import bifrost
import valor.common
from bifrost.network import write_private
from valor.common import whole_file
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.processes import BY_NAME, DAEMON, RECORDER
from valor.common.resources import robot_folder
from valor.common.table import checked
from valor.valorctl.hosts import logs
from valor.valorctl.hosts.remote import Greeting, Order, Reply
from valor.valorctl.instance import instance_setup, ros_domain, shutdown, startup, supervision, supervisor_config
from valor.valorctl.instance.supervision import Supervisor
from valor.valorctl.status.health import Listener
from valor.valorctl.terminal.console import Interruption, progress


class HostSetup(msgspec.Struct):
    """What a host needs to make its part of an instance."""

    settings: dict[str, Any]  # of the instance; the robot by the name that it has on every host
    here: str  # name of the host
    domain: int  # ROS domain, free on all hosts
    network: bytes  # content of the Bifrost network file
    keys: dict[str, bytes]  # contents of the key files, by their paths in the instance's folder


class Survey(msgspec.Struct):
    """What must be known of a host before an instance is made there."""

    versions: dict[str, str]  # of Python and packages, and hashes of code and robot; the same on all hosts
    folder: str  # of the instance
    domains: list[int]  # ROS domains that no process uses


def serve() -> None:
    """Write the greeting to stdout, read one order from stdin, execute it, write the reply."""
    with os.fdopen(os.dup(1), "wb", buffering=0) as output, contextlib.suppress(BrokenPipeError):
        os.dup2(2, 1)  # what others print must not reach the sender
        output.write(msgspec.json.encode(Greeting(time.monotonic(), time.time())) + b"\n")
        line = sys.stdin.buffer.readline()
        taken, reply = time.monotonic(), Reply()
        if not line:
            return  # the sender is gone
        try:
            order = msgspec.json.decode(line, type=Order)
            if (late := taken - order.until) > 0.0:
                raise ValorError(f"{order.verb}: arrived {late:.1f} s after its deadline; nothing was done")
            os.environ["VALOR_INSTANCE"] = order.instance
            instance = Instance.from_environment()
            if order.verb == "logs":
                logs.write(instance, output, **order.arguments)
                return
            reply.result = VERBS[order.verb](instance, **order.arguments)
        except (ValorError, bifrost.Error) as error:
            reply.error = str(error)
        except BrokenPipeError:
            return
        except Exception as error:
            reply.error = f"{type(error).__name__}: {error}"
        output.write(msgspec.json.encode(reply) + b"\n")


def survey(instance: Instance, robot: str) -> Survey:
    """Return the versions, the folder and the free ROS domains of this host."""
    others = ros_domain.taken(instance.folder.parent, but=instance)
    free = [
        domain
        for domain in ros_domain.DOMAINS
        if domain not in others and not ros_domain.is_reserved(domain) and ros_domain.is_free(domain)
    ]
    versions = {name: metadata.version(name) for name in ("valor", "valor-interfaces")}
    versions["Python"] = ".".join(platform.python_version_tuple()[:2])
    packages = Path(bifrost.__file__).parent, Path(valor.common.__file__).parents[1]
    versions["code"] = "".join(_digest(folder, "*.py") for folder in packages)
    versions["robot"] = _digest(robot_folder(robot), "*")
    return Survey(versions, str(instance.folder), free)


def make(instance: Instance, setup: dict[str, Any]) -> None:
    """Make this host's part of an instance, and start bifrostd; after a ``ValorError``, leave nothing of it."""
    with startup.new_instance(instance, progress=None):
        _make(instance, msgspec.convert(setup, HostSetup))


def down(instance: Instance) -> bool:
    """Stop this host's part; return whether there was anything."""
    with instance_setup.changing(instance):
        return shutdown.take_down(instance)


def doctor(instance: Instance) -> list[dict[str, str]]:
    """Return what `doctor` finds on this host."""
    from valor.valorctl.instance.checks import run_all

    return [asdict(finding) for finding in run_all(instance)]


VERBS: Mapping[str, Callable[..., Any]] = {each.__name__: each for each in (survey, make, down, doctor)}


def resume(instance: Instance) -> str:
    """Start this host's part of an instance again after it lost power, if the same run continues on another host.

    The robot does not move: processes wait, as after a restart by supervisord. Returns a line with the result.
    """
    from valor.valorctl.hosts.fleet import Fleet

    if not instance.settings_file.exists() or shutdown.processes_of(instance):
        return f"instance {instance.name!r}: nothing to resume"
    settings = instance.settings()
    with Fleet(instance, settings) as fleet:
        runs = fleet.runs()
    if settings.run not in runs.values():
        if missing := [name for name, run in runs.items() if run is None]:
            raise ValorError(f"unreachable: {', '.join(missing)}; expected a host on which the instance is up")
        return f"instance {instance.name!r}: its run is over; `valorctl up --deployment FILE` starts another one"
    with instance_setup.private_files(), instance_setup.changing(instance):
        startup.require_down(instance)
        for file in (supervisor_config.pid_file(instance), *instance.folder.glob("supervisor.sock*")):
            file.unlink(missing_ok=True)
        settings = msgspec.structs.replace(settings, epoch=time.monotonic_ns())
        whole_file.write(instance.settings_file, settings.json())
        with ros_domain.retake(settings.ros_domain_id) as reservation:
            supervisor = _launch(instance, settings, reservation.fileno())
        for name in sorted(supervisor.processes(), key=[*BY_NAME].index):
            supervisor.start(name)
    return f"instance {instance.name!r} continues on other hosts; started its part on {settings.here} again"


def _digest(folder: Path, pattern: str) -> str:
    """Hash of a package's or robot's files, except compiled files and data; follows links to services' folders."""
    digest = hashlib.blake2b(digest_size=8)
    for base in (folder, *(entry for entry in sorted(folder.iterdir()) if entry.is_symlink() and entry.is_dir())):
        for file in sorted(base.rglob(pattern)):
            name = file.relative_to(folder)
            if file.is_file() and not {"__pycache__", "data"}.intersection(name.parts):
                digest.update(f"{name}\0".encode() + file.read_bytes())
    return digest.hexdigest()


def _make(instance: Instance, setup: HostSetup) -> None:
    wanted = checked(Settings, setup.settings)
    row = next(host for host in wanted.hosts if host.name == setup.here)
    wanted = msgspec.structs.replace(
        wanted,
        robot=robot_folder(str(wanted.robot)),
        here=row.name,
        peers=tuple(host.address for host in wanted.beside(row.name) if host.name != row.name),
        bag=wanted.bag if RECORDER in row.processes else None,
    )
    with ros_domain.reserve_for(instance, setup.domain) as reservation:
        if reservation.domain != setup.domain:
            raise ValorError(f"ROS domain {setup.domain} is in use on {row.name}")
        instance_setup.make(instance, wanted, setup.domain, setup.domain, partial(_write_keys, setup))
        supervisor = _launch(instance, instance.settings(), reservation.fileno())
    with Listener(instance, [DAEMON]) as listener, Interruption() as interruption, progress() as shown:
        startup.start(supervisor, listener, [BY_NAME[DAEMON]], progress=shown, interruption=interruption)


def _launch(instance: Instance, settings: Settings, held: int) -> Supervisor:
    """Start supervisord for this host's part; ``held``: descriptor that reserves the ROS domain."""
    row = next(host for host in settings.hosts if host.name == settings.here)
    table = [process for name, process in BY_NAME.items() if name == DAEMON or name in row.processes]
    return supervision.launch(instance, table, held, lambda: None)


def _write_keys(setup: HostSetup, instance: Instance) -> None:
    for name, content in setup.keys.items():
        file = instance.folder / name
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_private(file, content)
    write_private(instance.network_file, setup.network)
