"""Advice in messages: each command that an error, a status or a check names exists, and parses."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from valor.valorctl.status.status import WAY_OUT
from valor.valorctl.terminal.app import app, hoist_instance

ROOT = Path(__file__).parents[2]
COMMAND: Any = typer.main.get_command(app)
QUOTED = re.compile(r"`(valorctl [^`]*)`|^\s*(?:when .*: )?(valorctl (?!or |on )[^`]*)$")


def texts(tree: ast.Module) -> Iterator[str]:
    """The strings of a module except docstrings; what an f-string inserts is a word, or nothing if it is an option."""
    documentation = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    parts = {part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(inserted(part) for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in documentation | parts:
            yield node.value


def inserted(part: ast.expr) -> str:
    if isinstance(part, ast.Constant):
        return str(part.value)
    return "" if "option" in ast.unparse(part) else "x"


def advised() -> Iterator[tuple[str, str]]:
    """Commands that messages name, with their files."""
    for verb in (*WAY_OUT.values(), "reset", "time resume"):
        yield f"valorctl {verb}", "status.py"
    for folder in ("valor", "services", "bifrost"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            for text in texts(ast.parse(file.read_text())):
                for line in text.splitlines():
                    for quoted in QUOTED.finditer(line):
                        commands = (quoted[1] or quoted[2]).split("; ")
                        yield from ((each, str(file.relative_to(ROOT))) for each in commands if each != "valorctl x")


def require_valid(command: str) -> None:
    """Parse a command line as `valorctl` does; raises an error of Typer."""
    verb = COMMAND
    context = verb.make_context("valorctl", hoist_instance(shlex.split(command)[1:]))
    while hasattr(verb, "commands"):
        name, verb, rest = verb.resolve_command(context, [*context._protected_args, *context.args])
        context = verb.make_context(name, rest, parent=context)


@pytest.mark.parametrize(("command", "file"), sorted(set(advised())))
def test_an_advised_command_is_valid(command: str, file: str) -> None:
    require_valid(command)


@pytest.mark.parametrize(
    "command", ["valorctl reboot", "valorctl bag mend x", "valorctl status --loud", "valorctl arm"]
)
def test_invalid_commands_are_detected(command: str) -> None:
    with pytest.raises(typer.TyperException):
        require_valid(command)
