"""The controller of docs/controllers.md: installed as the page says, it takes over from the Whole-Body Controller."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from harness.closed_loop import load_robot
from harness.places import REPOSITORY, ROBOTS
from harness.robot_in_process import RobotInProcess
from valor.common.behaviors import Behavior
from valor.common.errors import ConfigurationError
from valor.motion_manager.controllers import controller_factories
from valor.robot.motion_tables import WHOLE_BODY
from valor.valorctl.robots.robot_check import examine


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Its name; as `pip install` leaves it."""
    page = (REPOSITORY / "docs" / "controllers.md").read_text()
    (tmp_path / "statue.py").write_text(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1])  # type: ignore[index]
    project = tomllib.loads(re.search(r"```toml\n(.*?)```", page, re.DOTALL)[1])["project"]  # type: ignore[index]
    info = tmp_path / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    ((group, entries),) = project["entry-points"].items()
    ((name, value),) = entries.items()
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    return str(name)


def test_it_takes_over(installed: str) -> None:
    robot = load_robot(controllers={"stand": [WHOLE_BODY, installed]})
    loop = RobotInProcess(robot, "hardware", 1, others=controller_factories(robot))
    exchange = loop.manager.components.exchange
    assert not loop.stand_up()
    loop.run(0.5)
    assert not exchange.choose(installed, loop.manager.components.state)
    loop.run(1.0)
    assert exchange.active.name == installed and loop.behavior is Behavior.STAND


def test_a_name_that_nothing_has_is_rejected(tmp_path: Path) -> None:
    words = "no controller 'statue'; expected whole_body, remote, an installed one"
    with pytest.raises(ConfigurationError, match=words):
        controller_factories(load_robot(controllers={"stand": [WHOLE_BODY, "statue"]}))
    folder = tmp_path / "escher"
    shutil.copytree(ROBOTS / "escher", folder)
    with (folder / "robot.yaml").open("a") as table:
        table.write("controllers: { walk: [whole_body, statue] }\n")
    (fault,) = examine(folder).faults
    assert re.search(rf"robot.yaml:\d+:.*{words}", str(fault))
