"""``host join``, ``host agent``."""

from __future__ import annotations

import logging
import os
import shlex
import signal
from pathlib import Path
from typing import Annotated

import typer

from valor.common.errors import ConfigurationError, expected
from valor.common.instance import Instance
from valor.valorctl import completion
from valor.valorctl.console import say


def register(app: typer.Typer) -> None:
    """Add the group."""
    group = typer.Typer(no_args_is_help=True, help="Several computers: an agent on each, through which `up` works.")
    group.command()(join)
    group.command()(agent)
    app.add_typer(group, name="host")


def join(
    name: Annotated[str, typer.Argument(help="One of the deployment's hosts.")],
    deployment: Annotated[
        str,
        typer.Option(metavar="FILE", help="A .yaml file (docs/deployment.md).", autocompletion=completion.deployments),
    ],
) -> None:
    """Write a host's ticket, and show the one command that starts its agent there."""
    from bifrost.network import write_private
    from valor.valorctl.hosts.credentials import Credentials
    from valor.valorctl.hosts.deployment import Deployment, deployment_file

    found = Deployment.load(deployment_file(deployment))
    if name not in found.hosts:
        raise ConfigurationError(f"host {expected(name, found.hosts)}")
    credentials = Credentials.of(Instance.from_environment(), found.name)
    credentials.issue(found)
    ticket = Path(f"{found.name}.{name}.ticket")
    try:
        write_private(ticket, credentials.ticket(name, found.beside(name)))
    except OSError as error:
        raise ConfigurationError(f"{ticket}: {error.strerror}") from None
    address = found.hosts[name].address
    say(f"{ticket} admits who has it; bring it to {name} ({address}) and start the agent there:")
    say(f"  scp -p {shlex.quote(str(ticket))} {address}: && ssh -t {address} valorctl host agent {ticket.name}")
    say(f"afterwards, whenever that computer starts: valorctl host agent {found.name}")


def agent(
    ticket: Annotated[str, typer.Argument(help="A ticket of `host join`, or a deployment that was joined by one.")],
) -> None:
    """Let the deployment's hosts start and stop systems on this computer, until interrupted."""
    from valor.valorctl.hosts import credentials
    from valor.valorctl.hosts.agent import Agent

    home = Instance.from_environment().folder.parent
    file = Path(ticket).expanduser()
    known = credentials.admit(file, home) if file.is_file() else credentials.joined(ticket, home)
    stopped = False

    def stop(_signum: int, _frame: object) -> None:
        nonlocal stopped
        stopped = True

    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(signum) is not signal.SIG_IGN:  # as under nohup
            signal.signal(signum, stop)
    os.environ.pop("VALOR_INSTANCE", None)  # of whoever started it
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    Agent(known.network(), known.name, lambda name: Instance(name, home)).run(lambda: stopped, say)
