"""What a shell completes values to: names of what there is, read from tables alone. Never fails: it then knows none."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import typer

from valor.common.instance import Instance, Settings

Names = Callable[[typer.Context], Iterable[str]]


def completer(names: Names) -> Callable[[typer.Context, str], list[str]]:
    """Complete to those of some names that begin as what is there; without an instance or its files there are none."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            return [name for name in names(ctx) if name.startswith(incomplete)]
        except Exception:  # a traceback in the middle of somebody's command line helps nobody
            return []

    return complete


@completer
def profiles(_: typer.Context) -> Iterable[str]:
    """For ``--profile``."""
    from valor.common.resources import profiles

    return profiles()


@completer
def robots(_: typer.Context) -> Iterable[str]:
    """For ``--robot``."""
    from valor.common.resources import robots

    return robots()


@completer
def plans(_: typer.Context) -> Iterable[str]:
    """For ``step``."""
    from valor.common.resources import plans

    return plans()


@completer
def worlds(_: typer.Context) -> Iterable[str]:
    """For ``--world``."""
    from valor.simulation.world_names import WORLD_NAMES

    return WORLD_NAMES


@completer
def actuators(ctx: typer.Context) -> Iterable[str]:
    """For ``--actuators``: of the robot asked for."""
    from valor.common.resources import robot_folder

    folder = robot_folder(ctx.params.get("robot") or "escher")
    return _table(folder)["actuators"]


@completer
def modes(_: typer.Context) -> Iterable[str]:
    """Control modes."""
    from valor.valorctl.mode_names import names

    return names()


@completer
def initial_modes(_: typer.Context) -> Iterable[str]:
    """Control modes that ``up`` can bring a robot to."""
    from valor.valorctl.mode_names import initial

    return initial()


@completer
def services(_: typer.Context) -> Iterable[str]:
    """Processes."""
    from valor.common.processes import BY_NAME

    return BY_NAME


@completer
def levels(_: typer.Context) -> Iterable[str]:
    """Of logs."""
    from valor.valorctl.log_reader import LEVELS

    return LEVELS


@completer
def arm_presets(ctx: typer.Context) -> Iterable[str]:
    """Postures of the arms of the robot that is up."""
    return _table(_settings(ctx).robot)["arm_presets"]


@completer
def hand_presets(ctx: typer.Context) -> Iterable[str]:
    """Postures of the hands of the robot that is up."""
    return _table(_settings(ctx).robot)["hand_presets"]


@completer
def instances(_: typer.Context) -> Iterable[str]:
    """Those that are up, or have been."""
    home = Instance.from_environment().folder.parent
    return sorted(folder.name for folder in home.iterdir() if (folder / "logs").is_dir())


def _settings(ctx: typer.Context) -> Settings:
    """Of the instance named on the command line, else of the environment's."""
    return Instance.from_environment(
        ctx.find_root().params.get("instance") or os.environ.get("VALOR_INSTANCE")
    ).settings()


def _table(folder: Path) -> dict[str, Iterable[str]]:
    """A robot's table, unchecked: the check takes longer than a finger on the Tab key."""
    from valor.common.document import Document

    content: dict[str, Iterable[str]] = Document.load(folder / "robot.yaml").content  # type: ignore[assignment]
    return content
