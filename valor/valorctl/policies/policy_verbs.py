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
from valor.valorctl.terminal.console import rich_console, say, say_json, table
from valor.valorctl.terminal.options import Json, OptionalRobot, Robot

if TYPE_CHECKING:
    from valor.policies.contract import Contract
    from valor.policies.facts import Fact

policy = typer.Typer(
    name="policy", help="Add, list and check robots' trained policies.", no_args_is_help=True, rich_markup_mode=None
)
Force = Annotated[bool, typer.Option("--force", help="Replace an existing policy.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(policy)


@policy.command()
def add(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="ONNX file; its YAML files are next to it.")],
    *,
    robot: Robot = "escher",
    name: Annotated[str | None, typer.Option(help="Name of the policy. [default: the file's]")] = None,
    force: Force = False,
) -> None:
    """Check a policy and copy it, its sidecar and its exporter's files into a robot's folder."""
    from valor.common import whole_file
    from valor.policies import exported
    from valor.policies.contract import sidecar_of

    file = file.expanduser()
    _shown(file, robot)
    target = robot_folder(robot) / "policies" / f"{name or file.stem}.onnx"
    if target.exists() and not force:
        raise ConfigurationError(f"{target}: exists; expected another --name, or --force to replace it")
    copies = {file: target, sidecar_of(file): target.with_suffix(".yaml")}
    if (found := exported.find(file)) is not None:
        copies[found[0]] = target.with_suffix(f".{found[1]}.yaml")
    beside = [*file.parent.glob(f"{file.stem}*.data"), *file.parent.glob("*_initial_values.safetensors")]
    copies |= {each: target.with_name(each.name) for each in beside}
    try:
        target.parent.mkdir(exist_ok=True)
        for source, copy in copies.items():
            if source.is_file() and source.resolve() != copy.resolve():
                whole_file.write(copy, source.read_bytes())
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: {error.strerror}; expected a robot's folder of your own") from None
    say(f"{target}: added. Next:\n  valorctl policy check {target.stem} --robot {robot}")


@policy.command("list")
def list_policies(robot: OptionalRobot = None, json: Json = False) -> None:
    """List policies of a robot, or of all, and what is wrong with them."""
    from valor.policies import contract
    from valor.robot.description import RobotDescription

    rows: list[dict[str, Any]] = []
    for named in [robot] if robot else robots():
        described = RobotDescription.load(robot_folder(named))
        for file in policies(named):
            row: dict[str, Any] = {"robot": named, "policy": file.stem}
            try:
                found = contract.load(file, described)
                row |= {"convention": found.convention, "joints": len(found.joints), "period": found.period}
            except ConfigurationError as error:
                row["rejected"] = str(error).splitlines()
            rows.append(row)
    if json:
        say_json(rows)
        return
    shown = table("robot", "policy", "convention", "joints", "period [ms]", "", numbers=("joints", "period [ms]"))
    for row in rows:
        faults = f"rejected: {len(row['rejected'])} problems; `policy check` names them" if "rejected" in row else ""
        period = f"{row['period'] * 1e3:g}" if "period" in row else "–"
        cells = [str(row.get(key, "–")) for key in ("robot", "policy", "convention", "joints")]
        shown.add_row(*cells, period, faults)
    rich_console().print(shown) if rows else say("no policies; `valorctl policy add` adds one")


@policy.command()
def check(
    named: Annotated[
        str,
        typer.Argument(
            metavar="POLICY", help="A name from `policy list`, or an ONNX file.", autocompletion=completion.policies
        ),
    ],
    *,
    robot: Robot = "escher",
    json: Json = False,
) -> None:
    """Show every fact about a policy with its source, and let it act on 100 random states."""
    from valor.policies import trial
    from valor.policies.policy import Policy
    from valor.robot.description import RobotDescription

    known = {file.stem: file for file in policies(robot)}
    file = known.get(named, Path(named).expanduser())
    if named not in known and not file.is_file():
        raise ConfigurationError(f"policy {expected(named, known, 'an ONNX file, or ')}")
    described = RobotDescription.load(robot_folder(robot))
    contract = _shown(file, robot, json=json)
    result = trial.run(Policy(contract, described), described)
    if json:
        say_json({"policy": str(file), "facts": _plain(contract.facts), "trial": asdict(result)})
    else:
        size = f"{file.stat().st_size / 1e3:.0f} kB"
        times = f"{result.median * 1e3:.2f} ms median, {result.p99 * 1e3:.2f} ms p99 of {contract.period * 1e3:g} ms"
        within = f"{result.within:.0%} of targets within {described.name}'s limits"
        say(f"{size}; {result.acts} acts on random states: {times}; {within}")
    if not result.finite:
        raise ValorError(f"{named}: targets are not finite on random states; expected finite numbers")


def _shown(file: Path, robot: str, *, json: bool = False) -> Contract:
    """Load a policy and print all facts about it, also if it is rejected."""
    from valor.policies.contract import PolicyError, load
    from valor.robot.description import RobotDescription

    try:
        contract = load(file, RobotDescription.load(robot_folder(robot)))
    except PolicyError as error:
        if not json:
            _print(error.facts)
        raise
    if not json:
        say(f"convention: {contract.convention}")
        _print(contract.facts)
    return contract


def _print(facts: Mapping[str, Fact]) -> None:
    shown = table("fact", "value", "source", "")
    for name, fact in facts.items():
        shown.add_row(name, _text(fact.value), fact.source, fact.where)
    rich_console().print(shown, markup=False)


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {_text(each)}" for name, each in value.items())
    if isinstance(value, (list, tuple)):
        texts = [_text(each) for each in value]
        return f"{len(texts)} × {texts[0]}" if len(texts) > 1 and len(set(texts)) == 1 else ", ".join(texts)
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def _plain(facts: Mapping[str, Fact]) -> dict[str, Any]:
    import msgspec

    plain: dict[str, Any] = msgspec.to_builtins({name: asdict(fact) for name, fact in facts.items()})
    return plain
