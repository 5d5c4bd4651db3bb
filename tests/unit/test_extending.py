"""The changes of docs/extending.md, each applied to a copy of the tree, and what is said to be true then."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from harness.places import REPOSITORY

TREE = ("bifrost", "deploy", "harness", "robots", "services", "thesis", "valor")
CHANGES = {
    title: (diff, check)
    for title, diff, check in re.findall(
        r"^## (.+?)\n.*?^```diff\n(.*?)^```\n.*?^```python\n(.*?)^```\n",
        (REPOSITORY / "docs" / "extending.md").read_text(),
        re.MULTILINE | re.DOTALL,
    )
}


def test_every_section_has_a_change() -> None:
    text = (REPOSITORY / "docs" / "extending.md").read_text()
    assert list(CHANGES) == re.findall(r"^## (.+)$", text, re.MULTILINE)


@pytest.mark.parametrize("title", CHANGES)
def test_the_change_applies_and_does_what_is_said(title: str, tmp_path: Path) -> None:
    diff, check = CHANGES[title]
    for folder in TREE:
        ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
        shutil.copytree(REPOSITORY / folder, tmp_path / folder, symlinks=True, ignore=ignored)
    run(tmp_path, ["git", "apply", "-C1", "--recount", "-"], diff)
    run(tmp_path, [sys.executable, "-c", check], "")


def run(folder: Path, command: list[str], given: str) -> None:
    """Run a command of the copy; what it prints is shown when it fails."""
    environment = os.environ | {"PYTHONPATH": str(folder), "GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(
        command, cwd=folder, env=environment, input=given, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, f"{command[0]}: {done.stdout}{done.stderr}"
