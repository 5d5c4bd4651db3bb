"""``doctor``."""

from __future__ import annotations

from dataclasses import asdict

import typer

from valor.common.instance import Instance
from valor.valorctl.console import progress, rich_console, say_json
from valor.valorctl.verbs.options import Deployment, Json

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(doctor)


def doctor(json: Json = False, deployment: Deployment = None) -> None:
    """Look at this computer, or all hosts, and the instance for what is known to go wrong; say what to do about it."""
    from valor.valorctl.checks import run_all

    instance = Instance.from_environment()
    with progress() as shown:
        if deployment is not None or (instance.settings_file.exists() and instance.settings().hosts):
            from valor.valorctl.hosts.diagnosis import run_everywhere

            findings = run_everywhere(instance, deployment, shown.waiting)
        else:
            findings = run_all(instance, shown.waiting)
    if json:
        say_json([asdict(finding) for finding in findings])
    else:
        console = rich_console()
        for finding in findings:
            console.print(f"[{_COLOURS[finding.level]}]{finding.level:4}[/] {finding.check:10} ", end="")
            console.print(f"{finding.host}: {finding.text}" if finding.host else finding.text, markup=False)
            if finding.advice:
                console.print(f"{'':16}→ {finding.advice}", markup=False)
    if any(finding.level == "fail" for finding in findings):
        raise typer.Exit(1)
