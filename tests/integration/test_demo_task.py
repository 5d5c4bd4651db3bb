"""``demo door`` as a person runs it: up to a door, and open. Who cannot is refused; what is shut is left alone."""

import json
import re
from pathlib import Path

import pytest

from harness.closed_loop import load_robot
from harness.system import System, leftovers, shared_memory
from harness.task_robot import TaskRobot
from valor.analysis.reading.bag import Bag
from valor.common.behaviors import Behavior
from valor.manipulation import door, valve
from valor.manipulation.known import TASKS

TURNED = {door.NAME: 0.02, valve.NAME: 0.05}  # at most, of what does not give [rad]


@pytest.fixture
def system(home: Path) -> System:
    return System("demo-door", home)


def test_opens_the_door_and_leaves_a_bag_a_report_and_nothing_else(system: System, home: Path) -> None:
    before = shared_memory()
    out = home / "out"
    output = system.valorctl("demo", "door", "--seed", "1", "--rtf", "0", "--out", str(out), timeout=500.0).stdout
    report = json.loads((out / "door.json").read_text())
    assert report["turned_deg"] > 10.0 and f"the leaf has been turned by {report['turned_deg']:.0f}°" in output
    assert [move["name"] for move in report["moves"]][:3] == ["reach out", "over the lever", "turn the lever"]
    assert Bag(out / "door.mcap").origin["world"] == "door"
    assert leftovers(home, system.name, before) == []


@pytest.mark.parametrize("task", TASKS)
def test_a_fixture_that_is_shut_is_left_alone_with_the_reason_and_the_robot_stands_on(task: str) -> None:
    robot = TaskRobot(load_robot(), "hardware", 0, task, shut=True)
    outcome = robot.do()
    assert not outcome.done and not outcome.fell
    reason = rf".*: {robot.plan.resisted}: it presses or lifts with \d+ N; expected at most 60 N"
    assert re.fullmatch(reason, outcome.reason)
    assert outcome.states[-3][1] == "resisted" and [name for name, _ in outcome.states[-2:]] == ["back", "off"]
    assert robot.behavior is Behavior.STAND_MANIPULATE
    if task == door.NAME:  # a spoke may keep the thumb
        assert not robot.manager.components.hand_contacts.touching
    assert abs(outcome.turned) < TURNED[task]
