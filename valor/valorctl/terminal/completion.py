"""Shell completion of values, from tables without services. A failure yields no values."""

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import typer

from valor.common import mode_names, resources
from valor.common.instance import Instance, Settings
from valor.common.processes import BY_NAME
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl.status.log_reader import LEVELS

Names = Callable[[typer.Context], Iterable[str]]


def completer(names: Names) -> Callable[[typer.Context, str], list[str]]:
    """A completion function that offers the names with the given prefix."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            return [name for name in names(ctx) if name.startswith(incomplete)]
        except Exception:  # a traceback would appear in the middle of the command line
            return []

    return complete


profiles = completer(lambda _: resources.names("profile"))
deployments = completer(lambda _: resources.names("deployment"))
robots = completer(lambda _: resources.robots())
plans = completer(lambda _: resources.names("plan"))
worlds = completer(lambda _: WORLD_NAMES)
modes = completer(lambda _: mode_names.modes())
initial_modes = completer(lambda _: mode_names.initial())
services = completer(lambda _: BY_NAME)
levels = completer(lambda _: LEVELS)

policies = completer(lambda ctx: [file.stem for file in resources.policies(ctx.params.get("robot") or "escher")])


@completer
def actuators(ctx: typer.Context) -> Iterable[str]:
    """Actuator profiles of the robot on the command line."""
    folder = resources.robot_folder(ctx.params.get("robot") or "escher")
    return _table(folder)["actuators"]


@completer
def arm_presets(ctx: typer.Context) -> Iterable[str]:
    """Arm postures of the robot that is up."""
    return _table(_settings(ctx).robot).get("arm_presets", ())


@completer
def controllers(ctx: typer.Context) -> Iterable[str]:
    """Controllers of the robot that is up."""
    from valor.robot.motion_tables import WHOLE_BODY

    lists: Mapping[str, str | list[str]] = _table(_settings(ctx).robot).get("controllers", {})  # type: ignore[assignment]
    return sorted({WHOLE_BODY}.union(*([each] if isinstance(each, str) else each for each in lists.values())))


@completer
def hand_presets(ctx: typer.Context) -> Iterable[str]:
    """Hand postures of the robot that is up."""
    return _table(_settings(ctx).robot).get("hand_presets", ())


@completer
def instances(_: typer.Context) -> Iterable[str]:
    """Instances that are up, or were."""
    home = Instance.from_environment().folder.parent
    return sorted(folder.name for folder in home.iterdir() if (folder / "logs").is_dir())


def _settings(ctx: typer.Context) -> Settings:
    """Settings of the instance on the command line, else of the environment's."""
    return Instance.from_environment(
        ctx.find_root().params.get("instance") or os.environ.get("VALOR_INSTANCE")
    ).settings()


def _table(folder: Path) -> dict[str, Iterable[str]]:
    """A robot's table without validation, which would be too slow for completion."""
    from valor.common.document import Document

    content: dict[str, Iterable[str]] = Document.load(folder / "robot.yaml").content  # type: ignore[assignment]
    return content
