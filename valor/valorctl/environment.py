"""The environment with which any shell or program joins an instance."""

from __future__ import annotations

import shlex

from valor.common.instance import Instance


def exports(instance: Instance) -> str:
    """Shell commands, one a line.

    Raises:
        ConfigurationError: the instance is not up.
    """
    return "\n".join(f"export {name}={shlex.quote(value)}" for name, value in instance.environment().items())
