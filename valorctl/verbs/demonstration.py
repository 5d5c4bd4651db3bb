"""``demo``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from valor_common.instance import Instance
from valorctl.console import progress


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(demo)


def demo(
    out: Annotated[Path, typer.Option(help="The folder for the bag and the pictures.")] = Path("output/demo"),
) -> None:
    """Let the robot stand up and reach out in a system of its own; leaves a bag and pictures."""
    from valorctl import demonstration
    from valorctl.interruption import Interruption

    instance = Instance.from_environment(os.environ.get("VALOR_INSTANCE") or demonstration.NAME)
    with progress() as shown, Interruption() as interruption:
        demonstration.run(instance, out.expanduser().absolute(), shown, interruption)
