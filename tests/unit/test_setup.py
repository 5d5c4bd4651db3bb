"""`make setup` means the Python that it is given."""

import os
import subprocess
from pathlib import Path

import pytest

from harness.places import REPOSITORY


def interpreter(file: Path, answer: str, status: int = 0) -> Path:
    """A program that reports what an interpreter would, whatever it is asked."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\necho {answer}\nexit {status}\n")
    file.chmod(0o755)
    return file


def make(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run make, as from a shell: what a make around these tests was given is not handed on."""
    reported = ("MAKEFLAGS", "MAKEOVERRIDES", "MAKELEVEL", "MFLAGS", "PYTHON", "VENV")
    environment = {name: value for name, value in os.environ.items() if name not in reported}
    return subprocess.run(
        ["make", *arguments], cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [("3.10-usr", "is Python 3.10"), ("3.15-usr", "is Python 3.15"), ("", "is no Python that runs here")],
)
def test_a_python_that_cannot_be_used_is_named_in_one_line(answer: str, complaint: str, tmp_path: Path) -> None:
    python = interpreter(tmp_path / "python", answer)
    result = make("setup", f"PYTHON={python}", f"VENV={tmp_path}/env")
    complaints = [line for line in result.stderr.splitlines() if not line.startswith("make:")]
    assert result.returncode != 0
    assert complaints == [
        f"make setup: {python} {complaint}, needed is one of 3.11 3.12 3.13 3.14: make setup PYTHON=python3.12"
    ]
    assert not (tmp_path / "env").exists()


def test_another_python_has_the_environment_made_anew_and_none_keeps_it(tmp_path: Path) -> None:
    environment = tmp_path / "env"
    interpreter(environment / "bin" / "python", "3.12-own")
    (environment / "made-with-3.12-own").touch()
    interpreter(tmp_path / "other", "3.12-other")
    made = make("--dry-run", "setup", f"VENV={environment}", f"PYTHON={tmp_path}/other")
    command = next(line for line in made.stdout.splitlines() if "venv --quiet --clear" in line)
    assert f"{tmp_path}/other" in command and command.endswith(f" {environment}")
    kept = make("--dry-run", "setup", f"VENV={environment}")
    assert kept.returncode == 0 and "--clear" not in kept.stdout
