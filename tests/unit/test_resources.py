"""Resources are found by name, other files by path."""

from pathlib import Path

import pytest

from harness.places import REPOSITORY
from valor.common import resources
from valor.common.errors import ConfigurationError
from valor.robot import step_plan


@pytest.mark.parametrize("name", resources.names("plan"))
def test_every_example_plan_is_found_by_name_and_can_be_read(name: str) -> None:
    file = resources.file_of("plan", name)
    assert file == REPOSITORY / "examples" / "plans" / f"{name}.yaml" and step_plan.load(file).steps


def test_other_files_are_found_by_path_and_missing_ones_named(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.touch()
    assert resources.file_of("plan", str(file)) == file
    with pytest.raises(ConfigurationError, match=r"examples/dance.py: not found"):
        resources.example_file("dance.py")
    with pytest.raises(ConfigurationError, match=r"plan 'circle': expected a .yaml file, or one of arc, .*turn_right"):
        resources.file_of("plan", "circle")
