"""The command line: shared option in any position, negative numbers, quoting, errors, signals."""

import os
import shlex
import signal
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
from tests.conftest import Valorctl
from valor.common.instance import Instance, Settings
from valor.common.messages import ModeStatus
from valor.common.topics import MOTOR, SERVICE_TOPICS, TOPICS
from valor.valorctl.drive.control_mode import ModeChange
from valor.valorctl.status.bifrost_verbs import catalogue
from valor.valorctl.status.observation_verbs import exports
from valor.valorctl.terminal.app import app, hoist_instance

pytestmark = pytest.mark.portable

COMMAND: Any = typer.main.get_command(app)


@pytest.fixture
def call(valorctl: Valorctl, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Valorctl:
    """In an empty home."""
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    for name in ("VALOR_INSTANCE", "BIFROST_NETWORK", "BIFROST_KEYS"):
        monkeypatch.setenv(name, "")
    return valorctl


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
def test_the_instance_option_may_have_any_position(given: list[str], hoisted: list[str]) -> None:
    assert hoist_instance(given) == hoisted


@pytest.mark.parametrize("arguments", [["--instance", "x", "env"], ["env", "--instance", "x"]])
def test_a_named_instance_is_used(arguments: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setenv("VALOR_INSTANCE", "other")
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "instance.json").write_text(Settings(robot=tmp_path, ros_domain_id=7).json())
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "export VALOR_INSTANCE=x\n" in result.output and "export ROS_DOMAIN_ID=7\n" in result.output


@pytest.mark.parametrize("arguments", [["--instance", "x", "topic", "list"], ["topic", "list", "--instance", "x"]])
def test_bifrost_verbs_use_the_named_instance(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, call: Valorctl
) -> None:
    for name in ("VALOR_INSTANCE", "BIFROST_NETWORK", "BIFROST_KEYS"):
        monkeypatch.setenv(name, "other")
    status, _, err = call(*arguments)
    assert status == 1 and "instance 'x' is not up" in err


@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3))
def test_every_number_can_be_an_argument(impulse: tuple[float, float, float]) -> None:
    arguments = [*map(repr, impulse)]
    context = COMMAND.make_context("valorctl", ["push", *arguments])
    params = COMMAND.get_command(context, "push").make_context("push", arguments, parent=context).params
    assert (params["x"], params["y"], params["z"]) == impulse


@pytest.mark.parametrize(
    "arguments",
    [
        ["nothing"], ["push", "1", "2"], ["arm", "middle", "hang"], ["up", "--rtf", "-1"], ["push", "0", "nan", "0"],
        ["step", "--to", "0", "-inf", "0"], ["up", "--clock", "sundial"], ["status", "--instance"],
    ],
)  # fmt: skip
def test_a_wrong_command_line_is_status_2(arguments: list[str]) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2 and "Error" in result.output


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["up", "--world", "dirty"], "did you mean 'dirt'?"),
        (["up", "--initial-mode", "stnad"], "did you mean 'stand'?"),
        (["logs", "motion_manger"], "did you mean 'motion_manager'?"),
        (["up", "--initial-mode", "walk"], "--initial-mode"),  # not reachable after the start
        (["status", "--instance", "lab"], "`valorctl up --instance lab`"),
    ],
)
def test_errors_state_the_remedy_and_start_nothing(
    arguments: list[str], part: str, call: Valorctl, tmp_path: Path
) -> None:
    status, _, err = call(*arguments)
    assert status == 1 and part in err
    assert list(tmp_path.iterdir()) == []


def test_too_few_descriptors_are_reported_in_one_line(tmp_path: Path) -> None:
    valorctl = Path(sys.executable).with_name("valorctl")
    reported = subprocess.run(
        ["/bin/sh", "-c", f'ulimit -n 64; exec "{valorctl}" up'],
        env=os.environ | {"VALOR_HOME": str(tmp_path)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert reported.returncode == 1
    assert reported.stderr == "valorctl: a process may open 64 files here (ulimit -Hn); expected at least 256\n"
    assert list(tmp_path.iterdir()) == []


def test_the_environment_survives_a_shell(tmp_path: Path) -> None:
    home = tmp_path / 'it\'s a $HOME; with "quotes" `x`'
    instance = Instance("x", home)
    instance.folder.mkdir(parents=True)
    instance.settings_file.write_text(Settings(robot=tmp_path, ros_domain_id=7).json())
    script = exports(instance) + '\nprintf "%s" "$BIFROST_NETWORK"'
    reported = subprocess.run(
        ["/bin/sh", "-c", script], capture_output=True, text=True, check=True, env={"PATH": os.defpath}
    )
    assert reported.stdout == str(instance.network_file)
    assert all(line.startswith("export ") and len(shlex.split(line)) == 2 for line in exports(instance).splitlines())


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
    assert change.reached is reached and ("rejected" in change.describe()) is not reached
    assert ("leg tired" in change.describe()) is not reached


@pytest.mark.parametrize(
    "arguments",
    [
        ["status"], ["topic", "list"], ["bag", "info", "/nowhere.mcap"], ["up", "--bag-split", "7 parsecs"],
        ["up", "--bag-ring", "0"], ["up", "--robot", "/nowhere"], ["status", "--instance", "No Name"],
    ],
)  # fmt: skip
def test_foreseeable_errors_take_one_line(arguments: list[str], call: Valorctl) -> None:
    status, out, err = call(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("valorctl: ") and err.count("\n") == 1


def test_every_topic_and_service_is_in_the_catalogue(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    instance = Instance.from_environment()
    instance.folder.mkdir()
    instance.settings_file.write_text(Settings(robot=ROBOTS / "escher", control_rate=250.0, ros_domain_id=1).json())
    topics, services = catalogue("topic", None).read(), catalogue("service", None).read()
    assert topics.keys() == {row.name for row in TOPICS} and services.keys() == {row.name for row in SERVICE_TOPICS}
    assert topics[MOTOR.name]["rate_hz"] == 250.0 and topics[MOTOR.name]["may_publish"] == list(MOTOR.publishers)


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda signum: signum.name)
def test_a_signal_during_imports_ends_in_one_line(signum: signal.Signals) -> None:
    code = (
        f"import os, signal, sys; signal.signal({int(signum)}, signal.SIG_DFL)  # nohup has one of them ignored\n"
        "from valor.valorctl import __main__ as valorctl\n"
        "class Import:\n"
        f"    def find_spec(self, name, *_): os.kill(os.getpid(), {int(signum)}) if name == 'typer' else None\n"
        "sys.meta_path.insert(0, Import())\n"
        "sys.argv[1:] = ['up', '-h']\n"
        "sys.exit(valorctl.main())"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (128 + signum, f"valorctl: interrupted by {signum.name}\n")
