"""The command line: all verbs, and the options that they share."""

import functools
import importlib
import math
import os
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import complain, say

_DRIVE = "valor.valorctl.drive"
# The verbs that each module adds by its ``register``. A command line imports only the module of its verb.
MODULES: dict[str, tuple[str, ...]] = {
    "valor.valorctl.instance.lifecycle_verbs": ("up", "down", "restart", "reset", "host"),
    "valor.valorctl.status.observation_verbs": ("status", "view", "logs", "env", "doctor"),
    f"{_DRIVE}.motion_verbs": ("stop", "mode", "controller", "arm", "hand", "walk", "step", "push", "time", "get-up"),
    f"{_DRIVE}.calibration_verbs": ("calibrate",),
    "valor.valorctl.robots.robot_verbs": ("robot",),
    "valor.valorctl.policies.policy_verbs": ("policy",),
    "valor.valorctl.recordings.bag_verbs": ("bag", "video"),
    "valor.valorctl.demos.demo_verbs": ("demo",),
    "valor.valorctl.status.trace_verbs": ("trace",),
}
# Bifrost's own groups of verbs: the help names them without importing them.
BIFROST = {"topic": "Show and publish Bifrost topics.", "service": "Show and call Bifrost services."}
ADDED = "valorctl.verbs"  # group of entry points by which other distributions add verbs


def hoist_instance(arguments: list[str]) -> list[str]:
    """Move ``--instance NAME`` from any position before ``--`` to the front, so that every verb accepts it."""
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
    for number in value if isinstance(value, (list, tuple)) else (value,):
        if isinstance(number, float) and not math.isfinite(number):
            raise typer.BadParameter(f"{number}: expected a finite number", ctx=ctx, param=parameter)
    return value


def _strict(command: Any) -> Any:
    """Make a verb, or the verbs of a group, reject infinite numbers and NaN."""
    for parameter in command.params:
        parameter.callback = parameter.callback or _finite
    for verb in getattr(command, "commands", {}).values():
        _strict(verb)
    return command


class _BifrostGroup(TyperGroup):
    """A group of Bifrost's verbs, imported on first use, in the network of the instance on the command line."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self._loaded(ctx))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return self._loaded(ctx).get(cmd_name)

    def _loaded(self, ctx: Any) -> Any:
        if not self.commands:
            from valor.valorctl.status.bifrost_verbs import command

            instance = ctx.find_root().params.get("instance")  # needed before the callback of ``app`` runs
            self.commands = _strict(command(self.name or "", instance)).commands
        return self.commands


def _registered(*registers: Callable[[typer.Typer], None]) -> dict[str, Any]:
    scratch = typer.Typer(rich_markup_mode=None)
    for register in registers:
        register(scratch)
    return {name: _strict(command) for name, command in typer.main.get_group(scratch).commands.items()}


@functools.cache
def _added() -> dict[str, Any]:
    """Verbs of other distributions: each entry point of the group names a ``register`` function."""
    from importlib.metadata import entry_points

    found: dict[str, Any] = {}
    for entry in entry_points(group=ADDED):
        try:
            found |= _registered(entry.load())
        except Exception as error:
            name = entry.dist.name if entry.dist else entry.name
            what = f"its verbs cannot be loaded ({type(error).__name__}: {error})"
            complain(f"{name}: {what}; reinstall or uninstall {name}")
    return found


class _Verbs(TyperGroup):
    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        groups = {
            name: _BifrostGroup(name=name, help=text, no_args_is_help=True, rich_markup_mode=None)
            for name, text in BIFROST.items()
        }
        names = dict.fromkeys(name for verbs in MODULES.values() for name in verbs)
        self.commands: dict[str, Any] = names | groups  # None: not imported yet

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, hoist_instance(args))

    def list_commands(self, ctx: Any) -> list[str]:
        self.commands |= _added()
        return super().list_commands(ctx)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands:
            self.commands |= _added()
        if cmd_name in self.commands and self.commands[cmd_name] is None:
            module = next(module for module, verbs in MODULES.items() if cmd_name in verbs)
            self.commands |= _registered(importlib.import_module(module).register)
        return self.commands.get(cmd_name)


app = typer.Typer(
    name="valorctl",
    cls=_Verbs,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # would interpret units in brackets
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Start, observe, command and stop a robot system. Every verb accepts --instance NAME, before or after it.",
)


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        say(f"valor {version('valor')}")
        raise typer.Exit


@app.callback()
def _shared(
    instance: Annotated[
        str | None,
        typer.Option(
            envvar="VALOR_INSTANCE",
            help="System on this computer. [default: default]",
            autocompletion=completion.instances,
        ),
    ] = None,
    version: Annotated[  # handled by its callback
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if instance is not None:
        os.environ["VALOR_INSTANCE"] = instance
