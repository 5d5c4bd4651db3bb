"""What the command line says of itself: help in one style, and values that a shell completes."""

from __future__ import annotations

import os
import shutil
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
from valor.common.resources import profiles, robots
from valor.simulation.world_names import WORLD_NAMES
from valor.simulation.worlds import WORLDS
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valorctl.app import MOUNTED, app

VALORCTL = Path(sys.executable).with_name("valorctl")


HEAVY = frozenset(
    ("asyncio", "casadi", "daqp", "fpdf", "google", "matplotlib", "mcap", "mujoco", "multiprocessing", "numpy", "PIL",
     "psutil", "pydantic", "pygments", "rclpy", "rich", "rosbags", "scipy", "yaml", "zmq")
)  # fmt: skip
"""What takes longer to import than a person should notice; all of it is there."""


def imported(*arguments: str, environment: Mapping[str, str] = os.environ) -> set[str]:
    """The packages that a run of valorctl imports."""
    command = [sys.executable, "-X", "importtime", str(VALORCTL), *arguments]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stderr
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in told.splitlines()}


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_who_only_asks_waits_for_no_import(option: str) -> None:
    assert imported(option) & HEAVY == set()


def test_what_is_told_of_bifrosts_own_verbs_is_what_they_say() -> None:
    assert {group.info.name: group.info.help for group in (cli.topic, cli.service)} == MOUNTED


def verbs(group: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every verb and every group of verbs, by its words."""
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
    assert shown.startswith("Usage: ")
    assert not set("╭│╰─") & set(shown)
    text = " ".join(shown.split())
    for parameter in VERBS[words].params:
        for word in (getattr(parameter, "help", None) or "").split():
            assert word in text, f"{parameter.name}: {parameter.help}"


def test_up_names_all_that_it_can_start() -> None:
    shown = CliRunner().invoke(app, ["up", "-h"]).output
    for name in (*profiles(), *robots(), *WORLD_NAMES):
        assert name in shown


def test_names_told_without_mujoco_and_the_vrc_are_theirs() -> None:
    assert tuple(WORLDS) == WORLD_NAMES
    table = ControlModeTable.load()
    assert mode_names.names() == list(table.modes)
    assert set(mode_names.initial()) == table.modes[mode_names.PREPARING].to | {mode_names.PREPARING}


def completed(shell: str, line: str, home: Path) -> list[str]:
    """What a shell offers behind a line."""
    words = line.split(" ")
    told = {
        "bash": {"COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)},
        "zsh": {"_TYPER_COMPLETE_ARGS": line},
        "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    }[shell]
    environment = {"VALOR_HOME": str(home), "_VALORCTL_COMPLETE": f"complete_{shell}", **told}
    result = CliRunner().invoke(app, [], env=environment, prog_name="valorctl", complete_var="_VALORCTL_COMPLETE")
    assert result.exit_code == 0, result.output
    return result.output.split()


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """With an instance that is up."""
    made = Instance("lab", tmp_path)
    made.logs.mkdir(parents=True)
    made.settings_file.write_text(Settings(robot=ROBOTS / "escher", ros_domain_id=7).json())
    return tmp_path


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("valorctl st", {"status", "step"}),
        ("valorctl topic e", {"echo"}),
        ("valorctl bag re", {"recover"}),
        ("valorctl up --profile ", set(profiles())),
        ("valorctl up --robot t", {"thor"}),
        ("valorctl up --world st", {"stairs", "stairs_15cm"}),
        ("valorctl up --actuators i", {"ideal"}),
        ("valorctl up --clock l", {"lockstep"}),
        ("valorctl up --initial-mode stand_", {"stand_prep", "stand_manipulate"}),
        ("valorctl mode so", {"soft_stop"}),
        ("valorctl arm l", {"left"}),
        ("valorctl arm left f --instance lab", set()),
        ("valorctl --instance lab arm left f", {"forward"}),
        ("valorctl --instance lab hand left c", {"close"}),
        ("valorctl --instance nobody hand left c", set()),
        ("valorctl --instance l", {"lab"}),
        ("valorctl restart motion", {"motion_manager"}),
        ("valorctl logs comms", {"comms_manager"}),
        ("valorctl experiment a", {"all"}),
    ],
)
def test_values_are_completed(line: str, offered: set[str], home: Path) -> None:
    assert set(completed("bash", line, home)) >= offered
    if " " in line and not line.split(" ")[-2].startswith("-"):
        begun = line.rsplit(" ", maxsplit=1)[-1]
        assert all(each.startswith(begun) for each in completed("bash", line, home))


def test_topics_are_not_completed_where_nothing_is_up(home: Path) -> None:
    assert completed("bash", "valorctl topic hz ", home) == []


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_are_offered_the_same(shell: str, home: Path) -> None:
    assert "dirt" in " ".join(completed(shell, "valorctl up --world d", home))
    assert "freeze" in " ".join(completed(shell, "valorctl mode fr", home))


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_the_script_completes_in_bash(home: Path) -> None:
    script = subprocess.run(
        [VALORCTL, "--show-completion", "bash"],
        env=os.environ | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    ask = f"{script}\nCOMP_WORDS=({VALORCTL} restart bif); COMP_CWORD=2; _valorctl_completion {VALORCTL}\n"
    ask += 'echo "${COMPREPLY[@]}"'
    told = subprocess.run(
        ["bash", "-c", ask], env=os.environ | {"VALOR_HOME": str(home)}, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == ["bifrostd"]
