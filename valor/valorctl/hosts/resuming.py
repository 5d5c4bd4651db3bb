"""A host that was started anew takes up its part of an instance that goes on elsewhere; nothing that is over.

Nothing moves because of it: processes that begin anew wait, as they do when supervisord restarts them.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from valor.common import whole_file
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.processes import BY_NAME, DAEMON
from valor.valorctl import instance_setup, leftovers, ros_domain, startup, supervision, supervisor_config
from valor.valorctl.supervision import Supervisor


def run_of(instance: Instance) -> str:
    """What tells one run of an instance from another, on all of its hosts: of the keys that are issued for it alone.

    Empty: it is not up here, or its supervisor is gone.
    """
    return written_run(instance) if Supervisor(instance).answers() else ""


def written_run(instance: Instance) -> str:
    """The same, also of a run that may be over; empty: there is none."""
    try:
        network = msgspec.json.decode(instance.network_file.read_bytes())
    except (OSError, msgspec.DecodeError):
        return ""
    owners = msgspec.json.encode(network.get("owners"), order="sorted")
    return hashlib.blake2b(owners, digest_size=8).hexdigest()


def interrupted(home: Path, deployment: str) -> Iterator[Instance]:
    """Instances of a deployment that are written down as up here, and of which nothing runs."""
    for file in sorted(home.glob("*/instance.json")):
        try:
            instance = Instance(file.parent.name, home)
            settings = instance.settings()
        except ValorError:
            continue
        if settings.deployment == deployment and not leftovers.processes_of(instance):
            yield instance


def goes_on(instance: Instance, elsewhere: Mapping[str, Any]) -> bool:
    """Whether the same run is up on another host, by what these answered."""
    run = written_run(instance)
    return bool(run) and run in elsewhere.values()


def launch(instance: Instance, settings: Settings, held: int) -> Supervisor:
    """Start supervisord for this host's part of an instance, and bifrostd under it; ``held``: its domain's descriptor.

    Raises:
        ValorError: it does not come up.
    """
    row = next(host for host in settings.hosts if host.name == settings.here)
    table = [process for name, process in BY_NAME.items() if name == DAEMON or name in row.processes]
    environment = supervisor_config.environment(instance, sys.executable, os.environ)
    supervisor = supervision.launch(instance, table, environment, held, lambda: None)
    supervisor.start(DAEMON)
    return supervisor


def resume(instance: Instance) -> None:
    """Start this host's part of an instance again.

    Raises:
        ValorError: it does not come up.
    """
    with instance_setup.private_files(), instance_setup.changing(instance):
        startup.refuse_if_up(instance)
        for file in (supervisor_config.pid_file(instance), *instance.folder.glob("supervisor.sock*")):
            file.unlink(missing_ok=True)
        settings = msgspec.structs.replace(instance.settings(), epoch=time.monotonic_ns())
        whole_file.write(instance.settings_file, settings.json())
        with ros_domain.retake(settings.ros_domain_id) as reservation:
            supervisor = launch(instance, settings, reservation.fileno())
        for name in supervisor.processes():
            if name != DAEMON:  # which they find as soon as it is there
                supervisor.start(name)
