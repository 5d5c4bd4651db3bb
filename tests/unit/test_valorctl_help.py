"""Help of every verb in one style, and shell completion of values."""

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from bifrost import cli
from harness.places import ROBOTS
from valor.common import mode_names
from valor.common.instance import Instance, Settings
from valor.common.resources import names
from valor.simulation.world_names import WORLD_NAMES
from valor.simulation.worlds import WORLDS
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valorctl.terminal.app import BIFROST, app

VALORCTL = Path(sys.executable).with_name("valorctl")


HEAVY = frozenset(
    ("asyncio", "casadi", "daqp", "fpdf", "google", "matplotlib", "mcap", "mujoco", "multiprocessing", "numpy", "PIL",
     "psutil", "pydantic", "pygments", "rclpy", "rich", "rosbags", "scipy", "yaml", "zmq")
)  # fmt: skip
"""What takes longer to import than a person should notice; all of it is there."""


def imported(*arguments: str, environment: Mapping[str, str] = os.environ) -> set[str]:
    """The packages that a run of valorctl imports."""
    command = [sys.executable, "-X", "importtime", str(VALORCTL), *arguments]
    reported = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stderr
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in reported.splitlines()}


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_need_no_heavy_import(option: str) -> None:
    assert imported(option) & HEAVY == set()


def test_the_listed_help_of_bifrosts_groups_is_theirs() -> None:
    assert {group.info.name: group.info.help for group in (cli.topic, cli.service)} == BIFROST


def verbs(group: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    context = typer.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*path, name), command
        if hasattr(command, "list_commands"):
            yield from verbs(command, *path, name)


VERBS = dict(verbs(typer.main.get_command(app)))


@pytest.mark.parametrize("words", VERBS, ids=" ".join)
def test_help_is_plain_and_shows_every_unit(words: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*words, "-h"], env={"COLUMNS": "200"}).output
    assert shown == CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "200"}).output
    assert shown.startswith("Usage: ") and not set("╭│╰─") & set(shown)
    text = " ".join(shown.split())
    for parameter in VERBS[words].params:
        for word in (getattr(parameter, "help", None) or "").split():
            assert word in text, f"{parameter.name}: {parameter.help}"


def test_light_tables_of_names_equal_their_sources() -> None:
    assert tuple(WORLDS) == WORLD_NAMES
    table = ControlModeTable.load()
    assert list(mode_names.modes()) == list(table.modes)
    assert set(mode_names.initial()) == table.modes[mode_names.PREPARING].to | {mode_names.PREPARING}


def completed(line: str, home: Path) -> set[str]:
    """What bash offers behind a line."""
    environment = {
        "VALOR_HOME": str(home), "_VALORCTL_COMPLETE": "complete_bash", "COMP_WORDS": line,
        "COMP_CWORD": str(line.count(" ")),
    }  # fmt: skip
    result = CliRunner().invoke(app, [], env=environment, prog_name="valorctl", complete_var="_VALORCTL_COMPLETE")
    assert result.exit_code == 0, result.output
    return set(result.output.split())


@pytest.fixture
def home(tmp_path: Path) -> Path:
    made = Instance("lab", tmp_path)
    made.logs.mkdir(parents=True)
    made.settings_file.write_text(Settings(robot=ROBOTS / "escher", ros_domain_id=7).json())
    return tmp_path


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("valorctl st", {"status", "step"}),
        ("valorctl topic e", {"echo"}),
        ("valorctl up --profile ", set(names("profile"))),
        ("valorctl up --world st", {"stairs", "stairs_15cm"}),
        ("valorctl up --actuators i", {"ideal"}),
        ("valorctl up --initial-mode stand_", {"stand_prep", "stand_manipulate"}),
        ("valorctl mode so", {"soft_stop"}),
        ("valorctl --instance lab controller w", {"whole_body"}),
        ("valorctl arm l", {"left"}),
        ("valorctl arm left f --instance lab", set()),
        ("valorctl --instance lab arm left f", {"forward"}),
        ("valorctl --instance lab hand left c", {"close"}),
        ("valorctl --instance l", {"lab"}),
        ("valorctl restart motion", {"motion_manager"}),
    ],
)
def test_values_are_completed(line: str, offered: set[str], home: Path) -> None:
    found = completed(line, home)
    assert found >= offered
    if not line.split(" ")[-2].startswith("-"):
        assert all(each.startswith(line.rpartition(" ")[2]) for each in found)
