"""What a shell completes values to: names of what there is, read from tables alone. Never fails: it then knows none."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import ParamSpec

import typer

from valor.common.instance import Instance, Settings

P = ParamSpec("P")


def _named(names: Callable[P, Iterable[str]]) -> Callable[P, list[str]]:
    """Without an instance or its files there are no names."""

    @functools.wraps(names)
    def safe(*args: P.args, **kwargs: P.kwargs) -> list[str]:
        try:
            return list(names(*args, **kwargs))
        except Exception:  # a traceback in the middle of somebody's command line helps nobody
            return []

    return safe


@_named
def profiles(incomplete: str) -> Iterable[str]:
    """For ``--profile``."""
    from valor.common.resources import profiles

    return _begun(incomplete, profiles())


@_named
def robots(incomplete: str) -> Iterable[str]:
    """For ``--robot``."""
    from valor.common.resources import robots

    return _begun(incomplete, robots())


@_named
def plans(incomplete: str) -> Iterable[str]:
    """For ``step``."""
    from valor.common.resources import plans

    return _begun(incomplete, plans())


@_named
def worlds(incomplete: str) -> Iterable[str]:
    """For ``--world``."""
    from valor.simulation.world_names import WORLD_NAMES

    return _begun(incomplete, WORLD_NAMES)


@_named
def actuators(ctx: typer.Context, incomplete: str) -> Iterable[str]:
    """For ``--actuators``: of the robot asked for."""
    from valor.common.resources import robot_folder

    folder = robot_folder(ctx.params.get("robot") or "escher")
    return _begun(incomplete, _table(folder)["actuators"])


@_named
def modes(incomplete: str) -> Iterable[str]:
    """Control modes."""
    from valor.valorctl.mode_names import names

    return _begun(incomplete, names())


@_named
def initial_modes(incomplete: str) -> Iterable[str]:
    """Control modes that ``up`` can bring a robot to."""
    from valor.valorctl.mode_names import initial

    return _begun(incomplete, initial())


@_named
def services(incomplete: str) -> Iterable[str]:
    """Processes."""
    from valor.common.processes import BY_NAME

    return _begun(incomplete, BY_NAME)


@_named
def levels(incomplete: str) -> Iterable[str]:
    """Of logs."""
    from valor.valorctl.log_reader import LEVELS

    return _begun(incomplete, LEVELS)


@_named
def arm_presets(ctx: typer.Context, incomplete: str) -> Iterable[str]:
    """Postures of the arms of the robot that is up."""
    return _begun(incomplete, _table(_settings(ctx).robot)["arm_presets"])


@_named
def hand_presets(ctx: typer.Context, incomplete: str) -> Iterable[str]:
    """Postures of the hands of the robot that is up."""
    return _begun(incomplete, _table(_settings(ctx).robot)["hand_presets"])


@_named
def instances(incomplete: str) -> Iterable[str]:
    """Those that are up, or have been."""
    home = Instance.from_environment().folder.parent
    return _begun(incomplete, sorted(folder.name for folder in home.iterdir() if (folder / "logs").is_dir()))


@_named
def experiments(incomplete: str) -> Iterable[str]:
    """Experiments, and all of them."""
    from valor.valorctl.experiments.table import BY_NAME

    return _begun(incomplete, [*BY_NAME, "all"])


def _begun(incomplete: str, names: Iterable[str]) -> Iterable[str]:
    return (name for name in names if name.startswith(incomplete))


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
