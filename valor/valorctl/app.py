"""The command line as a whole: its verbs, and the option that all of them share."""

from __future__ import annotations

import functools
import math
import os
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from valor.valorctl import completion
from valor.valorctl.console import say
from valor.valorctl.verbs import (
    bags,
    calibration,
    demonstration,
    diagnosis,
    experiments,
    hosts,
    lifecycle,
    links,
    motion,
    observation,
    robots,
    step,
    tracing,
    video,
)

# Groups of Bifrost's own verbs: a list of all verbs names them, and waits for none of their imports.
MOUNTED = {"topic": "See what is published on Bifrost.", "service": "See and call what is served on Bifrost."}


def hoist_instance(arguments: list[str]) -> list[str]:
    """Move ``--instance NAME`` to the front, wherever it stands before ``--``: every verb accepts it."""
    hoisted: list[str] = []
    rest: list[str] = []
    waiting = list(arguments)
    while waiting:
        argument = waiting.pop(0)
        if argument == "--":
            rest += [argument, *waiting]
            break
        if argument == "--instance":
            hoisted += [argument, *waiting[:1]]
            del waiting[:1]
        elif argument.startswith("--instance="):
            hoisted.append(argument)
        else:
            rest.append(argument)
    return hoisted + rest


def _finite(ctx: Any, parameter: Any, value: Any) -> Any:
    """No number of a command line is infinite or none at all."""
    for number in value if isinstance(value, (list, tuple)) else (value,):
        if isinstance(number, float) and not math.isfinite(number):
            raise typer.BadParameter(f"{number}: expected a finite number", ctx=ctx, param=parameter)
    return value


def _strict(command: Any) -> Any:
    """A verb, or a group of them, whose numbers are finite."""
    for parameter in command.params:
        parameter.callback = parameter.callback or _finite
    for verb in getattr(command, "commands", {}).values():
        _strict(verb)
    return command


class _Mounted(TyperGroup):
    """A group that is loaded when one of its verbs is asked for."""

    def __init__(self, name: str, instance: str | None) -> None:
        super().__init__(name=name, help=MOUNTED[name], no_args_is_help=True, rich_markup_mode=None)
        self._instance = instance

    @functools.cached_property
    def _group(self) -> Any:
        from valor.valorctl.verbs.bifrost_verbs import command

        return _strict(command(self.name or "", self._instance))

    def invoke(self, ctx: Any) -> Any:
        from valor.valorctl.verbs.bifrost_verbs import catalogue

        ctx.obj = catalogue(self.name or "", self._instance)
        return super().invoke(ctx)

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self._group.list_commands(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return self._group.get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        return self._group.resolve_command(ctx, args)


class _Verbs(TyperGroup):
    """Verbs that are loaded late, and a shared option that may stand anywhere."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, hoist_instance(args))

    def list_commands(self, ctx: Any) -> list[str]:
        return [*super().list_commands(ctx), *MOUNTED]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in MOUNTED:
            return _Mounted(cmd_name, ctx.params.get("instance"))  # before the shared option's own callback runs
        found = super().get_command(ctx, cmd_name)
        return found and _strict(found)


app = typer.Typer(
    name="valorctl",
    cls=_Verbs,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # which would take the units in brackets for its own
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Starts, watches, drives and stops a robot system. Every verb takes --instance NAME, before or behind it.",
)
for _group in (
    lifecycle,
    observation,
    motion,
    step,
    calibration,
    robots,
    bags,
    demonstration,
    experiments,
    diagnosis,
    hosts,
    links,
    tracing,
    video,
):
    _group.register(app)


def _tell_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        say(f"valor {version('valor')}")
        raise typer.Exit


@app.callback()
def _shared(
    instance: Annotated[
        str | None,
        typer.Option(
            envvar="VALOR_INSTANCE",
            help="Which of the systems on this computer; `default` if none is named.",
            autocompletion=completion.instances,
        ),
    ] = None,
    version: Annotated[  # its callback does it
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    if instance is not None:
        os.environ["VALOR_INSTANCE"] = instance
