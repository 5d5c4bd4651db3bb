"""``policy add``, ``policy list``, ``policy check``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valor.common.errors import ConfigurationError, ValorError, expected
from valor.common.resources import policies, robot_folder, robots
from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import Interruption, progress, rich_console, say, say_json, table
from valor.valorctl.terminal.options import Json, OptionalRobot, Robot

if TYPE_CHECKING:
    from valor.policies.contract import Contract
    from valor.robot.description import RobotDescription
    from valor.self_test.results import AcceptanceResult

policy = typer.Typer(
    name="policy", help="Add, list and check robots' trained policies.", no_args_is_help=True, rich_markup_mode=None
)
Named = Annotated[
    str,
    typer.Argument(
        metavar="POLICY", help="A name from `policy list`, or an ONNX file.", autocompletion=completion.policies
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(policy)


@policy.command()
def add(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="ONNX file; its YAML files are next to it.")],
    *,
    robot: Robot = "escher",
    name: Annotated[str | None, typer.Option(help="Name of the policy. [default: the file's]")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing policy.")] = False,
) -> None:
    """Check a policy and copy it, its sidecar and its exporter's files into a robot's folder."""
    from valor.common import whole_file
    from valor.policies.contract import files_of

    file = file.expanduser()
    _load(file, _described(robot), shown=True)
    target = robot_folder(robot) / "policies" / f"{name or file.stem}.onnx"
    if target.exists() and not force:
        raise ConfigurationError(f"{target}: exists; expected another --name, or --force to replace it")
    try:
        target.parent.mkdir(exist_ok=True)
        for source, copy in files_of(file, target).items():
            if source.is_file() and source.resolve() != copy.resolve():
                whole_file.write(copy, source.read_bytes())
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: {error.strerror}; expected a robot's folder of your own") from None
    say(f"{target}: added. Next:\n  valorctl policy check {target.stem} --robot {robot}")


@policy.command("list")
def list_policies(robot: OptionalRobot = None, json: Json = False) -> None:
    """List policies of a robot, or of all, and what is wrong with them."""
    rows: list[dict[str, Any]] = []
    for named in [robot] if robot else robots():
        for file in policies(named):
            row: dict[str, Any] = {
                "robot": named,
                "policy": file.stem,
                "convention": "–",
                "joints": 0,
                "period": 0.0,
                "rejected": [],
            }
            try:
                found = _load(file, _described(named), shown=False)
                row |= {"convention": found.convention, "joints": len(found.joints), "period": found.period}
            except ConfigurationError as error:
                row["rejected"] = str(error).splitlines()
            rows.append(row)
    if json:
        say_json(rows)
    elif not rows:
        say("no policies; `valorctl policy add FILE` adds one")
    else:
        shown = table("robot", "policy", "convention", "joints", "period [s]", "", numbers=("joints", "period [s]"))
        for row in rows:
            faults = f"rejected: {len(row['rejected'])} problems; `policy check` names them" if row["rejected"] else ""
            shown.add_row(*(str(value) for value in [*row.values()][:-1]), faults)
        rich_console().print(shown)


@policy.command()
def check(
    named: Named,
    *,
    robot: Robot = "escher",
    no_play: Annotated[bool, typer.Option("--no-play", help="Do not simulate the robot.")] = False,
    json: Json = False,
) -> None:
    """Show every fact about a policy with its source, let it act on 100 random states, then control the robot.

    In simulation it takes over from the Whole-Body Controller, is pushed, walks, and gives back.
    """
    import msgspec

    from valor.policies import trial
    from valor.policies.policy import Policy
    from valor.valorctl.robots import robot_check
    from valor.valorctl.robots.robot_verbs import results_table

    known = {file.stem: file for file in policies(robot)}
    file = known.get(named, Path(named).expanduser())
    if named not in known and not file.is_file():
        raise ConfigurationError(f"policy {expected(named, known, 'an ONNX file, or ')}")
    described = _described(robot)
    contract = _load(file, described, shown=not json)
    result = trial.run(Policy(contract, described), described)
    results: list[AcceptanceResult] = []
    if result.finite and not no_play:
        with progress() as shown, Interruption() as interruption:
            results = robot_check.run(robot_folder(robot), interruption.check, shown.waiting, file)
    if json:
        found = {"facts": msgspec.to_builtins(contract.facts), "trial": asdict(result)}
        say_json({"policy": str(file), **found, "rungs": msgspec.to_builtins(results)})
    else:
        times = f"{result.median * 1e3:.2f} ms median, {result.p99 * 1e3:.2f} ms p99 of {contract.period * 1e3:g} ms"
        within = f"{result.within:.0%} of targets within {described.name}'s limits"
        say(f"{file.stat().st_size / 1e3:.0f} kB; {result.acts} acts on random states: {times}; {within}")
    if not result.finite:
        raise ValorError(f"{named}: targets are not finite on random states; expected finite numbers")
    if results and not json:
        rich_console().print(results_table(results))
    if failed := [f"{each.name} ({each.profile})" for each in results if not each.passed]:
        raise ValorError(f"{named}: {len(failed)} of {len(results)} tests failed: {', '.join(failed)}")


@policy.command()
def export(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new one.")], *, robot: Robot = "escher"
) -> None:
    """Write a package by which mjlab trains a policy that walks a robot; training needs a GPU and mjlab."""
    from valor.policies import training

    folder = folder.expanduser()
    task = training.export(_described(robot), folder)
    say(f"{folder}: written. Next, where mjlab is to train:\n  pip install -e {folder}\n  train {task}")


def _described(robot: str) -> RobotDescription:
    from valor.robot.description import RobotDescription

    return RobotDescription.load(robot_folder(robot))


def _load(file: Path, robot: RobotDescription, *, shown: bool) -> Contract:
    """Load a policy; print all facts about it, also if it is rejected."""
    from valor.policies.contract import PolicyError, load

    known: Contract | PolicyError | None = None
    try:
        known = load(file, robot)
    except PolicyError as error:
        known = error
        raise
    finally:
        if shown and known is not None:
            rows = table("fact", "value", "source", "")
            for name, fact in known.facts.items():
                rows.add_row(name, _text(fact.value), fact.source, fact.where)
            say(f"convention: {known.convention}")
            rich_console().print(rows, markup=False)
    return known


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {_text(each)}" for name, each in value.items())
    if isinstance(value, (list, tuple)):
        texts = [_text(each) for each in value]
        return f"{len(texts)} × {texts[0]}" if len(texts) > 1 and len(set(texts)) == 1 else ", ".join(texts)
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
