"""``demo door`` as a person runs it: the robot walks up to a door and opens it; one that cannot is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from harness.places import ROBOTS
from harness.system import System, leftovers, shared_memory
from valor.analysis.bag import Bag
from valor.tasks.known import TASKS
from valor.valorctl import task_demonstration


@pytest.fixture
def system(home: Path) -> System:
    return System(task_demonstration.name("door"), home)


def test_opens_the_door_and_leaves_a_bag_a_report_and_nothing_else(system: System, home: Path) -> None:
    before = shared_memory()
    out = home / "out"
    told = system.valorctl("demo", "door", "--seed", "1", "--rtf", "0", "--out", str(out), timeout=500.0).stdout
    report = json.loads((out / "door.json").read_text())
    assert report["turned_deg"] > 10.0
    assert f"the leaf has been turned by {report['turned_deg']:.0f}°" in told
    assert [move["name"] for move in report["moves"]][:3] == ["reach out", "over the lever", "turn the lever"]
    assert Bag(out / "door.mcap").origin["world"] == "door"
    assert leftovers(home, system.name, before) == []


def test_a_robot_without_the_fingers_for_it_is_refused_before_anything_starts(system: System, home: Path) -> None:
    folder = home / "robot"
    folder.mkdir()
    table = yaml.safe_load((ROBOTS / "escher" / "robot.yaml").read_text())
    table["hand_presets"] = {}
    (folder / "robot.yaml").write_text(yaml.safe_dump(table))
    (folder / "model.xml").write_text((ROBOTS / "escher" / "model.xml").read_text())
    for task in TASKS:
        told = system.valorctl("demo", task, "--robot", str(folder), "--out", str(home / "out"), expect=1).stderr
        assert f"{task}: robot 'escher' has no preset" in told
        assert len(told.strip().splitlines()) == 1
    assert not (home / "out").exists()
