"""What comes with the code is found by name, and what does not, by its path."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.places import REPOSITORY
from valor.common import resources
from valor.common.errors import ConfigurationError
from valor.robot import step_plan

PLANS = REPOSITORY / "examples" / "plans"


@pytest.mark.parametrize("name", sorted(file.stem for file in PLANS.glob("*.yaml")))
def test_every_example_plan_is_found_by_name_and_can_be_read(name: str) -> None:
    file = resources.plan_file(name)
    assert file == PLANS / f"{name}.yaml"
    assert step_plan.load(file).steps


def test_any_other_plan_is_found_by_its_path(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.touch()
    assert resources.plan_file(str(file)) == file


def test_a_plan_that_is_not_there_is_named_beside_those_that_are() -> None:
    with pytest.raises(ConfigurationError, match=r"plan 'circle': expected a file, or one of arc, .*turn_right"):
        resources.plan_file("circle")


def test_an_example_that_is_not_there_is_named() -> None:
    with pytest.raises(ConfigurationError, match=r"examples/dance.py: not found"):
        resources.example_file("dance.py")
