"""What a shell completes values to: names of what there is, read from tables alone. Never fails: it then knows none."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import typer

from valor.common import mode_names, resources
from valor.common.instance import Instance, Settings
from valor.common.processes import BY_NAME
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl.log_reader import LEVELS

Names = Callable[[typer.Context], Iterable[str]]


def completer(names: Names) -> Callable[[typer.Context, str], list[str]]:
    """Complete to those of some names that begin as what is there; without an instance or its files there are none."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            return [name for name in names(ctx) if name.startswith(incomplete)]
        except Exception:  # a traceback in the middle of somebody's command line helps nobody
            return []

    return complete


profiles = completer(lambda _: resources.profiles())
deployments = completer(lambda _: resources.deployments())
robots = completer(lambda _: resources.robots())
plans = completer(lambda _: resources.plans())
worlds = completer(lambda _: WORLD_NAMES)
modes = completer(lambda _: mode_names.names())
initial_modes = completer(lambda _: mode_names.initial())
services = completer(lambda _: BY_NAME)
levels = completer(lambda _: LEVELS)


@completer
def actuators(ctx: typer.Context) -> Iterable[str]:
    """For ``--actuators``: of the robot asked for."""
    folder = resources.robot_folder(ctx.params.get("robot") or "escher")
    return _table(folder)["actuators"]


@completer
def arm_presets(ctx: typer.Context) -> Iterable[str]:
    """Postures of the arms of the robot that is up."""
    return _table(_settings(ctx).robot).get("arm_presets", ())


@completer
def hand_presets(ctx: typer.Context) -> Iterable[str]:
    """Postures of the hands of the robot that is up."""
    return _table(_settings(ctx).robot).get("hand_presets", ())


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
