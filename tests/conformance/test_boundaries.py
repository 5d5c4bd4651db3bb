"""The boundaries of the architecture: who may import whom, and which modules the processes of the table name."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from harness.places import REPOSITORY
from valor.common.processes import DAEMON, PROCESSES
from valor.common.topics import SERVICE_TOPICS, STATISTICS, TOPICS

LINT_IMPORTS = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]


def test_import_contracts_hold() -> None:
    result = subprocess.run([*LINT_IMPORTS, "--no-cache"], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_import_contracts_can_fail(tmp_path: Path) -> None:
    """A Motion Manager that imports rclpy is caught: the contract is not an empty promise."""
    (tmp_path / "bifrost").symlink_to(REPOSITORY / "bifrost")
    shutil.copytree(REPOSITORY / "valor", tmp_path / "valor", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "valor" / "motion_manager" / "smuggled.py").write_text("import rclpy\n")
    result = subprocess.run(
        [*LINT_IMPORTS, "--no-cache", "--config", str(REPOSITORY / "pyproject.toml")], cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 1, result.stdout + result.stderr
    assert "valor.motion_manager.smuggled -> rclpy" in result.stdout


@pytest.mark.parametrize("process", PROCESSES, ids=lambda process: process.name)
def test_process_table_names_real_modules_and_processes(process) -> None:  # type: ignore[no-untyped-def]
    main = process.module if process.module.count(".") else f"{process.module}.__main__"
    assert importlib.util.find_spec(main), f"{process.name}: no module {main}"
    assert {*process.needs, *process.after, *process.spokesmen} <= {other.name for other in PROCESSES}


def test_every_service_of_the_table_has_statistics_and_topics_name_their_publisher() -> None:
    names = {process.name for process in PROCESSES}
    assert set(STATISTICS) == names - {DAEMON}
    assert {topic.owner for topic in TOPICS} | {topic.owner for topic in SERVICE_TOPICS} <= names
    every = [topic.name for topic in TOPICS] + [topic.name for topic in SERVICE_TOPICS]
    assert len(every) == len(set(every))


def test_the_table_of_client_tests_names_tests_that_exist() -> None:
    command = [sys.executable, ".ci/clients", "all"]
    listed = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert listed.stdout and not listed.stderr
