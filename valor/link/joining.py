"""An end of an instance's link: its keys are Bifrost's, its words must be those of the same robot."""

from __future__ import annotations

from valor.common import membership
from valor.common.errors import ConfigurationError
from valor.common.instance import Instance
from valor.common.linking import NAMES
from valor.link.fields import FIELDS
from valor.link.session import Session, fingerprint, shared_secret
from valor.robot.description import RobotDescription


def session(instance: Instance, name: str, robot: RobotDescription) -> Session:
    """Of the end that is the process ``name``.

    Raises:
        ConfigurationError: the instance's network has no keys of both ends.
    """
    secret = instance.link_key.read_bytes() if instance.link_key.exists() else _of_processes(instance, name)
    print_ = fingerprint(repr(FIELDS).encode(), robot.file.read_bytes(), robot.model_file.read_bytes())
    return Session(secret, name == NAMES[0], print_)


def _of_processes(instance: Instance, name: str) -> bytes:
    """What follows from the Bifrost keys of both ends, which one computer has issued."""
    network = membership.network(instance, name)
    other = NAMES[1 - NAMES.index(name)]
    public = network.grants.owners.get(other)
    if public is None or network.own is None:
        raise ConfigurationError(f"{instance.network_file}: no key of {other}; `valorctl up --link DOMAIN` issues it")
    return shared_secret(network.own.secret, public.encode())
