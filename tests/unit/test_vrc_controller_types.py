"""Types in controllers.yaml: those of the VRC, and of installed packages as docs/valor_ros_controller.md has one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from harness.closed_loop import load_robot
from harness.places import REPOSITORY
from valor.common.errors import ConfigurationError
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controller_manager import Resources
from valor.valor_ros_controller.controllers.table import FILE, TYPES, ControllersTable, make_controllers
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

KNOWN = ", ".join(TYPES)


def with_sway(folder: Path, entry: str) -> Path:
    """The VRC's own table, and another controller in its last line."""
    file = folder / "controllers.yaml"
    file.write_text(FILE.read_text() + f"  sway: {entry}\n")
    return file


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{ type: my_controllers/Sway }", f"sway.type: unknown type 'my_controllers/Sway': expected one of {KNOWN}"),
        ("{ groups: [torso] }", f"sway.type: got None; expected one of {KNOWN}"),
        ("{ type: valor_ros_controller/GravityOffset, gain: 1 }", "sway.gain: unknown key"),
    ],
)
def test_a_wrong_entry_is_rejected_with_file_line_and_value(tmp_path: Path, entry: str, words: str) -> None:
    file = with_sway(tmp_path, entry)
    line = len(file.read_text().splitlines())
    with pytest.raises(ConfigurationError) as error:
        ControllersTable.load(file)
    assert f"{file}:{line}:" in str(error.value) and f"robot_controllers.{words}" in str(error.value)


def test_an_installed_type_is_made_with_its_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (REPOSITORY / "docs" / "valor_ros_controller.md").read_text()
    (tmp_path / "sway.py").write_text(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1])  # type: ignore[index]
    info = tmp_path / "sway-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: sway\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[valor.ros_controllers]\nmy_controllers/Sway = sway:Sway\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    robot = load_robot()
    table = ControllersTable.load(with_sway(tmp_path, "{ type: my_controllers/Sway, groups: [torso], amplitude: 0.1 }"))
    resources = Resources(ValorEscherHWInterface(robot), ControlModeTable.load())
    made = {each.name: each for each in make_controllers(table.of(robot).robot_controllers, resources)}
    assert made["sway"].type == "my_controllers/Sway" and made["sway"].amplitude == 0.1  # type: ignore[attr-defined]
    with pytest.raises(ConfigurationError, match=r"sway.amplitude: expected, but missing"):
        ControllersTable.load(with_sway(tmp_path, "{ type: my_controllers/Sway, groups: [torso] }"))
