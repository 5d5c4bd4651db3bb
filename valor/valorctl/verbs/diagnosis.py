"""``doctor``."""

from __future__ import annotations

from dataclasses import asdict

import typer

from valor.common.instance import Instance
from valor.valorctl.console import progress, rich_console, say_json
from valor.valorctl.verbs.options import Json

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(doctor)


def doctor(json: Json = False) -> None:
    """Look at this computer and the instance for what is known to go wrong, and say what to do about it."""
    from valor.valorctl.checks import run_all

    with progress() as shown:
        findings = run_all(Instance.from_environment(), shown.waiting)
    if json:
        say_json([asdict(finding) for finding in findings])
    else:
        console = rich_console()
        for finding in findings:
            console.print(f"[{_COLOURS[finding.level]}]{finding.level:4}[/] {finding.check:10} ", end="")
            console.print(finding.text, markup=False)
            if finding.advice:
                console.print(f"{'':16}→ {finding.advice}", markup=False)
    if any(finding.level == "fail" for finding in findings):
        raise typer.Exit(1)
