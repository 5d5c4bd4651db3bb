"""The command line: the shared option anywhere, negative numbers, quoting, what is wrong is said to be wrong."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from harness.places import ROBOTS
from valor.common.instance import Instance, Settings
from valor.common.messages import ModeStatus
from valor.common.topics import MOTOR, SERVICE_TOPICS, TOPICS
from valor.valorctl.__main__ import run as main
from valor.valorctl.app import app, hoist_instance
from valor.valorctl.control_mode import ModeChange, flag_names
from valor.valorctl.environment import exports
from valor.valorctl.verbs.bifrost_verbs import catalogue

COMMAND: Any = typer.main.get_command(app)


def parsed(verb: str, *arguments: str) -> dict[str, object]:
    """What a verb is called with."""
    context = COMMAND.make_context("valorctl", [verb, *arguments])
    command = COMMAND.get_command(context, verb)
    parameters: dict[str, object] = command.make_context(verb, list(arguments), parent=context).params
    return parameters


@pytest.mark.parametrize(
    ("given", "hoisted"),
    [
        (["status", "--instance", "a"], ["--instance", "a", "status"]),
        (["--instance", "a", "status", "--json"], ["--instance", "a", "status", "--json"]),
        (["push", "-15", "--instance=a", "0", "0"], ["--instance=a", "push", "-15", "0", "0"]),
        (["status", "--instance"], ["--instance", "status"]),
        (["logs", "--", "--instance", "a"], ["logs", "--", "--instance", "a"]),
    ],
)
def test_the_instance_option_is_found_wherever_it_stands(given: list[str], hoisted: list[str]) -> None:
    assert hoist_instance(given) == hoisted


@given(st.lists(st.text(alphabet="ab-=", min_size=1, max_size=6), max_size=5), st.integers(0, 5))
def test_hoisting_leaves_everything_else_in_place(arguments: list[str], place: int) -> None:
    place = min(place, len(arguments))
    if "--" in arguments[:place]:
        return
    assert hoist_instance([*arguments[:place], "--instance", "x", *arguments[place:]]) == [
        "--instance",
        "x",
        *arguments,
    ]


@pytest.mark.parametrize("arguments", [["--instance", "x", "env"], ["env", "--instance", "x"]])
def test_the_instance_is_the_one_named(arguments: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setenv("VALOR_INSTANCE", "other")
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "instance.json").write_text(Settings(robot=tmp_path, ros_domain_id=7).json())
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "export VALOR_INSTANCE=x\n" in result.output
    assert "export ROS_DOMAIN_ID=7\n" in result.output


@pytest.mark.parametrize("arguments", [["--instance", "x", "topic", "list"], ["topic", "list", "--instance", "x"]])
def test_bifrost_verbs_go_to_the_instance_named(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    for name in ("VALOR_INSTANCE", "BIFROST_NETWORK", "BIFROST_KEYS"):
        monkeypatch.setenv(name, "other")
    monkeypatch.setattr("sys.argv", ["valorctl", *arguments])
    assert main() == 1
    assert "instance 'x' is not up" in capsys.readouterr().err


@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3))
def test_every_number_can_be_an_argument(impulse: tuple[float, float, float]) -> None:
    params = parsed("push", *map(repr, impulse))
    assert (params["x"], params["y"], params["z"]) == impulse


@pytest.mark.parametrize(
    "arguments",
    [
        ["nothing"],
        ["push", "1", "2"],
        ["push", "a", "0", "0"],
        ["push", "1", "2", "3", "--hard"],
        ["arm", "middle", "hang"],
        ["hand", "middle", "close"],
        ["up", "--rtf", "-1"],
        ["up", "--rtf", "nan"],
        ["up", "--bag-ring", "inf"],
        ["push", "0", "nan", "0"],
        ["walk", "--vx", "nan"],
        ["step", "--to", "0", "-inf", "0"],
        ["topic", "hz", "/x", "--for", "inf"],
        ["bag", "play", "/nowhere.mcap", "--rate", "nan"],
        ["up", "--seed", "-1"],
        ["demo", "walk", "--seed", "-1"],
        ["up", "--clock", "sundial"],
        ["logs", "-n", "-3"],
        ["status", "--instance"],
    ],
)
def test_a_wrong_command_line_is_status_2(arguments: list[str]) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "Error" in result.output


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["up", "--world", "dirty"], "dirt"),
        (["up", "--robot", "escer"], "escher"),
        (["up", "--profile", "hardwear"], "hardware"),
        (["up", "--initial-mode", "stnad"], "stand"),
        (["up", "--actuators", "idael"], "ideal"),
        (["logs", "motion_manger"], "motion_manager"),
        (["experiment", "traking"], "tracking"),
    ],
)
def test_what_is_nearly_right_is_guessed(
    arguments: list[str],
    meant: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["valorctl", *arguments])
    assert main() == 1
    assert f"did you mean {meant!r}?" in capsys.readouterr().err


@pytest.mark.parametrize("mode", ["fly", "walk"])  # unknown; and not to be reached from where the robot comes up
def test_an_initial_mode_that_cannot_be_starts_nothing(
    mode: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["valorctl", "up", "--initial-mode", mode])
    assert main() == 1
    assert "--initial-mode" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_too_few_descriptors_take_one_line(tmp_path: Path) -> None:
    valorctl = Path(sys.executable).with_name("valorctl")
    told = subprocess.run(
        ["/bin/sh", "-c", f'ulimit -n 64; exec "{valorctl}" up'],
        env=os.environ | {"VALOR_HOME": str(tmp_path)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert told.returncode == 1
    assert told.stderr == "valorctl: a process may open 64 files here (ulimit -Hn); expected at least 256\n"
    assert list(tmp_path.iterdir()) == []


def test_down_says_how_to_get_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["valorctl", "status", "--instance", "lab"])
    assert main() == 1
    assert "`valorctl up --instance lab`" in capsys.readouterr().err


@pytest.mark.parametrize("options", [["--out", "x"], ["--robot", "thor"], ["--rtf", "0"]])
def test_options_of_demo_walk_are_expected_behind_it(options: list[str]) -> None:
    result = CliRunner().invoke(app, ["demo", *options, "walk", "--distance", "1"])
    assert str(result.exception) == "options of `demo walk` are expected behind it"


def test_the_environment_survives_a_shell(tmp_path: Path) -> None:
    home = tmp_path / 'it\'s a $HOME; with "quotes" `x`'
    instance = Instance("x", home)
    instance.folder.mkdir(parents=True)
    instance.settings_file.write_text(Settings(robot=tmp_path, ros_domain_id=7).json())
    script = exports(instance) + '\nprintf "%s" "$BIFROST_NETWORK"'
    told = subprocess.run(
        ["/bin/sh", "-c", script], capture_output=True, text=True, check=True, env={"PATH": os.defpath}
    )
    assert told.stdout == str(instance.network_file)
    assert all(line.startswith("export ") and len(shlex.split(line)) == 2 for line in exports(instance).splitlines())


def test_mode_flags_have_names() -> None:
    assert flag_names(0) == []
    assert flag_names(2 | 2048) == ["MODE_REJECTED", "ERR_INVALID_TRANSITION"]
    assert flag_names(1 | 1 << 20) == ["MODE_ACCEPTED", "0x100000"]


def test_the_flags_are_those_of_the_message() -> None:
    from vigir_humanoid_control_msgs.msg import ControlModeStatus

    assert {flag.name: flag.value for flag in ModeStatus} == {
        name: getattr(ControlModeStatus, name)
        for name in dir(ControlModeStatus)
        if name.startswith(("MODE_", "ERR_", "EXTERNAL_"))
    }


@pytest.mark.parametrize(
    ("status", "current", "reached"),
    [
        (ModeStatus.MODE_ACCEPTED, "stand", True),
        (ModeStatus.MODE_DUPLICATE, "stand", True),
        (ModeStatus.MODE_ACCEPTED, "freeze", False),
        (ModeStatus.MODE_REJECTED | ModeStatus.ERR_INVALID_TRANSITION, "stand_prep", False),
        (ModeStatus.MODE_REJECTED, "stand", False),
    ],
)
def test_a_mode_is_reached_when_it_is_the_current_one(status: int, current: str, reached: bool) -> None:
    change = ModeChange("stand", current, status, 0.1, "leg tired")
    assert change.reached is reached
    assert ("refused" in change.describe()) is not reached
    assert ("leg tired" in change.describe()) is not reached


@pytest.mark.parametrize(
    "arguments",
    [
        ["status"],
        ["mode"],
        ["mode", "stand"],
        ["arm", "left", "forward"],
        ["hand", "left", "close"],
        ["push", "1", "2", "3"],
        ["walk", "--vx", "-0.2"],
        ["walk", "--for", "2"],
        ["restart", "bifrostd"],
        ["logs"],
        ["logs", "nobody"],
        ["env"],
        ["topic", "list"],
        ["bag", "info", "/nowhere.mcap"],
        ["bag", "recover", "/nowhere.mcap"],
        ["bag", "snap"],
        ["bag", "csv", "/nowhere.mcap"],
        ["bag", "play", "/nowhere.mcap"],
        ["bag", "play", "/nowhere.mcap", "--rate", "0"],
        ["up", "--bag-split", "7 parsecs"],
        ["up", "--bag-ring", "0"],
        ["up", "--profile", "moon"],
        ["up", "--robot", "/nowhere"],
        ["status", "--instance", "No Name"],
    ],
)
def test_what_is_foreseeable_takes_one_line(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for name in ("VALOR_INSTANCE", "BIFROST_NETWORK", "BIFROST_KEYS"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["valorctl", *arguments])
    assert main() == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("valorctl: ")
    assert err.count("\n") == 1


def test_down_of_what_is_not_up_is_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setenv("VALOR_INSTANCE", "")
    monkeypatch.setattr("sys.argv", ["valorctl", "down"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)
    assert "not up" in capsys.readouterr().out


def test_every_topic_and_service_is_in_the_catalogue(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    instance = Instance.from_environment()
    instance.folder.mkdir()
    instance.settings_file.write_text(Settings(robot=ROBOTS / "escher", control_rate=250.0, ros_domain_id=1).json())
    topics, services = catalogue("topic", None).entries, catalogue("service", None).entries
    assert topics.keys() == {row.name for row in TOPICS} and services.keys() == {row.name for row in SERVICE_TOPICS}
    assert topics[MOTOR.name]["rate_hz"] == 250.0
    assert topics[MOTOR.name]["may_publish"] == list(MOTOR.publishers)
